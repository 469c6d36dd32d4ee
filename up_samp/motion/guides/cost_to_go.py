"""Distances to a goal over a coarse grid: they guide searches, they prove nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry import Scene, Shape
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import (
    NO_FRAME,
    GridFrame,
    PolyData,
    along,
    grid_along,
    grid_point,
    inner,
    kernel,
)
from up_samp.model import Placed
from up_samp.model.arrays import BoolArray, FloatArray, Int32Array
from up_samp.motion.guides.heap import pop, push
from up_samp.motion.guides.visibility import sees

MAX_CELLS = 60_000


class Field(NamedTuple):
    """Distances to a goal: ``values`` float32 (rows, cols) in m (inf: cannot be reached), and where
    its cells lie. No rows: no field.
    """

    values: npt.NDArray[np.float32]
    frame: GridFrame


@kernel
def field_value(field: Field, x: float, y: float) -> float:
    """Return the distance (m) of a point to the field's goal; inf outside."""
    rows, cols = field.values.shape
    gx, gy = grid_along(field.frame, x, y)
    col, row = math.floor(gx / field.frame.size), math.floor(gy / field.frame.size)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return math.inf
    return float(field.values[row, col])


def least_value(field: Field, points: FloatArray) -> float:
    """Return the least distance (m) of ``points`` (n, 2) to the field's goal; inf without points
    that the field knows.
    """
    rows, cols = field.values.shape
    reach = np.stack(along(field.frame, points[:, 0], points[:, 1]))  # (2, n)
    col, row = np.floor(reach / field.frame.size).astype(np.int64)
    known = (row >= 0) & (col >= 0) & (row < rows) & (col < cols)
    return float(np.min(field.values[row[known], col[known]], initial=np.inf))


@kernel
def point_to_convex(x: float, y: float, verts: FloatArray, n: int) -> float:
    """Return the distance (m) from a point to a convex counter-clockwise polygon (0 inside)."""
    inside = True
    best = 1e300
    j = n - 1
    for i in range(n):
        ex, ey = verts[i, 0] - verts[j, 0], verts[i, 1] - verts[j, 1]
        wx, wy = x - verts[j, 0], y - verts[j, 1]
        if ex * wy - ey * wx < 0.0:
            inside = False
        square = max(ex * ex + ey * ey, 1e-300)
        t = min(1.0, max(0.0, (wx * ex + wy * ey) / square))
        dx, dy = wx - t * ex, wy - t * ey
        best = min(best, dx * dx + dy * dy)
        j = i
    return 0.0 if inside else math.sqrt(best)


@kernel
def mark_near(
    cells: BoolArray,
    frame: GridFrame,
    polys: PolyData,
    reach: float,
) -> None:
    """Set the cells whose centre is closer than ``reach`` (m) to an obstacle."""
    rows, cols = cells.shape
    size = frame.size
    for k in range(polys.counts.shape[0]):
        gx, gy = grid_along(frame, polys.centres[k, 0], polys.centres[k, 1])
        cx, cy = gx / size, gy / size
        span = (polys.centres[k, 2] + reach) / size + 1.0
        for row in range(max(0, math.floor(cy - span)), min(rows, math.ceil(cy + span))):
            for col in range(max(0, math.floor(cx - span)), min(cols, math.ceil(cx + span))):
                x, y = grid_point(frame, (col + 0.5) * size, (row + 0.5) * size)
                if point_to_convex(x, y, polys.verts[k], polys.counts[k]) < reach:
                    cells[row, col] = True


@inner
def _settle(
    dist: npt.NDArray[np.float32],
    root: Int32Array,
    sums: Int32Array,
    cell: int,
) -> None:
    """Make sure that a cell sees its root; otherwise take the best settled neighbour as its
    root.
    """
    rows, cols = dist.shape
    r, c = cell // cols, cell % cols
    rr, rc = root[r, c] // cols, root[r, c] % cols
    if max(abs(r - rr), abs(c - rc)) <= 1 or sees(sums, c + 0.5, r + 0.5, rc + 0.5, rr + 0.5):
        return
    best = np.inf
    for dr in range(-1, 2):
        for dc in range(-1, 2):
            nr, nc = r + dr, c + dc
            if (dr == 0 and dc == 0) or nr < 0 or nc < 0 or nr >= rows or nc >= cols:
                continue
            d = dist[nr, nc] + math.sqrt(float(dr * dr + dc * dc))
            if root[nr, nc] >= 0 and d < best:
                best = d
                root[r, c] = nr * cols + nc
    dist[r, c] = best


