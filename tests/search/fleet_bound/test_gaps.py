"""What robots do in turn, what they carry, and the units that they surely lose."""

import pytest
from unified_planning.model import Timing
from unified_planning.model.motion import ActivityWaypoints

from tests.search.fleet_bound.store_fleet import fleet_of
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.geometry import lay_out
from up_samp.search.fleet.jobs import (
    closed,
    find_jobs,
    held_by,
    idle_between,
    stated_gaps,
    stated_precedences,
)
from up_samp.search.fleet_bound.timelines import carried, guaranteed_locations
from up_samp.upio import read_problem


def named(problem, name):
    return next(a for a in problem.activities if a.name == name)


def held_names(problem, name):
    return {str(resource) for resource in held_by(problem)[name]}


def test_a_resource_that_somebody_else_gives_back_is_held_by_nobody():
    problem = warehouse(2, 2, encoding="compact")
    assert held_names(problem, "load_robot0_order0") == {"hands0"}
    assert held_names(problem, "carry_robot1_order1") == {"hands1"}
    lender = problem.add_activity("lender", duration=3, optional=True)
    hands = problem.fluent("hands0")
    lender.add_increase_effect(lender.start, hands, 1)
    lender.add_decrease_effect(lender.end, hands, 1)
    assert held_names(problem, "load_robot0_order0") == set()
    assert held_names(problem, "carry_robot1_order1") == {"hands1"}


def test_a_place_is_sure_as_long_as_nothing_else_sets_its_fluent():
    problem = warehouse(2, 2, encoding="compact")
    snapshot, _ = lay_out(read_problem(problem))
    sure = guaranteed_locations(problem, snapshot)
    assert sure.places["carry_robot0_order0", "robot0"].startswith("slot")
    assert "unload_robot0_order0" in sure.reads
    fluent = problem.fluent("robot_at")
    robot, dock = problem.object("robot0"), problem.object("dock1")
    wrong = problem.add_activity("wrong", duration=1, optional=True)
    wrong.add_effect(wrong.end, fluent(robot), dock)
    assert not {robot for _, robot in guaranteed_locations(problem, snapshot).places} & {"robot0"}


def test_who_drives_to_wherever_a_fluent_says_is_surely_nowhere():
    problem = warehouse(2, 2, encoding="compact")
    robot, body = problem.object("robot0"), problem.fluent("robot_at")
    home = problem.add_fluent("home", body.type, default_initial_value=problem.object("dock0"))
    drive = problem.add_motion_activity("anywhere", optional=True)
    drive.set_duration_bounds(1, 90)
    drive.add_motion_constraint(ActivityWaypoints(robot, body(robot), [home()]))
    snapshot, _ = lay_out(read_problem(problem))
    places = guaranteed_locations(problem, snapshot).places
    assert {robot for _, robot in places} == {"robot1"}


def test_what_is_told_only_while_another_one_is_there_is_not_told():
    problem = warehouse(2, 2, encoding="compact")
    told = stated_gaps(problem)
    assert told["load_robot0_order0", "carry_robot0_order0"] == 1
    one, two = (named(problem, f"unload_robot0_order{k}") for k in (0, 1))
    manager = problem.environment.expression_manager
    before = manager.LT(one.end, two.start)
    third = named(problem, "leave_robot1_order0")
    problem.add_constraint(before, [one.present, two.present, third.present])
    assert (one.name, two.name) not in stated_gaps(problem)
    problem.add_constraint(before, [one.present, two.present])
    assert stated_gaps(problem)[one.name, two.name] == 1


def test_an_order_is_told_only_where_one_ends_before_the_other_starts():
    """Not while they may overlap a little, and not while it hangs on somebody else."""
    problem = warehouse(2, 2, encoding="compact")
    one, two, three = (
        named(problem, f"{what}_robot{k}_order{k}")
        for what, k in (("unload", 0), ("unload", 1), ("load", 1))
    )
    manager = problem.environment.expression_manager
    before = stated_precedences(problem)
    problem.add_constraint(manager.LE(Timing(-2, one.end), two.start))
    problem.add_constraint(manager.LE(one.end, two.start), [three.present])
    assert stated_precedences(problem) == before
    problem.add_constraint(manager.LE(Timing(1, one.end), two.start), [two.present])
    assert stated_precedences(problem) == before | {(one.name, two.name)}
    assert (one.name, two.name) in stated_precedences(problem, strictly=True)


@pytest.mark.parametrize("style", ["scope", "implies", "or", "and", "nested"])
def test_an_order_is_told_however_it_is_written(style):
    problem = warehouse(2, 2, encoding="compact")
    one, two = (named(problem, f"unload_robot{k}_order{k}") for k in (0, 1))
    third = named(problem, "leave_robot1_order0")
    manager = problem.environment.expression_manager
    before, other = manager.LE(one.end, two.start), manager.LE(third.start, 90)
    here = [one.present, two.present]
    written = {
        "scope": (before, here),
        "implies": (manager.Implies(manager.And(here[::-1]), before), []),
        "or": (manager.Or(manager.Not(here[1]), before), here[:1]),
        "and": (manager.And(other, manager.Implies(here[0], before)), here[1:]),
        "nested": (manager.Implies(here[0], manager.Implies(here[1], before)), []),
    }
    problem.add_constraint(*written[style])
    assert (one.name, two.name) in stated_gaps(problem)


@pytest.mark.parametrize("style", ["absent", "either", "third"])
def test_no_order_is_told_that_hangs_on_something_else(style):
    problem = warehouse(2, 2, encoding="compact")
    one, two = (named(problem, f"unload_robot{k}_order{k}") for k in (0, 1))
    third = named(problem, "leave_robot1_order0")
    manager = problem.environment.expression_manager
    before = manager.LE(one.end, two.start)
    written = {
        "absent": manager.Implies(manager.Not(third.present), before),
        "either": manager.Or(manager.Not(one.present), third.present, before),
        "third": manager.And(manager.Implies(third.present, before)),
    }
    problem.add_constraint(written[style], [one.present, two.present])
    assert (one.name, two.name) not in stated_gaps(problem)


def test_what_has_to_be_between_follows():
    gaps = closed({("a", "b"): 1, ("b", "c"): 0, ("c", "x"): 3}, {"a", "b", "c"})
    assert gaps == {("a", "b"): 1, ("b", "c"): 0, ("a", "c"): 0}
    needs = frozenset("abc")

    def before(name, others, units):
        return idle_between(name, others, needs, gaps, lambda *pair: units[pair], after=False)

    assert before("a", "xyz", {}) == 0, "it may be the first of all"
    assert before("b", "ax", {("a", "b"): 2, ("x", "b"): 1}) == 1
    # b has to be between a and c
    assert before("c", "ab", {("b", "c"): 4}) == 4


def test_what_is_carried_is_told_by_a_fluent_that_all_heed():
    problem = fleet_of(2, 3).problem
    snapshot, _ = lay_out(read_problem(problem))
    needs = find_jobs(problem, snapshot).needs
    pairs = carried(problem, needs, stated_gaps(problem))
    assert len(pairs) == 6
    assert pairs["deliver_o1_r0"][0] == "pick_o1_r0"
    heedless = named(problem, "pick_o0_r0")
    for conditions in heedless.conditions.values():
        conditions[:] = [c for c in conditions if not c.is_fluent_exp()]
    left = carried(problem, needs, stated_gaps(problem))
    assert {taker for taker, _ in left.values()} == {"pick_o0_r1", "pick_o1_r1", "pick_o2_r1"}
