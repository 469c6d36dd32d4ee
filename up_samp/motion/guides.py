"""What leads searches over poses, and proves nothing: the box they search and how close to things
they may go, distances to a goal over a coarse grid, the heap of the compiled ones, and ways along
the lanes that robots prefer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.geometry import Scene, Shape
from up_samp.geometry.cells import sees
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import (
    NO_FRAME,
    GridFrame,
    PolyData,
    along,
    grid_along,
    grid_point,
    kernel,
    lean_inner,
    lean_kernel,
)
from up_samp.model import Body, Configuration, Placed, TrafficZone
from up_samp.model.arrays import BoolArray, FloatArray, Int32Array, IntArray

MARGIN_SHARES = (1.0, 0.25, 0.06, 0.015, 0.004, 0.001)
"""Shares of the clearance margin tried where a start or goal is closer to something than that."""

TOUCHES = "the start or the goal touches the map or an obstacle"
"""Why there is no motion where not even the least of these can be kept."""

OUT_OF_TIME = "out of time"
DRY = "no path at the finest resolution"
STUCK = f"{DRY} within fixed effort"
"""Why a search over poses found none."""


class Space(NamedTuple):
    """The box and the resolution of a search over poses, as the kernels take it.

    ``x``, ``y``: its low corner (m); ``cell`` (m), ``cols``, ``rows``; ``bins`` of headings.
    ``weight``: of what is left of the way. Of a car's search ``extra``: expansions to go on for
    after the first solution; ``near``: range (m) in which Reeds-Shepp times guide. Of a search by
    straight moves ``tight``: where a step does not go all the way, slide up to what is in the way,
    and half as far: so the tree gets into gaps that are narrower than its steps.
    """

    x: float
    y: float
    cell: float
    cols: int
    rows: int
    bins: int
    weight: float = 1.0
    extra: int = 0
    near: float = 0.0
    tight: bool = False


def widest_shape(
    scene: Scene, body: Body, poses: Sequence[Configuration], obstacles: tuple[Placed, ...]
) -> Shape | None:
    """Return the footprint with the largest margin that all ``poses`` can keep (None: they
    touch).
    """
    for share in MARGIN_SHARES:
        shape = scene.shape(body, scene.margin * share)
        least = 0.1 * shape.data.slack[2]
        if all(scene.clearance(shape, obstacles, pose) >= least for pose in poses):
            return shape
    return None


def search_box(
    scene: Scene, poses: Sequence[Configuration], obstacles: tuple[Placed, ...], reach: float
) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the map, or without one of what is known and ``reach`` m around it."""
    if scene.grid is not None:
        return scene.grid.box
    points = np.array([p[:2] for p in poses])
    polys = scene.polys(obstacles)
    if len(polys.counts):
        centres, radii = polys.centres[:, :2], polys.centres[:, 2:]
        points = np.concatenate([points, centres - radii, centres + radii])
    return points.min(axis=0) - reach, points.max(axis=0) + reach


def pose_space(
    scene: Scene,
    poses: Sequence[Configuration],
    obstacles: tuple[Placed, ...],
    reach: float,
    cell: float,
    bins: int,
) -> Space:
    """Return the box and the resolution of a search (``cell`` m)."""
    low, high = search_box(scene, poses, obstacles, reach)
    cols, rows = np.ceil((high - low) / cell).astype(int) + 1
    corner = float(low[0]), float(low[1]), float(cell)
    return Space(*corner, int(cols), int(rows), bins)


# ------------------ A binary heap of row numbers over plain arrays


@lean_inner
def push(heap: IntArray, rows: FloatArray, counters: IntArray, item: int) -> None:
    """Add a row number. The last column of ``rows`` is the order, ``counters[1]`` the size."""
    last = rows.shape[1] - 1
    i = counters[1]
    counters[1] += 1
    while i > 0:
        up = (i - 1) // 2
        if rows[heap[up], last] <= rows[item, last]:
            break
        heap[i] = heap[up]
        i = up
    heap[i] = item


@lean_inner
def pop(heap: IntArray, rows: FloatArray, counters: IntArray) -> int:
    """Remove and return the row number with the least value in the last column of ``rows``."""
    last = rows.shape[1] - 1
    top = heap[0]
    counters[1] -= 1
    n = counters[1]
    item = heap[n]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        if child + 1 < n and rows[heap[child + 1], last] < rows[heap[child], last]:
            child += 1
        if rows[heap[child], last] >= rows[item, last]:
            break
        heap[i] = heap[child]
        i = child
    heap[i] = item
    return int(top)


