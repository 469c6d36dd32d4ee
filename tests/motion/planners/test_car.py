"""Hand-made places whose answer is known."""

import math
from itertools import pairwise

import numpy as np
import pytest

from tests.motion.oracle import (
    CAR,
    DOOR,
    ROBOT,
    box_map,
    car_faults,
    ends_exactly,
    logistics_map,
    smallest_clearance,
)
from tests.usual import usually
from up_samp.geometry import Scene
from up_samp.model import (
    Body,
    Deadline,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    Placed,
)
from up_samp.motion import MotionCache, MotionService
from up_samp.motion.legs import parking_clears
from up_samp.motion.planners.car import CarPlanner, CarSettings
from up_samp.motion.protocol import LegQuery


@pytest.fixture(scope="module")
def depot():
    return MotionService(logistics_map())


def check(service, body, poses, obstacles=()):
    report = service.plan(PathQuery(body, poses, obstacles), Deadline.after(60))
    assert report.outcome is Outcome.FOUND, report
    trajectory = report.trajectory
    assert ends_exactly(trajectory, poses[0], poses[-1])
    assert car_faults(trajectory, body.kinematics) == []
    assert smallest_clearance(trajectory, body, service.grid, obstacles) > 0
    bound = sum(service.lower_bound(body, (a, b), obstacles) for a, b in pairwise(poses))
    assert trajectory.duration >= bound - 1e-9
    return trajectory, bound


def cusps(trajectory):
    d = np.diff(trajectory.poses, axis=0)
    mid = (trajectory.poses[1:, 2] + trajectory.poses[:-1, 2]) / 2
    along = np.sign(d[:, 0] * np.cos(mid) + d[:, 1] * np.sin(mid))
    return int((np.diff(along) != 0).sum())


GOALS = ((59, 32), (95, 27), (71, 42), (83, 17))


@pytest.mark.parametrize(("x", "y"), usually(*GOALS[1:], of=GOALS))
def test_depot_to_item_is_near_the_bound(depot, x, y):
    open_door = Placed("door", DOOR, (51.5, 40, 0))
    start = (25.0, 59.0, math.pi / 2)
    trajectory, bound = check(depot, ROBOT, (start, (x, y, 0)), (open_door,))
    assert trajectory.duration <= 1.10 * bound


def test_there_and_back_over_waypoints(depot):
    start = (25.0, 59.0, math.pi / 2)
    trajectory, bound = check(depot, ROBOT, (start, (46, 30, 0), (59, 32, 0), start))
    assert trajectory.duration <= 1.2 * bound
    button = np.hypot(trajectory.poses[:, 0] - 46, trajectory.poses[:, 1] - 30).min()
    assert button == 0.0


def test_a_closed_door_is_proven(depot):
    closed = Placed("door", DOOR, (51.5, 30, 0))
    query = PathQuery(ROBOT, ((25, 59, math.pi / 2), (59, 32, 0)), (closed,))
    report = depot.plan(query, Deadline.after(60))
    assert report.outcome is Outcome.IMPOSSIBLE
    assert report.blockers == {"door"}
    assert report.trajectory is None


def test_a_corridor_as_wide_as_the_robot_and_a_little():
    grid = box_map(20, 10, [(6, 0, 14, 4.4), (6, 5.6, 14, 10)])  # 1.2 m for a robot of 1 m
    service = MotionService(grid)
    trajectory, bound = check(service, ROBOT, ((3, 2, 0.0), (17, 8, 0.0)))
    assert trajectory.duration <= 1.3 * bound


def test_a_corridor_that_is_too_narrow():
    grid = box_map(20, 10, [(6, 0, 14, 4.6), (6, 5.4, 14, 10)])
    report = MotionService(grid).plan(
        PathQuery(ROBOT, ((3, 2, 0.0), (17, 8, 0.0))), Deadline.after(60)
    )
    assert report.outcome is Outcome.IMPOSSIBLE
    assert report.blockers == frozenset()


def test_parallel_parking():
    wide = box_map(20, 6, [(0, 0, 8.5, 1.6), (11.7, 0, 20, 1.6)])  # a slot of 3.2 m for 2 m
    trajectory, _ = check(MotionService(wide), ROBOT, ((15, 3, 0.0), (10.1, 0.9, 0.0)))
    assert cusps(trajectory) >= 1


def test_turning_round_in_a_dead_end():
    grid = box_map(16, 9, [(8, 0, 16, 3), (8, 6, 16, 9)])  # an alley of 3 m: no U-turn inside
    trajectory, _ = check(MotionService(grid), ROBOT, ((12, 4.5, 0.0), (12, 4.5, math.pi)))
    assert cusps(trajectory) > 0  # to and fro, ahead or back first


def test_poses_closer_to_a_wall_than_the_margin():
    grid = box_map(12, 8)
    service = MotionService(grid, margin=0.05)
    start, goal = (1.202, 4.0, 0.0), (9.0, 6.798, -math.pi / 2)  # 2 mm from the walls
    check(service, ROBOT, (start, goal))


