"""Compiled bookkeeping in time: who is in which cell when, and what that leaves free.

``occupied`` of a run has shape (cells + 3,): extended cell ``i`` is held during
``[occupied[i], occupied[i + 1]]``. A body that waits between two cells counts as being in the one
behind it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner, kernel

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Times(NamedTuple):
    """What counts as nothing in time, all in seconds: times closer than ``same`` are equal;
    ``near`` is the rounding that adds up over the cells of a path; samples nearer than ``close`` to
    a stop, and shorter waits, are left out; ``on_time`` is lateness that does not count; ``pad`` is
    kept free before and after a moving body's visit to a cell.
    """

    same: float = 1e-9
    near: float = 1e-7
    close: float = 1e-4
    on_time: float = 1e-6
    pad: float = 0.01


TIMES = Times()

A_AVOIDS = 1
"""Bit of a pair's flags: the first body, moving, must keep clear of the second."""
B_AVOIDS = 2
"""Bit of a pair's flags: the second body, moving, must keep clear of the first."""


class Safe(NamedTuple):
    """When cells are free: cell ``i`` in ``intervals[head[i]:head[i + 1]]`` (rows begin, end)."""

    head: IntArray
    intervals: FloatArray


@kernel
def occupancy(
    times: FloatArray, s: FloatArray, edges: FloatArray, since: float, until: float
) -> FloatArray:
    """Return when each extended cell is entered and, last, when the final rest ends.

    ``s`` (n,) is non-decreasing over the sample ``times`` (n,) and linear in between.
    """
    m = len(edges) - 1
    out = np.empty(m + 3)
    n = len(times)
    k = 0
    for j in range(m):
        # the last time at which s <= edges[j]
        while k + 1 < n and s[k + 1] <= edges[j] + TIMES.same:
            k += 1
        at = times[k]
        if k + 1 < n and s[k] < edges[j]:
            share = (edges[j] - s[k]) / (s[k + 1] - s[k])
            at += share * (times[k + 1] - times[k])
        out[j + 1] = at
    arrival = times[n - 1]
    for i in range(n - 1, -1, -1):
        if s[i] < edges[m] - TIMES.same:
            break
        arrival = times[i]
    out[m + 1] = arrival
    out[0] = min(since, out[1])
    out[m + 2] = max(until, arrival)
    return out


@kernel
def forbidden(
    runs: IntArray, cells: int, held: FloatArray, flags: int, out: FloatArray, used: int
) -> int:
    """Append rows (cell, from, until) in which a second body's visits forbid a first body's cells.

    ``runs`` are rows (i, j first, j last) of conflicting cells, ``held`` is the second body's
    occupancy, ``cells`` the first body's number of cells (its own rests are cells 0 and cells + 1).
    ``out`` must have room for ``len(runs)`` more rows. Returns the number of rows now in use.
    """
    last = len(held) - 2
    for r in range(len(runs)):
        i, j0, j1 = runs[r, 0], runs[r, 1], runs[r, 2]
        resting = i == 0 or i == cells + 1
        if resting or not flags & A_AVOIDS:
            # only the second body's own motion matters
            if not flags & B_AVOIDS:
                continue
            j0, j1 = max(j0, 1), min(j1, last - 1)
            if j0 > j1:
                continue
        low, high = held[j0], held[j1 + 1]
        if not resting:
            # sampling moves a crossing by about a millisecond; a rest begins and ends exactly
            low -= TIMES.pad if j0 > 0 else 0.0
            high += TIMES.pad if j1 < last else 0.0
        if high - low > TIMES.same:
            out[used, 0], out[used, 1], out[used, 2] = i, low, high
            used += 1
    return used


@inner
def _moment(times: FloatArray, poses: FloatArray, t: float) -> tuple[float, float]:
    """Return the position at time ``t`` (rest before and after), along chords."""
    n = len(times)
    if t <= times[0] or n == 1:
        return poses[0, 0], poses[0, 1]
    if t >= times[n - 1]:
        return poses[n - 1, 0], poses[n - 1, 1]
    low, high = 0, n - 1
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= t:
            low = middle
        else:
            high = middle
    share = (t - times[low]) / (times[high] - times[low])
    x = poses[low, 0] + share * (poses[high, 0] - poses[low, 0])
    return x, poses[low, 1] + share * (poses[high, 1] - poses[low, 1])


@kernel
def stay_far(
    ta: FloatArray,
    a: FloatArray,
    tb: FloatArray,
    b: FloatArray,
    low: float,
    high: float,
    reach: float,
    speed: float,
) -> bool:
    """Return whether two trajectories (times, poses) certainly stay over ``reach`` m apart while
    one of them moves during [low, high]; ``speed`` (m/s) bounds how fast they can approach.
    """
    t = max(low, min(ta[0], tb[0]))
    high = min(high, max(ta[len(ta) - 1], tb[len(tb) - 1]))
    while t <= high:
        if t > ta[len(ta) - 1] and t < tb[0]:
            t = tb[0]
        if t > tb[len(tb) - 1] and t < ta[0]:
            t = ta[0]
        x, y = _moment(ta, a, t)
        u, w = _moment(tb, b, t)
        gap = np.sqrt((x - u) ** 2 + (y - w) ** 2) - reach
        if gap <= 0.0:
            return False
        t += max(1e-3, gap / speed)
    return True


