"""Compiled collision checks of planar footprints (numba).

Poses are (x, y, theta) in the world frame, lengths in m, angles in rad. A footprint is checked
against the map in two stages: discs against the clearance field, which settles open space, then
the exact polygon against the cells. Motions are checked by conservative advancement (Mirtich
1996): from a pose with clearance ``c`` a body may move until its fastest point has travelled ``c``,
so nothing slips through between two checks.
"""

from __future__ import annotations

import math

import numpy as np

from up_samp.geometry.records import (
    GridData,
    PolyData,
    ShapeData,
    WorldData,
    grid_along,
    inner,
    kernel,
)
from up_samp.model.arrays import FloatArray

Pose = tuple[float, float, float]

FAR = 1e9
"""Clearance (m) where there is nothing to collide with."""


@kernel
def advance(x: float, y: float, th: float, kappa: float, s: float) -> tuple[float, float, float]:
    """Return the pose after driving ``s`` m (negative: backwards) along curvature ``kappa``."""
    turn = kappa * s
    if abs(turn) < 1e-7:  # series: exact to 1e-14 m per m
        mid = th + 0.5 * turn
        return x + s * math.cos(mid), y + s * math.sin(mid), th + turn
    after = th + turn
    return (
        x + (math.sin(after) - math.sin(th)) / kappa,
        y - (math.cos(after) - math.cos(th)) / kappa,
        after,
    )


@kernel
def point_clearance(grid: GridData, x: float, y: float) -> float:
    """Return a lower bound (m) on the distance from a point to what is blocked (0 outside)."""
    rows, cols = grid.clearance.shape
    if rows == 0:
        return FAR
    gx, gy = grid_along(grid.frame, x, y)
    col, row = math.floor(gx / grid.frame.size), math.floor(gy / grid.frame.size)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return 0.0
    return float(grid.clearance[row, col])


@inner
def _disc_bound(grid: GridData, shape: ShapeData, x: float, y: float, c: float, s: float) -> float:
    """Return a lower bound on the bare footprint's clearance from the map (may be negative)."""
    bound = point_clearance(grid, x, y) - shape.radius
    if bound >= 0.5 * shape.radius:
        return bound
    low = FAR
    for i in range(shape.discs.shape[0]):
        dx, dy = shape.discs[i, 0], shape.discs[i, 1]
        d = point_clearance(grid, x + c * dx - s * dy, y + s * dx + c * dy) - shape.discs[i, 2]
        low = min(low, d)
    return max(bound, low)


@inner
def _part_free(grid: GridData, verts: FloatArray, n: int, x: float, y: float, th: float) -> bool:
    """Return whether a convex polygon placed at a pose covers no blocked cell (exact)."""
    inv = 1.0 / grid.frame.size
    gx, gy = grid_along(grid.frame, x, y)
    px, py = gx * inv, gy * inv
    turn = th - grid.frame.yaw
    c, s = math.cos(turn) * inv, math.sin(turn) * inv
    p = np.empty((n, 2))
    low_x = low_y = 1e300
    high_x = high_y = -1e300
    for i in range(n):
        vx = px + c * verts[i, 0] - s * verts[i, 1]
        vy = py + s * verts[i, 0] + c * verts[i, 1]
        p[i, 0], p[i, 1] = vx, vy
        low_x, high_x = min(low_x, vx), max(high_x, vx)
        low_y, high_y = min(low_y, vy), max(high_y, vy)
    rows, cols = grid.clearance.shape
    tiny = 1e-6  # (cells) touching a cell's edge is no overlap
    if low_x < -tiny or low_y < -tiny or high_x > cols + tiny or high_y > rows + tiny:
        return False
    r0, r1 = max(0, math.floor(low_y + tiny)), min(rows, math.ceil(high_y - tiny))
    c0, c1 = max(0, math.floor(low_x + tiny)), min(cols, math.ceil(high_x - tiny))
    sums = grid.sums
    if sums[r1, c1] - sums[r0, c1] - sums[r1, c0] + sums[r0, c0] == 0:
        return True
    for row in range(r0, r1):
        if sums[row + 1, c1] - sums[row, c1] - sums[row + 1, c0] + sums[row, c0] == 0:
            continue
        left, right = 1e300, -1e300
        j = n - 1
        for i in range(n):
            ay, by = p[j, 1], p[i, 1]
            if not ((ay < row and by < row) or (ay > row + 1 and by > row + 1)):
                ax, bx = p[j, 0], p[i, 0]
                k = (bx - ax) / (by - ay) if ay != by else 0.0
                xa = ax + (min(max(ay, row), row + 1) - ay) * k
                xb = bx + (min(max(by, row), row + 1) - by) * k
                left = min(left, min(xa, xb))
                right = max(right, max(xa, xb))
            j = i
        a, b = max(0, math.floor(left + tiny)), min(cols, math.ceil(right - tiny))
        if b > a and sums[row + 1, b] - sums[row, b] - sums[row + 1, a] + sums[row, a] > 0:
            return False
    return True


@kernel
def level_free(grid: GridData, shape: ShapeData, x: float, y: float, th: float, level: int) -> bool:
    """Return whether the footprint inflated to ``level`` covers no blocked cell (exact)."""
    for i in range(shape.verts.shape[1]):
        if not _part_free(grid, shape.verts[level, i], shape.counts[level, i], x, y, th):
            return False
    return True