def test_parked_robots_are_driven_round(depot):
    parked = tuple(
        Placed(f"r{i}", ROBOT, (25.0, y, math.pi / 2)) for i, y in enumerate((52.0, 47.0, 42.0))
    )
    start, goal = (25.0, 59.0, -math.pi / 2), (25.0, 35.0, -math.pi / 2)
    trajectory, bound = check(depot, ROBOT, (start, goal), parked)
    assert trajectory.duration <= 1.1 * bound
    for other in parked:
        assert parking_clears(depot.scene, trajectory, ROBOT, other, 0.0)
        assert smallest_clearance(trajectory, ROBOT, None, (other,)) > 0.009
    inside = Placed("in the way", ROBOT, tuple(trajectory.poses[len(trajectory.poses) // 2]))
    assert not parking_clears(depot.scene, trajectory, ROBOT, inside, 0.0)


def test_larger_turning_radius_and_rear_axle_reference():
    footprint = ((-0.5, -0.6), (2.5, -0.6), (2.5, 0.6), (-0.5, 0.6))
    body = Body(footprint, Kinematics(MotionModel.REEDSSHEPP, 3.0, 1.5, 1.0))
    grid = box_map(30, 20, [(14, 0, 16, 12)])
    trajectory, bound = check(MotionService(grid), body, ((5, 5, 0.0), (25, 5, 0.0)))
    assert trajectory.duration <= 1.6 * bound


def test_the_open_plane_with_an_obstacle():
    service = MotionService(None)
    parked = Placed("other", ROBOT, (5.0, 0.0, math.pi / 2))
    trajectory, bound = check(service, ROBOT, ((0, 0, 0.0), (10, 0, 0.0)), (parked,))
    assert trajectory.duration <= 1.1 * bound


def test_staying_where_it_is(depot):
    pose = (25.0, 59.0, math.pi / 2)
    report = depot.plan(PathQuery(ROBOT, (pose, pose)), Deadline.after(10))
    assert report.outcome is Outcome.FOUND
    assert report.trajectory.duration == 0.0


def test_same_seed_same_motion():
    query = PathQuery(ROBOT, ((3, 2, 0.0), (17, 8, 1.0)))
    grid = box_map(20, 10, [(6, 0, 14, 4), (6, 6, 14, 10)])
    rows = [MotionService(grid).plan(query, Deadline.after(60)).trajectory.poses for _ in range(2)]
    assert np.array_equal(*rows)


def test_no_time_is_no_proof():
    grid = box_map(20, 10, [(6, 0, 14, 4), (6, 6, 14, 10)])
    query = PathQuery(ROBOT, ((3, 2, 0.0), (17, 8, 1.0)))
    report = MotionService(grid).plan(query, Deadline.after(0.0))
    assert report.outcome is Outcome.OUT_OF_TIME
    assert report.reason


def test_an_unreachable_heading_is_not_called_impossible():
    """A robot in a pen turns only if it fits: nothing found, nothing proven, no endless search."""
    grid = box_map(3.0, 2.0)  # free 2.6 x 1.6 m: a robot of 2 x 1 m cannot turn round
    query = PathQuery(ROBOT, ((1.5, 1.0, 0.0), (1.5, 1.0, math.pi)))
    report = MotionService(grid).plan(query, Deadline.after(60))
    assert report.outcome in (Outcome.OUT_OF_TIME, Outcome.IMPOSSIBLE)


def test_caches_are_shared():
    grid = box_map(20, 10, [(6, 0, 14, 4), (6, 6, 14, 10)])
    a, b = (3, 2, 0.0), (17, 8, 1.0)
    cache = MotionCache()
    first = MotionService(grid, cache=cache)
    there = first.plan(PathQuery(ROBOT, (a, b)), Deadline.after(60)).trajectory
    back = first.plan(PathQuery(ROBOT, (b, a)), Deadline.after(60)).trajectory
    assert first.cache.hits == 1
    assert back.duration == pytest.approx(there.duration)
    assert ends_exactly(back, b, a)
    assert car_faults(back, CAR) == []
    far = Placed("far", ROBOT, (2.0, 8.5, 0.0))
    again = MotionService(grid, cache=cache)
    report = again.plan(PathQuery(ROBOT, (a, b), (far,)), Deadline.after(60))
    assert np.array_equal(report.trajectory.poses, there.poses)
    assert again.cache.hits == 2
    # an obstacle on the way needs a motion of its own, remembered beside the other one
    on_the_way = Placed("near", ROBOT, tuple(there.at(there.duration / 4)))
    check(again, ROBOT, (a, b), (on_the_way,))
    assert len(again.cache) >= 2
    hits = cache.hits
    other_map = MotionService(box_map(20, 10), cache=cache)
    other_map.plan(PathQuery(ROBOT, (a, b)), Deadline.after(60))
    assert other_map.cache.hits == hits


def test_a_search_that_comes_no_nearer_gives_up():
    # a dog-leg that a disc could pass and the car cannot, between halls too large to exhaust
    grid = box_map(44, 16, [(20, 0, 24, 5), (20, 6.3, 22, 16), (22, 0, 23, 8), (23.3, 0, 24, 8)])
    planner = CarPlanner(Scene(grid), 0, CarSettings((0.35,), (60_000,), slice=2000, stuck=2))
    start, goal = (3.0, 3.0, 0.0), (41.0, 13.0, 0.0)
    leg = planner.leg(LegQuery(ROBOT, start, goal), Deadline.never())
    assert leg.trajectory is None
    assert "fixed effort" in leg.reason or "finest" in leg.reason
    assert leg.effort < 60_000
