"""Other bodies as the compiled searches see them: when is which pose visited?"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner, kernel
from up_samp.motion.curves.reeds_shepp import CarLimits, Pose
from up_samp.motion.fleet.cell_times import A_AVOIDS, B_AVOIDS
from up_samp.motion.fleet.conflicts import Part, apart
from up_samp.motion.fleet.swept import Hull, Piece, piece, standing

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


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


class Fineness(NamedTuple):
    """How finely drives are looked at: at so many ``pieces`` at most, ``piece`` m apart or more;
    so many ``visits`` are kept for a pose, each with ``guard`` s before and after it.
    """

    pieces: int
    piece: float
    visits: int
    guard: float


class Me(NamedTuple):
    """The body that is planned: its ``hull``, the ``margin`` (m) it keeps, its limits as a ``car``
    (the turning radius in m, m/s, m/s^2), when it may leave (``release``, s), after which time its
    goal stays free (``goal_free``, s), and how ``fine`` its drives are looked at.
    """

    hull: Hull
    margin: float
    car: CarLimits
    release: float
    goal_free: float
    fine: Fineness


@kernel
def visits(me: Me, movers: Movers, pose: Pose, resting: bool, out: FloatArray) -> int:
    """Fill ``out`` (visits, 2) with the times at which movers are at a pose; return how many."""
    here = standing(pose[0], pose[1], pose[2])
    count, guard = 0, me.fine.guard
    for k in range(len(movers.hull)):
        flags, hull = movers.flags[k], movers.hull[k]
        low, high = movers.first[k], movers.first[k + 1]
        shift = k
        reach = me.hull.radius + me.margin + movers.radii[hull]
        step = movers.steps[k]
        j = low
        if resting or not flags & A_AVOIDS:
            if not flags & B_AVOIDS:
                continue
            j += 1
            high -= 1
        open_from = -1
        while j < high:
            b = piece(movers.rows[j])
            gap = math.sqrt((here.x - b.x) ** 2 + (here.y - b.y) ** 2) - reach
            hit = False
            if gap <= 0.0:
                hit = _touch(here, me, b, movers, hull)
            if hit and open_from < 0:
                open_from = j
            if not hit and open_from >= 0:
                since, until = movers.held[open_from + shift], movers.held[j + shift]
                count = _add(out, count, since - guard, until + guard)
                open_from = -1
            j += 1 if gap <= 0.0 else max(1, int(gap / step))
        if open_from >= 0:
            since, until = movers.held[open_from + shift], movers.held[high + shift]
            count = _add(out, count, since - guard, until + guard)
    return count


@inner
def _touch(here: Piece, me: Me, b: Piece, movers: Movers, hull: int) -> bool:
    for i in range(len(me.hull.counts)):
        mine = Part(me.hull.verts[i], me.hull.counts[i], me.hull.radius)
        for j in range(movers.counts.shape[1]):
            n = movers.counts[hull, j]
            if n > 0:
                other = Part(movers.verts[hull, j], n, movers.radii[hull])
                if apart(here, mine, b, other, me.margin) == 0:
                    return True
    return False


@inner
def _add(out: FloatArray, count: int, low: float, high: float) -> int:
    """Add [low, high] to sorted disjoint intervals; return how many there are then."""
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