@kernel
def distances(blocked: BoolArray, sums: Int32Array, row: int, col: int) -> npt.NDArray[np.float32]:
    """Return the distance (in cells) of every cell to (row, col), along any angle.

    Lazy Theta* (Nash, Koenig, Tovey, AAAI 2010) without a goal: each cell hangs on the last turning
    point in sight. ``sums`` (rows, cols + 1): running sums of the blocked cells of each row.
    """
    rows, cols = blocked.shape
    dist = np.full((rows, cols), np.inf, dtype=np.float32)
    root = np.full((rows, cols), -1, dtype=np.int32)
    done = np.zeros((rows, cols), dtype=np.bool_)
    cap = 8 * rows * cols + 8
    # by entry: a cell is entered again when a shorter way to it is found
    cells, keys = np.empty(cap, dtype=np.int64), np.empty((cap, 1))
    heap, counters = np.empty(cap, dtype=np.int64), np.zeros(2, dtype=np.int64)
    dist[row, col] = 0.0
    root[row, col] = row * cols + col
    keys[0, 0], cells[0] = 0.0, row * cols + col
    counters[0] = 1
    push(heap, keys, counters, 0)
    while counters[1] > 0:
        cell = cells[pop(heap, keys, counters)]
        r, c = cell // cols, cell % cols
        if done[r, c]:
            continue
        _settle(dist, root, sums, cell)
        done[r, c] = True
        rr, rc = root[r, c] // cols, root[r, c] % cols
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                nr, nc = r + dr, c + dc
                if nr < 0 or nc < 0 or nr >= rows or nc >= cols or blocked[nr, nc]:
                    continue
                away = math.sqrt(float((nr - rr) ** 2 + (nc - rc) ** 2))
                step = np.float32(dist[rr, rc] + away)
                if not done[nr, nc] and step < dist[nr, nc]:
                    dist[nr, nc] = step
                    root[nr, nc] = root[r, c]
                    n = counters[0]
                    counters[0] += 1
                    keys[n, 0], cells[n] = step, nr * cols + nc
                    push(heap, keys, counters, n)
    return dist


class Fields:
    """Goal-distance fields of one scene, cached by goal cell, body size and obstacles."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._coarse: Memory[FloatArray] = Memory(8)
        self._fields: Memory[Field] = Memory(256)

    def toward(self, shape: Shape, goal: Sequence[float], obstacles: tuple[Placed, ...]) -> Field:
        """Return the distances (m) of the reference point's disc to ``goal``."""
        if self.scene.grid is None or shape.inscribed <= 0.0:
            return Field(np.zeros((0, 0), np.float32), NO_FRAME)
        key = (
            round(shape.inscribed, 6),
            float(goal[0]),
            float(goal[1]),
            frozenset((p.body.footprint, p.pose) for p in obstacles),
        )
        return self._fields.get_or(key, lambda: self._build(shape, goal, obstacles))

    def _build(self, shape: Shape, goal: Sequence[float], obstacles: tuple[Placed, ...]) -> Field:
        grid = self.scene.grid
        assert grid is not None
        rows, cols = grid.shape
        factor = max(1, int(0.8 * shape.inscribed / grid.resolution))
        factor = max(factor, math.ceil(math.sqrt(rows * cols / MAX_CELLS)))
        frame = self.scene.data.frame
        frame = frame._replace(size=frame.size * factor)
        clear = self._coarse.get_or(factor, lambda: self._coarsened(factor))
        # a fine cell's value is for its worst point; its best may be a diagonal better
        blocked = clear + grid.resolution * math.sqrt(2.0) < shape.inscribed
        reach = max(shape.inscribed - frame.size * math.sqrt(0.5), 0.02)
        if obstacles:
            mark_near(blocked, frame, self.scene.polys(obstacles), reach)
        col, row = (math.floor(g / frame.size) for g in along(frame, goal[0], goal[1]))
        if not (0 <= row < blocked.shape[0] and 0 <= col < blocked.shape[1]):
            return Field(np.full(blocked.shape, np.inf, np.float32), frame)
        sums = np.zeros((blocked.shape[0], blocked.shape[1] + 1), dtype=np.int32)
        np.cumsum(blocked, axis=1, out=sums[:, 1:])
        # a point may lie at the near side of its cell, and so may the goal
        cells = np.maximum(distances(blocked, sums, row, col) - np.float32(0.7), 0.0)
        return Field(np.ascontiguousarray(cells * np.float32(frame.size)), frame)

    def _coarsened(self, factor: int) -> FloatArray:
        """Return the largest clearance (m) within each block of ``factor`` x ``factor`` cells."""
        fine = self.scene.data.clearance
        rows, cols = (math.ceil(n / factor) for n in fine.shape)
        padded = np.full((rows * factor, cols * factor), -1.0, dtype=np.float32)
        padded[: fine.shape[0], : fine.shape[1]] = fine
        blocks = padded.reshape(rows, factor, cols, factor)
        return np.asarray(blocks.max(axis=(1, 3)).astype(np.float64))
