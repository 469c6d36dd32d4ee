"""Robots that keep formation (rule 27): whoever drives along keeps its own limits, where it is."""

import math
import random

import numpy as np
import pytest
from unified_planning.model.motion import ActivityWaypoints, MotionModels
from unified_planning.shortcuts import LE, OneshotPlanner

from tests.handmade import drive
from tests.upio.hall import Hall, write_hall
from up_samp.io import plan_to_dict
from up_samp.model import CandidateSchedule, Trajectory, UnsupportedError
from up_samp.model.frames import Frame
from up_samp.upio import build_plan, read_problem
from up_samp.validation import validate_plan

LIMITS = {"v_max": 1.0, "a_max": 0.6, "omega_max": 1.2, "drives_along": True}


def two(folder, offset, goal, *, start=(3.0, 5.0, 0.0), limits=LIMITS, **robot):
    """Two robots that drive from ``start`` to ``goal`` as one, the second one at ``offset``."""
    kind = {"motion_model": MotionModels.SE2, "motion_parameters": limits} | robot
    hall = Hall(folder, robots=2, map_file=write_hall(folder, wall_gap=(20, 80)), **kind)
    problem = hall.problem
    for name, pose in (("from", start), ("to", goal)):
        hall.pose(name, *pose)
        hall.pose(f"{name}_beside", *Frame(*pose).of(offset))
    problem.initial_configuration[:] = []
    problem.set_initial_configuration(hall.robots[0], hall.poses["from"])
    problem.set_initial_configuration(hall.robots[1], hall.poses["from_beside"])
    ride = hall.move("both", 0, "from", "to")
    for robot, place in zip(hall.robots, ("to", "to_beside"), strict=True):
        ride.add_motion_effect(robot, hall.poses[place])
    return problem


def solve(problem):
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        return planner.solve(problem, timeout=60).plan


def driven(plan, offset):
    """Times (s), and the second robot's places (m) and headings (rad), by the plan alone."""
    found = plan.trajectories["both"]
    x, y, heading = found.poses.T
    c, s = np.cos(heading), np.sin(heading)
    places = np.column_stack((x + c * offset[0] - s * offset[1], y + s * offset[0] + c * offset[1]))
    return found.times, places, heading + offset[2]


def fastest(times, places, headings):
    """Return the largest speed, acceleration and turn rate by finite differences."""
    dt = np.diff(times)
    speed = np.diff(places, axis=0) / dt[:, None]
    change = np.linalg.norm(np.diff(speed, axis=0), axis=1) / (0.5 * (dt[1:] + dt[:-1]))
    return np.linalg.norm(speed, axis=1).max(), change.max(), np.abs(np.diff(headings) / dt).max()


SEEDS = [*range(3), *(pytest.param(k, marks=pytest.mark.long) for k in range(3, 30))]


@pytest.mark.parametrize("seed", SEEDS)
def test_who_drives_along_keeps_its_limits(seed, tmp_path):
    rng = random.Random(seed)
    limits = LIMITS | {"v_max": rng.uniform(0.5, 2.0), "a_max": rng.uniform(0.3, 1.0)}
    far, side = rng.uniform(1.1, 1.8), rng.choice((-1.0, 1.0))
    offset = (side * far, rng.uniform(-0.5, 0.5), rng.choice((0.0, math.pi / 2, math.pi)))
    goal = (rng.uniform(14.0, 16.0), rng.uniform(3.5, 6.5), rng.uniform(-3.0, 3.0))
    problem = two(tmp_path, offset, goal, limits=limits)
    plan = solve(problem)
    assert validate_plan(problem, plan).valid
    assert plan_to_dict(problem, plan)["rides"][0]["object"] == "r1"
    v, a, w = fastest(*driven(plan, offset))
    assert v <= 1.01 * limits["v_max"]
    assert a <= 1.02 * limits["a_max"]
    assert w <= 1.01 * limits["omega_max"]
    assert v >= 0.6 * limits["v_max"]  # and it is not slow for nothing


def test_the_validator_sees_it_break_them(tmp_path):
    """The same motion in two thirds of the time is quick enough for the first robot alone."""
    offset = (0.0, 1.6, 0.0)
    problem = two(tmp_path, offset, (14.0, 5.0, 3.0), start=(6.0, 5.0, 0.0))
    plan = solve(problem)
    found = plan.trajectories["both"]
    quick = Trajectory(found.times * 0.7, found.poses)
    verdict = validate_plan(problem, plan, {"both": quick})
    assert {v.kind for v in verdict.violations} >= {"speed", "acceleration"}
    assert all("r1, which drives along" in v.what for v in verdict.violations)
    carried = two(tmp_path, offset, (14.0, 5.0, 3.0), start=(6.0, 5.0, 0.0), limits=FREE)
    assert validate_plan(carried, plan, {"both": quick}).valid


