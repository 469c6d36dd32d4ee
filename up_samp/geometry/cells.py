"""Distances, regions and shortest ways over the cells of a grid.

Distances and regions as scipy's ``ndimage`` and ``csgraph`` give them: importing those is a good
part of a small problem's whole time, so there are kernels for it here; they give the same numbers,
bit by bit (where several cells are nearest, any of them). Only large graphs, where scipy's search
is the better one, still go there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from up_samp.geometry.memory import Memory
from up_samp.geometry.records import inner, kernel
from up_samp.model import check_time
from up_samp.model.arrays import BoolArray, FloatArray, Int32Array

BAND = 2_000_000
"""Cells that are worked on between two looks at the clock."""

SMALL_GRAPH = 150
"""Nodes up to which the kernels look for shortest ways: some milliseconds."""


def distances_to(
    blocked: BoolArray, scale: float = 1.0, kind: type[np.floating[Any]] = np.float64
) -> npt.NDArray[Any]:
    """Return the distance (in cells, centre to centre) of every cell to the nearest blocked one
    (inf: there is none), times ``scale``, as numbers of a ``kind``.

    :raises OutOfTimeError: where the deadline in force comes before a large grid is done.
    """
    if not blocked.any():
        return np.full(blocked.shape, np.inf, dtype=kind)
    out = np.empty(blocked.shape, dtype=kind)
    near = _near(blocked)
    for rows in _bands(blocked.shape):
        part = np.empty((rows.stop - rows.start, blocked.shape[1]))
        row_distances(near[rows], part, np.empty((0, 0), dtype=np.int32))
        np.multiply(part, scale, out=part)
        out[rows] = part
    return out


def nearest_to(blocked: BoolArray) -> Int32Array:
    """Return (2, rows, columns): row and column of the blocked cell nearest to every cell; at least
    one has to be blocked.

    :raises OutOfTimeError: where the deadline in force comes before a large grid is done.
    """
    found = np.empty((2, *blocked.shape), dtype=np.int32)
    near = _near(blocked)
    for rows in _bands(blocked.shape):
        part = np.empty((rows.stop - rows.start, blocked.shape[1]))
        columns = np.empty(part.shape, dtype=np.int32)
        row_distances(near[rows], part, columns)
        here = np.arange(rows.start, rows.stop, dtype=np.int32)[:, None]
        away = np.take_along_axis(near[rows], columns, axis=1)
        above = np.maximum(here - away, 0)
        up = blocked[above, columns] & (above == here - away)
        found[0, rows] = np.where(up, above, here + away)
        found[1, rows] = columns
    return found


def _near(blocked: BoolArray) -> Int32Array:
    check_time()
    near = np.empty(blocked.shape, dtype=np.int32)
    column_distances(np.ascontiguousarray(blocked), near)
    return near


def _bands(shape: tuple[int, ...]) -> Iterator[slice]:
    """Yield parts of the rows, with a look at the clock before each."""
    step = max(1, BAND // max(1, shape[1]))
    for first in range(0, shape[0], step):
        check_time()
        yield slice(first, min(shape[0], first + step))


def grown(blocked: BoolArray) -> BoolArray:
    """Return the cells that are blocked or touch a blocked one, also at a corner."""
    tall = blocked.copy()
    tall[1:] |= blocked[:-1]
    tall[:-1] |= blocked[1:]
    wide = tall.copy()
    wide[:, 1:] |= tall[:, :-1]
    wide[:, :-1] |= tall[:, 1:]
    return wide


def shortest_ways(lengths: FloatArray) -> FloatArray:
    """Return the least length of a way between any two nodes, inf where there is none.

    ``lengths`` (n, n): those of the edges, symmetric, 0 where there is none.
    """
    if len(lengths) <= SMALL_GRAPH:
        return all_pairs(lengths)
    from scipy.sparse import csgraph

    return np.asarray(csgraph.dijkstra(lengths))


@kernel
def column_distances(blocked: BoolArray, near: Int32Array) -> None:
    """Write the distance (in cells) of every cell to the nearest blocked one of its column."""
    rows, cols = blocked.shape
    far = rows + cols
    for r in range(rows):
        for c in range(cols):
            before = near[r - 1, c] if r > 0 else far
            near[r, c] = 0 if blocked[r, c] else min(far, before + 1)
    for r in range(rows - 2, -1, -1):
        for c in range(cols):
            near[r, c] = min(near[r, c], near[r + 1, c] + 1)


@kernel
def row_distances(near: Int32Array, out: FloatArray, columns: Int32Array) -> None:
    """Write the exact distance (in cells) of every cell to the nearest blocked one, and (unless
    ``columns`` is empty) that one's column.

    ``near``: the distances along the columns. For each row the lower envelope of its columns'
    parabolas (Meijster, Roerdink, Hesselink 2000): linear in the cells, in whole numbers up to the
    root.
    """
    rows, cols = near.shape
    squares = np.empty(cols, dtype=np.int64)
    owner, since = np.empty(cols, dtype=np.int64), np.empty(cols, dtype=np.int64)
    for r in range(rows):
        for c in range(cols):
            squares[c] = np.int64(near[r, c]) * near[r, c]
        last = 0
        owner[0], since[0] = 0, 0
        for c in range(1, cols):
            while last >= 0:
                at, i = since[last], owner[last]
                if (at - i) * (at - i) + squares[i] <= (at - c) * (at - c) + squares[c]:
                    break
                last -= 1
            if last < 0:
                last, owner[0], since[0] = 0, c, 0
                continue
            i = owner[last]
            first = 1 + (c * c - i * i + squares[c] - squares[i]) // (2 * (c - i))
            if first < cols:
                last += 1
                owner[last], since[last] = c, first
        for c in range(cols - 1, -1, -1):
            i = owner[last]
            out[r, c] = math.sqrt((c - i) * (c - i) + squares[i])
            if columns.shape[0] > 0:
                columns[r, c] = i
            if c == since[last]:
                last -= 1


@inner
def _root(parents: Int32Array, label: int) -> int:
    """Return the least label known to mean the same region."""
    while parents[label] != label:
        parents[label] = parents[parents[label]]
        label = parents[label]
    return label


@kernel
def label_regions(cells: BoolArray, labels: Int32Array) -> int:
    """Number the regions of ``cells`` from 1 in the order of their first cells (row by row) and
    return how many there are. Cells that touch at a corner belong together; ``labels`` is 0 where
    there is no cell.

    Two passes with a union-find over the labels given in the first (Rosenfeld & Pfaltz 1966).
    """
    rows, cols = cells.shape
    parents = np.empty((rows + 1) // 2 * ((cols + 1) // 2) + 1, dtype=np.int32)
    given = 0
    for r in range(rows):
        for c in range(cols):
            if not cells[r, c]:
                labels[r, c] = 0
                continue
            left = labels[r, c - 1] if c > 0 else 0
            up = labels[r - 1, c] if r > 0 else 0
            before = labels[r - 1, c - 1] if r > 0 and c > 0 else 0
            after = labels[r - 1, c + 1] if r > 0 and c + 1 < cols else 0
            known = max(left, up, before)
            if up == 0 and after > 0 and known > 0 and after != known:
                one, other = _root(parents, known), _root(parents, after)
                parents[max(one, other)] = min(one, other)
            known = max(known, after)
            if known == 0:
                given += 1
                parents[given] = given
                known = given
            labels[r, c] = known
    count = 0
    for label in range(1, given + 1):
        if parents[label] == label:
            count += 1
            parents[label] = count
        else:
            parents[label] = parents[parents[label]]
    for r in range(rows):
        for c in range(cols):
            if labels[r, c] > 0:
                labels[r, c] = parents[labels[r, c]]
    return count


@kernel
def all_pairs(lengths: FloatArray) -> FloatArray:
    """Return all shortest lengths by Dijkstra's search from each node, without a heap."""
    n = lengths.shape[0]
    out = np.full((n, n), np.inf)
    for source in range(n):
        done = np.zeros(n, dtype=np.bool_)
        out[source, source] = 0.0
        for _ in range(n):
            best, node = np.inf, -1
            for i in range(n):
                if not done[i] and out[source, i] < best:
                    best, node = out[source, i], i
            if node < 0:
                break
            done[node] = True
            for i in range(n):
                if lengths[node, i] > 0.0 and best + lengths[node, i] < out[source, i]:
                    out[source, i] = best + lengths[node, i]
    return out


