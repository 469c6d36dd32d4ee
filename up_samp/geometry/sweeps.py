"""Compiled checks of whole motions: no collision slips through between two looks at a pose.

The clearance at one pose bounds how far the body may go before the next look (conservative
advancement; Mirtich 1996). Lengths in m, angles in rad.
"""

from __future__ import annotations

import math

from up_samp.geometry.kernels import Pose, advance, clearance
from up_samp.geometry.records import RuleData, ShapeData, WorldData, inner, kernel
from up_samp.geometry.ways import WIDER, piece_obeys
from up_samp.model.arrays import FloatArray


@kernel
def travel_ratio(shape: ShapeData, kappa: float) -> float:
    """Return how far the footprint's fastest point moves per metre of the reference point."""
    best = 1.0
    for i in range(shape.verts.shape[1]):
        for k in range(shape.counts[0, i]):
            x, y = shape.verts[0, i, k, 0], shape.verts[0, i, k, 1]
            best = max(best, (1.0 - kappa * y) ** 2 + (kappa * x) ** 2)
    return math.sqrt(best)


@kernel
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


@inner
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


@kernel
def path_free(world: WorldData, start: FloatArray, arcs: FloatArray) -> int:
    """Return the index of the first of the ``arcs`` (n, 2: curvature, signed length), driven one
    after the other from ``start``, that does not keep the margin; -1 if all do.
    """
    return first_blocked(world, (start[0], start[1], start[2]), arcs, arcs.shape[0])


@inner
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


@kernel
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


@kernel
def sweep_travel(poses: FloatArray, i: int, radius: float) -> float:
    """Return a bound (m) on the travel of any point within ``radius`` from sample i to the next."""
    turn = abs(poses[i + 1, 2] - poses[i, 2])
    dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
    chord = math.sqrt(dx * dx + dy * dy)
    half = 0.5 * turn
    arc = chord if half < 1e-6 else chord * half / max(abs(math.sin(half)), 1e-9)
    return arc + turn * radius


@kernel
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
