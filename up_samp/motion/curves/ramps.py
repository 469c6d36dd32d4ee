"""Ramps of the curvature: ways of arcs whose curvature jumps become ways on which it changes in
small steps.

Around a jump the curvature rises evenly: a clothoid, in small arcs (Scheuer & Laugier 1998;
Fraichard & Scheuer 2004). That keeps the headings and moves the end of the way a little; the arcs
are then made longer or shorter, as little as it takes, until it ends where it did.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from up_samp.model import Body, Kinematics, Trajectory
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.curves.rolling import SHARES, moves_on
from up_samp.motion.curves.slowing import driven
from up_samp.motion.curves.trapezoid import MOST_TURN
from up_samp.motion.curves.turning import Bends
from up_samp.motion.curves.twists import twists

TRIES = 40
"""Ways that are looked at before a body rests at all jumps."""


def with_ramps(motion: Trajectory, body: Body, blocked: Callable[[FloatArray], int]) -> Trajectory:
    """Return the motion of a body that drives along its heading, from time 0, as its limits allow:
    with ramps where these are quicker than rests, and ``blocked`` (the first of the poses (n, 3)
    after which a way is not free, or -1) lets them be. A ramp that is not free is halved.
    """
    rows = motion.poses[moves_on(motion.poses)]
    slow = driven(rows, body)
    found = _ramped(rows, body.kinematics, blocked)
    quick = slow if found is None else driven(found, body)
    return min(slow, quick, key=lambda one: one.duration)


def _ramped(
    rows: FloatArray, kinematics: Kinematics, blocked: Callable[[FloatArray], int]
) -> FloatArray | None:
    """Return a way with ramps that is free, if there is one."""
    way = Bends.of(*twists(rows).T[[0, 2]]).whole
    push = SHARES.along * kinematics.alpha_max
    tops = np.minimum(way.tops(kinematics), kinematics.v_max)
    if kinematics.mobility.rolls:
        tops = np.minimum(tops, kinematics.omega_max / np.maximum(np.abs(way.bends), 1e-9))
    fast = np.minimum(tops[:-1], tops[1:])
    sizes = fast**2 * way.jumps / push
    for _ in range(TRIES):
        sizes = _fitting(way, sizes)
        # what is too short is driven no faster than with a rest
        sizes[sizes * push < (SHARES.slow * fast) ** 2 * way.jumps] = 0.0
        if not sizes.any():
            return None
        counts = np.ceil(np.sqrt(sizes * way.jumps / push) / SHARES.step).astype(np.int64)
        found = _closed(way, rows, sizes, counts)
        if found is None:
            sizes = 0.5 * sizes
            continue
        hit = blocked(found[0])
        if hit < 0:
            return found[0]
        joints = np.flatnonzero(sizes)
        sizes[joints[np.argmin(np.abs(found[1][joints] - hit))]] *= 0.5
    return None


def _fitting(way: Bends, sizes: FloatArray, share: float = 0.9) -> FloatArray:
    """Return ramps (m) no longer than that two of them leave something of the arc between."""
    before, after = np.append(0.0, sizes), np.append(sizes, 0.0)
    room = np.minimum(1.0, share * np.abs(way.ways) / np.maximum(0.5 * (before + after), 1e-12))
    return np.asarray(sizes * np.minimum(room[:-1], room[1:]))


def _closed(
    way: Bends, rows: FloatArray, sizes: FloatArray, counts: IntArray
) -> tuple[FloatArray, IntArray] | None:
    """Return the way with ramps of such ``sizes`` (m) in so many steps (``counts``), from the first
    of ``rows`` to the last, and which of its poses is where each jump was; None if there is none.

    Newton's method: how the end moves as an arc gets longer is a turn about that arc's middle.
    """
    spot = way.ways == 0.0
    unit = np.where(spot[:, None], [0.0, 1.0], np.stack([np.ones(len(spot)), way.bends], axis=1))
    gone = np.zeros(len(spot))
    for _ in range(12):
        poses, ends, middle = _laid(way, rows[0], unit * gone[:, None], sizes, counts)
        if middle.min() < 0.0:
            return None
        off = rows[-1] - poses[-1]
        if np.abs(off).max() < 1e-10:
            poses[-1] = rows[-1]
            return poses, ends[:-1]
        here, (ahead, turn) = poses[ends], unit.T
        gap = poses[-1] - here
        c, s = np.cos(here[:, 2]), np.sin(here[:, 2])
        by = np.stack([ahead * c - turn * gap[:, 1], ahead * s + turn * gap[:, 0], turn])
        weight = np.maximum(middle, 1e-6)
        gone = gone + weight * (np.linalg.lstsq(by * weight, off, rcond=1e-9)[0])
    return None


def _laid(
    way: Bends, start: FloatArray, more: FloatArray, sizes: FloatArray, counts: IntArray
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the poses (k, 3) of a way with ramps whose arcs are by ``more`` (n, 2; m, rad) longer,
    which of them ends the even part of each arc, and how long these parts are (m; rad on the spot).
    """
    sense = np.sign(way.ways)
    before, after = np.append(0.0, sizes), np.append(sizes, 0.0)
    even = way.ways + more[:, 0] - sense * 0.5 * (before + after)
    turns = np.where(sense == 0.0, way.turns + more[:, 1], way.bends * even)
    pieces, ends, n = [], [], 0
    for i in range(len(even)):
        parts = max(1, math.ceil(abs(turns[i]) / MOST_TURN))
        pieces.append(np.tile([[even[i], turns[i]]], (parts, 1)) / parts)
        n += parts
        ends.append(n)
        if i < len(sizes) and sizes[i] > 0.0:
            count = int(counts[i])
            share = (np.arange(count) + 0.5) / count
            bends = way.bends[i] + share * (way.bends[i + 1] - way.bends[i])
            step = np.full(count, sense[i] * sizes[i] / count)
            pieces.append(np.stack([step, bends * step], axis=1))
            n += count
    steps, turned = np.concatenate(pieces).T
    heading = start[2] + np.concatenate([[0.0], np.cumsum(turned)])
    chord, along = steps * np.sinc(turned / (2.0 * math.pi)), heading[:-1] + 0.5 * turned
    x, y = (np.append(0.0, np.cumsum(chord * f(along))) for f in (np.cos, np.sin))
    left = np.where(sense == 0.0, np.abs(turns), sense * even)
    return np.stack([start[0] + x, start[1] + y, heading], axis=1), np.array(ends), left