@kernel
def first_meeting(
    runs: IntArray, a: FloatArray, b: FloatArray, flags: int
) -> tuple[float, int, int]:
    """Return (time, cell of a, cell of b) of the first conflict of two runs (time inf: none)."""
    best, at_i, at_j = np.inf, -1, -1
    end_a, end_b = len(a) - 2, len(b) - 2
    for r in range(len(runs)):
        i, j0, j1 = runs[r, 0], runs[r, 1], runs[r, 2]
        if a[i] >= b[j1 + 1] or a[i + 1] <= b[j0]:
            continue
        for j in range(j0, j1 + 1):
            low, high = max(a[i], b[j]), min(a[i + 1], b[j + 1])
            if high - low <= TIMES.same or low >= best:
                continue
            a_moves, b_moves = 0 < i < end_a, 0 < j < end_b
            if (a_moves and flags & A_AVOIDS) or (b_moves and flags & B_AVOIDS):
                best, at_i, at_j = low, i, j
    return best, at_i, at_j


@kernel
def shared_stretch(runs: IntArray, a: FloatArray, b: FloatArray, after: float) -> tuple[int, int]:
    """Return the first and last cell of ``a`` in which two runs conflict at some time, from the
    first conflict (at ``after`` or later) on as long as they are no more than 2 s apart (-1: none).
    """
    low = np.empty(len(runs))
    for r in range(len(runs)):
        i, j0, j1 = runs[r, 0], runs[r, 1], runs[r, 2]
        low[r] = max(a[i], b[j0])
        if min(a[i + 1], b[j1 + 1]) - low[r] <= TIMES.same or low[r] < after - TIMES.same:
            low[r] = np.inf
    first, last = -1, -1
    until = low.min() if len(low) > 0 else np.inf
    grown = until < np.inf
    while grown:
        grown = False
        for r in range(len(runs)):
            if low[r] <= until and low[r] < np.inf:  # until may be endless
                i = runs[r, 0]
                first = i if first < 0 else min(first, i)
                last = max(last, i)
                until = max(until, min(a[i + 1], b[runs[r, 2] + 1]) + 2.0)
                low[r] = np.inf
                grown = True
    return first, last


@kernel
def safe_intervals(rows: FloatArray, cells: int) -> Safe:
    """Return the safe time intervals of all extended cells, ascending, outside of ``rows`` (cell,
    from, until).
    """
    count = np.zeros(cells + 3, dtype=np.int64)
    for r in range(len(rows)):
        count[int(rows[r, 0]) + 1] += 1
    start = np.zeros(cells + 3, dtype=np.int64)
    fill = np.zeros(cells + 3, dtype=np.int64)
    for cell in range(1, cells + 3):
        start[cell] = fill[cell] = start[cell - 1] + count[cell]
    order = np.empty(len(rows), dtype=np.int64)
    for r in range(len(rows)):
        cell = int(rows[r, 0])
        # insertion keeps every cell's intervals sorted by their beginning
        k = fill[cell]
        while k > start[cell] and rows[order[k - 1], 1] > rows[r, 1]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = r
        fill[cell] += 1
    head = np.zeros(cells + 3, dtype=np.int64)
    safe = np.empty((len(rows) + cells + 2, 2))
    used = 0
    for cell in range(cells + 2):
        free_from = -np.inf
        for k in range(start[cell], start[cell + 1]):
            low, high = rows[order[k], 1], rows[order[k], 2]
            if low > free_from + TIMES.same:
                safe[used, 0], safe[used, 1] = free_from, low
                used += 1
            free_from = max(free_from, high)
        if free_from < np.inf:
            safe[used, 0], safe[used, 1] = free_from, np.inf
            used += 1
        head[cell + 1] = used
    return Safe(head, safe[:used])


@kernel
def forbidden_starts(
    rows: FloatArray, held: FloatArray, release: float, until: float
) -> tuple[FloatArray, float, float]:
    """Return start times at which driving with a fixed timing collides, and the window for it.

    ``rows`` are forbidden (cell, from, until), ``held`` the occupancy when it starts at time 0.
    The open intervals (k, 2) are unsorted. The start must lie in the returned [earliest, latest]:
    after its ends it must be able to rest until ``until``, before it rests at its first pose.
    """
    end = len(held) - 2
    out = np.empty((len(rows), 2))
    used = 0
    earliest, latest = release, np.inf
    for r in range(len(rows)):
        cell, low, high = int(rows[r, 0]), rows[r, 1], rows[r, 2]
        if cell == 0:
            if high > release:
                latest = min(latest, low)
        elif cell == end:
            if low < until:
                earliest = max(earliest, high - held[end])
        else:
            out[used, 0], out[used, 1] = low - held[cell + 1], high - held[cell]
            used += 1
    return out[:used], earliest, latest


@kernel
def first_gap(blocked: FloatArray, earliest: float, latest: float) -> float:
    """Return the first time in [earliest, latest] outside the open intervals (inf: none).

    ``blocked`` (k, 2) is sorted by its first column.
    """
    at = earliest
    for k in range(len(blocked)):
        if blocked[k, 0] >= at:
            break
        if blocked[k, 1] > at:
            at = blocked[k, 1]
    return at if at <= latest else np.inf
