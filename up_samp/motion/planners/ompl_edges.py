"""Compiled checks of whole edges for OMPL's planners, which also tell what stood in the way.

An edge is checked by conservative advancement (Mirtich 1996), as in
:mod:`up_samp.geometry.kernels`: nothing slips through between two checks. Every check counts what
it hits in ``hits``: one counter for each resting object, the last one for the map.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import kernel
from up_samp.geometry.kernels import (
    GridData,
    PolyData,
    ShapeData,
    advance,
    map_clearance,
    poly_distance,
)
from up_samp.geometry.sweeps import between, sweep_travel, travel_ratio
from up_samp.motion.curves.reeds_shepp import connect

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@kernel
def look(
    grid: GridData, polys: PolyData, shape: ShapeData, x: float, y: float, th: float, hits: IntArray
) -> float:
    """Return a lower bound (m) on the clearance beyond the margin; -1 (and a hit) if it is less
    than the smallest that swept checks accept.
    """
    least = 0.1 * shape.slack[2]
    c = map_clearance(grid, shape, x, y, th)
    if c < least:
        hits[hits.shape[0] - 1] += 1
        return -1.0
    if polys.counts.shape[0] > 0:
        d, owner = poly_distance(polys, shape, x, y, th, c + shape.numbers[1])
        d -= shape.numbers[1]
        if d < least:
            hits[owner] += 1
            return -1.0
        c = min(c, d)
    return c


@kernel
def car_edge(
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    limits: FloatArray,
    ax: float,
    ay: float,
    ath: float,
    bx: float,
    by: float,
    bth: float,
    hits: IntArray,
) -> bool:
    """Return whether the shortest Reeds-Shepp curve between two poses keeps the margin.

    ``limits``: (turning radius m, 1, inf, 0, 0), see :func:`reeds_shepp.connect`.
    """
    if look(grid, polys, shape, bx, by, bth, hits) < 0.0:
        return False
    arcs = np.empty((5, 2))
    _, n = connect(ax, ay, ath, bx, by, bth, limits, arcs)
    for i in range(n):
        kappa, s = arcs[i, 0], arcs[i, 1]
        ratio = travel_ratio(shape, kappa)
        total, done = abs(s), 0.0
        sign = 1.0 if s >= 0.0 else -1.0
        while done < total:
            x, y, th = advance(ax, ay, ath, kappa, sign * done)
            c = look(grid, polys, shape, x, y, th, hits)
            if c < 0.0:
                return False
            done += c / ratio
        ax, ay, ath = advance(ax, ay, ath, kappa, s)
    return True


@kernel
def line_edge(
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    limits: FloatArray,
    ax: float,
    ay: float,
    ath: float,
    bx: float,
    by: float,
    bth: float,
    hits: IntArray,
) -> bool:
    """Return whether the straight motion between two poses, turning the shorter way round at a
    constant rate, keeps the margin. ``limits`` is not used (same signature as :func:`car_edge`).
    """
    if look(grid, polys, shape, bx, by, bth, hits) < 0.0:
        return False
    turn = (bth - ath + math.pi) % (2.0 * math.pi) - math.pi
    dx, dy = bx - ax, by - ay
    travel = math.sqrt(dx * dx + dy * dy) + abs(turn) * shape.numbers[0]
    share = 0.0
    while share < 1.0:
        c = look(grid, polys, shape, ax + share * dx, ay + share * dy, ath + share * turn, hits)
        if c < 0.0:
            return False
        if c >= travel:
            return True
        share += c / travel
    return True


@kernel
def sweep_edge(
    grid: GridData, polys: PolyData, shape: ShapeData, poses: FloatArray, hits: IntArray
) -> bool:
    """Return whether the swept motion through ``poses`` (n, 3), with a constant twist between two
    of them, keeps the margin.
    """
    n = poses.shape[0]
    if look(grid, polys, shape, poses[n - 1, 0], poses[n - 1, 1], poses[n - 1, 2], hits) < 0.0:
        return False
    credit = 0.0  # how far the fastest point may still travel unseen
    for i in range(n - 1):
        travel = sweep_travel(poses, i, shape.numbers[0])
        done = credit
        while done < travel:
            x, y, th = between(poses, i, done / travel)
            c = look(grid, polys, shape, x, y, th, hits)
            if c < 0.0:
                return False
            done += c
        credit = done - travel
    return True
