"""Legs strung together: motions that pass from one into the next without a stop where they can.

A waypoint asks for a pose, not for a rest. What drives along its heading drives on where its
direction does not change, and it need not turn on the spot; a free flyer does where the next piece
goes on straight, at the same share of turn.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from up_samp.model import Kinematics, Trajectory
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.motion.curves.rolling import rolled, thinned
from up_samp.motion.curves.trajectories import joined
from up_samp.motion.curves.trapezoid import time_of_distance


def driven_through(parts: Sequence[Trajectory], kinematics: Kinematics) -> Trajectory:
    """Return the legs of a body that drives along its heading as one motion from time 0 that rests
    where it turns on the spot, or changes its direction, only.
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

    marks = [0, *corners.tolist(), len(ways)]
    times = np.zeros(len(ways) + 1)
    for low, high in itertools.pairwise(marks):  # one trapezoid from each rest to the next
        s, turning = np.cumsum(ways[low:high]), float(top[low])
        fastest = kinematics.omega_max / turning if turning > 1e-12 else np.inf
        v = min(kinematics.v_max, fastest)
        times[low + 1 : high + 1] = times[low] + time_of_distance(
            s, float(s[-1]), v, kinematics.a_max
        )
    # where it rested before, samples now are far closer than they need be; ways may be nothing
    stay = [0]
    for i in range(1, len(times) - 1):
        asked = inner[i - 1] or i in marks or times[i + 1] - times[stay[-1]] > Trajectory.MAX_STEP
        if asked and times[stay[-1]] < times[i] < times[-1]:
            stay.append(i)
    stay.append(len(times) - 1)
    motion = Trajectory(times[stay], whole.poses[stay].copy())
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
