"""Ramps of the curvature: ways of arcs whose curvature jumps become ways on which it changes in
small steps.

The curvature becomes its mean over a window about each place: that makes a clothoid of a jump, in
small arcs, and a low bump of a short arc (Scheuer & Laugier 1998; Fraichard & Scheuer 2004 put
clothoids between arcs). Headings stay about what they were, and the end of the way moves a little;
the arcs are made longer or shorter, as little as it takes, until it ends where it did.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from up_samp.model import Body, Kinematics, Trajectory
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.curves.rolling import moves_on
from up_samp.motion.curves.slowing import driven
from up_samp.motion.curves.trapezoid import MOST_TURN
from up_samp.motion.curves.turning import ALONG, MOMENT, SLOW, Bends
from up_samp.motion.curves.twists import twists


def with_ramps(motion: Trajectory, body: Body, blocked: Callable[[FloatArray], int]) -> Trajectory:
    """Return the motion of a body that drives along its heading, from time 0, as its limits allow:
    with ramps where these are quicker than rests, and ``blocked`` (the first of the poses (n, 3)
    after which a way is not free, or -1) lets them be. A ramp that is not free is halved.
    """
    rows = motion.poses[moves_on(motion.poses)]
    way = Bends.of(*twists(rows).T[[0, 2]]).whole
    best = driven(rows, body)
    if not way.jumps.any():
        return best
    windows = _windows(way, body.kinematics)
    for share in (1.6, 0.8, 0.4, 0.2):
        found = _ramped(way, rows, share * windows, body.kinematics, blocked)
        if found is not None:
            best = min(best, driven(found, body), key=lambda one: one.duration)
    return best


def _windows(way: Bends, kinematics: Kinematics) -> FloatArray:
    """Return over how many metres each jump may be made good at the speed that is had there."""
    tops = np.minimum(way.tops(kinematics), kinematics.v_max)
    if kinematics.mobility.rolls:
        tops = np.minimum(tops, kinematics.omega_max / np.maximum(np.abs(way.bends), 1e-9))
    fast = np.minimum(tops[:-1], tops[1:]) ** 2
    s = np.concatenate([[0.0], np.cumsum(np.abs(way.ways))])
    rests = s[np.concatenate([[True], way.jumps == 0.0, [True]])]
    near = np.abs(s[1:-1, None] - rests).min(axis=1)
    push = ALONG * kinematics.alpha_max
    # a short arc becomes a bump of its turn, which is the lower the longer it is
    turns = np.maximum(np.abs(way.turns[1:]), np.abs(way.turns[:-1]))
    windows = np.minimum(fast * way.jumps / push, np.sqrt(fast * turns / push))
    return np.asarray(np.minimum(windows, 5.0 * near))


def _ramped(
    way: Bends,
    rows: FloatArray,
    windows: FloatArray,
    kinematics: Kinematics,
    blocked: Callable[[FloatArray], int],
) -> FloatArray | None:
    """Return a way with ramps over at most such ``windows`` (m) that is free, if there is one."""
    step = MOMENT * SLOW * kinematics.v_max
    for k in range(30):  # each time half as long where it hits something, and wider around
        windows = np.where(windows > step, windows, 0.0)
        if not windows.any():
            return None
        found = _closed(way, rows, windows, 2.0 * step)
        if found is None:
            windows = 0.5 * windows
            continue
        hit = blocked(found[0])
        if hit < 0:
            return found[0]
        poses, joints = found
        far = np.hypot(*(poses[joints, :2] - poses[hit, :2]).T)
        least = max(float(far[windows > 0.0].min()), 0.3 * k)
        windows[far <= np.maximum(0.5 * windows, least)] *= 0.5
    return None


def _closed(
    way: Bends, rows: FloatArray, windows: FloatArray, step: float
) -> tuple[FloatArray, IntArray] | None:
    """Return the way with ramps over such ``windows`` (m), in steps of at most ``step`` m, from the
    first of ``rows`` to the last, and which of its poses is where each jump was; None if there is
    none.

    Newton's method: the end moves, as an arc gets longer, as if it turned about that arc's middle.
    """
    spot = way.ways == 0.0
    ahead, turn = np.where(spot, 0.0, 1.0), np.where(spot, 1.0, way.bends)
    size = np.where(spot, np.abs(way.turns), np.abs(way.ways))
    counts = np.maximum(2, np.ceil(size / np.where(spot, MOST_TURN, step)).astype(np.int64))
    ends = np.cumsum(counts)
    gone = np.zeros(len(size))
    for _ in range(25):
        ways, turns = way.ways + ahead * gone, way.turns + turn * gone
        if np.any(np.where(spot, turns * way.turns, ways * way.ways) <= 0.0):
            return None
        poses = _laid(rows[0], ways, turns, counts, np.where(way.jumps > 0.0, windows, -1.0))
        off = rows[-1] - poses[-1]
        if np.abs(off).max() < 1e-10:
            poses[-1] = rows[-1]
            return poses, ends[:-1]
        here = poses[ends - counts // 2]
        gap = poses[-1] - here
        c, s = np.cos(here[:, 2]), np.sin(here[:, 2])
        by = np.stack([ahead * c - turn * gap[:, 1], ahead * s + turn * gap[:, 0], turn])
        gone = gone + size * (np.linalg.lstsq(by * size, off, rcond=1e-9)[0])
    return None


def _laid(
    start: FloatArray, ways: FloatArray, turns: FloatArray, counts: IntArray, windows: FloatArray
) -> FloatArray:
    """Return the poses (k, 3) of arcs of such signed ``ways`` and ``turns``, each in so many parts,
    with the curvature of each part the mean over a window about it, as long as that of the jumps
    beside it (``windows``, m; -1: a rest).
    """
    parts, turned = np.repeat(ways / counts, counts), np.repeat(turns / counts, counts)
    s = np.concatenate([[0.0], np.cumsum(np.abs(parts))])
    heading = np.concatenate([[0.0], np.cumsum(turned)])
    middle, first = 0.5 * (s[1:] + s[:-1]), 0
    for run in np.split(np.arange(len(ways)), np.flatnonzero(windows < 0.0) + 1):
        last = first + int(counts[run].sum())
        low, high, here = s[first], s[last], slice(first, last)
        if len(run) > 1:
            joints = s[first + np.cumsum(counts[run])[:-1]]
            width = np.interp(middle[here], joints, windows[run[:-1]])
            size = np.abs(parts[here])
            half = 0.5 * np.maximum(width, size)
            # beyond its ends it would go on as it begins and ends
            far = 2.0 * (high - low)
            known = (
                np.concatenate([[low - far], s[first : last + 1], [high + far]]),
                np.concatenate(
                    [
                        [heading[first] - far * turned[first] / size[0]],
                        heading[first : last + 1],
                        [heading[last] + far * turned[last - 1] / size[-1]],
                    ]
                ),
            )
            mean = np.interp(middle[here] + half, *known) - np.interp(middle[here] - half, *known)
            turned[here] = size * mean / (2.0 * half)
        first = last
    heading = start[2] + np.concatenate([[0.0], np.cumsum(turned)])
    chord, along = parts * np.sinc(turned / (2.0 * math.pi)), heading[:-1] + 0.5 * turned
    x, y = (np.append(0.0, np.cumsum(chord * f(along))) for f in (np.cos, np.sin))
    return np.stack([start[0] + x, start[1] + y, heading], axis=1)
