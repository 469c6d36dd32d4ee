"""Compiled checks of whole edges for OMPL's planners, which also tell what stood in the way.

An edge is checked by conservative advancement (Mirtich 1996), as in
:mod:`up_samp.geometry.kernels`: nothing slips through between two checks. Every check counts what
it hits in ``hits``: one counter for each resting object, the last one for the map.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from up_samp.geometry.kernels import (
    GridData,
    PolyData,
    ShapeData,
    advance,
    between,
    map_clearance,
    poly_distance,
    sweep_travel,
    travel_ratio,
)
from up_samp.motion.reeds_shepp import connect, run_time

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def line_time(a: FloatArray, b: FloatArray, limits: FloatArray) -> float:
    """Return the rest-to-rest time (s) of a straight motion between (x, y, theta) a and b with
    ``limits`` (v m/s, a m/s^2, omega rad/s): distance and turn share one trapezoid.
    """
    dx, dy = b[0] - a[0], b[1] - a[1]
    way, turn = math.sqrt(dx * dx + dy * dy), abs(b[2] - a[2])
    if way < 1e-9:
        return turn / limits[2]
    return run_time(1.0, min(limits[0] / way, limits[2] / max(turn, 1e-12)), limits[1] / way)


@njit(cache=True)
def _chain_time(nodes: FloatArray, limits: FloatArray) -> float:
    total = 0.0
    for i in range(nodes.shape[0] - 1):
        total += line_time(nodes[i], nodes[i + 1], limits)
    return total


@njit(cache=True)
def _free(
    grid: GridData, polys: PolyData, shape: ShapeData, a: FloatArray, b: FloatArray, hits: IntArray
) -> bool:
    # a turn of more than half a circle would be checked the wrong way round
    if abs(b[2] - a[2]) > math.pi:
        return False
    return line_edge(grid, polys, shape, a, a[0], a[1], a[2], b[0], b[1], b[2], hits)


@njit(cache=True)
def _point(nodes: FloatArray, position: float) -> FloatArray:
    """Return the pose at ``position`` (number of the edge and share of it)."""
    i = min(int(position), nodes.shape[0] - 2)
    share = position - i
    return nodes[i] + share * (nodes[i + 1] - nodes[i])


@njit(cache=True)
def shorten_lines(
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    nodes: FloatArray,
    limits: FloatArray,
    rounds: int,
    patience: int,
    seed: int,
) -> FloatArray:
    """Return a chain of straight motions that is not slower (rest at each node), by random
    shortcuts and displaced nodes; deterministic for ``seed``.

    ``nodes``: (n, 3), theta continuous; ``limits``: see :func:`line_time`. Stops after ``patience``
    rounds without a gain (Geraerts & Overmars 2007, with times in place of lengths).
    """
    np.random.seed(seed)
    hits = np.zeros(polys.counts.shape[0] + 1, dtype=np.int64)
    best, idle = _chain_time(nodes, limits), 0
    for r in range(rounds):
        n = nodes.shape[0]
        if idle > patience or n < 3:
            break
        idle += 1
        if r % 3 < 2:  # join two points of the chain, in half of the rounds two nodes
            p, q = np.random.random() * (n - 1), np.random.random() * (n - 1)
            if r % 3 == 0:
                p, q = np.round(p), np.round(q)
            p, q = min(p, q), max(p, q)
            i, j = math.ceil(p), math.floor(q)
            if i > j:
                continue
            one, two = _point(nodes, p), _point(nodes, q)
            new = np.empty((i + 2 + n - 1 - j, 3))
            new[:i], new[i], new[i + 1], new[i + 2 :] = nodes[:i], one, two, nodes[j + 1 :]
            first = i
        else:  # move a node
            first = 1 + int(np.random.random() * (n - 2))
            new = nodes.copy()
            size = 10.0 ** (-2.0 * np.random.random())
            for k in range(3):
                new[first, k] += size * np.random.normal()
            first -= 1
        time = _chain_time(new, limits)
        if time >= best - 1e-4:
            continue
        edges = 1 if r % 3 < 2 else 2
        free = True
        for k in range(first, first + edges):
            free = free and _free(grid, polys, shape, new[k], new[k + 1], hits)
        if free:
            nodes, best, idle = _without_repeats(new), time, 0
    return nodes


@njit(cache=True)
def _without_repeats(nodes: FloatArray) -> FloatArray:
    keep = np.ones(nodes.shape[0], dtype=np.bool_)
    for i in range(1, nodes.shape[0]):
        keep[i] = np.abs(nodes[i] - nodes[i - 1]).max() > 1e-12
    keep[0] = True
    return nodes[keep]


@njit(cache=True)
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
