"""What bodies sweep on fixed paths, and the compiled conflict geometry of two of them, safe between
samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import NamedTuple, TypeVar

import numpy as np

from up_samp.geometry.records import inner, kernel, lean_inner, lean_kernel
from up_samp.geometry.scene import Scene
from up_samp.model import check_time
from up_samp.model.arrays import BoolArray, FloatArray, IntArray

DEPTH = 2
"""Times that a cell may be halved."""


class Hull(NamedTuple):
    """A planar body's convex parts: ``verts`` (p, m, 2) padded by repeating the last corner,
    ``counts`` (p,), circumscribed ``radius`` about the reference point, and ``core``, how deep that
    is inside the body: the radius of the inscribed disc about it, or minus the distance to the body
    where it lies beside (m).
    """

    verts: FloatArray
    counts: IntArray
    radius: float
    core: float


class Swept(NamedTuple):
    """A body on its path: the ``table`` (see :func:`sweep_table`) and its ``hull``."""

    table: FloatArray
    hull: Hull


class SweptPiece(NamedTuple):
    """A stretch of a path: the pose in its middle (``x``, ``y`` in m, ``cos`` and ``sin`` of the
    heading), the direction of travel ``tx``, ``ty`` there per unit of ``s``, the largest ``turn``
    per unit of ``s``, ``half`` its length, and the displacement (m) that jumps of the direction
    inside it may add.
    """

    x: float
    y: float
    cos: float
    sin: float
    tx: float
    ty: float
    turn: float
    half: float
    jump: float


@lean_inner
def piece(row: FloatArray) -> SweptPiece:
    """Return the piece in a row (9,) of a table."""
    return SweptPiece(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8])


@lean_inner
def standing(x: float, y: float, heading: float) -> SweptPiece:
    """Return the piece of a body that rests at a pose."""
    at = float(x), float(y)  # poses of whole numbers, too
    return SweptPiece(at[0], at[1], np.cos(heading), np.sin(heading), 0.0, 0.0, 0.0, 0.0, 0.0)


@lean_inner
def reach_of(p: SweptPiece, radius: float) -> float:
    """Return how far (m) any point of a body can be from where it is in the middle of a piece."""
    return p.half * (1.0 + p.turn * (radius + 0.5 * p.half)) + p.jump


@kernel
def sweep_table(s: FloatArray, poses: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the pieces of all extended cells as rows, shape (cells + 2, 2 ** (DEPTH + 1), 9).

    Row 1 of an extended cell is the whole cell, rows 2k and 2k + 1 are the halves of row k. The
    rests have ``half = 0``.
    """
    cells = len(edges) - 1
    rows = 1 << (DEPTH + 1)
    table = np.zeros((cells + 2, rows, 9))
    n = len(s)
    for cell in range(cells + 2):
        rest = cell == 0 or cell == cells + 1
        low = edges[0] if cell == 0 else edges[min(cell - 1, cells)]
        high = low if rest else edges[cell]
        for row in range(1, rows):
            level = 0
            while (1 << (level + 1)) <= row:
                level += 1
            share = (row - (1 << level)) / (1 << level)
            a = low + (high - low) * share
            b = a + (high - low) / (1 << level)
            middle = 0.5 * (a + b)
            i = max(0, min(n - 2, np.searchsorted(s, middle, side="right") - 1))
            at = _piece_at(s, poses, i, middle)
            tx, ty, turn, half, jump = 0.0, 0.0, 0.0, 0.0, 0.0
            if not rest and n > 1:
                tx, ty, half = at.tx, at.ty, 0.5 * (b - a)
                k = i
                while k > 0 and s[k] > a:
                    k -= 1
                while k < n - 1 and s[k] < b:
                    turn = max(turn, abs(poses[k + 1, 2] - poses[k, 2]) / (s[k + 1] - s[k]))
                    if s[k] > a:
                        jump += half * _jump(s, poses, k)
                    k += 1
            out = table[cell, row]
            out[0], out[1], out[2], out[3], out[4] = at.x, at.y, at.cos, at.sin, tx
            out[5], out[6], out[7], out[8] = ty, turn, half, jump
    return table


