"""Random schedules, judged as by a naive oracle."""

from hypothesis import given, settings
from hypothesis import strategies as st
from unified_planning.model import (
    Timing,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    Not,
)

from tests.validation.schedule_kit import INTERVALS, judge

small = st.integers(0, 6)


@st.composite
def puzzles(draw):
    """Three activities of 0..3 units that set and read a bool, and use a resource."""
    rows = []
    for _ in range(3):
        rows.append(
            {
                "start": draw(small),
                "length": draw(st.integers(0, 3)),
                "sets": draw(st.none() | st.tuples(st.integers(0, 3), st.booleans())),
                "wants": draw(
                    st.none() | st.tuples(st.sampled_from(list(INTERVALS)), st.booleans())
                ),
                "uses": draw(st.integers(0, 2)),
            }
        )
    return draw(st.booleans()), rows


def build(initial, rows):
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=initial)
    r = pb.add_resource("r", 2)
    times = {}
    for i, row in enumerate(rows):
        a = pb.add_activity(f"a{i}", duration=row["length"])
        if row["sets"]:
            a.add_effect(a.start + row["sets"][0], f, row["sets"][1])
        if row["wants"]:
            span = INTERVALS[row["wants"][0]](Timing(0, a.start), Timing(0, a.end))
            a.add_condition(span, f if row["wants"][1] else Not(f))
        if row["uses"]:
            a.uses(r, row["uses"])
        times[a] = (row["start"], row["start"] + row["length"])
    return pb, times


def oracle(initial, rows, at_once):
    """Tick by tick, as plainly as can be."""
    value, ok = initial, True
    for t in range(15):
        sets = [
            (i, row["sets"][1])
            for i, row in enumerate(rows)
            if row["sets"] and row["start"] + row["sets"][0] == t
        ]
        ok &= len(sets) < 2
        load = sum(row["uses"] for row in rows if row["start"] <= t < row["start"] + row["length"])
        ok &= load <= 2
        if at_once and sets:
            value = sets[-1][1]
        for i, row in enumerate(rows):
            if not row["wants"]:
                continue
            span, wants = row["wants"]
            low = row["start"] + (span[0] == "(")
            high = row["start"] + row["length"] - (span[1] == ")")
            if low <= t <= high:
                ok &= value == wants
                ok &= at_once or all(j == i for j, _ in sets)
        if sets:
            value = sets[-1][1]
    return ok


@settings(max_examples=150, deadline=None, derandomize=True)
@given(puzzles())
def test_agrees_with_a_naive_oracle(puzzle):
    verdict = judge(*build(*puzzle))
    assert verdict.valid == oracle(*puzzle, at_once=False)
    assert verdict.definition3 == oracle(*puzzle, at_once=True)
