"""Earliest arrival along a fixed path among moving obstacles, with bounded acceleration.

Path-velocity decomposition (Kant & Zucker 1986) as an exact dynamic programme over a lattice of
positions and speeds (in the spirit of SIPP-IP, Ali & Yakovlev 2023): vertex ``i`` is the boundary
between two cells, speed level ``k`` is ``sqrt(2 a k ds)``, so that one cell at full acceleration
is one level. For every (vertex, level) the *set* of times at which it can be reached is kept as
intervals; waiting is allowed at level 0. Nothing but the lattice itself is approximated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from up_samp.geometry.records import inner, kernel, lean_inner
from up_samp.model import (
    Placed,
    TimedMotion,
    avoids,
)
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.reeds_shepp import DriveLimits
from up_samp.motion.fleet.conflicts import with_room
from up_samp.motion.fleet.paths import (
    ROUNDED,
    SAME_TIME,
    Path,
    TimeSets,
    first_gap,
    forbidden_starts,
    safe_intervals,
    times_of,
)
from up_samp.motion.fleet.timed_path import (
    TimedPath,
    Timing,
    natural_timing,
    run_of,
    sampled,
    speed_of,
)
from up_samp.motion.fleet.workspace import Workspace

SHARE = 1.0 - 2e-6
"""Share of the speed and acceleration limits that is used, so that rounding never exceeds them."""


MOST = 64
"""Intervals kept for one (vertex, level); later ones are dropped (sound, maybe later arrivals)."""


@lean_inner
def _crossing(v0: float, v1: float, a: float, ds: float) -> float:
    """Return the least time (s) over ``ds`` between two adjacent speed levels."""
    low, high = min(v0, v1), max(v0, v1)
    ramp = (high * high - low * low) / (2 * a)
    return (high - low) / a + max(0.0, ds - ramp) / high


@lean_inner
def _merge(lo: FloatArray, hi: FloatArray, count: int) -> int:
    """Sort and merge the first ``count`` intervals in place; return how many remain."""
    for i in range(1, count):
        x, y = lo[i], hi[i]
        k = i
        while k > 0 and lo[k - 1] > x:
            lo[k], hi[k] = lo[k - 1], hi[k - 1]
            k -= 1
        lo[k], hi[k] = x, y
    kept = 0
    for i in range(count):
        if kept > 0 and lo[i] <= hi[kept - 1] + SAME_TIME:
            hi[kept - 1] = max(hi[kept - 1], hi[i])
        else:
            lo[kept], hi[kept] = lo[i], hi[i]
            kept += 1
    return min(kept, MOST)


class TunedPath(NamedTuple):
    """A path to be tuned, by vertex: where it is (``edges``, m), whether the body must rest there
    (``halt``), its top speed there (``caps``, m/s); by cell whether it keeps to one speed
    (``held``), and by vertex whether it may wait there (``waits``).
    """

    edges: FloatArray
    halt: BoolArray
    caps: FloatArray
    held: BoolArray
    waits: BoolArray


class Cell(NamedTuple):
    """A cell on the way: its length ``ds`` (m), when it is ``free``, the ``latest`` time (s) at
    which its end is worth reaching, whether it is ``held`` at one speed.
    """

    ds: float
    free: FloatArray
    latest: float
    held: bool


@lean_inner
def _advance(
    begin: FloatArray, cell: Cell, tau: float, lo: FloatArray, hi: FloatArray, count: int
) -> int:
    """Append the times at which a cell that takes ``tau`` s can have been crossed, for crossings
    that begin in ``begin``; return the new count.
    """
    free = cell.free
    for q in range(len(begin)):
        for r in range(len(free)):
            x = max(begin[q, 0], free[r, 0]) + tau
            y = min(begin[q, 1] + tau, free[r, 1])
            if x <= y and x <= cell.latest and count < len(lo):
                lo[count], hi[count] = x, y
                count += 1
    return count


@lean_inner
def _waits(came: FloatArray, free: FloatArray, lo: FloatArray, hi: FloatArray) -> int:
    """Extend arrivals to the end of the interval in which the cell behind is free."""
    count = 0
    for q in range(len(came)):
        for r in range(len(free)):
            if (
                free[r, 0] <= came[q, 0] + SAME_TIME
                and came[q, 0] <= free[r, 1]
                and count < len(lo)
            ):
                lo[count], hi[count] = came[q, 0], max(came[q, 1], free[r, 1])
                count += 1
                break
    return count


@lean_inner
def _arrivals(
    before: TimeSets, level: int, can: DriveLimits, cell: Cell, lo: FloatArray, hi: FloatArray
) -> int:
    """Fill ``lo``, ``hi`` with arrivals at ``level`` from the vertex ``before``; return how
    many.
    """
    count, width = 0, len(before.head) - 1
    v1 = speed_of(level, can, cell.ds)
    # a level up or down or the same; never from rest to rest
    for other in range(abs(level - 1), min(level + 1, width - 2) + 1):
        if cell.held and other != level:
            continue
        source = other if other > 0 else width - 1
        begin = before.intervals[before.head[source] : before.head[source + 1]]
        if len(begin) > 0:
            tau = _crossing(speed_of(other, can, cell.ds), v1, can.a, cell.ds)
            count = _advance(begin, cell, tau, lo, hi, count)
    return count


@inner
def _most(way: TunedPath, can: DriveLimits) -> IntArray:
    """Return the highest speed level at each vertex: that of top speed there, or from which the
    cells to the next halt or tighter bend are just enough. (Two stops a hair apart make tiny cells,
    of which top speed would be millions of levels.)
    """
    m = len(way.edges) - 1
    most = np.zeros(m + 1, dtype=np.int64)
    for i in range(m - 1, 0, -1):
        if not way.halt[i]:
            ds = way.edges[i] - way.edges[i - 1]
            top = int(np.ceil(can.v * can.v / (2 * can.a * ds) - 1e-9))
            most[i] = min(most[i + 1] + 1, top)
            if way.caps[i] < can.v:
                most[i] = min(most[i], int(way.caps[i] ** 2 / (2 * can.a * ds) + 1e-9))
    return most


@inner
def _to_go(way: TunedPath, can: DriveLimits, most: IntArray) -> FloatArray:
    """Return the least time (s) from each vertex to rest at the end, at speed levels of at most
    ``most``.
    """
    m = len(way.edges) - 1
    left = np.zeros(m + 1)
    for i in range(m, 0, -1):
        ds = way.edges[i] - way.edges[i - 1]
        v0 = speed_of(min(most[i - 1], most[i] + 1), can, ds)
        v1 = speed_of(min(most[i], most[i - 1] + 1), can, ds)
        left[i - 1] = left[i] + (_crossing(v0, v1, can.a, ds) if v0 + v1 > 0.0 else ds / can.v)
    return left


@kernel
def in_time(
    way: TunedPath,
    can: DriveLimits,
    safe: TimeSets,
    release: float,
    goal_free: float,
    horizon: float,
) -> bool:
    """Return whether somebody that leaves at ``release`` might arrive from ``goal_free`` to
    ``horizon`` (s) if it could wait anywhere, and took each cell at the highest speeds there.

    A pass over the cells, where :func:`reachable` takes one for each level of speed: most ways that
    are tried among others are in vain.
    """
    m = len(way.edges) - 1
    to_go = _to_go(way, can, _most(way, can))
    since, until = np.empty(MOST), np.empty(MOST)
    came, left = np.empty(MOST), np.empty(MOST)
    now, count = times_of(safe, 0), 0
    for r in range(len(now)):
        if now[r, 0] <= release + SAME_TIME and release < now[r, 1]:
            since[0], until[0], count = release, now[r, 1], 1
    for i in range(1, m + 1):
        free, before, count = times_of(safe, i), count, 0
        if len(free) > MOST:
            return True
        came, left, since, until = since, until, came, left
        for r in range(len(free)):
            enters = np.inf
            for q in range(before):
                t = max(came[q], free[r, 0])
                if t <= min(left[q], free[r, 1]) + SAME_TIME:
                    enters = min(enters, t)
            leaves = enters + to_go[i - 1] - to_go[i]
            if leaves <= min(free[r, 1], horizon - to_go[i]) + SAME_TIME:
                since[count], until[count] = leaves, free[r, 1]
                count += 1
    comes = (until[:count] + SAME_TIME >= goal_free) & (since[:count] < np.inf)
    return bool(comes.any())


@kernel
def reachable(
    way: TunedPath, can: DriveLimits, safe: TimeSets, release: float, horizon: float
) -> TimeSets:
    """Return when vertices can be reached: set ``i * width + k`` is that of (vertex i, level k),
    each vertex's last one that of level 0 *with* waiting.

    What cannot arrive until ``horizon`` (s) even at the highest speeds from there is left out.
    """
    edges = way.edges
    m = len(edges) - 1
    most = _most(way, can)
    width = max(1, most.max()) + 2
    index = np.zeros((m + 1) * width + 1, dtype=np.int64)
    sets = np.empty((4096, 2))
    used = 0
    first = times_of(safe, 0)
    for k in range(len(first)):
        if first[k, 0] <= release + SAME_TIME and release < first[k, 1]:
            sets[0, 0], sets[0, 1] = release, first[k, 1]
            used = 1
    index[width] = used
    lo, hi = np.empty(8 * MOST), np.empty(8 * MOST)
    to_go = _to_go(way, can, most)
    for i in range(1, m + 1):
        ds, cap = edges[i] - edges[i - 1], most[i]
        latest = horizon - to_go[i] + SAME_TIME
        cell = Cell(ds, times_of(safe, i), latest, way.held[i - 1])
        for k in range(width):
            count = 0
            if k == width - 1:
                came = times_of(TimeSets(index, sets), i * width)
                count = _waits(came, cell.free if way.waits[i] else came, lo, hi)
            elif k <= cap and (k > 0 or way.halt[i] or way.waits[i]):
                before = TimeSets(index[(i - 1) * width : i * width + 1], sets)
                count = _arrivals(before, k, can, cell, lo, hi)
            count = _merge(lo, hi, count)
            sets = with_room(sets, used + count)
            for q in range(count):
                sets[used + q, 0], sets[used + q, 1] = lo[q], hi[q]
            used += count
            index[i * width + k + 1] = used
        if used == index[i * width]:
            index[(i + 1) * width + 1 :] = used  # nobody comes here in time
            break
    return TimeSets(index, sets[:used])


@lean_inner
def _spans(intervals: FloatArray, begin: float, end: float) -> bool:
    """Return whether one interval contains [begin, end], but for rounding."""
    for r in range(len(intervals)):
        if intervals[r, 0] <= begin + ROUNDED and end <= intervals[r, 1] + ROUNDED:
            return True
    return False


@lean_inner
def _came(came: FloatArray, free: FloatArray, t: float) -> float:
    """Return the latest arrival up to ``t`` from which one can wait until ``t`` (-inf: none)."""
    low = -np.inf
    for r in range(len(free)):
        if free[r, 0] <= t + ROUNDED and t <= free[r, 1] + ROUNDED:
            low = free[r, 0]
    best = -np.inf
    for q in range(len(came)):
        if came[q, 0] <= t + ROUNDED and came[q, 1] >= low - ROUNDED:
            best = max(best, min(came[q, 1], t))
    return best


@kernel
def backtrack(
    way: TunedPath, can: DriveLimits, safe: TimeSets, reached: TimeSets, arrival: float
) -> tuple[bool, IntArray, FloatArray]:
    """Return whether there is a timing that arrives at ``arrival`` (s), and by vertex its speed
    level, and when it leaves.

    Of several predecessors the fastest is taken, so waits fall as early as they can.
    """
    edges = way.edges
    m = len(edges) - 1
    width = (len(reached.head) - 1) // (m + 1)
    level = np.zeros(m + 1, dtype=np.int64)
    left = np.empty(m + 1)
    left[m] = arrival
    t, k = arrival, 0
    for i in range(m, 0, -1):
        ds = edges[i] - edges[i - 1]
        v1 = speed_of(k, can, ds)
        free = times_of(safe, i)
        found = False
        for before in range(min(k + 1, width - 2), abs(k - 1) - 1, -1):
            if way.held[i - 1] and before != k:
                continue
            begin = t - _crossing(speed_of(before, can, ds), v1, can.a, ds)
            source = (i - 1) * width + (before if before > 0 else width - 1)
            options = times_of(reached, source)
            if _spans(free, begin, t) and _spans(options, begin, begin):
                found = True
                k, t = before, begin
                break
        if not found:
            return False, level, left
        level[i - 1] = k
        left[i - 1] = t
        if k == 0 and i > 1:
            t = _came(times_of(reached, (i - 1) * width), times_of(safe, i - 1), t)
            if t == -np.inf:
                return False, level, left
    return True, level, left


def tune(
    path: Path,
    safe: TimeSets,
    release: float,
    goal_free: float,
    horizon: float = math.inf,
) -> Timing | None:
    """Return the earliest arrival along ``path`` in the safe intervals of its cells, if any.

    It leaves not before ``release`` and arrives not before ``goal_free`` nor after ``horizon`` (s).
    """
    kin = path.body.kinematics
    can = DriveLimits(0.0, kin.v_max * SHARE, path.push * SHARE)
    waits = np.append(path.entries[1:-1] == np.arange(1, path.cells + 1), True)
    way = TunedPath(path.edges, path.halt, path.caps * SHARE, path.held, waits)
    if not in_time(way, can, safe, release, goal_free, horizon):
        return None
    reached = reachable(way, can, safe, release, horizon)
    width = (len(reached.head) - 1) // (path.cells + 1)
    first, last = reached.head[path.cells * width :][:2]
    arrivals = reached.intervals[first:last]
    times = [max(float(lo), goal_free) for lo, hi in arrivals if hi >= goal_free]
    if not times or min(times) > horizon:
        return None
    found, level, left = backtrack(way, can, safe, reached, min(times))
    return sampled(path, level, left, can) if found else None


# ------------------ The earliest arrival along one path among runs: waiting, and speeds tuned


GAIN = 0.02
"""Seconds for which another timing is worth having."""


def fit(
    workspace: Workspace,
    motion: TimedMotion,
    path: Path,
    others: Sequence[TimedPath],
    best: TimedPath | None = None,
) -> TimedPath | None:
    """Return the earliest arrival along ``path`` among ``others``, by waiting and slowing down, or
    ``best`` if that is not later.

    Where it meets others is looked at only for those that it comes near: to heed all of them is no
    quicker than to heed some, if the others are far from it all the time.
    """
    limit = best.arrival if best else math.inf
    if motion.release + path.fastest >= limit:
        return best
    others = [o for o in others if o.until > motion.release]
    heeded = [o for o in others if workspace.knows(path, o.path)]
    rows = np.empty((0, 3))
    while True:
        more = workspace.forbidden(path, motion.object, motion.avoid, heeded)
        rows = np.concatenate([rows, more])
        timing = _earliest(motion, path, rows, limit)
        if timing is None:
            return best
        run = run_of(motion, path, timing)
        known = set(map(id, heeded))
        others = [o for o in others if id(o) not in known]
        heeded = [o for o in others if not workspace.far_apart(run, o)]
        if not heeded:
            return run


def _start(motion: TimedMotion, path: Path, rows: FloatArray) -> float:
    """Return when a motion can first begin its ``path`` with the path's own timing (s; inf: never),
    with forbidden (cell, from, until) ``rows``.
    """
    blocked, earliest, latest = forbidden_starts(
        rows, path.natural_held, float(motion.release), motion.present_until
    )
    return first_gap(blocked[np.argsort(blocked[:, 0], kind="stable")], earliest, latest)


def _to_come(motion: TimedMotion, path: Path, rows: FloatArray) -> FloatArray:
    """Return the forbidden ``rows`` that are not over as a motion is released, and those at its
    end.
    """
    return rows[(rows[:, 2] > motion.release) | (rows[:, 0] == path.cells + 1)]


def _earliest(
    motion: TimedMotion,
    path: Path,
    rows: FloatArray,
    limit: float,
) -> Timing | None:
    """Return the earliest arrival along ``path``, before ``limit``, with forbidden (cell, from,
    until) ``rows``; at another speed only if that gains ``GAIN`` s.
    """
    rows = _to_come(motion, path, rows)
    start = _start(motion, path, rows)
    best = None
    if start + path.natural.duration < limit:
        best = natural_timing(path, start)
        limit = best.trajectory.end
    if start > motion.release and path.tunable and path.cells > 0:
        safe = safe_intervals(rows, path.cells)
        # at the end it must be able to rest, so it arrives after the last visit of another
        ends = rows[(rows[:, 0] == path.cells + 1) & (rows[:, 1] < motion.present_until)]
        goal_free = float(np.max(ends[:, 2], initial=-math.inf))
        # hundredths of a second are not worth a timing that stops and goes
        if max(goal_free, motion.release + path.fastest) < limit - GAIN:
            tuned = tune(path, safe, motion.release, goal_free, limit - GAIN)
            best = tuned or best
    return best


def parked_all_the_time(motion: TimedMotion, others: Iterable[TimedPath]) -> list[Placed]:
    """Return what rests in one place all through the motion's window."""
    end, found = max(motion.due, motion.release), []
    for other in others:
        there = other.since <= motion.release and other.until >= end
        if there and other.object != motion.object and avoids(motion.avoid, other.object):
            rest = other.rests_during(motion.release, end)
            if rest is not None:
                found.append(Placed(other.object, other.path.body, rest))
    return found