FREE = {k: v for k, v in LIMITS.items() if k != "drives_along"}


def test_what_cannot_be_followed_is_refused(tmp_path):
    problem = two(tmp_path, (1.5, 0.0, 0.0), (14.0, 5.0, 0.0))
    robot = problem.object("r0")
    robot._motion_model = MotionModels.REEDSSHEPP
    robot._motion_parameters = {"turning_radius": 1.0}
    with pytest.raises(UnsupportedError, match=r"'both': .*with 'r0' could not follow it"):
        read_problem(problem)


@pytest.mark.parametrize("along", [True, False])
def test_who_drove_to_its_place_is_taken_along(along, tmp_path):
    """It is where its own drive has led it that it is taken from, not only where it is at first."""
    limits = LIMITS if along else FREE
    problem = two(tmp_path, (1.4, 0.0, 0.0), (14.0, 5.0, 1.0), limits=limits)
    hall_pose = problem.object("left1")
    first = problem.initial_configuration[0]
    problem.initial_configuration[:] = [first]
    problem.set_initial_configuration(problem.object("r1"), hall_pose)
    come = problem.add_motion_activity("come")
    come.set_duration_bounds(1, 100)
    beside, robot = problem.object("from_beside"), problem.object("r1")
    come.add_motion_constraint(ActivityWaypoints(robot, hall_pose, [beside]))
    come.add_motion_effect(robot, beside)
    (both,) = (a for a in problem.activities if a.name == "both")
    problem.add_constraint(LE(come.end, both.start))
    leave = problem.add_motion_activity("leave")
    leave.set_duration_bounds(1, 100)
    there, home = problem.object("to_beside"), problem.object("left1")
    leave.add_motion_constraint(ActivityWaypoints(robot, there, [home]))
    leave.add_motion_effect(robot, home)
    problem.add_constraint(LE(both.end, leave.start))
    plan = solve(problem)
    assert validate_plan(problem, plan).valid
    assert [r["object"] for r in plan_to_dict(problem, plan)["rides"]] == ["r1"]


def quick(way, rng):
    """Return where one robot is beside the other, and a motion of both that each of them can make:
    straight on as fast as they are, or round the slower one.
    """
    start = (6.0, 5.0, rng.uniform(-0.3, 0.3))
    far = rng.uniform(1.2, 1.6)
    if way == "straight":
        return (-far, rng.uniform(-0.5, 0.5), 0.0), drive(start, [(4.0, 0.0)], 0.0, 1.0, 0.6)
    arc = drive((0.0, 0.0, 0.0), [(far, 0.0)], 0.0, 0.4, 0.2)
    turned = start[2] + arc.poses[:, 0] / far
    middle = Frame(*start).of((0.0, far, 0.0))
    x, y = middle[0] + far * np.sin(turned), middle[1] - far * np.cos(turned)
    return (0.0, far, 0.0), Trajectory(arc.times, np.column_stack((x, y, turned)))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("way", ["straight", "round"])
def test_nothing_is_proven_of_robots_that_drive_together_but_what_each_needs(way, seed, tmp_path):
    offset, motion = quick(way, random.Random(f"{way} {seed}"))
    limits = LIMITS | ({"v_max": 0.1, "a_max": 0.1} if way == "round" else {})
    start, goal = (tuple(motion.poses[k].tolist()) for k in (0, -1))
    problem = two(tmp_path, offset, goal, start=start, limits=limits)
    problem.object("r0")._motion_parameters = {"v_max": 1.0, "a_max": 0.6, "omega_max": 1.2}
    problem.activities[0].set_duration_bounds(1, 500)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"seconds_per_unit": 0.1}) as planner:
        result = planner.solve(problem, timeout=60)
    units = math.ceil(motion.duration / 0.1)
    schedule = CandidateSchedule({"both": (0, units)})
    known = build_plan(problem, read_problem(problem, 0.1), schedule, {"both": motion})
    verdict = validate_plan(problem, known, seconds_per_unit=0.1)
    assert verdict.valid, verdict.violations
    told = result.metrics
    assert result.plan is not None
    bound = told["lower_bound" if told["bound_kind"] == "absolute" else "absolute_bound"]
    assert int(bound) <= units
