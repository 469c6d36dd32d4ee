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
from up_samp.motion.curves.rolling import ON_SPOT, SAME
from up_samp.motion.curves.twists import twists

ALONG = 0.5
"""At most this share of ``alpha_max`` is for changes of curvature, what is left for changes of
speed.
"""
MOMENT = 0.05
"""What ``alpha_max`` makes good within so many s needs no ramp of its own."""
SLOW = 0.3
"""A body rests where the curvature jumps so that it could pass with less than this share of its top
speed only.
"""


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
        jumps[jumps <= SAME + 1e-7 / least] = 0.0  # headings may be off by 1e-7 rad
        turns_on = spot[:-1] & spot[1:] & (turns[:-1] * turns[1:] > 0.0)
        cut = (jumps > 0.0) | ~(passes | turns_on)
        arc = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(cut)])
        return Bends(drives, turns, bends, arc, jumps)

    @property
    def whole(self) -> Bends:
        """The same way with the pieces of each arc as one."""
        firsts = np.flatnonzero(np.diff(self.arc, prepend=-1))
        return Bends.of(*(np.add.reduceat(a, firsts) for a in (self.ways, self.turns)))

    def tops(self, kinematics: Kinematics) -> FloatArray:
        """Return the speeds (m/s) that the lateral acceleration, v^2 k on a curvature k, allows."""
        tight = np.maximum(np.abs(self.bends), SAME)
        return np.sqrt(np.where(tight > SAME, kinematics.lateral_a_max, math.inf) / tight)


class TurnLimits(NamedTuple):
    """What a way's bends allow: top speeds ``tops`` (m/s) and accelerations ``pushes`` (m/s^2)
    between poses, infinite where they say nothing; and at which inner poses a body ``rests``.
    """

    tops: FloatArray
    pushes: FloatArray
    rests: BoolArray


def limits_in_bends(poses: FloatArray, kinematics: Kinematics) -> TurnLimits:
    """Return what the bends of a way (n, 3) allow.

    A step dk of the curvature over l m turns faster by v^2 dk / l, which takes at most a share of
    ``alpha_max`` (``ALONG``), and half of it on either side. What the steps beside an arc of
    curvature k leave of ``alpha_max`` is for speeding up in it, which takes k a.
    """
    n = len(poses) - 1
    if not kinematics.heeds_turns or n < 1:
        free = np.full(n, math.inf)
        return TurnLimits(free, free, np.zeros(max(n - 1, 0), dtype=np.bool_))
    way = Bends.of(*twists(poses).T[[0, 2]])
    most, alpha = way.tops(kinematics), kinematics.alpha_max
    length = np.maximum(np.abs(np.bincount(way.arc, way.ways)), SAME)[way.arc]
    least = np.minimum(length[:-1], length[1:])
    jumps = way.jumps if math.isfinite(alpha) else np.zeros(n - 1)
    steps = np.where(jumps > 0.0, jumps, SAME**2)
    push = ALONG * alpha
    speeds = np.minimum(np.sqrt(push * least / steps), push * MOMENT / steps)
    fast = np.minimum(kinematics.v_max, np.minimum(most[:-1], most[1:]))
    rests = (jumps > 0.0) & (speeds < SLOW * fast)
    speeds = np.where(rests | (jumps == 0.0), math.inf, speeds)
    most[:-1] = np.minimum(most[:-1], speeds)
    most[1:] = np.minimum(most[1:], speeds)
    used = np.where(np.isinf(speeds), 0.0, 0.5 * np.minimum(speeds, fast) ** 2 * jumps)
    taken = np.bincount(way.arc[:-1], used, n) + np.bincount(way.arc[1:], used, n)
    left = alpha - taken[way.arc] / length
    return TurnLimits(most, left / np.maximum(np.abs(way.bends), SAME**2), rests)


def turns_evenly(motion: Trajectory, kinematics: Kinematics) -> bool:
    """Return whether the turn rate of a motion never changes faster than it may, from rest to rest:
    means between samples, and a ``MOMENT`` is allowed for steps.
    """
    alpha = kinematics.alpha_max
    if math.isinf(alpha):
        return True
    times = motion.times
    middle = np.concatenate([times[:1], 0.5 * (times[1:] + times[:-1]), times[-1:]])
    rates = np.concatenate([[0.0], np.diff(motion.poses[:, 2]) / np.diff(times), [0.0]])
    # since any time before, by more than alpha times what has passed
    grown = [s * rates - alpha * (1.0 + SAME) * middle for s in (1.0, -1.0)]
    least = alpha * MOMENT
    return all(bool(np.all(g - np.minimum.accumulate(g) <= least)) for g in grown)
