"""Limits of the lateral acceleration and of changes of the turn rate, along drawn ways."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.usual import usually
from up_samp.execution.travel import travel_of
from up_samp.model import Body, Kinematics, MotionModel, Trajectory
from up_samp.motion.curves.reeds_shepp import fastest, run_time
from up_samp.motion.curves.rolling import rolled, rows_of
from up_samp.motion.curves.slowing import (
    allowed_speeds,
    limits_in_bends,
    push_along,
    slowed,
    turns_evenly,
    with_ramps,
)
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.fleet.paths import path_of, safe_intervals
from up_samp.motion.fleet.speed import tune
from up_samp.motion.planners.car import rolling_limits
from up_samp.validation.kinematics import Limits, motion_violations

RING = ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3))
INF = math.inf


def drawn(rng, far=9.0):
    """A body with limits, and a fast way between two poses driven without them."""
    speeds = {"v_max": float(rng.uniform(0.5, 2)), "a_max": float(rng.uniform(0.3, 2))}
    if rng.random() < 0.5:
        model, radius = MotionModel.REEDSSHEPP, float(rng.uniform(0.4, 2))
        kin = Kinematics(model, turning_radius=radius, reverse=rng.random() < 0.7, **speeds)
    else:
        kin = Kinematics(MotionModel.PIVOT, omega_max=float(rng.uniform(0.5, 2)), **speeds)
    a, b = [
        (float(rng.uniform(0, far)), float(rng.uniform(0, far)), float(rng.uniform(-3, 3)))
        for _ in range(2)
    ]
    if kin.mobility.steers:
        free = trajectory_of((a, b), fastest(a, b, limits_of(kin))[1], kin)
    else:
        arcs = fastest(a, b, rolling_limits(kin))[1]
        free = rolled(rows_of(np.array(a), arcs), kin)
    lateral, alpha = (float(np.exp(rng.uniform(-1.5, 1.2))) for _ in range(2))
    which = rng.random()
    lateral, alpha = (lateral if which < 0.8 else INF), (alpha if which > 0.2 else INF)
    return Body(RING, replace(kin, lateral_a_max=lateral, alpha_max=alpha)), free


def broken(body, motion):
    """What the validator says of a motion."""
    kin = body.kinematics
    radius = kin.turning_radius if kin.mobility.steers else 0.0
    back = kin.v_max if kin.reverse else 0.0
    limits = Limits(
        "r", kin.model.name, radius, kin.v_max, back, kin.a_max, kin.omega_max,
        lateral=kin.lateral_a_max, alpha=kin.alpha_max,
    )  # fmt: skip
    return [v.kind for v in motion_violations("m", limits, motion.times, motion.poses)]


@pytest.mark.parametrize("seed", usually(0, of=range(3)))
def test_drawn_ways_are_driven_within_limits_alone_and_in_traffic(seed):
    rng = np.random.default_rng(seed)
    refused = 0
    for _ in range(40):
        body, free = drawn(rng)
        refused += bool(broken(body, free))
        slow = slowed(free, body)
        assert broken(body, slow) == []
        assert slow.duration >= free.duration - 1e-9
        again = slowed(slow, body)
        assert again.duration == pytest.approx(slow.duration, rel=1e-6)
        path = path_of(free, body)
        cell, since = int(rng.integers(1, path.cells + 1)), float(rng.uniform(0, 15))
        taken = np.array([[cell, since, since + float(rng.uniform(1, 9))]])
        tuned = tune(path, safe_intervals(taken, path.cells), 0.0, -INF)
        assert tuned is not None
        assert broken(body, tuned.trajectory) == []
    assert refused > 30


@pytest.mark.parametrize("seed", usually(2, of=range(3)))
def test_ramps_keep_the_ends_the_limits_and_are_no_slower_than_rests(seed):
    rng = np.random.default_rng(100 + seed)
    gained = 0
    for _ in range(40):
        body, free = drawn(rng)
        body = Body(RING, replace(body.kinematics, alpha_max=float(rng.uniform(0.3, 3))))
        rests = slowed(free, body)
        motion = with_ramps(free, body, lambda rows: -1)
        assert np.abs(motion.poses[[0, -1]] - free.poses[[0, -1]]).max() < 1e-9
        assert broken(body, motion) == []
        assert motion.duration <= rests.duration + 1e-9
        assert slowed(motion, body) is motion
        gained += motion.duration < rests.duration - 0.1
    assert gained > 15


def test_a_ramp_that_is_not_free_gets_shorter_and_is_left_out_at_last():
    rng = np.random.default_rng(5)
    for _ in range(20):
        body, free = drawn(rng)
        body = Body(RING, replace(body.kinematics, alpha_max=1.0))
        rests = slowed(free, body)
        blocked = with_ramps(free, body, lambda rows: 0)
        assert blocked.duration == pytest.approx(rests.duration)
        asked = []

        def narrow(rows, asked=asked):
            asked.append(rows)
            return len(rows) // 2 if len(asked) < 3 else -1

        some = with_ramps(free, body, narrow)
        assert broken(body, some) == []
        assert some.duration <= rests.duration + 1e-9


def test_lateral_acceleration_bounds_the_speed_on_an_arc():
    kin = Kinematics(MotionModel.REEDSSHEPP, turning_radius=2.0, v_max=2.0)
    body = Body(RING, replace(kin, lateral_a_max=0.5))
    free = trajectory_of(((0, 0, 0), (0, 4, math.pi)), np.array([[0.5, 2 * math.pi]]), kin)
    assert np.allclose(allowed_speeds(free.poses, body), 1.0)
    assert slowed(free, body).duration == pytest.approx(run_time(2 * math.pi, 1.0, 1.0), rel=1e-6)
    assert travel_of(path_of(free, body)).speed.max() == pytest.approx(1.0)


def test_a_turn_on_the_spot_is_a_trapezoid_of_the_turn_rate():
    kin = Kinematics(MotionModel.PIVOT, omega_max=1.0, alpha_max=0.5)
    rows = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    motion = rolled(rows, kin)
    assert motion.duration == pytest.approx(3.0 + 2.0)
    assert broken(Body(RING, kin), motion) == []
    free = rolled(rows, replace(kin, alpha_max=INF))
    assert free.duration == pytest.approx(3.0)
    assert broken(Body(RING, kin), free) == ["turn-acceleration"]


def test_who_has_no_room_for_a_ramp_rests_where_the_curvature_jumps():
    kin = Kinematics(MotionModel.REEDSSHEPP, turning_radius=1.0, alpha_max=1.0)
    arcs = np.array([[0.0, 2.0], [1.0, 1.0]])  # the end can be reached by no other lengths
    end = (2 + math.sin(1), 1 - math.cos(1), 1.0)
    free = trajectory_of(((0, 0, 0), end), arcs, replace(kin, alpha_max=INF))
    body = Body(RING, kin)
    motion = with_ramps(free, body, lambda rows: -1)
    assert push_along(free.poses, body) == pytest.approx(1.0)
    assert motion.duration == pytest.approx(run_time(2.0, 1.0, 1.0) + run_time(1.0, 1.0, 1.0))
    assert path_of(free, body).stop.sum() == 3
    assert limits_in_bends(free.poses, kin).rests.sum() == 1


def test_without_limits_nothing_changes():
    rng = np.random.default_rng(9)
    for _ in range(10):
        body, free = drawn(rng)
        body = Body(RING, replace(body.kinematics, lateral_a_max=INF, alpha_max=INF))
        assert slowed(free, body) is free
        assert turns_evenly(free, body.kinematics)
        assert push_along(free.poses, body) == body.kinematics.a_max


@pytest.mark.parametrize("model", [MotionModel.SE2, MotionModel.SE3, MotionModel.CONTROL])
@pytest.mark.parametrize("limit", ["lateral_a_max", "alpha_max"])
def test_only_who_drives_along_its_heading_has_these_limits(model, limit):
    with pytest.raises(ValueError, match="along its heading"):
        Kinematics(model, **{limit: 1.0})
    with pytest.raises(ValueError, match=limit):
        Kinematics(MotionModel.PIVOT, **{limit: 0.0})


def test_one_pose_is_a_way():
    kin = Kinematics(MotionModel.PIVOT, alpha_max=1.0)
    still = Trajectory(np.zeros(1), np.zeros((1, 3)))
    assert path_of(still, Body(RING, kin)).cells == 0
