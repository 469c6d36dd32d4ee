"""The judge of lateral accelerations and of changes of the turn rate: drawn motions that keep the
limits pass, however they are sampled, and such that do not are refused.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import MovableType

from tests.usual import usually
from up_samp.model import ProblemError, UnsupportedError
from up_samp.upio.read_maps import read_movable
from up_samp.validation.kinematics import Limits, limits_of, motion_violations, speeds_on_way

FINE = 1e-3
LIMITS = Limits("r", "PIVOT", 0.0, 1.0, 1.0, 0.8, 1.2, lateral=0.6, alpha=0.9)


def toward(rng, size, push, most, seconds):
    """A signal that goes as fast as it may to one drawn value after the other, and to 0 at last."""
    found, now, goal = np.zeros(round(seconds / FINE)), 0.0, 0.0
    for i in range(len(found)):
        left = (len(found) - i) * FINE
        if rng.random() < FINE:
            goal = float(rng.choice([0.0, rng.uniform(-size, size), size]))
        if abs(now) >= push * (left - 0.1):
            goal = 0.0
        aim = math.copysign(min(abs(goal), most[i]), goal)
        now += float(np.clip(aim - now, -push * FINE, push * FINE))
        found[i] = now
    return found


def driven(rng, limits, seconds=12.0):
    """Times and poses of a motion that keeps the limits, sampled at random."""
    free = np.full(round(seconds / FINE), math.inf)
    v = np.abs(toward(rng, limits.v_max, limits.a_max, free, seconds))
    # looks ahead so far that it slows its turn in time
    soon = np.lib.stride_tricks.sliding_window_view(np.pad(v, (0, 1500), mode="edge"), 1501)
    slow = limits.lateral / np.maximum(soon.max(axis=1)[: len(v)], 0.1)
    omega = toward(rng, limits.omega_max, limits.alpha, slow, seconds)
    theta = np.concatenate([[0.0], np.cumsum(omega * FINE)])
    heading = theta[:-1] + omega * FINE / 2
    steps = (v * FINE)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    way = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    at, samples = 0, [0]
    while at < len(v):
        at = min(len(v), at + int(rng.integers(5, 99)))
        samples.append(at)
    poses = np.column_stack([way, theta])[samples]
    return np.array(samples) * FINE, poses, v, omega


def kinds(limits, times, poses):
    return {v.kind for v in motion_violations("m", limits, times, poses)}


@pytest.mark.parametrize("seed", usually(0, 1, of=range(12)))
def test_what_keeps_the_limits_passes_and_what_does_not_is_refused(seed):
    rng = np.random.default_rng(seed)
    times, poses, v, omega = driven(rng, LIMITS)
    assert np.max(np.abs(v * omega)) <= LIMITS.lateral * 1.001
    loose = replace(LIMITS, lateral=math.inf, alpha=math.inf)
    assert kinds(loose, times, poses) == set()
    assert kinds(LIMITS, times, poses) == set()
    pull = float(np.quantile(np.abs(v * omega), 0.9))
    if pull > 0.05:
        assert "lateral-acceleration" in kinds(replace(loose, lateral=0.8 * pull), times, poses)
        assert list(speeds_on_way("m", replace(loose, lateral=0.8 * pull), times, poses))
    if np.abs(omega).max() > 0.5:  # it took half a second to get there
        assert "turn-acceleration" in kinds(replace(loose, alpha=LIMITS.alpha / 1.6), times, poses)


@pytest.mark.parametrize("dt", [0.01, 0.05, 0.1])
def test_jumps_of_the_turn_rate_are_refused_however_dense_the_samples(dt):
    times = np.arange(0.0, 4.0 + 1e-9, dt)
    theta = np.clip(times - 1.0, 0.0, 2.0)
    poses = np.column_stack([np.zeros((len(times), 2)), theta])
    assert kinds(replace(LIMITS, alpha=math.inf), times, poses) == set()
    assert kinds(LIMITS, times, poses) == {"turn-acceleration"}
    # and such that are made up of many small ones
    poses[:, 2] = np.clip(times - 0.5, 0.0, 1.0) ** 2 / 2
    assert kinds(replace(LIMITS, alpha=0.6), times, poses) == {"turn-acceleration"}


RING = [(-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)]


def movable(model=MotionModels.REEDSSHEPP, **own):
    return MovableObject(
        "r", MovableType("robot"), footprint=RING, motion_model=model, motion_parameters=own
    )


def test_they_are_read_twice():
    item = movable(alpha_max=2, turning_radius=0.0, lateral_a_max=0.5)
    kinematics, limits = read_movable(item).body.kinematics, limits_of(item)
    assert (kinematics.lateral_a_max, kinematics.alpha_max) == (0.5, 2.0)
    assert (limits.lateral, limits.alpha) == (0.5, 2)
    assert limits_of(movable()).alpha == limits_of(movable()).lateral == math.inf


@pytest.mark.parametrize("key", ["lateral_a_max", "alpha_max"])
def test_what_is_wrong_with_them_is_said(key):
    for value in (0, -1.0, "fast", True, math.nan):
        with pytest.raises(ProblemError, match=key):
            read_movable(movable(**{key: value}))
    with pytest.raises(UnsupportedError, match=f"{key}.*leave them out"):
        read_movable(movable(MotionModels.SE2, **{key: 1.0}))
    with pytest.raises(ProblemError, match=key):
        limits_of(movable(MotionModels.SE2, **{key: 1.0}))
