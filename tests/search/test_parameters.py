"""Waypoints that are parameters and fluents: what is learned for one value holds for it only."""

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model import Fluent
from unified_planning.model.motion import ActivityWaypoints
from unified_planning.shortcuts import Equals, Object, Or, UserType

from tests.search.test_end_to_end import solve
from tests.shuffled import shuffled
from tests.upio.hall import Hall, write_hall
from tests.usual import usually
from up_samp.model import UnsupportedError
from up_samp.scheduling.quirks import known_engines
from up_samp.validation import validate_plan

INSTALLED = ["cpsat", *(name for name, _, _ in known_engines())]
PROVING = [name for name in INSTALLED if name != "aries"]


def each(engines, often):
    """Give a test each of the engines; only some of them where the slow tests are not run."""
    often = [engine for engine in often if engine in engines]
    return pytest.mark.parametrize("engine", usually(*often, of=engines))


EACH_INSTALLED = each(INSTALLED, ("cpsat",))
EACH_PROVING = each(PROVING, ("cpsat", "aries-opt"))
MOSTLY_OURS = each(PROVING, ("cpsat",))


def choice_of(hall, name, *places, robot=0, start=None, **keywords):
    """Add a drive whose goal is a parameter ``to`` with a value among ``places``."""
    activity = hall.problem.add_motion_activity(name, 1, keywords.get("optional", False))
    activity.set_duration_bounds(1, 200)
    to = activity.add_parameter("to", hall.place)
    if places:
        hall.problem.add_constraint(Or(Equals(to, hall.poses[p]) for p in places))
    begin = hall.poses[f"left{robot}"] if start is None else start
    activity.add_motion_constraint(ActivityWaypoints(hall.robots[robot], begin, [to]))
    return activity, to


def goal_of(result, activity):
    return str(result.plan.get(activity.parameters[0]))


def makespan(result):
    return int(result.metrics["makespan"])


@EACH_INSTALLED
def test_one_value_lies_in_a_closed_room(tmp_path, engine):
    hall = Hall(tmp_path, map_file=write_hall(tmp_path, wall_gap=None))
    hall.pose("near", 5.5, 3.0, 0.0)
    go, _ = choice_of(hall, "go", "right0", "near")
    result = solve(hall.problem, engine, optimal=engine != "aries")
    assert result.plan is not None, result.log_messages
    assert goal_of(result, go) == "near"
    assert makespan(result) == 5
    assert validate_plan(hall.problem, result.plan).valid


@MOSTLY_OURS
def test_the_nearer_of_two_values_is_taken(tmp_path, engine):
    hall = Hall(tmp_path)
    hall.pose("near", 6.5, 3.0, 0.0)
    go, _ = choice_of(hall, "go", "right0", "near")
    result = solve(hall.problem, engine)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert goal_of(result, go) == "near"
    assert makespan(result) == 6
    assert validate_plan(hall.problem, result.plan).valid


@EACH_INSTALLED
def test_a_deadline_that_only_the_nearer_value_meets(tmp_path, engine):
    hall = Hall(tmp_path)
    hall.pose("near", 6.5, 3.0, 0.0)
    go, _ = choice_of(hall, "go", "right0", "near")
    go.add_deadline(8)
    result = solve(hall.problem, engine, optimal=engine != "aries")
    assert result.plan is not None, result.log_messages
    assert goal_of(result, go) == "near"
    assert makespan(result) == 6


@MOSTLY_OURS
def test_a_waypoint_given_by_a_fluent_that_changes(tmp_path, engine):
    hall = Hall(tmp_path)
    hall.pose("near", 6.5, 3.0, 0.0)
    target = Fluent("target", hall.place)
    hall.problem.add_fluent(target, default_initial_value=hall.poses["right0"])
    switch = hall.problem.add_activity("switch", 1, True)
    switch.add_effect(switch.end, target, hall.poses["near"])
    go = hall.problem.add_motion_activity("go", 1)
    go.set_duration_bounds(1, 200)
    go.add_motion_constraint(ActivityWaypoints(hall.robots[0], hall.poses["left0"], [target()]))
    result = solve(hall.problem, engine)
    assert result.status is Status.SOLVED_OPTIMALLY
    # the switch ends at 1, is seen from 2 on, and the drive takes 6
    assert makespan(result) == 8
    assert validate_plan(hall.problem, result.plan).valid


