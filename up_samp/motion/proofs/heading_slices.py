"""A stronger proof of impossibility: components of (x, y, heading), slower than those of (x, y).

The space of poses is cut into boxes: a square of the map times a range of headings. Discs inside
the footprint, each shrunk by what it can move within a box, tell boxes in which every pose
collides; all motions, of whatever kind, go through neighbouring other boxes. A flood from the
start that does not reach the goal's box is a proof, which sees the footprint's length where the
proof by one disc does not. Of a body that drives ahead only, the reference point leaves a square on
no side that it looks away from: there is a flood from the start, and one back from the goal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.geometry import Scene
from up_samp.geometry.records import GridData, PolyData, along, grid_point, lean_inner, lean_kernel
from up_samp.geometry.shapes import shape_of
from up_samp.model import Body, Configuration, Deadline, Placed
from up_samp.model.arrays import FloatArray, Int32Array, IntArray
from up_samp.motion.guides import point_to_convex

BINS = (72, 36)
"""Ranges of headings: on small maps, on large ones."""
MOST_BOXES = 12_000_000


def discs_inside(body: Body) -> FloatArray:
    """Return discs (k, 3: x, y, r in the body frame, m) that lie inside the footprint."""
    polygon = shapely.Polygon(shape_of(body).footprint)
    low_x, low_y, high_x, high_y = polygon.bounds
    xs, ys = np.meshgrid(np.linspace(low_x, high_x, 25), np.linspace(low_y, high_y, 13))
    points = shapely.points(xs.T.ravel(), ys.T.ravel())
    points = points[shapely.contains(polygon, points)]
    radii = shapely.distance(polygon.exterior, points) * (1 - 1e-9)
    order = np.argsort(-radii, kind="stable")
    rows = np.column_stack((shapely.get_coordinates(points), radii))[order].tolist()
    chosen: list[tuple[float, float, float]] = [shape_of(body).inner]
    for x, y, r in rows:
        if all(math.hypot(x - a, y - b) > 0.45 * max(r, c) for a, b, c in chosen):
            chosen.append((x, y, r))
    return np.array(chosen[:12])


class Blocking(NamedTuple):
    """What collides: ``discs`` (k, 3: x, y, r) inside the footprint with the map and ``polys``.

    ``nearest`` int32 (2, rows, cols): row + 1 and column + 1 of a blocked cell near each cell of
    the ``grid``; ``reach`` (m): how far from the reference point discs lie.
    """

    nearest: Int32Array
    grid: GridData
    reach: float
    polys: PolyData
    discs: FloatArray


class Flood(NamedTuple):
    """What a flood over boxes has seen, kept between calls.

    ``sense``: how the body drives in it: 0 both ways, 1 ahead only, -1 back in time ahead only.
    ``state`` int8 (rows, cols, bins): 0 unseen, 1 free, 2 blocked. ``queue``: boxes (index: (row *
    cols + col) * bins + bin) to go on from, from both its ends: a queue, and before it a stack of
    those that lead nearer to the ``goal``, the box to reach. ``ends`` (3,): head and tail of the
    first, top of the second. ``size`` (m): side of a box.
    """

    state: npt.NDArray[np.int8]
    queue: Int32Array
    ends: IntArray
    goal: int
    size: float
    sense: float


@lean_inner
def _leads(heading: float, half: float, dr: int, dc: int) -> bool:
    """Return whether a body that drives ahead at a heading (rad, or ``half`` more or less) may
    leave a square towards a neighbouring one: over a side it must not look away from that side,
    over a corner from neither.
    """
    off = abs((heading - math.atan2(dr, dc) + math.pi) % (2.0 * math.pi) - math.pi)
    return dr == 0 == dc or off <= (0.5 - 0.25 * abs(dr * dc)) * math.pi + half + 1e-9


@lean_inner
def _blocked(
    blocking: Blocking, centre: tuple[float, float], heading: float, half: tuple[float, float]
) -> bool:
    """Return whether every pose of a box collides. ``centre``: m along the map's columns and rows;
    ``half``: half diagonal (m) and half range of headings (rad).
    """
    nearest, polys, discs = blocking.nearest, blocking.polys, blocking.discs
    rows, cols = nearest.shape[1], nearest.shape[2]
    res = blocking.grid.frame.size
    gx, gy = centre
    row, col = min(math.floor(gy / res), rows - 1), min(math.floor(gx / res), cols - 1)
    # no disc comes near what is blocked on the map (what is known of that is float32)
    clear = blocking.grid.clearance[row, col] > blocking.reach + 1e-3
    if clear and polys.counts.shape[0] == 0:
        return False
    c, s = math.cos(heading), math.sin(heading)
    for i in range(discs.shape[0]):
        dx, dy = discs[i, 0], discs[i, 1]
        x, y = gx + c * dx - s * dy, gy + s * dx + c * dy
        room = discs[i, 2] - half[0] - half[1] * math.sqrt(dx * dx + dy * dy) - 1e-5
        col, row = math.floor(x / res), math.floor(y / res)
        beside = row < 0 or col < 0 or row >= rows or col >= cols
        if beside and not clear:
            if room > 0.0:  # the disc's centre itself leaves the map
                beyond = max(max(-x, x - cols * res), max(-y, y - rows * res))
                if beyond > half[0] + half[1] * math.sqrt(dx * dx + dy * dy):
                    return True
            continue
        if not clear:
            # any blocked cell near by will do: its distance is an upper bound
            ox = max(abs(x - (nearest[1, row, col] - 0.5) * res) - 0.5 * res, 0.0)
            oy = max(abs(y - (nearest[0, row, col] - 0.5) * res) - 0.5 * res, 0.0)
            if math.sqrt(ox * ox + oy * oy) < room:
                return True
        wx, wy = grid_point(blocking.grid.frame, x, y)
        for k in range(polys.counts.shape[0]):
            px, py = wx - polys.centres[k, 0], wy - polys.centres[k, 1]
            near = math.sqrt(px * px + py * py) - polys.centres[k, 2] < room
            if near and point_to_convex(wx, wy, polys.verts[k], polys.counts[k]) < room:
                return True
    return False


@lean_inner
def _away(cols: int, bins: int, box: int, goal: int) -> int:
    """Return how many rows, columns and ranges of headings a box is away from the goal's."""
    turn, cell, end = abs(box % bins - goal % bins), box // bins, goal // bins
    rows_away, cols_away = abs(cell // cols - end // cols), abs(cell % cols - end % cols)
    return min(turn, bins - turn) + rows_away + cols_away


@lean_kernel
def spread(flood: Flood, blocking: Blocking, budget: int) -> int:
    """Go on flooding ``budget`` boxes. Returns 1 if the goal's box is reached, 2 if all that can be
    reached was seen, 0 if there is more to do.
    """
    state, queue, ends, goal, size, sense = flood
    rows, cols, bins = state.shape
    half = size * math.sqrt(0.5), math.pi / bins
    for _ in range(budget):
        if ends[2] < queue.shape[0]:
            box = queue[ends[2]]
            ends[2] += 1
        elif ends[0] < ends[1]:
            box = queue[ends[0]]
            ends[0] += 1
        else:
            return 2
        away = _away(cols, bins, box, goal)
        b, cell = box % bins, box // bins
        row, col = cell // cols, cell % cols
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                for db in range(-1, 2):
                    r, c, n = row + dr, col + dc, (b + db + bins) % bins
                    if r < 0 or c < 0 or r >= rows or c >= cols or state[r, c, n] != 0:
                        continue
                    # the heading between the two, half a turn on where time runs back
                    between = (2.0 * b + db) * half[1] + 0.5 * math.pi * (1.0 - sense)
                    wide = (1.0 + abs(db)) * half[1]
                    if sense != 0.0 and not _leads(between, wide, dr, dc):
                        continue
                    centre = (c + 0.5) * size, (r + 0.5) * size
                    if _blocked(blocking, centre, 2.0 * math.pi * n / bins, half):
                        state[r, c, n] = 2
                        continue
                    state[r, c, n] = 1
                    index = (r * cols + c) * bins + n
                    if index == goal:
                        return 1
                    if _away(cols, bins, index, goal) < away:
                        ends[2] -= 1
                        queue[ends[2]] = index
                    else:
                        queue[ends[1]] = index
                        ends[1] += 1
    return 0


def separated(
    scene: Scene,
    nearest: Int32Array,
    body: Body,
    ends: tuple[Configuration, Configuration],
    obstacles: Sequence[Placed],
    deadline: Deadline,
) -> bool:
    """Return whether no motion joins two poses, proven by boxes of poses (False: no proof).

    ``nearest`` int32 (2, rows, cols): row + 1 and column + 1 of a blocked cell near each cell.
    """
    assert scene.grid is not None
    rows, cols = scene.grid.shape
    bins = BINS[0] if rows * cols * BINS[0] <= MOST_BOXES else BINS[1]
    factor = math.ceil(math.sqrt(rows * cols * bins / MOST_BOXES))
    size = scene.grid.resolution * factor
    shape = (math.ceil(rows / factor), math.ceil(cols / factor), bins)
    boxes = [_box(scene, pose, size, shape) for pose in ends]
    if boxes[0] < 0 or boxes[1] < 0 or boxes[0] == boxes[1]:
        return False
    discs = discs_inside(body)
    reach = float(np.max(np.hypot(discs[:, 0], discs[:, 1]) + discs[:, 2]))
    blocking = Blocking(nearest, scene.data, reach, scene.polys(obstacles), discs)
    a, b = boxes
    ways = ((a, b, 0.0),) if body.kinematics.reverse else ((a, b, 1.0), (b, a, -1.0))
    floods = [_begun(shape, start, goal, float(size), sense) for start, goal, sense in ways]
    verdict = 0
    while verdict == 0 and not deadline.expired():
        for flood in floods:
            verdict = verdict or spread(flood, blocking, 20_000)
    return verdict == 2


def _begun(shape: tuple[int, int, int], start: int, goal: int, size: float, sense: float) -> Flood:
    """Return the flood that has seen its start and nothing else."""
    state = np.zeros(shape, dtype=np.int8)
    state.reshape(-1)[start] = 1
    queue = np.empty(state.size + 1, dtype=np.int32)
    queue[0] = start
    return Flood(state, queue, np.array([0, 1, len(queue)], dtype=np.int64), goal, size, sense)


def _box(scene: Scene, pose: Configuration, size: float, shape: tuple[int, int, int]) -> int:
    """Return the index of the box of a pose, -1 outside the map."""
    frame = scene.data.frame
    col, row = (math.floor(g / size) for g in along(frame, pose[0], pose[1]))
    if not (0 <= row < shape[0] and 0 <= col < shape[1]):
        return -1
    turn = ((pose[2] - frame.yaw) % (2 * math.pi)) / (2 * math.pi)
    return (row * shape[1] + col) * shape[2] + int(turn * shape[2] + 0.5) % shape[2]
