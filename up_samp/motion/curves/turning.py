"""What ``lateral_a_max`` and ``alpha_max`` allow along a way that is driven along the heading.

Ways are poses with a constant twist from each to the next, so their curvature is constant by pieces
and a change of it is a step. A step is driven over as if the curvature rose evenly along the
shorter of the pieces beside it, and never by more turn rate than ``alpha_max`` makes good within a
moment; where that is too slow, the body rests. :mod:`.ramps` makes small steps of large ones.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from up_samp.model import Kinematics, Trajectory
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.rolling import ON_SPOT, SAME, SHARES
from up_samp.motion.curves.twists import twists


class Bends(NamedTuple):
    """How a way bends, by piece: signed ``ways`` (m), ``turns`` (rad), ``bends`` (1/m; 0 on the
    spot), and which pieces are one ``arc``; by inner pose: by how much the curvature ``jumps``
    where the body need not rest (1/m).
    """

    ways: FloatArray
    turns: FloatArray
    bends: FloatArray
    arc: IntArray
    jumps: FloatArray

    @staticmethod
    def of(ways: FloatArray, turns: FloatArray) -> Bends:
        """Return how pieces of such signed ``ways`` and ``turns`` bend."""
        spot = np.abs(ways) <= ON_SPOT * np.abs(turns)
        bends = np.where(spot, 0.0, turns / np.where(spot, 1.0, ways))
        drives = np.where(spot, 0.0, ways)
        passes = drives[:-1] * drives[1:] > 0.0
        least = np.where(passes, np.minimum(*np.abs([ways[:-1], ways[1:]])), 1.0)
        jumps = np.where(passes, np.abs(np.diff(bends)), 0.0)
        jumps[jumps <= SAME + SHARES.noise / least] = 0.0
        turns_on = spot[:-1] & spot[1:] & (turns[:-1] * turns[1:] > 0.0)
        cut = (jumps > 0.0) | ~(passes | turns_on)
        arc = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(cut)])
        return Bends(drives, turns, bends, arc, jumps)

    @property
    def whole(self) -> Bends:
        """The same way with the pieces of each arc as one."""
        ways, turns = (np.add.reduceat(a, self.firsts) for a in (self.ways, self.turns))
        return Bends.of(ways, turns)

    @property
    def firsts(self) -> IntArray:
        """The first piece of each arc."""
        return np.flatnonzero(np.diff(self.arc, prepend=-1))

    def tops(self, kinematics: Kinematics) -> FloatArray:
        """Return the speeds (m/s) that the lateral acceleration, v^2 k on a curvature k, allows."""
        tight = np.maximum(np.abs(self.bends), SAME)
        return np.sqrt(np.where(tight > SAME, kinematics.lateral_a_max, math.inf) / tight)


def speeds_in_bends(poses: FloatArray, kinematics: Kinematics) -> tuple[FloatArray, BoolArray]:
    """Return the top speeds (m/s; inf: no limit) between poses (n, 3) in bends and where curvature
    changes, shape (n - 1,), and at which inner poses it changes so much that the body rests there,
    shape (n - 2,).

    A step dk of the curvature over l m turns faster by v^2 dk / l, and has a share of ``alpha_max``
    (``TurnShares``); the rest is for speeding up in bends, see
    :func:`up_samp.motion.curves.rolling.pushes_of`.
    """
    if not kinematics.heeds_turns or len(poses) < 2:
        return np.full(len(poses) - 1, math.inf), np.zeros(max(len(poses) - 2, 0), dtype=np.bool_)
    way = Bends.of(*twists(poses).T[[0, 2]])
    most, push = way.tops(kinematics), SHARES.along * kinematics.alpha_max
    length = np.abs(np.bincount(way.arc, way.ways))[way.arc]
    steps = np.where(way.jumps > 0.0, way.jumps, SAME**2)
    speeds = np.sqrt(push * np.minimum(length[:-1], length[1:]) / steps)
    speeds = np.where(way.jumps > 0.0, np.minimum(speeds, push * SHARES.step / steps), math.inf)
    rests = speeds < SHARES.slow * np.minimum(kinematics.v_max, np.minimum(most[:-1], most[1:]))
    speeds[rests] = math.inf
    most[:-1] = np.minimum(most[:-1], speeds)
    most[1:] = np.minimum(most[1:], speeds)
    return most, rests


def turns_evenly(motion: Trajectory, kinematics: Kinematics) -> bool:
    """Return whether the turn rate of a motion never changes faster than it may, from rest to rest:
    means between samples, and a moment (``TurnShares.step``) is allowed for steps.
    """
    alpha = kinematics.alpha_max
    if math.isinf(alpha):
        return True
    times = motion.times
    middle = np.concatenate([times[:1], 0.5 * (times[1:] + times[:-1]), times[-1:]])
    rates = np.concatenate([[0.0], np.diff(motion.poses[:, 2]) / np.diff(times), [0.0]])
    # since any time before, by more than alpha times what has passed
    grown = [s * rates - alpha * (1.0 + SAME) * middle for s in (1.0, -1.0)]
    least = alpha * SHARES.step
    return all(bool(np.all(g - np.minimum.accumulate(g) <= least)) for g in grown)