# ------------------ Exact shortest ways of a disc's centre over surely blocked cells (any angle)
# Shortest paths among polygons turn only at convex corners (Lozano-Perez & Wesley 1979); here the
# polygons are unions of cells, so the corners are grid vertices. The result never exceeds the
# length of any real motion's way, because only cells in which the centre can nowhere be count as
# blocked.


MOST_CORNERS = 500
EPS = 1e-9


@kernel
def sees(sums: Int32Array, ax: float, ay: float, bx: float, by: float) -> bool:
    """Return whether the segment between two points (in cells) stays out of the blocked area.

    ``sums`` (rows, cols + 1): running sums of the blocked cells of each row. Touching is allowed.
    """
    rows, cols = sums.shape[0], sums.shape[1] - 1
    if by < ay:
        ax, ay, bx, by = bx, by, ax, ay
    first, last = math.floor(ay + EPS), math.ceil(by - EPS)
    if last <= first:  # along a grid line: blocked where both sides are
        if first <= 0 or first >= rows:
            return True
        c0, c1 = math.floor(min(ax, bx) + EPS), math.ceil(max(ax, bx) - EPS)
        for col in range(max(0, c0), min(cols, c1)):
            below = sums[first - 1, col + 1] - sums[first - 1, col]
            if below > 0 and sums[first, col + 1] - sums[first, col] > 0:
                return False
        return True
    slope = (bx - ax) / (by - ay) if by > ay else 0.0
    for row in range(max(0, first), min(rows, last)):
        xa = ax + (max(ay, row) - ay) * slope
        xb = ax + (min(by, row + 1) - ay) * slope
        if by - ay < EPS:
            xa, xb = ax, bx
        low, high = min(xa, xb), max(xa, xb)
        c0, c1 = math.floor(low + EPS), math.ceil(high - EPS)
        if c1 <= c0:  # along a vertical grid line
            if 0 < c0 < cols and sums[row, c0 + 1] - sums[row, c0 - 1] == 2:
                return False
            continue
        c0, c1 = max(0, c0), min(cols, c1)
        if c1 > c0 and sums[row, c1] - sums[row, c0] > 0:
            return False
    return True


