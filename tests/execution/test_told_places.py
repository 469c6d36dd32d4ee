"""Where fluents tell obstacles to be is where these are, in what is left of a plan at any instant.

A fluent that is set where a drive ends tells, while its robot is under way, a place that the robot
has left: what is left of the plan would ask others to find it there.
"""

import functools
import itertools

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401
from tests.metamorphic.motions import ALIKE, OTHERS, MotionStyle, MotionWriter
from tests.metamorphic.sites import store
from up_samp.benchmarks import instance
from up_samp.execution import Delays, Executor, dependencies_of, solve_remaining
from up_samp.execution.simulate import Floor
from up_samp.io import plan_from_dict, result_to_dict
from up_samp.upio.expressions import told_by
from up_samp.validation import validate_plan

INSTANCES = ("logistics-do-oc-r2-i2", "logistics-dc-all-r2-i2", "jobshop-r2-j1-m1", "doors-r2-d1")
STYLES = (MotionStyle(shuffled=2, fluents="parameter", alone="level"), MotionStyle(arrive="end"))
MORE = [s for s in (*ALIKE, *OTHERS) if s.obstacles not in ("lists", "none") and s not in STYLES]


@functools.cache
def solved(name):
    """A problem in its published form with fluents, and its first plan."""
    get_environment().credits_stream = None
    problem = instance(name).build("fluents")
    return problem, plan_of(problem)


def plan_of(problem):
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        return result_to_dict(problem, planner.solve(problem, timeout=120))


def told_elsewhere(problem, begun):
    """Return the obstacles of motions whose fluent tells a place where they neither are nor are
    brought by what has begun, with that place.
    """
    stands = {m.object().name: place.object() for m, place in problem.initial_configuration}
    aims = {name: [place] for name, place in stands.items()}
    ways = [(a, c) for a in problem.motion_activities for c in a.motion_constraints]
    for activity, way in ways:
        if activity.name in begun and way.waypoints[-1].is_object_exp():
            aims[way.movable.object().name].append(way.waypoints[-1].object())
    found = set()
    for activity, way in ways:
        for listed in (way.static_obstacles, way.dynamic_obstacles_at_start):
            for movable, value in listed.items() if isinstance(listed, dict) else ():
                place = problem.initial_value(told_by(activity.name, movable, value)).object()
                if not any(near(place, aim) for aim in aims[movable.name]):
                    found.add((movable.name, place.name))
    return found


def near(one, two):
    poses = ([float(v) for v in place.configuration] for place in (one, two))
    return one.type == two.type and next(poses) == pytest.approx(next(poses), abs=1e-2)


def moments(problem, plan, seed, every):
    """Yield what is left every so many seconds of a run, and what has begun of it."""
    found = dependencies_of(problem, plan)
    floor = Floor(Executor(plan, problem, dependencies=found), Delays(slow=0.4, stops=2), seed)
    next_ = 0.0
    while not floor.executive.finished and floor.now < 500:
        if floor.now >= next_:
            next_ += every
            executor = floor.executive
            begun = {n for n in executor.state.phase if executor.phase(n).value == "running"}
            yield executor.remaining_problem(), begun
        floor.step()


@pytest.mark.parametrize("name", INSTANCES[1:3])
def test_obstacles_are_where_they_are_told_to_be(name):
    problem, plan = solved(name)
    looked = 0
    for left, begun in moments(problem, plan, 3, 6.0):
        assert not told_elsewhere(left.problem, begun), left.since
        looked += 1
    assert looked > 3


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", INSTANCES)
def test_they_are_at_many_moments(name, seed):
    problem, plan = solved(name)
    for left, begun in moments(problem, plan, seed, 0.5):
        assert not told_elsewhere(left.problem, begun), left.since


def in_style(style, folder):
    problem = MotionWriter(store(0, robots=2, items=1), style, folder).problem
    for left, begun in moments(problem, plan_of(problem), 1, 2.0):
        assert not told_elsewhere(left.problem, begun), left.since


@pytest.mark.parametrize("style", STYLES, ids=str)
def test_they_are_in_other_styles(style, tmp_path):
    in_style(style, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("style", MORE, ids=str)
def test_they_are_in_every_style(style, tmp_path):
    in_style(style, tmp_path)


def test_what_is_left_while_robots_drive_is_planned_and_valid():
    problem, plan = solved("logistics-do-oc-r2-i2")
    left, begun = [*itertools.islice(moments(problem, plan, 3, 5.0), 2)][-1]
    assert len(begun) == 2
    rest = solve_remaining(left, seconds=60)
    assert validate_plan(left.problem, plan_from_dict(left.problem, rest)).valid


@pytest.mark.long
@pytest.mark.parametrize("name", INSTANCES)
def test_what_is_left_is_planned_and_valid_at_many_moments(name):
    problem, plan = solved(name)
    for left, _ in moments(problem, plan, 1, 10.0):
        rest = solve_remaining(left, seconds=60)
        assert validate_plan(left.problem, plan_from_dict(left.problem, rest)).valid, left.since