@kernel
def map_clearance(grid: GridData, shape: ShapeData, x: float, y: float, th: float) -> float:
    """Return a lower bound (m) on the clearance from the map beyond the margin; -1 if there is
    less than the margin (as level 1 of the shape says).
    """
    if grid.clearance.shape[0] == 0:
        return FAR
    bound = _disc_bound(grid, shape, x, y, math.cos(th), math.sin(th)) - shape.margin
    for level in range(shape.slack.shape[0] - 1, 0, -1):
        if bound >= shape.slack[level]:
            return bound
        if level_free(grid, shape, x, y, th, level):
            return shape.slack[level]
    return -1.0


@inner
def _place(
    verts: FloatArray,
    n: int,
    x: float,
    y: float,
    th: float,
    out: FloatArray,
) -> None:
    c, s = math.cos(th), math.sin(th)
    for i in range(n):
        vx, vy = verts[i, 0], verts[i, 1]
        out[i, 0] = x + c * vx - s * vy
        out[i, 1] = y + s * vx + c * vy


@inner
def _separation(a: FloatArray, n: int, b: FloatArray, m: int) -> float:
    """Return the largest gap between b and an edge's line of a (negative: none separates)."""
    best = -1e300
    j = n - 1
    for i in range(n):
        ex, ey = a[i, 0] - a[j, 0], a[i, 1] - a[j, 1]
        length = math.sqrt(ex * ex + ey * ey)
        if length > 1e-12:
            nx, ny = ey / length, -ex / length
            low = 1e300
            for k in range(m):
                low = min(low, (b[k, 0] - a[j, 0]) * nx + (b[k, 1] - a[j, 1]) * ny)
            best = max(best, low)
        j = i
    return best


@inner
def _corner_distance(a: FloatArray, n: int, b: FloatArray, m: int) -> float:
    """Return the squared distance from b's corners to a's edges."""
    best = 1e300
    j = n - 1
    for i in range(n):
        ex, ey = a[i, 0] - a[j, 0], a[i, 1] - a[j, 1]
        square = max(ex * ex + ey * ey, 1e-300)
        for k in range(m):
            wx, wy = b[k, 0] - a[j, 0], b[k, 1] - a[j, 1]
            t = min(1.0, max(0.0, (wx * ex + wy * ey) / square))
            dx, dy = wx - t * ex, wy - t * ey
            best = min(best, dx * dx + dy * dy)
        j = i
    return best


@kernel
def convex_distance(a: FloatArray, n: int, b: FloatArray, m: int) -> float:
    """Return the distance (m) of two convex polygons with ``n`` and ``m`` corners, exact where they
    are apart; where they overlap, minus the depth along the best separating direction.
    """
    gap = max(_separation(a, n, b, m), _separation(b, m, a, n))
    if gap <= 0.0:
        return gap
    return math.sqrt(min(_corner_distance(a, n, b, m), _corner_distance(b, m, a, n)))


@kernel
def poly_distance(
    polys: PolyData, shape: ShapeData, x: float, y: float, th: float, enough: float
) -> float:
    """Return the distance (m) from the bare footprint to the nearest obstacle.

    Distances above ``enough`` need not be exact (a lower bound that is at least ``enough``).
    """
    best = FAR
    placed = np.empty((shape.verts.shape[2], 2))
    for k in range(polys.counts.shape[0]):
        dx, dy = x - polys.centres[k, 0], y - polys.centres[k, 1]
        far = math.sqrt(dx * dx + dy * dy) - polys.centres[k, 2] - shape.radius
        if far >= best:
            continue
        if far >= enough:
            best = far
            continue
        for i in range(shape.verts.shape[1]):
            n = shape.counts[0, i]
            _place(shape.verts[0, i], n, x, y, th, placed)
            best = min(best, convex_distance(placed, n, polys.verts[k], polys.counts[k]))
    return best


@kernel
def clearance(world: WorldData, x: float, y: float, th: float) -> float:
    """Return a lower bound (m) on the clearance beyond the margin from map and obstacles, or -1."""
    polys, shape = world.polys, world.shape
    c = map_clearance(world.grid, shape, x, y, th)
    if c >= 0.0 and polys.counts.shape[0] > 0:
        d = poly_distance(polys, shape, x, y, th, c + shape.margin) - shape.margin
        if d < 0.0:
            return -1.0
        c = min(c, d)
    return c


@kernel
def pair_distance(a: ShapeData, pose_a: Pose, b: ShapeData, pose_b: Pose) -> float:
    """Return the distance (m) of two placed bare footprints (exact if apart, else <= 0)."""
    best = FAR
    pa, pb = np.empty((a.verts.shape[2], 2)), np.empty((b.verts.shape[2], 2))
    for i in range(a.verts.shape[1]):
        n = a.counts[0, i]
        _place(a.verts[0, i], n, *pose_a, pa)
        for j in range(b.verts.shape[1]):
            m = b.counts[0, j]
            _place(b.verts[0, j], m, *pose_b, pb)
            best = min(best, convex_distance(pa, n, pb, m))
    return best
