"""Compiled conflict geometry of two bodies on fixed paths, safe between samples.

Two pieces (see :mod:`up_samp.motion.fleet.swept`) are apart if for one edge normal of the convex
parts the gap at the middle poses exceeds what both can move and the margin (conservative
advancement along separating axes). Pieces that are neither apart nor overlapping in the middle are
split; what stays undecided at the finest level counts as a conflict.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner, kernel
from up_samp.model import check_time
from up_samp.motion.fleet.swept import Hull, Piece, Swept, piece, reach_of, standing

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Part(NamedTuple):
    """One convex part of a body: its ``corners`` (m, 2), of which the first ``many`` count, and
    the ``radius`` (m) of the body around its reference point.
    """

    corners: FloatArray
    many: int
    radius: float


class Frame(NamedTuple):
    """Where a body is in the frame of another one: ``x``, ``y`` (m), ``cos`` and ``sin`` of the
    heading.
    """

    x: float
    y: float
    cos: float
    sin: float


@inner
def _part(hull: Hull, i: int) -> Part:
    return Part(hull.verts[i], hull.counts[i], hull.radius)


@inner
def _frame(p: Piece, q: Piece) -> Frame:
    """Return where ``q`` is in the frame of ``p`` (in their middles)."""
    dx, dy = q.x - p.x, q.y - p.y
    return Frame(
        p.cos * dx + p.sin * dy,
        -p.sin * dx + p.cos * dy,
        p.cos * q.cos + p.sin * q.sin,
        p.cos * q.sin - p.sin * q.cos,
    )


@inner
def _edge_gap(mine: Part, i: int, other: Part, at: Frame) -> tuple[float, float, float]:
    """Return the gap (m) along the normal of an edge of ``mine`` to the ``other`` part, which is
    ``at`` a place in its frame, and the normal.
    """
    v, w = mine.corners, other.corners
    j = i + 1 if i + 1 < mine.many else 0
    nx, ny = v[j, 1] - v[i, 1], v[i, 0] - v[j, 0]
    norm = 1.0 / np.sqrt(nx * nx + ny * ny)
    nx *= norm
    ny *= norm
    # least of n . (o + R v) over the other's corners, minus the edge's own offset
    gx, gy = at.cos * nx + at.sin * ny, -at.sin * nx + at.cos * ny
    least = gx * w[0, 0] + gy * w[0, 1]
    for k in range(1, other.many):
        least = min(least, gx * w[k, 0] + gy * w[k, 1])
    return least + nx * (at.x - v[i, 0]) + ny * (at.y - v[i, 1]), nx, ny


@inner
def apart(a: Piece, mine: Part, b: Piece, other: Part, margin: float) -> int:
    """Return 2 if two convex parts stay apart in both pieces, 1 if they are apart in the middle
    only, 0 if they are not (all with ``margin``).
    """
    ha, hb = a.half, b.half
    spin = a.turn * ha * (mine.radius + 0.5 * ha)
    spin = spin + b.turn * hb * (other.radius + 0.5 * hb) + a.jump + b.jump
    tx, ty = ha * a.tx, ha * a.ty
    ux, uy = hb * b.tx, hb * b.ty
    found = 0
    for side in range(2):
        p, q = (a, b) if side == 0 else (b, a)
        one, two = (mine, other) if side == 0 else (other, mine)
        at = _frame(p, q)
        for i in range(one.many):
            gap, nx, ny = _edge_gap(one, i, two, at)
            gap -= margin
            if gap > 0.0:
                found = 1
                wx, wy = p.cos * nx - p.sin * ny, p.sin * nx + p.cos * ny
                moved = abs(tx * wx + ty * wy) + abs(ux * wx + uy * wy) + spin
                if gap > moved:
                    return 2
    return found


@inner
def verdict(a: Piece, g: Hull, b: Piece, h: Hull, margin: float) -> int:
    """Return the least verdict of :func:`apart` over all pairs of convex parts."""
    dx, dy = a.x - b.x, a.y - b.y
    reach = g.radius + h.radius + a.half + b.half + margin
    if dx * dx + dy * dy > reach * reach:
        return 2
    worst = 2
    for i in range(len(g.counts)):
        for j in range(len(h.counts)):
            said = apart(a, _part(g, i), b, _part(h, j), margin)
            if said == 0:
                return 0
            worst = min(worst, said)
    return worst


@inner
def pieces_conflict(ta: FloatArray, g: Hull, tb: FloatArray, h: Hull, margin: float) -> bool:
    """Return whether two cells (rows ``ta``, ``tb`` of sweep tables) are not shown to be apart."""
    stack = np.empty((64, 2), dtype=np.int64)
    stack[0, 0], stack[0, 1] = 1, 1
    top = 1
    half_a, half_b = len(ta) // 2, len(tb) // 2
    while top > 0:
        top -= 1
        i, j = stack[top, 0], stack[top, 1]
        a, b = piece(ta[i]), piece(tb[j])
        said = verdict(a, g, b, h, margin)
        if said == 2:
            continue
        if said == 0:
            return True
        can_a, can_b = i < half_a and a.half > 0, j < half_b and b.half > 0
        if not can_a and not can_b:
            return True
        longer = a.half * (1 + a.turn * g.radius) >= b.half * (1 + b.turn * h.radius)
        if can_a and (not can_b or longer):
            stack[top, 0], stack[top, 1] = 2 * i, j
            stack[top + 1, 0], stack[top + 1, 1] = 2 * i + 1, j
        else:
            stack[top, 0], stack[top, 1] = i, 2 * j
            stack[top + 1, 0], stack[top + 1, 1] = i, 2 * j + 1
        top += 2
    return False


@inner
def _gap(a: Piece, g: Hull, b: Piece, h: Hull) -> float:
    """Return the largest gap (m) along an edge normal at the middles of two pieces, least over the
    pairs of convex parts: not more than the distance, or minus the depth of the overlap.
    """
    least = np.inf
    for u in range(len(g.counts)):
        for w in range(len(h.counts)):
            mine, other = _part(g, u), _part(h, w)
            best = -np.inf
            for side in range(2):
                p, q = (a, b) if side == 0 else (b, a)
                one, two = (mine, other) if side == 0 else (other, mine)
                at = _frame(p, q)
                for i in range(one.many):
                    best = max(best, _edge_gap(one, i, two, at)[0])
            least = min(least, best)
    return least


@inner
def _noted(runs: IntArray, used: int, i: int, first: int, last: int) -> IntArray:
    """Return the runs with one more in row ``used``, in twice the room if there was none left."""
    if used == len(runs):
        more = np.empty((2 * used, 3), dtype=np.int64)
        for k in range(used):
            more[k, 0], more[k, 1], more[k, 2] = runs[k, 0], runs[k, 1], runs[k, 2]
        runs = more
    runs[used, 0], runs[used, 1], runs[used, 2] = i, first, last
    return runs


@kernel
def conflict_runs(one: Swept, other: Swept, margin: float) -> IntArray:
    """Return the conflicting cell pairs of two paths as rows (i, j first, j last), shape (k, 3).

    From one cell of the other path to the next its middle moves at most ``step`` m and no point
    more than ``stride`` m, so that pairs that are far apart, or deep in each other, let the scan
    along it jump ahead. Middles that are less than the sum of the inscribed radii apart certainly
    overlap.
    """
    ta, g, tb, h = one.table, one.hull, other.table, other.hull
    core = g.core + h.core
    runs = np.empty((64, 3), dtype=np.int64)
    used, m = 0, len(tb)
    step = stride = 1e-9
    for j in range(m):
        b = piece(tb[j, 1])
        step = max(step, 2 * b.half)
        stride = max(stride, 2 * reach_of(b, h.radius))
    for i in range(len(ta)):
        a = piece(ta[i, 1])
        mine = reach_of(a, g.radius)
        open_from, j = -1, 0
        while j < m:
            b = piece(tb[j, 1])
            dx, dy = a.x - b.x, a.y - b.y
            away = np.sqrt(dx * dx + dy * dy)
            far = away - (g.radius + h.radius + a.half + 0.5 * step + margin)
            hit, same = False, 0  # the next ``same`` cells of b are like this one
            if far > 0.0:
                same = int(far / step) - 1
            elif away < core:
                hit, same = True, int((core - away) / step)
            else:
                gap = _gap(a, g, b, h) - margin
                if gap <= 0.0:
                    hit, same = True, int(-gap / stride)
                elif gap > mine + 0.5 * stride:
                    same = int((gap - mine - 0.5 * stride) / stride)
                else:
                    hit = pieces_conflict(ta[i], g, tb[j], h, margin)
            if hit and open_from < 0:
                open_from = j
            if not hit and open_from >= 0:
                runs = _noted(runs, used, i, open_from, j - 1)
                used += 1
                open_from = -1
            j += 1 + max(0, same)
        if open_from >= 0:
            runs = _noted(runs, used, i, open_from, m - 1)
            used += 1
    return runs[:used].copy()  # a part would keep all of it


def conflicting_cells(one: Swept, other: Swept, margin: float, most: int = 5_000_000) -> IntArray:
    """Return the same as :func:`conflict_runs`, so many comparisons of convex parts at a time:
    between them it looks at the time limit.
    """
    table, hull = one
    each = len(hull.counts) * len(other.hull.counts) * max(len(other.table), 1)
    rows = max(1, most // each)
    if rows >= len(table):
        return conflict_runs(one, other, margin)
    found = []
    for first in range(0, len(table), rows):
        check_time()
        runs = conflict_runs(Swept(table[first : first + rows], hull), other, margin)
        runs[:, 0] += first
        found.append(runs)
    return np.concatenate(found)


@kernel
def separation(p: FloatArray, g: Hull, q: FloatArray, h: Hull, enough: float) -> float:
    """Return the largest gap (m) between two placed bodies along an edge normal (<= 0: overlap);
    ``enough`` where it is more than that.
    """
    a, b = standing(p[0], p[1], p[2]), standing(q[0], q[1], q[2])
    worst = enough
    for i in range(len(g.counts)):
        for j in range(len(h.counts)):
            mine, other = _part(g, i), _part(h, j)
            # bisect the margin at which the parts stop being apart: cheap, and done rarely
            low, high = 0.0, enough
            if apart(a, mine, b, other, low) == 0:
                return 0.0
            if apart(a, mine, b, other, high) == 0:
                for _ in range(40):
                    middle = 0.5 * (low + high)
                    if apart(a, mine, b, other, middle) == 0:
                        high = middle
                    else:
                        low = middle
            else:
                low = high
            worst = min(worst, low)
    return worst
