"""Other bodies as the compiled searches see them: when is which pose visited?"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner, kernel
from up_samp.motion.fleet.cell_times import A_AVOIDS, B_AVOIDS
from up_samp.motion.fleet.conflicts import _apart

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

VISITS = 24
"""Visits of movers kept for one pose."""
GUARD = 0.1
"""Time (s) kept from visits at sampled poses."""


class Movers(NamedTuple):
    """Other bodies: ``rows`` (n, 9) poses in the middle of their extended cells (as in
    ``sweep_table``, but without extent), body k has ``first[k]:first[k + 1]``; ``held``
    its occupancy from ``first[k] + k`` on; ``hull`` (m,) the index of its shape in ``verts``
    (h, p, c, 2), ``counts`` (h, p; 0: no part), ``radii`` (h,);
    ``steps`` (m,) distance between middles at most; ``flags`` (m,) who keeps clear of whom.
    """

    rows: FloatArray
    first: IntArray
    held: FloatArray
    hull: IntArray
    verts: FloatArray
    counts: IntArray
    radii: FloatArray
    steps: FloatArray
    flags: IntArray


class Me(NamedTuple):
    """The body that is planned: convex parts, and ``numbers``: radius, margin, turning radius, v,
    a, release, time after which the goal stays free, time until which it must rest there.
    """

    verts: FloatArray
    counts: IntArray
    numbers: FloatArray


@kernel
def visits(
    me: Me, movers: Movers, x: float, y: float, th: float, resting: bool, out: FloatArray
) -> int:
    """Fill ``out`` (VISITS, 2) with the times at which movers are at a pose; return how many."""
    row = np.zeros(9)
    row[0], row[1], row[2], row[3] = x, y, math.cos(th), math.sin(th)
    count = 0
    for k in range(len(movers.hull)):
        flags, hull = movers.flags[k], movers.hull[k]
        low, high = movers.first[k], movers.first[k + 1]
        shift = k
        reach = me.numbers[0] + me.numbers[1] + movers.radii[hull]
        step = movers.steps[k]
        j = low
        if resting or not flags & A_AVOIDS:
            if not flags & B_AVOIDS:
                continue
            j += 1
            high -= 1
        open_from = -1
        while j < high:
            b = movers.rows[j]
            gap = math.sqrt((x - b[0]) ** 2 + (y - b[1]) ** 2) - reach
            hit = False
            if gap <= 0.0:
                hit = _touch(row, me, b, movers, hull)
            if hit and open_from < 0:
                open_from = j
            if not hit and open_from >= 0:
                count = _add(out, count, movers.held[open_from + shift], movers.held[j + shift])
                open_from = -1
            j += 1 if gap <= 0.0 else max(1, int(gap / step))
        if open_from >= 0:
            count = _add(out, count, movers.held[open_from + shift], movers.held[high + shift])
    return count


@inner
def _touch(row: FloatArray, me: Me, b: FloatArray, movers: Movers, hull: int) -> bool:
    for i in range(len(me.counts)):
        for j in range(movers.counts.shape[1]):
            n = movers.counts[hull, j]
            if n > 0 and not _apart(
                row,
                me.verts[i],
                me.counts[i],
                0.0,
                b,
                movers.verts[hull, j],
                n,
                0.0,
                me.numbers[1],
            ):
                return True
    return False


@inner
def _add(out: FloatArray, count: int, low: float, high: float) -> int:
    """Add [low, high], guarded, to sorted disjoint intervals; return how many there are then."""
    low -= GUARD
    high += GUARD
    k = 0
    while k < count and out[k, 1] < low:
        k += 1
    last = k
    while last < count and out[last, 0] <= high:
        low, high = min(low, out[last, 0]), max(high, out[last, 1])
        last += 1
    if last == k:
        if count == len(out):
            return count
        for i in range(count, k, -1):
            out[i, 0], out[i, 1] = out[i - 1, 0], out[i - 1, 1]
        count += 1
    else:
        for i in range(last, count):
            out[i - last + k + 1, 0], out[i - last + k + 1, 1] = out[i, 0], out[i, 1]
        count -= last - k - 1
    out[k, 0], out[k, 1] = low, high
    return count
