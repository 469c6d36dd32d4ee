"""Waypoints are poses to pass, not places to stop at."""

import math
import random

import numpy as np
import pytest

from tests.motion.oracle import RECTANGLE, car_faults
from tests.motion.planners.test_planar import faults
from up_samp.geometry import OccupancyGrid
from up_samp.model import Body, Deadline, Kinematics, MotionModel, PathQuery
from up_samp.motion import MotionService
from up_samp.motion.fleet.workspace import Workspace
from up_samp.validation.kinematics import Limits, motion_violations

CAR = Body(RECTANGLE, Kinematics(MotionModel.REEDSSHEPP, 1.0, 2.0, 0.5))
SLIDER = Body(RECTANGLE, Kinematics(MotionModel.SE2, 1.0, 1.5, 0.8, 0.7))
TURNER = Body(RECTANGLE, Kinematics(MotionModel.PIVOT, 1.0, 1.5, 0.8, 0.7))
HALL = OccupancyGrid(np.zeros((120, 120), dtype=np.bool_), 0.1)


def planned(body, poses, service=None):
    report = (service or MotionService(None)).plan(PathQuery(body, tuple(poses)), Deadline.never())
    assert report.trajectory is not None
    return report


def speed_at(trajectory, pose):
    """Return the mean speed from just before to just after a pose that is passed exactly."""
    off = np.abs(trajectory.poses[:, :2] - np.array(pose[:2])).max(axis=1)
    turn = trajectory.poses[:, 2] - pose[2]
    off = np.maximum(off, np.abs(turn - 2 * np.pi * np.round(turn / (2 * np.pi))))
    i = int(np.argmin(off))
    assert off[i] < 1e-9
    gap = trajectory.poses[i + 1, :2] - trajectory.poses[i - 1, :2]
    return math.hypot(*gap) / (trajectory.times[i + 1] - trajectory.times[i - 1])


@pytest.mark.parametrize("body", [CAR, SLIDER])
def test_a_straight_way_takes_as_long_with_waypoints_as_without(body):
    for heading in (0.0, 0.7, 3.0):
        shares = (0.0, 0.05, 0.3, 0.31, 0.8, 1.0)
        poses = [(30 * s * math.cos(heading), 30 * s * math.sin(heading), heading) for s in shares]
        report = planned(body, poses)
        alone = planned(body, (poses[0], poses[-1])).trajectory.duration
        assert report.trajectory.duration == pytest.approx(alone, rel=1e-9)
        assert report.complete
        for pose in poses[1:-1]:
            assert speed_at(report.trajectory, pose) > 0.5


