"""Compiled checks of whole edges for OMPL's planners, which also tell what stood in the way.

An edge is checked by conservative advancement (Mirtich 1996), as in
:mod:`up_samp.geometry.kernels`: nothing slips through between two checks. Every check counts what
it hits in ``hits``: one counter for each resting object, the last one for the map.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernels import advance, map_clearance, poly_distance
from up_samp.geometry.records import WorldData, kernel
from up_samp.geometry.sweeps import travel_ratio
from up_samp.motion.curves.reeds_shepp import CarLimits, Pose, connect

IntArray = npt.NDArray[np.int64]


@kernel
def look(world: WorldData, x: float, y: float, th: float, hits: IntArray) -> float:
    """Return a lower bound (m) on the clearance beyond the margin; -1 (and a hit) if it is less
    than the smallest that swept checks accept.
    """
    polys, shape = world.polys, world.shape
    least = 0.1 * shape.slack[2]
    c = map_clearance(world.grid, shape, x, y, th)
    if c < least:
        hits[hits.shape[0] - 1] += 1
        return -1.0
    if polys.counts.shape[0] > 0:
        d, owner = poly_distance(polys, shape, x, y, th, c + shape.margin)
        d -= shape.margin
        if d < least:
            hits[owner] += 1
            return -1.0
        c = min(c, d)
    return c


@kernel
def car_edge(world: WorldData, car: CarLimits, a: Pose, b: Pose, hits: IntArray) -> bool:
    """Return whether the fastest Reeds-Shepp curve between two poses keeps the margin (with v = 1
    and a = inf it is the shortest).
    """
    if look(world, b[0], b[1], b[2], hits) < 0.0:
        return False
    arcs = np.empty((5, 2))
    _, n = connect(a, b, car, (0.0, 0.0), arcs)
    ax, ay, ath = a
    for i in range(n):
        kappa, s = arcs[i, 0], arcs[i, 1]
        ratio = travel_ratio(world.shape, kappa)
        total, done = abs(s), 0.0
        sign = 1.0 if s >= 0.0 else -1.0
        while done < total:
            x, y, th = advance(ax, ay, ath, kappa, sign * done)
            c = look(world, x, y, th, hits)
            if c < 0.0:
                return False
            done += c / ratio
        ax, ay, ath = advance(ax, ay, ath, kappa, s)
    return True


@kernel
def line_edge(world: WorldData, a: Pose, b: Pose, hits: IntArray) -> bool:
    """Return whether the straight motion between two poses, turning the shorter way round at a
    constant rate, keeps the margin.
    """
    (ax, ay, ath), (bx, by, bth) = a, b
    if look(world, bx, by, bth, hits) < 0.0:
        return False
    turn = (bth - ath + math.pi) % (2.0 * math.pi) - math.pi
    dx, dy = bx - ax, by - ay
    travel = math.sqrt(dx * dx + dy * dy) + abs(turn) * world.shape.radius
    share = 0.0
    while share < 1.0:
        c = look(world, ax + share * dx, ay + share * dy, ath + share * turn, hits)
        if c < 0.0:
            return False
        if c >= travel:
            return True
        share += c / travel
    return True
