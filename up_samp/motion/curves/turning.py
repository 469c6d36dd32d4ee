"""What ``lateral_a_max`` and ``alpha_max`` allow along a way that is driven along the heading.

Ways are poses with a constant twist from each to the next, so their curvature is constant by pieces
and a change of it is a step. A step is driven over as if the curvature rose evenly along the
shorter of the pieces beside it, and never by more turn rate than ``alpha_max`` makes good within a
moment; where that is too slow, the body rests. :mod:`.ramps` makes small steps of large ones.
"""

from __future__ import annotations

import math

import numpy as np

from up_samp.model import Kinematics, Trajectory
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.motion.curves.rolling import ON_SPOT, SAME, SHARES
from up_samp.motion.curves.twists import twists


def speeds_in_bends(poses: FloatArray, kinematics: Kinematics) -> tuple[FloatArray, BoolArray]:
    """Return the top speeds (m/s; inf: no limit) between poses (n, 3) in bends and where curvature
    changes, shape (n - 1,), and at which inner poses it changes so much that the body rests there,
    shape (n - 2,).

    The lateral acceleration on a curvature k is v^2 k. A step dk of the curvature over l m turns
    faster by v^2 dk / l, and has a share of ``alpha_max`` (``TurnShares``); the rest is for
    speeding up in bends, see :func:`up_samp.motion.curves.rolling.pushes_of`.
    """
    most, rests = (
        np.full(len(poses) - 1, math.inf),
        np.zeros(max(len(poses) - 2, 0), dtype=np.bool_),
    )
    if not kinematics.heeds_turns:
        return most, rests
    ahead, _, turns = twists(poses).T
    ways = np.abs(ahead)
    spot = ways <= ON_SPOT * np.abs(turns)
    bends = np.where(spot, 0.0, turns / np.where(spot, 1.0, ahead))
    tight = np.abs(bends) > SAME
    most[tight] = np.sqrt(kinematics.lateral_a_max / np.abs(bends[tight]))
    if math.isinf(kinematics.alpha_max):
        return most, rests
    one, other = slice(None, -1), slice(1, None)
    passes = ~spot[one] & ~spot[other] & (ahead[one] * ahead[other] > 0.0)
    jumps = np.where(passes, np.abs(np.diff(bends)), 0.0)
    least = np.where(passes, np.minimum(ways[one], ways[other]), 1.0)
    jumps[jumps <= SAME + SHARES.noise / least] = 0.0
    arc = np.concatenate([[0], np.cumsum(~passes | (jumps > 0.0))])
    whole = np.bincount(arc, ways)[arc]
    push = SHARES.along * kinematics.alpha_max
    size = np.where(jumps > 0.0, jumps, 1.0)
    speeds = np.minimum(
        np.sqrt(push * np.minimum(whole[one], whole[other]) / size), push * SHARES.step / size
    )
    speeds[jumps == 0.0] = math.inf
    fast = np.minimum(kinematics.v_max, np.minimum(most[one], most[other]))
    rests = speeds < SHARES.slow * fast
    speeds[rests] = math.inf
    for side in (one, other):
        most[side] = np.minimum(most[side], speeds)
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
