"""Legs strung together: motions that pass from one into the next without a stop where they can.

A waypoint asks for a pose, not for a rest. A car drives on where its direction does not change,
and so does a body that turns on the spot where it need not; a free flyer does where the next
piece goes on straight, at the same share of turn.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from up_samp.model import Kinematics, Trajectory
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.rolling import SAME, rolled, thinned
from up_samp.motion.curves.trajectories import joined
from up_samp.motion.curves.trapezoid import time_of_distance
from up_samp.motion.curves.twists import twists


def driven_through(parts: Sequence[Trajectory], kinematics: Kinematics) -> Trajectory:
    """Return a car's legs as one motion from time 0 that rests at cusps only."""
    whole = joined(parts)
    if len(whole.times) < 3:
        return whole
    moves = twists(whole.poses)
    ways = np.copysign(np.hypot(moves[:, 0], moves[:, 1]), moves[:, 0])
    driven = np.flatnonzero(ways)  # a step of no length has no direction
    if not len(driven):
        return whole
    cusps = driven[1:][ways[driven[:-1]] * ways[driven[1:]] < 0.0]
    bends = np.abs(np.diff(moves[:, 2] / np.where(ways == 0.0, np.inf, ways))) > SAME
    return _retimed(
        whole,
        np.abs(ways),
        cusps,
        bends | _joints(parts),
        lambda _: (kinematics.v_max, kinematics.a_max),
    )


def pivoted_through(parts: Sequence[Trajectory], kinematics: Kinematics) -> Trajectory:
    """Return the legs of a body that turns on the spot as one motion from time 0 that rests where
    it does so, or changes its direction, only.
    """
    whole = joined(parts)
    if len(whole.times) < 3:
        return whole
    kept = np.concatenate([[True], _joints(parts), [True]])
    return rolled(thinned(whole.poses, kinematics, kept), kinematics)


def flown_through(parts: Sequence[Trajectory], kinematics: Kinematics) -> tuple[Trajectory, bool]:
    """Return a flyer's legs (straight pieces, at rest at each corner) as one motion from time 0,
    and whether it passes all joints without a stop.
    """
    whole = joined(parts)
    inner = _joints(parts)
    if len(whole.times) < 3:
        return whole, True
    ways = np.linalg.norm(np.diff(whole.poses[:, :3], axis=0), axis=1)
    if not np.all(ways > 1e-12):  # turns on the spot have no share of a way
        return whole, not inner.any()
    rates = rotations(whole.poses) / ways[:, None]
    units = np.diff(whole.poses[:, :3], axis=0) / ways[:, None]
    change = np.abs(np.diff(np.hstack([units, rates]), axis=0)).max(axis=1)
    corners = np.flatnonzero(change > 1e-7) + 1
    top = np.linalg.norm(rates, axis=1)

    def limits(step: int) -> tuple[float, float]:
        turning = float(top[step])
        fastest = kinematics.omega_max / turning if turning > 1e-12 else np.inf
        return min(kinematics.v_max, fastest), kinematics.a_max

    motion = _retimed(whole, ways, corners, inner, limits)
    return motion, not inner[corners - 1].any()


def _joints(parts: Sequence[Trajectory]) -> BoolArray:
    """Return which inner samples of the joined motion are ends of a leg, shape (n - 2,)."""
    counts = [len(part.times) - 1 for part in parts]
    ends = np.cumsum(counts)[:-1]
    marks = np.zeros(sum(counts) + 1, dtype=np.bool_)
    marks[ends] = True
    return marks[1:-1]


def rotations(poses: FloatArray) -> FloatArray:
    """Return the rotation vectors (n - 1, 3) (rad) from each quaternion (x, y, z, w) to the next,
    in the world's frame.
    """
    q = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    a, b = q[:-1], q[1:]
    w = np.sum(a * b, axis=1)
    v = a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(b[:, :3], a[:, :3])
    sign = np.where(w < 0, -1.0, 1.0)
    size = np.linalg.norm(v, axis=1)
    angle = 2 * np.arctan2(size, np.abs(w))
    return np.asarray(v * (sign * angle / np.where(size > 1e-15, size, 1.0))[:, None])


def _retimed(
    whole: Trajectory,
    ways: FloatArray,
    rests: IntArray,
    kept: BoolArray,
    limits: Callable[[int], tuple[float, float]],
) -> Trajectory:
    """Return the same poses at the times of one trapezoid from each rest to the next.

    ``ways`` (n - 1,): metres between samples; ``rests``: samples with a rest between the ends;
    ``kept`` (n - 2,): inner samples that have to stay; ``limits(step)``: speed and acceleration.
    """
    marks = [0, *(int(i) for i in rests), len(ways)]
    times = np.zeros(len(ways) + 1)
    for low, high in itertools.pairwise(marks):
        s = np.cumsum(ways[low:high])
        v, a = limits(low)
        times[low + 1 : high + 1] = times[low] + time_of_distance(s, float(s[-1]), v, a)
    # where it rested before, samples now are far closer than they need be; ways may be nothing
    stay = [0]
    for i in range(1, len(times) - 1):
        asked = kept[i - 1] or i in marks or times[i + 1] - times[stay[-1]] > Trajectory.MAX_STEP
        if asked and times[stay[-1]] < times[i] < times[-1]:
            stay.append(i)
    stay.append(len(times) - 1)
    return Trajectory(times[stay], whole.poses[stay].copy())
