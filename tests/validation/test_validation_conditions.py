"""When effects are seen, and what is kept apart: rules 9 to 12, and Definition 3."""

import pytest
from unified_planning.model import (
    ClosedTimeInterval,
    GlobalEndTiming,
    GlobalStartTiming,
    RightOpenTimeInterval,
    Timing,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule
from unified_planning.shortcuts import (
    LE,
    BoolType,
    Not,
    OneshotPlanner,
)

from tests.oracles import brute_force_schedule
from tests.validation.schedule_kit import INTERVALS, judge, kinds
from up_samp.validation import validate_schedule


def one_reads_one_writes(write, interval, wants, initial=False, sets=True):
    """r = [5, 10] wants f == ``wants`` over its interval; w sets f at ``write``."""
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=initial)
    w, r = pb.add_activity("w", duration=1), pb.add_activity("r", duration=5)
    w.add_effect(w.end, f, sets)
    r.add_condition(
        INTERVALS[interval](Timing(0, r.start), Timing(0, r.end)), f if wants else Not(f)
    )
    return judge(pb, {w: (write - 1, write), r: (5, 10)})


@pytest.mark.parametrize(
    ("interval", "write", "wants", "valid"),
    [
        # as aries 0.5.0 answers, each tried
        ("[]", 4, True, True),
        ("[]", 5, True, False),
        ("[]", 10, False, False),
        ("[]", 11, False, True),
        ("()", 5, True, True),
        ("()", 6, True, False),
        ("()", 9, False, False),
        ("()", 10, False, True),
        ("(]", 5, True, True),
        ("(]", 10, False, False),
        ("(]", 11, False, True),
        ("[)", 5, True, False),
        ("[)", 9, False, False),
        ("[)", 10, False, True),
    ],
)
def test_other_activities_effects(interval, write, wants, valid):
    assert one_reads_one_writes(write, interval, wants).valid == valid


@pytest.mark.parametrize(("interval", "apart"), [("[]", 4), ("()", 5), ("(]", 5), ("[)", 4)])
def test_kept_apart_whatever_the_value(interval, apart):
    allowed = {t for t in range(3, 13) if one_reads_one_writes(t, interval, True, True).valid}
    ends = {"[]": 11, "()": 10, "(]": 11, "[)": 10}[interval]
    assert allowed == {t for t in range(3, 13) if t <= apart or t >= ends}


@pytest.mark.parametrize(
    ("interval", "write", "wants", "valid"),
    [
        ("[]", 4, True, True),
        ("[]", 5, False, False),
        ("[]", 5, True, False),
        ("[]", 10, False, True),
        ("[]", 9, False, False),
        ("()", 9, False, False),
        ("()", 10, False, True),
        ("()", 5, True, True),
        ("[)", 9, False, False),
        ("[)", 10, False, True),
        ("(]", 10, False, True),
    ],
)
def test_own_effects_are_seen_one_later(interval, write, wants, valid):
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=False)
    a = pb.add_activity("a", duration=5)
    a.add_effect(Timing(write - 5, a.start), f, True)
    a.add_condition(
        INTERVALS[interval](Timing(0, a.start), Timing(0, a.end)), f if wants else Not(f)
    )
    assert judge(pb, {a: (5, 10)}).valid == valid


def test_problem_effects_and_conditions_are_not_kept_apart():
    for t, wants, valid in [(5, False, True), (5, True, False), (6, True, True), (6, False, False)]:
        pb = SchedulingProblem()
        f = pb.add_fluent("f", default_initial_value=False)
        a, b = pb.add_activity("a", duration=1), pb.add_activity("b", duration=5)
        pb.add_effect(5, f, True)
        a.add_condition(a.start, f if wants else Not(f))
        assert judge(pb, {a: (t, t + 1), b: (0, 5)}).valid == valid
        pb = SchedulingProblem()
        f = pb.add_fluent("f", default_initial_value=False)
        b = pb.add_activity("b", duration=5)
        b.add_effect(b.end, f, True)
        pb.add_condition(GlobalStartTiming(t), f if wants else Not(f))
        assert judge(pb, {b: (0, 5)}).valid == valid


def test_definition3_sees_effects_at_once():
    for write, wants, both in [(5, True, (False, True)), (5, False, (False, False))]:
        verdict = one_reads_one_writes(write, "[]", wants)
        assert (verdict.valid, verdict.definition3) == both
    # the activity's own effect at its end is seen at its end
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=False)
    a = pb.add_activity("a", duration=5)
    a.add_effect(a.end, f, True)
    a.add_condition(ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end)), Not(f))
    verdict = judge(pb, {a: (0, 5)})
    assert verdict.valid
    assert not verdict.definition3


def test_global_end():
    for sets, wants in ((True, True), (False, False), (True, False)):
        pb = SchedulingProblem()
        f = pb.add_fluent("f", default_initial_value=not sets)
        a = pb.add_activity("a", duration=5)
        a.add_effect(Timing(3, a.end), f, sets)
        pb.add_condition(GlobalEndTiming(), f if wants else Not(f))
        verdict = judge(pb, {a: (0, 5)})
        assert verdict.valid == verdict.definition3 == (sets == wants)
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=True)
    a = pb.add_activity("a", duration=5)
    a.add_effect(a.end, f, False)
    pb.add_condition(ClosedTimeInterval(GlobalStartTiming(), GlobalEndTiming()), f)
    assert kinds(judge(pb, {a: (0, 5)})) == {"condition"}
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=True)
    a = pb.add_activity("a", duration=5)
    pb.add_effect(GlobalEndTiming(), f, False)
    pb.add_condition(GlobalEndTiming(), Not(f))
    a.add_condition(a.end, f)
    assert judge(pb, {a: (0, 5)}).valid


@pytest.mark.parametrize("set_at", [2, 3, 4, 5])
@pytest.mark.parametrize("owner", ["problem", "own", "other"])
def test_half_open_intervals_are_dense_inside(owner, set_at):
    """A condition over [0, 5): an effect at 4 is seen in (4, 5), one at 5 is not."""
    problem = SchedulingProblem("dense")
    flag = problem.add_fluent("flag", BoolType(), default_initial_value=True)
    a = problem.add_activity("a", duration=5)
    a.add_condition(RightOpenTimeInterval(Timing(0, a.start), Timing(0, a.end)), flag)
    b = problem.add_activity("b", duration=set_at)
    if owner == "problem":
        problem.add_effect(set_at, flag, False)
    elif owner == "own":
        a.add_effect(Timing(set_at, a.start), flag, False)
    else:
        b.add_effect(b.end, flag, False)
    times = {"a": (0, 5), "b": (0, set_at)}
    assignment = {
        t: v for x in (a, b) for t, v in zip((x.start, x.end), times[x.name], strict=True)
    }
    valid = validate_schedule(problem, Schedule([a, b], assignment)).valid
    assert valid == (set_at == 5)
    problem.add_constraint(LE(a.start, 0))
    problem.add_constraint(LE(b.start, 0))
    with OneshotPlanner(name="cpsat") as planner:
        found = planner.solve(problem, timeout=20).plan is not None
    assert found == (set_at == 5)
    assert (brute_force_schedule.solve(problem, 6) is not None) == found
