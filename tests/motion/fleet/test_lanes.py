"""Lanes beside a path, for bodies that can leave it sideways."""

import math

import numpy as np
import pytest

from tests.motion.fleet import tight_places as tight
from tests.motion.fleet.independent import judge, limits_of
from up_samp.model import Deadline, GroupQuery, Kinematics, TimedMotion, Trajectory
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.paths import path_of, safe_intervals
from up_samp.motion.fleet.speed import tune
from up_samp.motion.fleet.workspace import workspace_of
from up_samp.motion.service import MotionService
from up_samp.validation.kinematics import motion_violations


def changed(body, goal, last, offset):
    """Return a path through a hall, and the same with a lane of a few metres beside it."""
    service = MotionService(tight.hall(20, 8, [(0.5, 0.5, 19.5, 7.5)]))
    workspace = workspace_of(service)
    path = workspace.path(body, ((2.0, 4.0, 0.0), goal), (), Deadline.never())
    lane = workspace.lane(path, 8.0, last, offset)
    motion = lane.natural
    assert not list(motion_violations("lane", limits_of("r", body), motion.times, motion.poses))
    assert path.natural.duration < motion.duration < path.natural.duration + 3.0
    return path, lane


@pytest.mark.parametrize("offset", [-1.0, 0.7])
@pytest.mark.parametrize("goal", [(18.0, 4.0, 0.0), (18.0, 6.0, 1.0)])
def test_a_lane_leaves_the_path_and_comes_back(offset, goal):
    path, lane = changed(tight.omni(), goal, 11.0, offset)
    motion = lane.natural
    assert np.allclose(motion.poses[[0, -1], :2], path.poses[[0, -1], :2])
    way = path.poses[-1, :2] - path.poses[0, :2]
    left = np.array([-way[1], way[0]]) / np.hypot(*way)
    aside = (motion.poses[:, :2] - path.poses[0, :2]) @ left
    assert max(aside * np.sign(offset)) == pytest.approx(abs(offset), abs=0.02)


@pytest.mark.parametrize("offset", [-1.0, 0.7])
@pytest.mark.parametrize("goal", [(18.0, 4.0, 0.0), (18.0, 6.0, 1.0), (18.0, 4.0, math.pi)])
def test_who_turns_on_the_spot_changes_lanes_without_a_stop(offset, goal):
    path, lane = changed(tight.differential(), goal, 9.0, offset)
    motion = lane.natural
    assert np.allclose(motion.poses[0], path.poses[0])
    gap = motion.poses[-1] - path.poses[-1]
    assert np.allclose([*gap[:2], math.remainder(gap[2], 2 * math.pi)], 0.0)
    gaps = np.hypot(*(motion.poses[:, None, :2] - path.poses[None, :, :2]).transpose(2, 0, 1))
    assert gaps.min(axis=1).max() == pytest.approx(abs(offset), abs=0.1)
    assert lane.stop.sum() == path.stop.sum()


def test_no_lane_through_a_wall_or_where_somebody_stops_to_turn():
    service = MotionService(tight.hall(20, 8, [(0.0, 3.0, 20.0, 5.0)]))
    workspace = workspace_of(service)
    ends = ((2.0, 4.0, 0.0), (18.0, 4.0, 0.0))
    narrow = workspace.path(tight.omni(), ends, (), Deadline.never())
    assert workspace.lane(narrow, 8.0, 11.0, 1.0) is None
    pivot = workspace.path(tight.differential(), ends, (), Deadline.never())
    assert workspace.lane(pivot, 8.0, 11.0, 1.0) is None
    assert workspace.lane(pivot, 8.0, 11.0, 0.1) is not None
    turns = [*ends, (18.0, 4.0, 1.5), (12.0, 4.0, 3.1)]
    turning = workspace.path(tight.differential(), tuple(turns), (), Deadline.never())
    stop = float(turning.s[turning.stop][1])
    assert workspace.lane(turning, stop - 2.0, stop + 2.0, 0.1) is None


def test_a_fast_one_overtakes_in_the_open(tmp_path):
    grid = tight.hall(30, 8, [(0.0, 0.5, 30.0, 7.5)])
    slow = tight.Body(tight.SQUARE, Kinematics(tight.omni().kinematics.model, v_max=0.2))
    motions = (
        TimedMotion("slow", "tortoise", slow, ((6.0, 4.0, 0.0), (24.0, 4.0, 0.0)), 0.0, 1e6),
        TimedMotion("fast", "hare", tight.omni(), ((3.0, 4.0, 0.0), (27.0, 4.0, 0.0)), 0.0, 40.0),
    )
    traffic = tight.Traffic("overtaking", grid, GroupQuery(motions))
    report = coordinate(MotionService(grid), traffic.query, Deadline.after(200.0))
    judge(traffic, report, tmp_path)
    assert not report.late


def turning_on_its_way():
    x = np.linspace(0.0, 2.0, 41)
    return np.stack([x, 0 * x, 0.75 * np.maximum(0.0, x - 1.0) ** 2], axis=1)


def on_a_circle(radius):
    angles = np.linspace(0.0, 2.0, 121)
    arc = np.stack([radius * np.sin(angles), radius * (1 - np.cos(angles)), 0 * angles], axis=1)
    straight = np.linspace(0.0, 2.0, 41)[1:, None]
    way = np.array([np.cos(2.0), np.sin(2.0), 0.0])
    return np.concatenate([straight[::-1] * [-1.0, 0.0, 0.0], arc, arc[-1] + straight * way])


def round_a_sharp_corner():
    there = np.stack([np.linspace(0.0, 2.0, 41), np.zeros(41), np.zeros(41)], axis=1)
    on = np.stack([np.full(40, 2.0), np.linspace(0.05, 2.0, 40), np.zeros(40)], axis=1)
    return np.concatenate([there, on])


@pytest.mark.parametrize(
    "poses",
    [on_a_circle(1.5), on_a_circle(4.0), turning_on_its_way(), round_a_sharp_corner()],
    ids=["tight", "wide", "turning", "corner"],
)
@pytest.mark.parametrize("closed", [(), (3.0, 9.0)])
def test_a_body_that_slides_keeps_to_its_limits_at_tuned_speeds(poses, closed):
    body = tight.omni()
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    path = path_of(Trajectory(np.append(0.0, np.cumsum(steps / 0.5)), poses), body)
    assert path.tunable
    rows = np.array([(path.cells // 2, *closed)]) if closed else np.empty((0, 3))
    found = tune(path, safe_intervals(rows, path.cells), 0.0, -math.inf).trajectory
    assert not list(motion_violations("go", limits_of("r", body), found.times, found.poses))
    assert np.abs(found.poses[-1] - poses[-1]).max() < 1e-9
