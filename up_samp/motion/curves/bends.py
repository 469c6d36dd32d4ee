"""Where ways bend: how they are cut into pieces, and what a body that moves in any direction may do
in a bend.
"""

from __future__ import annotations

import numpy as np

from up_samp.model import Body
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.rolling import ON_SPOT

SHORT = 1e-7
"""Steps shorter than this (m) carry no shape of their own."""
STRAIGHT, SHARP = 1e-4, 0.35
"""An omnidirectional body bends where its direction changes by more from sample to sample, and
rests where it changes by more.
"""


def bends_of(
    poses: FloatArray, s: FloatArray, times: FloatArray, body: Body, most: FloatArray
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Return how an omnidirectional body gets along a way that was driven at ``times`` (n,): top
    speeds (m/s) between samples, none above ``most`` (n - 1,), whether it keeps to one speed there,
    and where it has to rest.

    What was driven keeps to the limits, so a bend may be driven at one speed that is not more.
    """
    kin = body.kinematics
    fast = np.minimum(kin.v_max, most)
    step, gone = np.diff(s), np.diff(poses[:, :2], axis=0)
    turn, way = np.abs(np.diff(poses[:, 2])), np.hypot(*gone.T)
    arc = kin.reach * np.diff(poses[:, 2])
    spot = way < ON_SPOT * turn
    tops = np.where(spot, kin.v_max, np.minimum(kin.v_max, kin.omega_max * step / (turn + 1e-12)))
    driven = np.minimum(step / np.diff(times), kin.v_max)
    unit = np.column_stack((gone, arc)) / np.maximum(step, SHORT)[:, None]
    change = np.diff(np.where(spot[:, None], 0.0, unit), axis=0)
    change = np.hypot(change[:, 0], change[:, 1]) + np.abs(change[:, 2])
    bend = change > STRAIGHT
    # a little slower than its planner chose, and at rest where that is far below its top speed
    speed = 0.95 * np.minimum(driven[1:], driven[:-1])
    slow = bend & (speed < 0.3 * np.minimum(fast[1:], fast[:-1]))
    rests = (spot[1:] != spot[:-1]) | slow | (change > SHARP)
    bend &= ~rests
    steady = np.zeros(len(step), dtype=np.bool_)
    for side in (slice(None, -1), slice(1, None)):
        steady[side] |= bend
        tops[side] = np.where(bend, np.minimum(tops[side], speed), tops[side])
    tops = np.where(spot, tops, np.minimum(tops, most))
    return tops, steady, np.concatenate([[True], rests, [True]])


def ways_at(poses: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the direction per metre (n, 2) in which an omnidirectional body comes to each sample
    of its way, and that in which it leaves: where it does not rest, that of a straight piece
    beside it, else the mean of both sides.
    """
    unit = np.diff(poses[:, :2], axis=0) / np.diff(s)[:, None]
    change = np.concatenate([[0.0], np.hypot(*np.diff(unit, axis=0).T), [0.0]])
    bend = change > STRAIGHT
    before, after = np.concatenate([unit[:1], unit]), np.concatenate([unit, unit[-1:]])
    begins = bend & ~np.append(False, bend[:-1])
    ends = bend & ~np.append(bend[1:], False)
    mean = 0.5 * (before + after)
    way = np.where((begins & ~ends)[:, None], before, mean)
    way = np.where((ends & ~begins)[:, None], after, way)
    sharp = (change > SHARP)[:, None]
    return np.where(sharp, before, way), np.where(sharp, after, way)


def between_bends(
    poses: FloatArray,
    s: FloatArray,
    ways: tuple[FloatArray, FloatArray],
    i: IntArray,
    share: FloatArray,
) -> FloatArray:
    """Return the poses (k, 3) ``share`` (k,) of the way from samples ``i`` (k,) of an
    omnidirectional body's way to the next ones, along cubics (Hermite) that keep its direction
    (``ways``, see :func:`ways_at`) from jumping.
    """
    u, step = share[:, None], (s[i + 1] - s[i])[:, None]
    a, b = poses[i], poses[i + 1]
    out = a + u * (b - a)
    d = b[:, :2] - a[:, :2]
    comes, leaves = ways
    p, q = leaves[i] * step - d, d - comes[i + 1] * step
    out[:, :2] += u * (1 - u) * ((1 - u) * p + u * q)
    return np.asarray(out)
