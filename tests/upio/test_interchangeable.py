"""Activities that are the same but for their names, and what may be said of them."""

import pytest
from unified_planning.model import ClosedTimeInterval, TimePointInterval, Timing
from unified_planning.shortcuts import LE, BoolType, Not, Or, Plus

from tests.metamorphic.motions import MotionStyle, write
from tests.metamorphic.sites import haulage, shop
from tests.upio.hall import Hall
from up_samp.model import CandidateSchedule, Deadline, ScheduleStatus
from up_samp.model.refinement import FirstUsed, Layer, Refinement, Strength
from up_samp.refinement import holds
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio import read_problem, relax, write_refinement
from up_samp.upio.interchangeable import interchangeable
from up_samp.upio.restrict import restricted


def groups(problem):
    return interchangeable(relax(problem, read_problem(problem)))


def test_copies_that_leave_a_place_are_interchangeable(tmp_path):
    site = haulage(0)
    for style in (MotionStyle(moves="leave"), MotionStyle(moves="leave", alone="uses", shuffled=2)):
        found = groups(write(site, style, tmp_path))
        roads = {(r, a) for r in range(2) for (a, _), _ in site.ways(r)}
        assert len(found) == len(roads)
        assert sum(map(len, found)) == sum(len(site.ways(r)) for r in range(2))
        # shuffled, names tell nothing
        alike = [len({name.partition("copy")[0] for name in some}) == 1 for some in found]
        assert style.shuffled or all(alike)


def test_moves_that_may_take_any_road_are_one_set(tmp_path):
    site = shop(0, jobs=1)
    found = groups(write(site, MotionStyle(moves="go", lasts="bounds"), tmp_path))
    assert [len(some) for some in found] == [len(site.ways(r)) for r in range(2)]


def test_what_is_done_by_one_of_two_robots_is_not_the_same(tmp_path):
    assert groups(write(shop(0), MotionStyle(), tmp_path)) == []


@pytest.fixture
def hall(tmp_path):
    """Three copies of one move."""
    hall = Hall(tmp_path, robots=2)
    for i in range(3):
        hall.move(f"out{i}", 0, "left0", "right0", bounds=(9, 50), optional=True)
    return hall


def constrained(hall, how):
    p = hall.problem
    out = [a for a in p.activities if a.name.startswith("out")]
    if how == "one ends early":
        p.add_constraint(LE(out[0].end, 30))
    elif how == "one after another":
        p.add_constraint(LE(out[0].end, out[1].start), [out[0].present, out[1].present])
    elif how == "one lasts longer":
        out[0].set_duration_bounds(10, 50)
    elif how == "one has another obstacle":
        out[0].motion_constraints[0]._static_obstacles = []
    elif how == "somebody else knows it":
        other = p.add_activity("other", 3)
        other.add_constraint(LE(Plus(out[0].end, 2), other.start))
    elif how == "one sets a flag":
        flag = p.add_fluent("flag", BoolType(), default_initial_value=False)
        out[0].add_effect(Timing(0, out[0].end), flag, True)
    elif how.startswith("somebody's"):
        flag = p.add_fluent("flag", BoolType(), default_initial_value=True)
        owner = p if "problem" in how else p.add_activity("other", 3)
        if "needs" in how:
            span = ClosedTimeInterval(Timing(0, out[0].start), Timing(0, out[0].end))
            owner.add_condition(span, flag)
        elif owner is not p:
            owner.add_effect(Timing(0, out[0].end), flag, False)
        else:
            p.add_condition(TimePointInterval(Timing(0, out[0].end)), Not(flag))
    elif how == "one needs a flag":
        flag = p.add_fluent("flag", BoolType(), default_initial_value=False)
        out[0].add_condition(TimePointInterval(Timing(0, out[0].start)), Not(flag))
    else:
        for a in out:
            p.add_constraint(LE(a.end, 30))
        for a, b in ((0, 1), (2, 1), (2, 0)):
            apart = Or(LE(out[a].end, out[b].start), LE(out[b].end, out[a].start))
            p.add_constraint(apart, [out[b].present, out[a].present])
        other = p.add_activity("other", 3)
        p.add_constraint(Or(a.present for a in out), [])
        for a in out:
            other.add_constraint(LE(Plus(a.end, 2), other.start))


@pytest.mark.parametrize(
    "how",
    ["one ends early", "one after another", "one lasts longer", "one has another obstacle",
     "somebody else knows it", "one sets a flag", "one needs a flag",
     "somebody's problem needs it", "somebody's problem at its end", "somebody's activity needs it",
     "somebody's effect at its end"],
)  # fmt: skip
def test_whoever_differs_is_not_among_them(hall, how):
    constrained(hall, how)
    found = groups(hall.problem)
    assert found == [("out1", "out2")] if how != "one after another" else found == []


def test_what_is_said_of_each_alike_tells_no_difference(hall):
    constrained(hall, "all alike")
    assert groups(hall.problem) == [("out0", "out1", "out2")]


def test_the_first_ones_are_used_first(hall):
    constrained(hall, "all alike")
    relaxation = relax(hall.problem, read_problem(hall.problem))
    order = FirstUsed(("out0", "out1", "out2"))
    write_refinement(relaxation, Refinement(order, Layer.BOUND, Strength.PROVEN, "test"))
    session = CpsatSession(relaxation.problem, workers=1)
    report = session.solve(Deadline.after(20))
    assert report.status is ScheduleStatus.OPTIMAL
    assert report.schedule.times.keys() & {"out0", "out1", "out2"} == {"out0"}
    assert holds(order, report.schedule, lambda *_: set())
    times = {"out1": (0, 9), "other": (11, 14)}
    another = CandidateSchedule(times)
    assert not holds(order, another, lambda *_: set())
    late = CandidateSchedule({"out0": (9, 18), "out1": (0, 9)})
    assert not holds(order, late, lambda *_: set())
    # what is decided may be anything that is valid
    rest = restricted(relaxation, another)
    assert CpsatSession(rest, workers=1).solve(Deadline.after(20)).status is ScheduleStatus.OPTIMAL