@inner
def _jump(s: FloatArray, poses: FloatArray, k: int) -> float:
    """Return how much the direction of travel per unit of ``s`` jumps at the inner sample ``k``."""
    ends = np.empty((2, 2))
    for side in range(2):
        i = k - 1 + side
        dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
        half = 0.5 * (poses[i + 1, 2] - poses[i, 2])
        grow = 1.0 if abs(half) < 1e-9 else half / np.sin(half)
        angle = half if side == 0 else -half
        c, q = np.cos(angle), np.sin(angle)
        step = grow / (s[i + 1] - s[i])
        ends[side, 0], ends[side, 1] = step * (c * dx - q * dy), step * (q * dx + c * dy)
    return np.hypot(ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1])


@lean_inner
def _piece_at(s: FloatArray, poses: FloatArray, i: int, at: float) -> SweptPiece:
    """Return the pose and the direction of travel at parameter ``at`` of sample interval ``i``."""
    if len(s) == 1 or at <= s[0]:
        return standing(poses[0, 0], poses[0, 1], poses[0, 2])
    share = min(1.0, (at - s[i]) / (s[i + 1] - s[i]))
    dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
    turn = poses[i + 1, 2] - poses[i, 2]
    half = 0.5 * turn
    if abs(half) < 1e-9:
        scale, angle, grow = share, 0.0, 1.0
    else:
        scale = np.sin(share * half) / np.sin(half)
        angle = (share - 1.0) * half
        grow = half / np.sin(half)
    c, q = np.cos(angle), np.sin(angle)
    x = poses[i, 0] + scale * (c * dx - q * dy)
    y = poses[i, 1] + scale * (q * dx + c * dy)
    theta = poses[i, 2] + share * turn
    # direction of travel: the chord turned by what is missing to the arc's tangent here
    c, q = np.cos(share * turn - half), np.sin(share * turn - half)
    step = grow / (s[i + 1] - s[i])
    tx, ty = step * (c * dx - q * dy), step * (q * dx + c * dy)
    return SweptPiece(x, y, np.cos(theta), np.sin(theta), tx, ty, 0.0, 0.0, 0.0)


# ------------------ Compiled conflict geometry of two bodies on fixed paths, safe between samples
# Two pieces are apart if for one edge normal of the convex
# parts the gap at the middle poses exceeds what both can move and the margin (conservative
# advancement along separating axes). Pieces that are neither apart nor overlapping in the middle
# are split; what stays undecided at the finest level counts as a conflict.


class Part(NamedTuple):
    """One convex part of a body: its ``corners`` (m, 2), of which the first ``many`` count, and
    the ``radius`` (m) of the body around its reference point.
    """

    corners: FloatArray
    many: int
    radius: float


Sway = tuple[float, float, float, float, float]
"""How far two pieces may move from their middles (m): x and y of one, of the other, what both turn.
"""
RelativePose = tuple[float, float, float, float]
"""Where a body is in the frame of another one: x, y (m), cosine and sine of the heading."""


@lean_inner
def _relative_pose(p: SweptPiece, q: SweptPiece) -> RelativePose:
    """Return where ``q`` is in the frame of ``p`` (in their middles)."""
    dx, dy = q.x - p.x, q.y - p.y
    x, y = p.cos * dx + p.sin * dy, -p.sin * dx + p.cos * dy
    return x, y, p.cos * q.cos + p.sin * q.sin, p.cos * q.sin - p.sin * q.cos


@lean_inner
def _edge_gap(mine: Part, i: int, other: Part, at: RelativePose) -> tuple[float, float, float]:
    """Return the gap (m) along the normal of an edge of ``mine`` to the ``other`` part, which is
    ``at`` a place in its frame, and the normal.
    """
    v, w, (x, y, c, s) = mine.corners, other.corners, at
    j = i + 1 if i + 1 < mine.many else 0
    nx, ny = v[j, 1] - v[i, 1], v[i, 0] - v[j, 0]
    norm = 1.0 / np.sqrt(nx * nx + ny * ny)
    nx *= norm
    ny *= norm
    # least of n . (o + R v) over the other's corners, minus the edge's own offset
    gx, gy = c * nx + s * ny, -s * nx + c * ny
    least = gx * w[0, 0] + gy * w[0, 1]
    for k in range(1, other.many):
        least = min(least, gx * w[k, 0] + gy * w[k, 1])
    return least + nx * (x - v[i, 0]) + ny * (y - v[i, 1]), nx, ny


