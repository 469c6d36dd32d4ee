"""Compiled collision checks of planar footprints (numba), at poses and all along motions.

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
    RuleData,
    ShapeData,
    WorldData,
    grid_along,
    kernel,
    lean_inner,
    lean_kernel,
)
from up_samp.model.arrays import FloatArray

Pose = tuple[float, float, float]

FAR = 1e9
"""Clearance (m) where there is nothing to collide with."""


@lean_kernel
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


@lean_kernel
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


@lean_inner
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


@lean_inner
def _part_free(grid: GridData, verts: FloatArray, n: int, x: float, y: float, th: float) -> bool:
    """Return whether a convex polygon placed at a pose covers no blocked cell (exact)."""
    inv = 1.0 / grid.frame.size
    gx, gy = grid_along(grid.frame, x, y)
    px, py = gx * inv, gy * inv
    turn = th - grid.frame.yaw
    c, s = math.cos(turn) * inv, math.sin(turn) * inv
    low_x = low_y = 1e300
    high_x = high_y = -1e300
    for i in range(n):
        vx = px + c * verts[i, 0] - s * verts[i, 1]
        vy = py + s * verts[i, 0] + c * verts[i, 1]
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
        ax = px + c * verts[n - 1, 0] - s * verts[n - 1, 1]
        ay = py + s * verts[n - 1, 0] + c * verts[n - 1, 1]
        for i in range(n):
            bx = px + c * verts[i, 0] - s * verts[i, 1]
            by = py + s * verts[i, 0] + c * verts[i, 1]
            if not ((ay < row and by < row) or (ay > row + 1 and by > row + 1)):
                k = (bx - ax) / (by - ay) if ay != by else 0.0
                xa = ax + (min(max(ay, row), row + 1) - ay) * k
                xb = bx + (min(max(by, row), row + 1) - by) * k
                left = min(left, min(xa, xb))
                right = max(right, max(xa, xb))
            ax, ay = bx, by
        a, b = max(0, math.floor(left + tiny)), min(cols, math.ceil(right - tiny))
        if b > a and sums[row + 1, b] - sums[row, b] - sums[row + 1, a] + sums[row, a] > 0:
            return False
    return True


@lean_kernel
def level_free(grid: GridData, shape: ShapeData, x: float, y: float, th: float, level: int) -> bool:
    """Return whether the footprint inflated to ``level`` covers no blocked cell (exact)."""
    for i in range(shape.verts.shape[1]):
        if not _part_free(grid, shape.verts[level, i], shape.counts[level, i], x, y, th):
            return False
    return True


@lean_kernel
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


@lean_inner
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


@lean_inner
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


@lean_inner
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


@lean_kernel
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
    placed = np.empty((shape.verts.shape[2], 2))
    return _distance_placed(polys, shape, (x, y, th), enough, placed)


@lean_inner
def _distance_placed(
    polys: PolyData, shape: ShapeData, pose: Pose, enough: float, placed: FloatArray
) -> float:
    """Return :func:`poly_distance`; ``placed`` (corners, 2) is for a part where the body is."""
    (x, y, th), best = pose, FAR
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


@lean_kernel
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


# ------------------ Rules of ways
# Zones that are driven through in one direction only, and zones in which no body turns on the spot.
# A motion is looked at piece by piece, each taken for its chord; the zones are wider by what that
# may leave out.


WIDER = 0.01
"""What zones are wider (m) than they are: arcs leave their chords by less than half of it."""


@lean_inner
def _meets(verts: FloatArray, n: int, ax: float, ay: float, bx: float, by: float) -> bool:
    """Return whether a segment meets a convex counter-clockwise polygon (Cyrus and Beck)."""
    low, high = 0.0, 1.0
    j = n - 1
    for i in range(n):
        nx, ny = verts[j, 1] - verts[i, 1], verts[i, 0] - verts[j, 0]
        inside = (ax - verts[j, 0]) * nx + (ay - verts[j, 1]) * ny
        gain = (bx - ax) * nx + (by - ay) * ny
        if gain == 0.0:
            if inside < 0.0:
                return False
        elif gain > 0.0:
            low = max(low, -inside / gain)
        else:
            high = min(high, -inside / gain)
        if low > high:
            return False
        j = i
    return True


@lean_inner
def piece_obeys(
    rules: RuleData, ax: float, ay: float, bx: float, by: float, turn: float, bend: float
) -> bool:
    """Return whether a piece of a way from one point to another keeps the rules: it turns the body
    by ``turn`` rad, and its own direction leaves the chord's by ``bend`` rad at most.
    """
    dx, dy = bx - ax, by - ay
    way = math.sqrt(dx * dx + dy * dy)
    # who turns round a point nearer than 5 cm turns on the spot
    spot = abs(turn) > 1e-9 and way < 0.05 * abs(turn)
    for k in range(rules.counts.shape[0]):
        u, w, still = rules.rules[k, 0], rules.rules[k, 1], rules.rules[k, 2] > 0.0
        if still:
            if not spot:
                continue
        else:
            along, across = dx * u + dy * w, abs(dx * w - dy * u)
            # a millionth of the way may lead against the direction: rounding
            if along * math.cos(bend) - across * math.sin(bend) >= -1e-6 * way - 1e-12:
                continue
        if _meets(rules.verts[k], rules.counts[k], ax, ay, bx, by):
            return False
    return True


# ------------------ Whole motions


@lean_kernel
def travel_ratio(shape: ShapeData, kappa: float) -> float:
    """Return how far the footprint's fastest point moves per metre of the reference point."""
    best = 1.0
    for i in range(shape.verts.shape[1]):
        for k in range(shape.counts[0, i]):
            x, y = shape.verts[0, i, k, 0], shape.verts[0, i, k, 1]
            best = max(best, (1.0 - kappa * y) ** 2 + (kappa * x) ** 2)
    return math.sqrt(best)