@kernel
def corner_matrix(sums: Int32Array, corners: FloatArray) -> FloatArray:
    """Return the lengths (cells) of the visible segments between corners, 0 where not visible."""
    n = corners.shape[0]
    out = np.zeros((n, n))
    for i in range(n):
        for j in range(i):
            ax, ay, bx, by = corners[i, 0], corners[i, 1], corners[j, 0], corners[j, 1]
            if sees(sums, ax, ay, bx, by):
                d = math.sqrt((ax - bx) ** 2 + (ay - by) ** 2)
                out[i, j] = d
                out[j, i] = d
    return out


@kernel
def seen_from(sums: Int32Array, corners: FloatArray, x: float, y: float) -> FloatArray:
    """Return the distance (cells) of a point to each corner, inf where it is not visible."""
    out = np.empty(corners.shape[0])
    for i in range(corners.shape[0]):
        dx, dy = corners[i, 0] - x, corners[i, 1] - y
        free = sees(sums, x, y, corners[i, 0], corners[i, 1])
        out[i] = math.sqrt(dx * dx + dy * dy) if free else np.inf
    return out


def convex_corners(blocked: BoolArray) -> FloatArray:
    """Return the grid vertices (x, y in cells) at which a shortest way can turn."""
    p = np.pad(blocked, 1, constant_values=True).astype(np.int8)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, :-1], p[1:, 1:]
    count = a + b + c + d
    turn = (count == 1) | ((count == 2) & (a == d))
    rows, cols = np.nonzero(turn)
    return np.stack([cols, rows], axis=1).astype(np.float64)


class Visibility:
    """Shortest any-angle distances over a grid of blocked cells (m per cell: ``size``).

    Where the blocked area has too many corners, it is shrunk to larger cells (still admissible).
    """

    def __init__(self, blocked: BoolArray, size: float) -> None:
        scale = 1
        corners = convex_corners(blocked)
        while len(corners) > MOST_CORNERS:
            scale *= 2
            blocked = _halved(blocked)
            corners = convex_corners(blocked)
        self.cell = size * scale
        self._scale = scale
        self._corners = corners
        self._sums = np.zeros((blocked.shape[0], blocked.shape[1] + 1), dtype=np.int32)
        np.cumsum(blocked, axis=1, out=self._sums[:, 1:])
        lengths = corner_matrix(self._sums, corners)
        self._between = shortest_ways(lengths)
        self._known: Memory[tuple[FloatArray, FloatArray]] = Memory(256)  # places

    def distance(self, a: tuple[float, float], b: tuple[float, float]) -> float:
        """Return the shortest distance (m) between two points given in the original grid's cells.

        ``inf`` if no way joins them (which proves nothing for points inside blocked cells).
        """
        ax, ay, bx, by = (v / self._scale for v in (*a, *b))
        straight = math.hypot(ax - bx, ay - by)
        if sees(self._sums, ax, ay, bx, by):
            return straight * self.cell
        if len(self._corners) == 0:
            return math.inf
        return float((self._around(ax, ay)[1] + self._around(bx, by)[0]).min()) * self.cell

    def _around(self, x: float, y: float) -> tuple[FloatArray, FloatArray]:
        """Return the distances (cells) of a point to the corners that it sees (inf: it does not),
        and its shortest ways to all corners. A place is asked for again and again.
        """
        return self._known.get_or((x, y), lambda: self._looked(x, y))

    def _looked(self, x: float, y: float) -> tuple[FloatArray, FloatArray]:
        seen = seen_from(self._sums, self._corners, x, y)
        near = np.nonzero(np.isfinite(seen))[0]
        if len(near) == 0:
            return seen, seen
        return seen, (seen[near, None] + self._between[near]).min(axis=0)


def _halved(blocked: BoolArray) -> BoolArray:
    """Return the grid of cells twice as large, blocked where all four parts are."""
    rows, cols = blocked.shape
    padded = np.pad(blocked, ((0, rows % 2), (0, cols % 2)), constant_values=True)
    return np.ascontiguousarray(
        padded[::2, ::2] & padded[1::2, ::2] & padded[::2, 1::2] & padded[1::2, 1::2]
    )