@lean_inner
def apart(a: SweptPiece, mine: Part, b: SweptPiece, other: Part, margin: float) -> int:
    """Return 2 if two convex parts stay apart in both pieces, 1 if they are apart in the middle
    only, 0 if they are not (all with ``margin``).
    """
    ha, hb = a.half, b.half
    spin = a.turn * ha * (mine.radius + 0.5 * ha)
    spin = spin + b.turn * hb * (other.radius + 0.5 * hb) + a.jump + b.jump
    sway = ha * a.tx, ha * a.ty, hb * b.tx, hb * b.ty, spin
    said = _told_apart(a, mine, b, other, margin, sway)
    return said if said == 2 else max(said, _told_apart(b, other, a, mine, margin, sway))


@lean_inner
def _told_apart(
    p: SweptPiece, mine: Part, q: SweptPiece, other: Part, margin: float, sway: Sway
) -> int:
    """Return what the edges of ``mine`` alone tell of :func:`apart`."""
    (tx, ty, ux, uy, spin), at, found = sway, _relative_pose(p, q), 0
    for i in range(mine.many):
        gap, nx, ny = _edge_gap(mine, i, other, at)
        gap -= margin
        if gap > 0.0:
            found = 1
            wx, wy = p.cos * nx - p.sin * ny, p.sin * nx + p.cos * ny
            moved = abs(tx * wx + ty * wy) + abs(ux * wx + uy * wy) + spin
            if gap > moved:
                return 2
    return found


@lean_inner
def verdict(a: SweptPiece, g: Hull, b: SweptPiece, h: Hull, margin: float) -> int:
    """Return the least verdict of :func:`apart` over all pairs of convex parts."""
    dx, dy = a.x - b.x, a.y - b.y
    reach = g.radius + h.radius + a.half + b.half + margin
    if dx * dx + dy * dy > reach * reach:
        return 2
    worst = 2
    for i in range(len(g.counts)):
        mine = Part(g.verts[i], g.counts[i], g.radius)
        for j in range(len(h.counts)):
            said = apart(a, mine, b, Part(h.verts[j], h.counts[j], h.radius), margin)
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


@lean_inner
def _gap(a: SweptPiece, g: Hull, b: SweptPiece, h: Hull) -> float:
    """Return the largest gap (m) along an edge normal at the middles of two pieces, least over the
    pairs of convex parts: not more than the distance, or minus the depth of the overlap.
    """
    least = np.inf
    for i in range(len(g.counts)):
        mine = Part(g.verts[i], g.counts[i], g.radius)
        for j in range(len(h.counts)):
            other = Part(h.verts[j], h.counts[j], h.radius)
            best = max(
                _widest(mine, other, _relative_pose(a, b)),
                _widest(other, mine, _relative_pose(b, a)),
            )
            least = min(least, best)
    return least


@lean_inner
def _widest(mine: Part, other: Part, at: RelativePose) -> float:
    """Return the largest gap (m) along a normal of an edge of ``mine``."""
    best = -np.inf
    for i in range(mine.many):
        best = max(best, _edge_gap(mine, i, other, at)[0])
    return best


Rows = TypeVar("Rows", FloatArray, IntArray)


@inner
def with_room(rows: Rows, needed: int) -> Rows:
    """Return the rows in twice the room, if there is none for so many."""
    if needed <= len(rows):
        return rows
    more = np.empty((2 * len(rows), rows.shape[1]), dtype=rows.dtype)
    more[: len(rows)] = rows
    return more


@inner
def noted(rows: Rows, used: int, number: int, first: float, last: float) -> Rows:
    """Return the rows (number, first, last) with one more in row ``used``."""
    rows = with_room(rows, used + 1)
    rows[used, 0], rows[used, 1], rows[used, 2] = number, first, last
    return rows


@lean_inner
def _strides(table: FloatArray, radius: float) -> tuple[float, float]:
    """Return how far (m) the middle, and any point, of a body moves at most from cell to cell."""
    step = stride = 1e-9
    for k in range(len(table)):
        p = piece(table[k, 1])
        step, stride = max(step, 2 * p.half), max(stride, 2 * reach_of(p, radius))
    return step, stride


