"""What every one of OMPL's planners must do: find, not find, repeat itself, and stop in time."""

import math

import numpy as np
import pytest

from tests.motion.planners import ompl_oracle as oracle
from tests.motion.planners.asking import plan_with_ompl
from tests.motion.planners.ompl_oracle import CAR, CRATE, DOOR, GOAL, OMNI, START
from tests.oracles.clocks import Watch
from tests.usual import usually
from up_samp.model import (
    Body,
    Deadline,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    ProblemError,
    UnsupportedError,
)
from up_samp.motion.planners.ompl import PLANNERS, explore

BODIES = pytest.mark.parametrize("body", [CAR, OMNI], ids=["car", "omni"])
EACH = pytest.mark.parametrize("planner", PLANNERS)
SCENE = oracle.hall_scene()
WALLS = oracle.walls(SCENE.grid)
CLOSED = oracle.hall_scene(gap=False)


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    """Compile before anything is timed."""
    for body in (CAR, OMNI):
        plan_with_ompl(
            SCENE,
            PathQuery(body, (START, GOAL), (CRATE,)),
            Deadline.after(240),
            planner="RRTConnect",
        )


def ends_exactly(trajectory, poses):
    first, last = trajectory.poses[0], trajectory.poses[-1]
    assert trajectory.times[0] == 0
    assert tuple(first[:2]) == poses[0][:2]
    assert tuple(last[:2]) == poses[-1][:2]
    for pose, wanted in ((first, poses[0]), (last, poses[-1])):
        assert abs(math.remainder(pose[2] - wanted[2], 2 * math.pi)) < 1e-9


@BODIES
@EACH
def test_through_the_gap(planner, body):
    query = PathQuery(body, (START, GOAL), (CRATE,))
    report = plan_with_ompl(SCENE, query, Deadline.after(20), planner=planner, seed=3)
    assert report.outcome is Outcome.FOUND
    assert report.planner == planner
    ends_exactly(report.trajectory, query.poses)
    oracle.check_limits(body, report.trajectory)
    world = WALLS.union(oracle.obstacles_of([CRATE]))
    assert oracle.clearance(body, report.trajectory.poses[::4], world) > 0


@pytest.mark.long
@BODIES
@EACH
def test_many_seeds(planner, body):
    world = WALLS.union(oracle.obstacles_of([CRATE]))
    for seed in range(3):
        query = PathQuery(body, (START, GOAL, START), (CRATE,))
        report = plan_with_ompl(SCENE, query, Deadline.after(60), planner=planner, seed=seed)
        assert report.outcome is Outcome.FOUND
        oracle.check_limits(body, report.trajectory)
        assert oracle.clearance(body, report.trajectory.poses, world) > 0


@EACH
def test_same_seed_same_answer(planner):
    query = PathQuery(OMNI, (START, GOAL))
    reports = [
        plan_with_ompl(SCENE, query, Deadline.after(20), planner=planner, seed=11) for _ in range(2)
    ]
    poses = [r.trajectory.poses for r in reports]
    assert np.array_equal(poses[0], poses[1])


@EACH
def test_closed_room_is_no_proof_and_ends_in_time(planner):
    query = PathQuery(CAR, (START, GOAL))
    watch = Watch()
    report = plan_with_ompl(CLOSED, query, Deadline.after(0.1), planner=planner)
    assert watch.late(0.1) < 1.0
    assert report.outcome is Outcome.OUT_OF_TIME
    assert planner in report.reason


def test_closed_door_is_no_proof():
    query = PathQuery(CAR, (START, GOAL), (CRATE, DOOR))
    report = plan_with_ompl(SCENE, query, Deadline.after(0.5), planner="rrt", seed=1)
    assert report.outcome is Outcome.OUT_OF_TIME
    assert report.planner == "RRT"


@pytest.mark.parametrize("body", usually(OMNI, of=(CAR, OMNI)), ids=["car", "omni"])
def test_what_a_search_reached(body):
    targets = {"near": (4.0, 9.0, 1.0), "far": GOAL, "in the wall": (10.0, 1.0, 0.0)}
    query = PathQuery(body, (START, GOAL), (DOOR,))
    assert explore(SCENE, query, targets, Deadline.after(0.5), seed=2) == (
        False,
        {"near"},
        {"door"},
    )
    query = PathQuery(body, (START, GOAL))
    arrived, reached, _ = explore(SCENE, query, targets, Deadline.after(20), seed=2)
    assert arrived
    assert "far" in reached


def test_waypoints():
    poses = (START, (6.0, 9.0, 0.0), (6.0, 9.0, 0.0), GOAL)
    query = PathQuery(CAR, poses, (CRATE,))
    report = plan_with_ompl(SCENE, query, Deadline.after(20), planner="RRTConnect")
    assert report.outcome is Outcome.FOUND
    trajectory = report.trajectory
    ends_exactly(trajectory, poses)
    assert np.abs(trajectory.poses[:, :2] - np.array([6.0, 9.0])).sum(axis=1).min() < 1e-9
    oracle.check_limits(CAR, trajectory)


def test_start_close_to_the_wall():
    start = (0.5 + 0.2 + 1e-3, 3.0, 0.0)  # 1 mm from the wall, below the margin of 10 mm
    query = PathQuery(CAR, (start, GOAL))
    report = plan_with_ompl(SCENE, query, Deadline.after(20), planner="RRTConnect")
    assert report.outcome is Outcome.FOUND
    assert oracle.clearance(CAR, report.trajectory.poses[::4], WALLS) > 0


def test_start_in_the_wall():
    query = PathQuery(CAR, ((0.3, 3.0, 0.0), GOAL))
    report = plan_with_ompl(SCENE, query, Deadline.after(20), planner="RRTConnect")
    assert report.outcome is Outcome.NOT_FOUND
    assert "touches" in report.reason


def test_names():
    query = PathQuery(CAR, (START, GOAL))
    with pytest.raises(ProblemError, match=r"no planner 'dijkstra'.*RRTConnect"):
        plan_with_ompl(SCENE, query, Deadline.after(1), planner="dijkstra")
    with pytest.raises(UnsupportedError, match="PRM"):
        plan_with_ompl(SCENE, query, Deadline.after(1), planner="prm")


def test_open_plane():
    from up_samp.geometry import Scene

    body = Body(OMNI.footprint, Kinematics(MotionModel.SE2))
    query = PathQuery(body, ((0.0, 0.0, 0.0), (0.0, 0.0, math.pi)), ())
    report = plan_with_ompl(Scene(None), query, Deadline.after(5), planner="RRTConnect")
    assert report.trajectory.duration == pytest.approx(math.pi, rel=1e-3)
