"""Search, schedulers and validator mean the same: obstacles with fluents, shutting doors, loads,
lists that are not mutual. Rules: ``docs/semantics.md``.
"""

import itertools

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import Equals, OneshotPlanner

from tests.upio.hall import Hall
from tests.usual import usually
from up_samp.benchmarks import logistics
from up_samp.validation import validate_plan

ENGINES = ["cpsat", "aries-opt"]
SOLVED = (Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY)


def crossed(name, values, engines=ENGINES):
    """Give each value with an engine of its own; all with all where the slow tests are run."""
    own, pairs = zip(values, engines, strict=True), itertools.product(values, engines)
    return pytest.mark.parametrize((name, "engine"), usually(*own, of=pairs))


def solve(problem, engine="cpsat", timeout=60.0, **params):
    with OneshotPlanner(name=f"samp-refine[{engine}]", params=params) as planner:
        result = planner.solve(problem, timeout=timeout)
    if result.plan is not None:
        assert validate_plan(problem, result.plan).valid
    return result


def span(result, name):
    activity = next(a for a in result.plan.activities if a.name == name)
    return tuple(int(str(result.plan.get(t))) for t in (activity.start, activity.end))


def standing_in_the_gap(folder):
    """A robot stands in the gap that the door, which is open, has to shut."""
    hall = Hall(folder, door=True)
    hall.pose("gap", 10.0, 5.0, 0.0)
    hall.problem.set_initial_configuration(hall.robots[0], hall.poses["gap"])
    hall.problem.initial_configuration[:] = [
        (o, p)
        for o, p in hall.problem.initial_configuration
        if (str(o), str(p)) not in (("r0", "left0"), ("door", "shut"))
    ]
    hall.problem.set_initial_configuration(hall.door, hall.poses["away"])
    shut = hall.problem.add_motion_activity("close", 1)
    shut.add_motion_effect(hall.door, hall.poses["shut"])
    return hall


@pytest.mark.parametrize("engine", usually("cpsat", of=ENGINES))
def test_a_door_waits_for_whoever_stands_in_it(tmp_path, engine):
    hall = standing_in_the_gap(tmp_path)
    hall.move("go", 0, "gap", "right0", optional=True)
    result = solve(hall.problem, engine, optimal=True)
    assert result.status in SOLVED
    assert {a.name for a in result.plan.activities} == {"go", "close"}
    assert span(result, "close")[1] > span(result, "go")[0]


def test_a_door_shuts_when_who_stands_in_it_is_lifted_away(tmp_path):
    """At the same instant, not a unit later: what is learned from a refusal allows that."""
    hall = standing_in_the_gap(tmp_path)
    hall.move("go", 0, "gap", "right0", optional=True, bounds=(100, 200))
    lift = hall.problem.add_motion_activity("lift", 10)
    lift.add_motion_effect(hall.robots[0], hall.poses["left0"])
    result = solve(hall.problem, optimal=True)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert span(result, "lift") == (0, 10)
    assert span(result, "close")[1] == 10
    assert result.metrics["refused"] == "1"


def test_a_door_that_nobody_can_clear_never_shuts(tmp_path):
    hall = standing_in_the_gap(tmp_path)
    hall.move("come", 0, "right0", "gap", optional=True)
    result = solve(hall.problem, optimal=True)
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert "close" in result.log_messages[0].message


@crossed("lists", [("r1", None), (None, "r0")])
def test_lists_that_are_not_mutual(tmp_path, engine, lists):
    """Both have to pass the gap; only one of them names the other."""
    hall = Hall(tmp_path, robots=2)
    byname = {r.name: r for r in hall.robots}
    for k, other in enumerate(lists):
        named = [byname[other]] if other else []
        goal = f"right{1 - k}"
        hall.move(f"go{k}", k, f"left{k}", goal, bounds=(1, 60), dynamic_obstacles_at_start=named)
    assert solve(hall.problem, engine, first_plan=True).status in SOLVED


@crossed("delay", [0, -1])
def test_a_static_door_told_by_its_fluent(tmp_path, engine, delay):
    """As with the list; with the effect at the end the motion waits until the fluent says so."""
    makespans = {}
    for told in ("list", "dict"):
        folder = tmp_path / told
        folder.mkdir()
        hall = Hall(folder, door=True)
        problem, shut, away = hall.problem, hall.poses["shut"], hall.poses["away"]
        at = problem.add_fluent("door_at", hall.place, default_initial_value=shut)
        opening = hall.open_door()
        opening.add_effect(opening.end + delay, at, away)
        static = {hall.door: at} if told == "dict" else [hall.door]
        hall.move("go", 0, "left0", "right0", static_obstacles=static)
        result = solve(problem, engine, optimal=True)
        assert result.status is Status.SOLVED_OPTIMALLY
        makespans[told] = int(result.metrics["makespan"])
    assert makespans["dict"] == makespans["list"] + (delay == 0)


@pytest.mark.parametrize("engine", usually("cpsat", of=ENGINES))
def test_a_carrier_is_not_stopped_by_its_load(tmp_path, engine):
    hall = Hall(tmp_path, door=True)
    # the load is a door leaf that lies in the gap; who carries it away gets through
    carry = hall.move("carry", 0, "left0", "right0")
    hall.pose("shelf", 17.0, 7.0, 0.0)
    carry.add_motion_effect(hall.door, hall.poses["shelf"])
    result = solve(hall.problem, engine, optimal=True)
    assert result.status is Status.SOLVED_OPTIMALLY


@crossed("encoding", ["fluents", "fluents-uses"], ["cpsat", "aries"])
def test_published_logistics_behind_a_door(engine, encoding):
    problem = logistics(2, 2, sides="corridor", encoding=encoding, metric=False)
    assert solve(problem, engine).status in SOLVED


def test_a_refusal_is_learned_from(tmp_path):
    """A fluent that lies about a robot until 3: the validator refuses, the search goes on."""
    hall = Hall(tmp_path, robots=2)
    problem = hall.problem
    left, right = hall.poses["left1"], hall.poses["right1"]
    wrong = hall.pose("wrong", 3.0, 8.5, 0.0)
    at = problem.add_fluent("told", hall.place, default_initial_value=wrong)
    tell = problem.add_activity("tell", 3)
    tell.add_effect(tell.end, at, left)
    told = {hall.robots[1]: at}
    hall.move("go", 0, "left0", "right0", dynamic_obstacles_at_start=told)
    other = hall.move("other", 1, "left1", "right1")
    other.add_condition(other.start, Equals(at, left))
    assert right is not None
    result = solve(problem, first_plan=True, query_seconds=0.15)
    assert result.status in SOLVED
    assert span(result, "go")[0] > 3
    assert int(result.metrics["refused"]) >= 1
