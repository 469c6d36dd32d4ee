"""Shortening of car paths by Reeds-Shepp connections, judged by time, not by length."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import WorldData, inner, kernel
from up_samp.geometry.sweeps import first_blocked
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.curves.reeds_shepp import (
    TINY,
    DriveLimits,
    Pose,
    connect,
    driven_on,
    ends_of,
    merged,
    nodes_of,
    on_spot,
    path_time,
    run_time,
)


@inner
def _side(
    arcs: FloatArray, i: int, part: float, forward: bool, car: DriveLimits
) -> tuple[float, float]:
    """Return (signed length of the run at a cut, time of the complete runs beyond it).

    The cut leaves ``part`` (signed) of arc ``i`` on the side looked at: before it, or after it if
    ``forward``.
    """
    run, time = part, 0.0
    in_first = not on_spot(arcs[i, 0], car)
    if not in_first:
        run, time = 0.0, abs(arcs[i, 0] * part) / car.omega
    open_run = run
    k = i + 1 if forward else i - 1
    while 0 <= k < arcs.shape[0]:
        before = time
        time, after = driven_on(time, run, arcs[k, 0], arcs[k, 1], car)
        if in_first and time > before:  # what ends the run at the cut: that one's time is no part
            open_run, in_first = run, False
            time -= run_time(abs(run), car.v, car.a)
        run = after
        k = k + 1 if forward else k - 1
    if in_first:
        return run if abs(run) > TINY else 0.0, 0.0
    return open_run, time + run_time(abs(run), car.v, car.a)


@inner
def _cut(
    arcs: FloatArray, nodes: FloatArray, ends: FloatArray, p: float
) -> tuple[int, float, Pose]:
    """Return (arc, signed length into it, pose) at position ``p``."""
    i = min(int(np.searchsorted(ends, p)), ends.shape[0] - 1)
    into = p - (ends[i] - abs(arcs[i, 1]))
    into = min(max(into, 0.0), abs(arcs[i, 1]))
    part = into if arcs[i, 1] >= 0.0 else -into
    if abs(part - arcs[i, 1]) < 1e-9:
        return i, arcs[i, 1], (nodes[i + 1, 0], nodes[i + 1, 1], nodes[i + 1, 2])
    return i, part, advance(nodes[i, 0], nodes[i, 1], nodes[i, 2], arcs[i, 0], part)


@inner
def _copy(source: FloatArray, n: int, target: FloatArray, at: int) -> None:
    for k in range(n):
        target[at + k, 0], target[at + k, 1] = source[k, 0], source[k, 1]


class Shortcut(NamedTuple):
    """Where a path is cut: ``part`` (signed, m) of ``arc`` lies before it; there the car is at
    ``pose``. On the side that stays: the signed length of the ``run`` at the cut, the ``time`` (s)
    of the complete runs beyond it.
    """

    arc: int
    part: float
    pose: Pose
    run: float
    time: float


@inner
def _spliced(
    arcs: FloatArray, first: Shortcut, last: Shortcut, new: FloatArray, n: int
) -> FloatArray:
    """Return the path with everything between two cuts replaced."""
    i, j = first.arc, last.arc
    size = arcs.shape[0]
    out = np.empty((i + 1 + n + size - j, 2))
    _copy(arcs, i + 1, out, 0)
    out[i, 1] = first.part
    _copy(new, n, out, i + 1)
    _copy(arcs[j:], size - j, out, i + 1 + n)
    out[i + 1 + n, 1] = arcs[j, 1] - last.part
    return merged(out)


@inner
def random_share(state: IntArray) -> float:
    """Return the next number in [0, 1) of a linear congruential generator (Knuth's MMIX)."""
    state[0] = state[0] * 6364136223846793005 + 1442695040888963407
    return ((state[0] >> 11) & ((1 << 52) - 1)) / 4503599627370496.0


@inner
def _spread(state: IntArray) -> float:
    """Return a number of mean 0 and standard deviation 1, about normal."""
    return 2.0 * (random_share(state) + random_share(state) + random_share(state) - 1.5)


@inner
def _stretch(state: IntArray, r: int, total: float, radius: float) -> tuple[float, float]:
    """Return the positions (m along the path) between which round ``r`` replaces the path."""
    if r % 3 == 0:
        p, q = random_share(state) * total, random_share(state) * total
    else:  # local windows find what long ones cannot
        p = random_share(state) * total
        q = p + (0.5 + 8.0 * random_share(state)) * radius
    p, q = min(p, q), min(max(p, q), total)
    if r % 5 == 0:
        p = 0.0
    if r % 7 == 0:
        q = total
    return p, q


@inner
def _over(
    state: IntArray,
    middle: Shortcut,
    first: Shortcut,
    last: Shortcut,
    car: DriveLimits,
    new: FloatArray,
) -> tuple[float, int]:
    """Join two cuts over a pose near one between them, at random; fill ``new`` and return the time
    (s) with the runs at the cuts, and the number of arcs.
    """
    size = car.radius * 0.5 * 10.0 ** (-2.0 * random_share(state))
    x, y, th = middle.pose
    x += size * _spread(state)
    y += size * _spread(state)
    th += 0.3 * size / car.radius * _spread(state)
    via = x, y, th
    ahead = (1.0 if middle.run > 0.0 else -1.0) * 4.0 * car.radius
    out = np.empty((5, 2))
    _, n1 = connect(first.pose, via, car, (first.run, ahead), out)
    _copy(out, n1, new, 0)
    time, run = 0.0, first.run
    for k in range(n1):
        time, run = driven_on(time, run, new[k, 0], new[k, 1], car)
    rest, n2 = connect(via, last.pose, car, (run, last.run), out)
    _copy(out, n2, new, n1)
    return time + rest, n1 + n2


@kernel
def improve(
    world: WorldData,
    start: FloatArray,
    arcs: FloatArray,
    car: DriveLimits,
    rounds: tuple[int, int],
    seed: int,
) -> FloatArray:
    """Return a path that is not slower, by random replacements: so many ``rounds``, or so many of
    them without a gain.

    Each round cuts the path at two places and joins them by the fastest curve, directly or over a
    randomly displaced pose of the path between them. Deterministic for a seed.
    """
    state = np.empty(1, dtype=np.int64)
    state[0] = seed
    for _ in range(8):
        random_share(state)
    new = np.empty((10, 2))
    best = path_time(arcs, car)
    nodes = nodes_of(start, arcs)
    ends = ends_of(arcs)
    idle = 0
    most, patience = rounds
    for r in range(most):
        if arcs.shape[0] < 2 or idle > patience:
            break
        idle += 1
        p, q = _stretch(state, r, ends[-1], car.radius)
        if q - p < 1e-3:
            continue
        i, part, pose = _cut(arcs, nodes, ends, p)
        first = Shortcut(i, part, pose, *_side(arcs, i, part, False, car))
        i, part, pose = _cut(arcs, nodes, ends, q)
        last = Shortcut(i, part, pose, *_side(arcs, i, arcs[i, 1] - part, True, car))
        if r % 2 == 0:
            time, n = connect(first.pose, last.pose, car, (first.run, last.run), new)
        else:
            i, part, pose = _cut(arcs, nodes, ends, p + random_share(state) * (q - p))
            time, n = _over(state, Shortcut(i, part, pose, arcs[i, 1], 0.0), first, last, car, new)
        sooner = first.time + time + last.time < best - 1e-4
        if sooner and first_blocked(world, first.pose, new, n) < 0:
            arcs = _spliced(arcs, first, last, new, n)
            best = path_time(arcs, car)
            nodes = nodes_of(start, arcs)
            ends = ends_of(arcs)
            idle = 0
    return arcs


def settle(start: FloatArray, goal: FloatArray, arcs: FloatArray) -> float:
    """Return how far (m, rad: the larger) the path ends from ``goal``."""
    end = nodes_of(start, arcs)[-1]
    turn = math.remainder(float(end[2] - goal[2]), 2 * math.pi)
    return max(abs(float(end[0] - goal[0])), abs(float(end[1] - goal[1])), abs(turn))
