"""Exact shortest ways of a disc's centre over a grid of surely blocked cells (any angle).

Shortest paths among polygons turn only at convex corners (Lozano-Perez & Wesley 1979); here the
polygons are unions of cells, so the corners are grid vertices. The result never exceeds the length
of any real motion's way, because only cells in which the centre can nowhere be count as blocked.
"""

from __future__ import annotations

import math

import numpy as np

from up_samp.geometry.cells import shortest_ways
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import kernel
from up_samp.model.arrays import BoolArray, FloatArray, Int32Array

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