def test_a_car_passes_poses_on_a_bend():
    turn = math.pi / 2
    poses = [(0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (7.0, 1.0, turn), (7.0, 8.0, turn)]
    report = planned(CAR, poses)
    length = 6.0 + turn + 7.0
    assert report.trajectory.duration == pytest.approx(length / 2.0 + 4.0, rel=1e-9)
    assert car_faults(report.trajectory, CAR.kinematics) == []
    assert all(speed_at(report.trajectory, p) > 1.9 for p in poses[1:-1])


def test_a_car_rests_where_its_direction_changes():
    poses = [(0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (1.0, 0.0, 0.0)]
    report = planned(CAR, poses)
    apart = sum(planned(CAR, poses[i : i + 2]).trajectory.duration for i in (0, 1))
    assert report.trajectory.duration == pytest.approx(apart, rel=1e-9)
    assert car_faults(report.trajectory, CAR.kinematics) == []


def test_a_slider_that_goes_there_and_back_has_to_stop_there():
    rng = np.random.default_rng(3)
    for _ in range(30):
        home, there = ((*rng.uniform(-9, 9, 2), 0.4) for _ in range(2))
        alone = planned(SLIDER, (home, there)).trajectory.duration
        report = planned(SLIDER, (home, there, home))
        assert report.trajectory.duration == pytest.approx(2 * alone, rel=1e-9)
        assert report.complete
        assert not faults(report.trajectory, SLIDER.kinematics)


def test_a_slider_passes_corners_exactly_and_moving():
    rng = np.random.default_rng(5)
    for _ in range(20):
        poses = [tuple(map(float, (*rng.uniform(-8, 8, 2), rng.uniform(-1, 1)))) for _ in range(5)]
        report = planned(SLIDER, poses)
        assert faults(report.trajectory, SLIDER.kinematics) == []
        apart = sum(planned(SLIDER, poses[i : i + 2]).trajectory.duration for i in range(4))
        assert report.trajectory.duration < apart
        for pose in poses[1:-1]:
            assert speed_at(report.trajectory, pose) > 0.0
        assert report.trajectory.duration >= MotionService(None).lower_bound(SLIDER, poses)


def test_where_walls_leave_no_room_to_pass_a_corner_moving_it_stops_and_says_so():
    """A corner of a corridor that is as wide as the robot: the blend would go through the wall."""
    cells = np.ones((120, 120), dtype=np.bool_)
    cells[49:61, 10:61] = False
    cells[49:110, 49:61] = False
    body = Body(
        ((-0.52, -0.52), (0.52, -0.52), (0.52, 0.52), (-0.52, 0.52)),
        Kinematics(MotionModel.SE2, 1.0, 1.0, 1.0, 1.0),
    )
    service = MotionService(OccupancyGrid(cells, 0.1))
    poses = [(2.0, 5.5, 0.0), (5.5, 5.5, 0.0), (5.5, 10.0, 0.0)]
    report = planned(body, poses, service)
    assert speed_at(report.trajectory, poses[1]) < 0.35
    legs = sum(planned(body, poses[i : i + 2], service).trajectory.duration for i in (0, 1))
    assert report.trajectory.duration <= legs + 1e-9


def test_what_turns_on_the_spot_stops_only_there():
    kin = Kinematics(MotionModel.PIVOT, 1.0, 1.0, 1.0, 0.5)
    body = Body(RECTANGLE, kin)
    poses = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (5.0, 0.0, 0.0), (16.0, 0.0, 0.0)]
    report = planned(body, poses)
    assert report.trajectory.duration == pytest.approx(17.0, rel=1e-9)
    assert report.complete
    up = math.pi / 2
    turned = planned(body, [*poses, (16.0, 0.0, up), (16.0, 4.0, up), (16.0, 16.0, up)])
    assert turned.trajectory.duration == pytest.approx(17.0 + math.pi + 17.0, rel=1e-9)
    limits = Limits("r", "PIVOT", 0.0, 1.0, 1.0, 1.0, 0.5)
    times, rows = turned.trajectory.times, turned.trajectory.poses
    assert list(motion_violations("motion", limits, times, rows)) == []


@pytest.mark.parametrize("body", [CAR, SLIDER, TURNER])
def test_waypoints_said_twice_or_with_whole_turns_between_them_change_nothing(body):
    up, over = math.pi, 2 * math.pi
    plain = [(3.0, 5.0, up), (8.0, 5.0, up), (3.0, 5.0, up)]
    alone = planned(body, plain, MotionService(HALL)).trajectory.duration
    rng = random.Random(2)
    for _ in range(20):
        poses = [(x, y, th + over * rng.choice((-1, 0, 1))) for x, y, th in plain for _ in (1, 2)]
        poses = [(x + rng.choice((0.0, 1e-12, 2e-9)), y, th) for x, y, th in poses]
        service = MotionService(HALL)
        assert planned(body, poses, service).trajectory.duration == pytest.approx(alone, abs=1e-3)
        way = Workspace(service).detour(body, tuple(poses), (), (), Deadline.never())
        assert way.poses[-1] == pytest.approx((3.0, 5.0, way.poses[-1][2]), abs=1e-6)


@pytest.mark.parametrize("body", [CAR, SLIDER, TURNER])
def test_poses_that_are_almost_one_are_driven_between(body):
    """A robot stops a hair before its goal, and what is left of its way is planned anew."""
    rng = random.Random(1)
    for _ in range(40):
        poses = [(5.0, 5.0, rng.choice((0.0, 1.0, math.pi)))]
        while len(poses) < 4:
            (x, y, th), little = poses[-1], 10 ** rng.uniform(-13, -4)
            far = (rng.uniform(3, 9), rng.uniform(3, 9), th)
            near = ((x + little, y, th), (x, y - little, th), (x, y, th + little))
            poses.append(rng.choice((far, *near)))
        last = planned(body, poses, MotionService(HALL)).trajectory.poses[-1]
        assert last == pytest.approx(np.array(poses[-1]), abs=1e-6)
