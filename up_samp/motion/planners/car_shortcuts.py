"""Shortening of car paths by Reeds-Shepp connections, judged by time, not by length."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner, kernel
from up_samp.geometry.kernels import GridData, PolyData, ShapeData, advance
from up_samp.geometry.sweeps import arc_free
from up_samp.motion.curves.arcs import ends_of, merged, nodes_of, path_time
from up_samp.motion.curves.reeds_shepp import TINY, connect, run_time

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@inner
def _locate(ends: FloatArray, p: float) -> int:
    """Return the arc in which the position ``p`` (m along the path) lies."""
    low, high = 0, ends.shape[0] - 1
    while low < high:
        mid = (low + high) // 2
        if ends[mid] < p:
            low = mid + 1
        else:
            high = mid
    return low


@inner
def _side(
    arcs: FloatArray, i: int, part: float, forward: bool, v: float, a: float
) -> tuple[float, float]:
    """Return (signed length of the run at a cut, time of the complete runs beyond it).

    The cut leaves ``part`` (signed) of arc ``i`` on the side looked at: before it, or after it if
    ``forward``.
    """
    run, time = part, 0.0
    first = abs(part) > TINY
    open_run = run
    k = i + 1 if forward else i - 1
    in_first = True
    while 0 <= k < arcs.shape[0]:
        s = arcs[k, 1]
        if run * s < 0.0:
            if in_first:
                open_run, in_first = run, False
            else:
                time += run_time(abs(run), v, a)
            run = s
        else:
            run += s
        k = k + 1 if forward else k - 1
    if in_first:
        return run if first or abs(run) > TINY else 0.0, 0.0
    return open_run, time + run_time(abs(run), v, a)


@inner
def _cut(
    arcs: FloatArray, nodes: FloatArray, ends: FloatArray, p: float
) -> tuple[int, float, float, float, float]:
    """Return (arc, signed length into it, pose) at position ``p``."""
    i = _locate(ends, p)
    into = p - (ends[i] - abs(arcs[i, 1]))
    into = min(max(into, 0.0), abs(arcs[i, 1]))
    part = into if arcs[i, 1] >= 0.0 else -into
    if abs(part - arcs[i, 1]) < 1e-9:
        return i, arcs[i, 1], nodes[i + 1, 0], nodes[i + 1, 1], nodes[i + 1, 2]
    x, y, th = advance(nodes[i, 0], nodes[i, 1], nodes[i, 2], arcs[i, 0], part)
    return i, part, x, y, th


@inner
def _free(
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    x: float,
    y: float,
    th: float,
    arcs: FloatArray,
    n: int,
) -> bool:
    for k in range(n):
        if not arc_free(grid, polys, shape, x, y, th, arcs[k, 0], arcs[k, 1]):
            return False
        x, y, th = advance(x, y, th, arcs[k, 0], arcs[k, 1])
    return True


@inner
def _last_run(arcs: FloatArray, n: int, before: float) -> float:
    """Return the signed length of the run in which ``before`` followed by the arcs ends."""
    run = before
    for k in range(n):
        run = arcs[k, 1] if run * arcs[k, 1] < 0.0 else run + arcs[k, 1]
    return run


@inner
def _closed_time(arcs: FloatArray, n: int, before: float, v: float, a: float) -> float:
    """Return the time of all runs but the last one of ``before`` followed by the arcs."""
    run, time = before, 0.0
    for k in range(n):
        if run * arcs[k, 1] < 0.0:
            time += run_time(abs(run), v, a)
            run = arcs[k, 1]
        else:
            run += arcs[k, 1]
    return time


@inner
def _copy(source: FloatArray, n: int, target: FloatArray, at: int) -> None:
    for k in range(n):
        target[at + k, 0], target[at + k, 1] = source[k, 0], source[k, 1]


@inner
def _spliced(
    arcs: FloatArray, i: int, part_i: float, j: int, part_j: float, new: FloatArray, n: int
) -> FloatArray:
    """Return the path with everything between two cuts replaced."""
    size = arcs.shape[0]
    out = np.empty((i + 1 + n + size - j, 2))
    _copy(arcs, i + 1, out, 0)
    out[i, 1] = part_i
    _copy(new, n, out, i + 1)
    _copy(arcs[j:], size - j, out, i + 1 + n)
    out[i + 1 + n, 1] = arcs[j, 1] - part_j
    return merged(out)


@inner
def _random(state: IntArray) -> float:
    """Return the next number in [0, 1) of a linear congruential generator (Knuth's MMIX)."""
    state[0] = state[0] * 6364136223846793005 + 1442695040888963407
    return ((state[0] >> 11) & ((1 << 52) - 1)) / 4503599627370496.0


@inner
def _spread(state: IntArray) -> float:
    """Return a number of mean 0 and standard deviation 1, about normal."""
    return 2.0 * (_random(state) + _random(state) + _random(state) - 1.5)


@kernel
def improve(
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    start: FloatArray,
    arcs: FloatArray,
    limits: FloatArray,
    rounds: int,
    patience: int,
    seed: int,
) -> FloatArray:
    """Return a path that is not slower, by up to ``rounds`` random replacements.

    Each round cuts the path at two places and joins them by the fastest curve, directly or over a
    randomly displaced pose of the path between them; stops after ``patience`` rounds without a
    gain. Deterministic for ``seed``. ``limits``: turning radius, v, a (then two entries of
    scratch).
    """
    state = np.empty(1, dtype=np.int64)
    state[0] = seed
    for _ in range(8):
        _random(state)
    radius, v, a = limits[0], limits[1], limits[2]
    out, new = np.empty((5, 2)), np.empty((10, 2))
    best = path_time(arcs, v, a)
    nodes = nodes_of(start, arcs)
    ends = ends_of(arcs)
    idle = 0
    for r in range(rounds):
        if arcs.shape[0] < 2 or idle > patience:
            break
        idle += 1
        total = ends[-1]
        if r % 3 == 0:
            p, q = _random(state) * total, _random(state) * total
        else:  # local windows find what long ones cannot
            p = _random(state) * total
            q = p + (0.5 + 8.0 * _random(state)) * radius
        p, q = min(p, q), min(max(p, q), total)
        if r % 5 == 0:
            p = 0.0
        if r % 7 == 0:
            q = total
        if q - p < 1e-3:
            continue
        i, part_i, x, y, th = _cut(arcs, nodes, ends, p)
        j, part_j, gx, gy, gth = _cut(arcs, nodes, ends, q)
        before, left = _side(arcs, i, part_i, False, v, a)
        after, right = _side(arcs, j, arcs[j, 1] - part_j, True, v, a)
        limits[3], limits[4] = before, after
        if r % 2 == 0:
            time, n = connect(x, y, th, gx, gy, gth, limits, out)
            _copy(out, n, new, 0)
        else:
            k, _, mx, my, mth = _cut(arcs, nodes, ends, p + _random(state) * (q - p))
            size = radius * 0.5 * 10.0 ** (-2.0 * _random(state))
            mx += size * _spread(state)
            my += size * _spread(state)
            mth += 0.3 * size / radius * _spread(state)
            limits[4] = (1.0 if arcs[k, 1] > 0.0 else -1.0) * 4.0 * radius
            _, n1 = connect(x, y, th, mx, my, mth, limits, out)
            _copy(out, n1, new, 0)
            time = _closed_time(new, n1, before, v, a)
            limits[3], limits[4] = _last_run(new, n1, before), after
            rest, n2 = connect(mx, my, mth, gx, gy, gth, limits, out)
            _copy(out, n2, new, n1)
            n = n1 + n2
            time += rest
        if left + time + right < best - 1e-4 and _free(grid, polys, shape, x, y, th, new, n):
            arcs = _spliced(arcs, i, part_i, j, part_j, new, n)
            best = path_time(arcs, v, a)
            nodes = nodes_of(start, arcs)
            ends = ends_of(arcs)
            idle = 0
    return arcs


def settle(start: FloatArray, goal: FloatArray, arcs: FloatArray) -> float:
    """Return how far (m, rad: the larger) the path ends from ``goal``."""
    end = nodes_of(start, arcs)[-1]
    turn = math.remainder(float(end[2] - goal[2]), 2 * math.pi)
    return max(abs(float(end[0] - goal[0])), abs(float(end[1] - goal[1])), abs(turn))