@MOSTLY_OURS
def test_a_start_given_by_the_parameter_of_another_activity(tmp_path, engine):
    hall = Hall(tmp_path)
    hall.pose("near", 6.5, 3.0, 0.0)
    go, to = choice_of(hall, "go", "right0", "near")
    back = hall.problem.add_motion_activity("back", 1)
    back.set_duration_bounds(1, 200)
    back.add_motion_constraint(ActivityWaypoints(hall.robots[0], to, [hall.poses["left0"]]))
    result = solve(hall.problem, engine)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert goal_of(result, go) == "near"
    assert makespan(result) == 12
    assert validate_plan(hall.problem, result.plan).valid


def named_places(hall):
    """Add names of places, and a fluent that tells where each one is."""
    hall.pose("near", 6.5, 3.0, 0.0)
    sort = UserType("name")
    names = {n: Object(n, sort) for n in ("far", "close")}
    hall.problem.add_objects(names.values())
    told = Fluent("told", hall.place, at=sort)
    hall.problem.add_fluent(told, default_initial_value=hall.poses["right0"])
    hall.problem.set_initial_value(told(names["close"]), hall.poses["near"])
    return names, told


@MOSTLY_OURS
def test_a_waypoint_given_by_a_fluent_of_a_parameter(tmp_path, engine):
    hall = Hall(tmp_path)
    names, told = named_places(hall)
    go = hall.problem.add_motion_activity("go", 1)
    go.set_duration_bounds(1, 200)
    to = go.add_parameter("to", names["far"].type)
    go.add_motion_constraint(ActivityWaypoints(hall.robots[0], hall.poses["left0"], [told(to)]))
    result = solve(hall.problem, engine)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert (goal_of(result, go), makespan(result)) == ("close", 6)
    assert validate_plan(hall.problem, result.plan).valid
    # what the fluent tells of the far one changes
    hall.problem.add_constraint(Equals(to, names["far"]))
    switch = hall.problem.add_activity("switch", 1, True)
    switch.add_effect(switch.end, told(names["far"]), hall.poses["near"])
    result = solve(hall.problem, engine)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert (goal_of(result, go), makespan(result)) == ("far", 8)
    assert validate_plan(hall.problem, result.plan).valid


def test_a_fluent_of_another_activitys_parameter_is_refused_by_name(tmp_path):
    hall = Hall(tmp_path)
    names, told = named_places(hall)
    other = hall.problem.add_activity("other", 1)
    to = other.add_parameter("to", names["far"].type)
    go = hall.problem.add_motion_activity("go", 1)
    go.add_motion_constraint(ActivityWaypoints(hall.robots[0], hall.poses["left0"], [told(to)]))
    with pytest.raises(UnsupportedError, match=r"'go'.*'told\(other\.to\)'.*not 'other\.to'"):
        solve(hall.problem, "cpsat")


@pytest.mark.parametrize("deep", [2.1e-6, 2.4e-6, 5e-6])
@pytest.mark.parametrize("order", range(2))
def test_who_leaves_a_place_by_another_name_of_it_is_gone(deep, order, tmp_path):
    """Names of one pose differ by rounding: by one of them it overlaps whom it would hardly touch
    by the other one.
    """
    hall = Hall(tmp_path, robots=2)
    hall.pose("here", 6.0000004, 3.0, 0.0)
    hall.pose("named", 5.9999996, 3.0, 0.0)
    hall.pose("beside", 7.0000004 - deep, 3.0, 0.0)
    problem, (first, _) = hall.problem, hall.robots
    problem.initial_configuration[:] = problem.initial_configuration[1:]
    problem.set_initial_configuration(first, hall.poses["here"])
    at = problem.add_fluent("at", hall.place, default_initial_value=hall.poses["named"])
    leave = problem.add_motion_activity("leave", 1)
    leave.set_duration_bounds(1, 100)
    leave.add_motion_constraint(ActivityWaypoints(first, at, [hall.poses["left0"]]))
    leave.add_effect(leave.end, at, hall.poses["left0"])
    hall.move("come", 1, "left1", "beside")
    result = solve(shuffled(problem, order, rename=False).problem)
    assert result.plan is not None, result.log_messages