@kernel
def conflict_runs(one: Swept, other: Swept, margin: float) -> IntArray:
    """Return the conflicting cell pairs of two paths as rows (i, j first, j last), shape (k, 3).

    From one cell of the other path to the next its middle moves at most ``step`` m and no point
    more than ``stride`` m, so that pairs that are far apart, or deep in each other, let the scan
    along it jump ahead. It leaves a quarter of the way to those that are far: cells of the first
    path that are nearer to this one than the least ``room`` (m) of them have no conflicts either.
    Bodies whose middles are less than the sum of their cores apart certainly overlap.
    """
    ta, g, tb, h = one.table, one.hull, other.table, other.hull
    core = g.core + h.core
    runs, used, i, m = np.empty((64, 3), dtype=np.int64), 0, 0, len(tb)
    (step, stride), (pace, _) = _strides(tb, h.radius), _strides(ta, g.radius)
    while i < len(ta):
        a = piece(ta[i, 1])
        mine, room = reach_of(a, g.radius), np.inf
        open_from, j = -1, 0
        while j < m:
            b = piece(tb[j, 1])
            dx, dy = a.x - b.x, a.y - b.y
            away = np.sqrt(dx * dx + dy * dy)
            far = away - (g.radius + h.radius + a.half + 0.5 * step + margin)
            hit, same = False, 0  # the next ``same`` cells of b are like this one
            if far > 0.0:
                same = int(0.75 * far / step) - 1
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
                runs = noted(runs, used, i, open_from, j - 1)
                used += 1
                open_from = -1
            same = max(0, same)
            room = min(room, far - same * step)
            j += 1 + same
        if open_from >= 0:
            runs = noted(runs, used, i, open_from, m - 1)
            used += 1
        i += 1 + max(0, int(min(room / pace, float(len(ta)))) - 1)
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


@lean_kernel
def separation(p: FloatArray, g: Hull, q: FloatArray, h: Hull) -> float:
    """Return the largest gap (m) between two placed bodies along an edge normal (0: they touch or
    overlap).
    """
    return max(0.0, _gap(standing(p[0], p[1], p[2]), g, standing(q[0], q[1], q[2]), h))