@lean_kernel
def arc_free(world: WorldData, x: float, y: float, th: float, kappa: float, s: float) -> bool:
    """Return whether driving ``s`` m along curvature ``kappa`` keeps the margin *all the way*.

    Refuses motions that come closer than the margin plus the shape's smallest slack, too, and those
    that break a rule of ways.
    """
    if not _arc_obeys(world.shape.ways, x, y, th, kappa, s):
        return False
    ratio = travel_ratio(world.shape, kappa)
    least = 0.1 * world.shape.slack[2]
    total, done = abs(s), 0.0
    sign = math.copysign(1.0, s)
    while True:
        px, py, pth = advance(x, y, th, kappa, sign * done)
        c = clearance(world, px, py, pth)
        if c < least:
            return False
        done += c / ratio
        if done >= total:
            return True


@lean_inner
def _arc_obeys(ways: RuleData, x: float, y: float, th: float, kappa: float, s: float) -> bool:
    """Return whether driving ``s`` m along curvature ``kappa`` keeps the rules of ways."""
    if ways.counts.shape[0] == 0:
        return True
    turn = abs(kappa * s)
    # an arc leaves its chord by turn * length / 8
    n = max(1, math.ceil(turn / 0.2), math.ceil(math.sqrt(turn * abs(s) / (4.0 * WIDER))))
    for _ in range(n):
        ax, ay = x, y
        x, y, th = advance(x, y, th, kappa, s / n)
        if not piece_obeys(ways, ax, ay, x, y, kappa * s / n, 0.5 * turn / n):
            return False
    return True


@lean_kernel
def path_free(world: WorldData, start: FloatArray, arcs: FloatArray) -> int:
    """Return the index of the first of the ``arcs`` (n, 2: curvature, signed length), driven one
    after the other from ``start``, that does not keep the margin; -1 if all do.
    """
    return first_blocked(world, (start[0], start[1], start[2]), arcs, arcs.shape[0])


@lean_inner
def first_blocked(world: WorldData, start: Pose, arcs: FloatArray, n: int) -> int:
    """Return the index of the first of ``n`` arcs, driven from ``start``, that does not keep the
    margin; -1 if all do.
    """
    x, y, th = start
    for i in range(n):
        if not arc_free(world, x, y, th, arcs[i, 0], arcs[i, 1]):
            return i
        x, y, th = advance(x, y, th, arcs[i, 0], arcs[i, 1])
    return -1


@lean_kernel
def between(poses: FloatArray, i: int, share: float) -> tuple[float, float, float]:
    """Return the pose ``share`` of the way from sample ``i`` to the next under a constant twist."""
    turn = poses[i + 1, 2] - poses[i, 2]
    dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
    if abs(turn) < 1e-9:
        return poses[i, 0] + share * dx, poses[i, 1] + share * dy, poses[i, 2] + share * turn
    cot = math.cos(0.5 * turn) / math.sin(0.5 * turn)
    cx, cy = poses[i, 0] + 0.5 * (dx - dy * cot), poses[i, 1] + 0.5 * (dy + dx * cot)
    c, s = math.cos(share * turn), math.sin(share * turn)
    rx, ry = poses[i, 0] - cx, poses[i, 1] - cy
    return cx + c * rx - s * ry, cy + s * rx + c * ry, poses[i, 2] + share * turn


@lean_kernel
def sweep_travel(poses: FloatArray, i: int, radius: float) -> float:
    """Return a bound (m) on the travel of any point within ``radius`` from sample i to the next."""
    turn = abs(poses[i + 1, 2] - poses[i, 2])
    dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
    chord = math.sqrt(dx * dx + dy * dy)
    half = 0.5 * turn
    arc = chord if half < 1e-6 else chord * half / max(abs(math.sin(half)), 1e-9)
    return arc + turn * radius


@lean_kernel
def samples_free(world: WorldData, poses: FloatArray, least: float) -> int:
    """Return the index of the first sample after which the swept motion through ``poses`` (n, 3),
    with a constant twist between samples, does not keep the margin, or the rules of ways; -1 if it
    keeps them all the way.

    Clearance beyond the margin below ``least`` (> 0, m) counts as none.
    """
    credit = 0.0  # how far the fastest point may still travel unseen
    n = poses.shape[0]
    if n == 1:
        c = clearance(world, poses[0, 0], poses[0, 1], poses[0, 2])
        return -1 if c >= 0.0 else 0
    ways = world.shape.ways
    for i in range(n - 1):
        if ways.counts.shape[0] > 0:
            turn = poses[i + 1, 2] - poses[i, 2]
            (ax, ay), (bx, by) = (poses[i, 0], poses[i, 1]), (poses[i + 1, 0], poses[i + 1, 1])
            if not piece_obeys(ways, ax, ay, bx, by, turn, 0.5 * abs(turn)):
                return i
        travel = sweep_travel(poses, i, world.shape.radius)
        if travel <= credit:
            credit -= travel
            continue
        share = 0.0 if travel <= 0.0 else credit / travel
        while True:
            x, y, th = between(poses, i, share)
            credit = clearance(world, x, y, th)
            if credit < least:
                return i
            rest = (1.0 - share) * travel
            if credit >= rest:
                credit -= rest
                break
            share += credit / travel
    return -1


def first_hit(world: WorldData, poses: FloatArray) -> int:
    """Return :func:`samples_free` for a way that is planned: clearance below a thousandth of the
    least extra inflation counts as none.
    """
    return int(samples_free(world, poses, 1e-3 * float(world.shape.slack[2])))