# ------------------ Distances to a goal over a coarse grid


MAX_CELLS = 60_000


class Field(NamedTuple):
    """Distances to a goal: ``values`` float32 (rows, cols) in m (inf: cannot be reached), and where
    its cells lie. No rows: no field.
    """

    values: npt.NDArray[np.float32]
    frame: GridFrame


@lean_kernel
def field_value(field: Field, x: float, y: float) -> float:
    """Return the distance (m) of a point to the field's goal; inf outside, 0 without a field."""
    rows, cols = field.values.shape
    if rows == 0:
        return 0.0
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


@lean_kernel
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


@lean_kernel
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


@lean_inner
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


# ------------------ Ways along the lanes that robots prefer: through which poses they lead
# Shortest ways (Dijkstra) on a graph of points on the lanes, on which a metre counts for less than
# beside them. Lanes join where points of theirs are near each other. A planner has to find a motion
# through these poses, and what that lasts decides.


Length = Callable[[Body, Configuration, Configuration], float]
"""Metres that no way of a body between two planar poses can beat."""


def along_lanes(
    body: Body, poses: Sequence[Configuration], length: Length
) -> tuple[Configuration, ...]:
    """Return poses (m, rad) that a body drives through, with those between them that lead along
    the lanes that it prefers, where these are worth it.
    """
    # a third of a second, for those only who have lanes
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial.distance import cdist

    lanes = body.kinematics.lanes
    whole = [_middle(lane) for lane in lanes]
    apart = max(0.5, sum(line.length for line in whole) / 200)  # m; few are quick to look at
    lines = [shapely.get_coordinates(shapely.segmentize(line, apart)) for line in whole]
    counts = [len(line) for line in lines]
    points, number = np.concatenate(lines), np.repeat(np.arange(len(lanes)), counts)
    shares = np.repeat([1.0 / lane.prefer for lane in lanes], counts)
    gaps = cdist(points, points)
    costs = np.where(number == number[:, None], gaps * shares, gaps + 1e-6)
    graph = np.zeros((len(points) + 2, len(points) + 2))  # 0: no edge
    graph[2:, 2:] = np.where(gaps <= apart * (1.0 + 1e-6), costs, 0.0)
    found = list(poses[:1])
    for start, goal in itertools.pairwise(poses):
        rows = [(float(x), float(y), 0.0) for x, y in points]
        graph[0, 1:] = [length(body, start, to) for to in (goal, *rows)]
        graph[2:, 1] = [length(body, at, goal) for at in rows]
        _, before = dijkstra(graph, indices=0, return_predecessors=True)
        way = [1]
        while way[-1] > 0:
            way.append(int(before[way[-1]]))
        found += [*_turned(points[np.array(way[-2:0:-1], dtype=np.int64) - 2], body), goal]
    return tuple(found)


def _middle(lane: TrafficZone) -> shapely.LineString:
    """Return the middle of a lane's length (m), but for half its width at both ends."""
    box = shapely.oriented_envelope(shapely.Polygon(lane.polygon))
    corners = shapely.get_coordinates(box)[:4]
    sides = np.roll(corners, -1, axis=0) - corners
    if np.hypot(*sides[0]) < np.hypot(*sides[1]):
        corners, sides = np.roll(corners, -1, axis=0), np.roll(sides, -1, axis=0)
    ends = 0.5 * (corners[[0, 1]] + corners[[3, 2]])
    inset = min(0.5, 0.5 * np.hypot(*sides[1]) / np.hypot(*sides[0])) * sides[0]
    return shapely.LineString([ends[0] + inset, ends[1] - inset])


def _turned(points: FloatArray, body: Body) -> list[Configuration]:
    """Return two poses for each straight piece of a way through points (n, 2): so far from its ends
    that a body turns into it and out of it; none for shorter pieces.
    """
    steps = np.diff(points, axis=0)
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    bends = np.abs(np.exp(1j * np.diff(headings)) - 1.0) > 1e-3
    rests = np.hypot(*steps.T) < 1e-3
    ends = [0, *(1 + np.flatnonzero(bends | rests[1:] | rests[:-1])), len(steps)]
    turn = max(0.5, body.kinematics.bend_radius)
    pieces = [
        (points[a], points[b], math.dist(points[a], points[b]))
        for a, b in itertools.pairwise(ends)
        if b > a and math.dist(points[a], points[b]) > 2.0 * turn
    ]
    return [
        (float(x), float(y), math.atan2(*(to - at)[::-1]))
        for at, to, long in pieces
        for x, y in (at + (to - at) * turn / long, to - (to - at) * turn / long)
    ]