def runs_in(cells: BoolArray) -> IntArray:
    """Return which pairs of cells (n, m) are set, as rows (i, j first, j last)."""
    edges = np.diff(np.pad(cells.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    begins, ends = np.argwhere(edges > 0), np.argwhere(edges < 0)
    # kernels are compiled anew for arrays that lie otherwise, or cannot be written
    return np.ascontiguousarray(np.column_stack([begins, ends[:, 1] - 1]))


# ------------------ On which sides two robots may pass each other

A_AVOIDS = 1
"""Bit of a pair's flags: the first body, moving, must keep clear of the second."""
B_AVOIDS = 2
"""Bit of a pair's flags: the second body, moving, must keep clear of the first."""


@inner
def _joined(rows: IntArray) -> tuple[IntArray, int]:
    """Return to which obstacle each row (i, j first, j last) of conflicting cells belongs, and how
    many there are: cells that touch, by a corner at least, belong together. Rows ascend by i.
    """
    n = len(rows)
    part = np.arange(n)
    for r in range(n):
        for q in range(r - 1, -1, -1):
            if rows[q, 0] < rows[r, 0] - 1:
                break
            if rows[q, 1] <= rows[r, 2] + 1 and rows[r, 1] <= rows[q, 2] + 1:
                low, high = min(part[q], part[r]), max(part[q], part[r])
                if low < high:
                    for k in range(r + 1):
                        if part[k] == high:
                            part[k] = low
    # each obstacle has the number of its first row: count them
    number, many = np.empty(n, dtype=np.int64), 0
    for r in range(n):
        if part[r] == r:
            number[r] = many
            many += 1
        else:
            number[r] = number[part[r]]
    return number, many


@kernel
def passing_gaps(
    rows: IntArray, first_held: FloatArray, other_held: FloatArray, flags: int
) -> FloatArray:
    """Return for each obstacle of two paths' coordination diagram (O'Donnell and Lozano-Pérez 1989)
    what it takes that one body passes it before the other one: seconds, shape (k, 2, 2, 2).

    ``rows`` are conflicting cells (i, j first, j last) that ascend by i, ``held`` is when each cell
    is entered if a path is driven from 0 s on without a stop, ``flags`` tell who heeds whom. The
    indices: which obstacle; who passes first; whether that one has to have left its goal, else to
    be on its way; whether the other one has not come to its start yet, else is on its way. The
    value is by how much, at least, the second event (its start, or its coming to where it starts)
    comes after the first one (its start, or its leaving the goal); -inf where nothing is asked.
    """
    part, many = _joined(rows)
    found = np.full((many, 2, 2, 2), -np.inf)
    end, last = len(first_held) - 2, len(other_held) - 2
    for r in range(len(rows)):
        i, low, high = rows[r, 0], rows[r, 1], rows[r, 2]
        if i == 0 or i == end or not flags & A_AVOIDS:
            # one that rests, or heeds nobody, is only in the way of one that moves and heeds it
            low, high = max(low, 1), min(high, last - 1)
            if low > high or not flags & B_AVOIDS:
                continue
        k = part[r]
        leaves, comes = i == end, low == 0
        since = (0.0 if leaves else first_held[i + 1]) - (0.0 if comes else other_held[low])
        a, b = int(leaves), int(comes)
        found[k, 0, a, b] = max(found[k, 0, a, b], since)
        leaves, comes = high == last, i == 0
        since = (0.0 if leaves else other_held[high + 1]) - (0.0 if comes else first_held[i])
        a, b = int(leaves), int(comes)
        found[k, 1, a, b] = max(found[k, 1, a, b], since)
    return found


# ------------------ How much clearance two bodies keep from each other


MARGIN, ROOM = 0.01, 0.02
"""Clearance (m) kept where the service has no scene that tells another one, and what bodies at rest
have to spare of theirs, so that one of them may drive off.
"""


def wished(scene: Scene | None) -> float:
    """Return the clearance (m) asked for: that of the scene, from walls and from others alike."""
    return MARGIN if scene is None else scene.margin


def eased(wish: float, gap: float) -> float:
    """Return the clearance (m) that two bodies keep which rest ``gap`` m apart at an end: ``wish``,
    or less where they could not drive off with so much.
    """
    return min(wish, max(0.5 * gap, gap - ROOM))


def kept(wish: float, a: Iterable[FloatArray], g: Hull, b: Iterable[FloatArray], h: Hull) -> float:
    """Return the clearance (m) that two bodies keep: ``wish``, less where poses at which they rest
    (``a`` and ``b``, (3,) each) are closer to each other than that.
    """
    margin = wish
    for p, q in product(a, b):
        gap = separation(p, g, q, h)
        if gap > 0.0:
            margin = eased(margin, gap)
    return margin


# ------------------ Compiled conflicts of two short moves
# Driven in step, or one after the other in any way. Two robots drive *in step* when each is at the
# same share of its own move at every instant. A robot may then follow right behind another, or
# several may turn in a ring that is full.


@lean_inner
def _moved(p: SweptPiece, tx: float, ty: float) -> SweptPiece:
    """Return a piece with another direction of travel."""
    return SweptPiece(p.x, p.y, p.cos, p.sin, tx, ty, p.turn, p.half, p.jump)


@kernel
def swept_in_step(one: Swept, other: Swept, margin: float) -> bool:
    """Return whether two moves, driven in step, are not shown to keep ``margin`` m apart.

    Their tables have the same number of cells. What counts between two pieces of the same share is
    how far one moves relative to the other.
    """
    ta, tb = one.table, other.table
    half = ta.shape[1] // 2
    stack = np.empty(64, dtype=np.int64)
    for cell in range(1, len(ta) - 1):
        top = 1
        stack[0] = 1
        while top > 0:
            top -= 1
            row = stack[top]
            a, b = piece(ta[cell, row]), piece(tb[cell, row])
            # all of the relative motion is given to one of the two
            x, y = a.half * a.tx - b.half * b.tx, a.half * a.ty - b.half * b.ty
            if a.half > 0.0:
                a, b = _moved(a, x / a.half, y / a.half), _moved(b, 0.0, 0.0)
            elif b.half > 0.0:
                a, b = _moved(a, 0.0, 0.0), _moved(b, x / b.half, y / b.half)
            said = verdict(a, one.hull, b, other.hull, margin)
            if said == 2:
                continue
            if said == 0 or row >= half or (a.half <= 0.0 and b.half <= 0.0):
                return True
            stack[top], stack[top + 1] = 2 * row, 2 * row + 1
            top += 2
    return False


@kernel
def sweeps_meet(one: Swept, other: Swept, margin: float) -> bool:
    """Return whether any part of one move is not shown to be apart from any part of the other."""
    for i in range(1, len(one.table) - 1):
        for j in range(1, len(other.table) - 1):
            if pieces_conflict(one.table[i], one.hull, other.table[j], other.hull, margin):
                return True
    return False
