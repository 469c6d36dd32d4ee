"""Fixed paths, cut into short cells: the geometry that speed tuning and conflict checks share,
where paths bend, and what a body in the plane can do (the coordination asks for this, never for
a motion model).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import shapely

from up_samp.geometry.meshes import load_mesh
from up_samp.geometry.records import inner, kernel
from up_samp.geometry.shapes import Shape, padded, shape_of
from up_samp.model import Body, Configuration, Trajectory
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.rolling import ON_SPOT, rolls_of
from up_samp.motion.curves.slowing import (
    SHORT,
    allowed_speeds,
    bends_of,
    between_bends,
    last_stay,
    limits_in_bends,
    push_along,
    slowed,
    steps_in,
    ways_at,
)
from up_samp.motion.curves.trajectories import partway, rotations, travels, twists
from up_samp.motion.fleet.conflicts import (
    A_AVOIDS,
    B_AVOIDS,
    Hull,
    Swept,
    runs_in,
    sweep_table,
)
from up_samp.motion.fleet.flyers import ROUND, SweptSolid

# ------------------ Compiled bookkeeping in time
# Who is in which cell when, and what that leaves free. ``occupied`` of a run has shape (cells +
# 3,): extended cell ``i`` is held during ``[occupied[i], occupied[i + 1]]``. A body that waits
# between two cells counts as being in the one behind it.


SAME_TIME = 1e-9
"""Times (s) that are closer are equal."""
ROUNDED = 1e-7
"""Rounding (s) that adds up over the cells of a path."""


class TimeSets(NamedTuple):
    """Sets of times (s), by number: set ``k`` is ``intervals[head[k]:head[k + 1]]``, rows (begin,
    end), ascending.
    """

    head: IntArray
    intervals: FloatArray


@inner
def times_of(sets: TimeSets, k: int) -> FloatArray:
    """Return the intervals (n, 2) of a set."""
    return sets.intervals[sets.head[k] : sets.head[k + 1]]


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
        while k + 1 < n and s[k + 1] <= edges[j] + SAME_TIME:
            k += 1
        at = times[k]
        if k + 1 < n and s[k] < edges[j]:
            share = (edges[j] - s[k]) / (s[k + 1] - s[k])
            at += share * (times[k + 1] - times[k])
        out[j + 1] = at
    arrival = times[n - 1]
    for i in range(n - 1, -1, -1):
        if s[i] < edges[m] - SAME_TIME:
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
            # sampling moves a crossing by about 1 ms, so keep off by 10; a rest ends exactly
            low -= 0.01 if j0 > 0 else 0.0
            high += 0.01 if j1 < last else 0.0
        if high - low > SAME_TIME:
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
            if high - low <= SAME_TIME or low >= best:
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
        if min(a[i + 1], b[j1 + 1]) - low[r] <= SAME_TIME or low[r] < after - SAME_TIME:
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
def safe_intervals(rows: FloatArray, cells: int) -> TimeSets:
    """Return when all extended cells are safe: outside of ``rows`` (cell, from, until)."""
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
            if low > free_from + SAME_TIME:
                safe[used, 0], safe[used, 1] = free_from, low
                used += 1
            free_from = max(free_from, high)
        if free_from < np.inf:
            safe[used, 0], safe[used, 1] = free_from, np.inf
            used += 1
        head[cell + 1] = used
    return TimeSets(head, safe[:used])


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
        at = max(at, blocked[k, 1])
    return at if at <= latest else np.inf


# ------------------ Where paths bend
# Their parameter, where they kink, where the body must rest or drive slowly.


LEVELS = 20
"""Speed levels that the tuning aims at (see :mod:`up_samp.motion.fleet.speed`)."""


def path_steps(poses: FloatArray, body: Body, radius: float) -> FloatArray:
    """Return the steps of ``s`` (m) between samples of a body of this ``radius`` (m)."""
    if body.flies:
        ways = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
        return np.asarray(ways + radius * np.linalg.norm(rotations(poses), axis=1))
    kin = body.kinematics
    moves = twists(poses)
    ways, turns = np.hypot(moves[:, 0], moves[:, 1]), np.abs(moves[:, 2])
    if body.mobility.sideways:  # chords: between samples it goes straight on, see ``poses_at``
        ways = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    if body.mobility.pivots:
        arcs = kin.reach * turns
        spots = np.maximum(arcs, turns * kin.v_max / kin.omega_max)
        return np.where(ways < ON_SPOT * turns, spots, ways + arcs)
    turn_metre = 0.0 if kin.mobility.steers else radius
    return np.asarray(np.maximum(ways, turn_metre * turns))


def _reached(s: FloatArray, stop: BoolArray, body: Body) -> FloatArray:
    """Return the speeds (m/s) between samples that full acceleration from the stop before, or to
    the one behind, leads to: top speeds above them limit nothing (by one per cent less, for samples
    are rounded where they are kept).
    """
    stops = s[stop]
    since = s[1:] - stops[np.searchsorted(stops, s[:-1], side="right") - 1]
    left = stops[np.searchsorted(stops, s[1:], side="left")] - s[:-1]
    return 0.99 * np.sqrt(2.0 * body.kinematics.a_max * np.minimum(since, left))


def kept_samples(s: FloatArray) -> IntArray:
    """Return samples that lie at least a tiny step apart, always with the first and the last."""
    if np.all(np.diff(s) >= SHORT):
        return np.arange(len(s), dtype=np.int64)
    keep = [0]
    for i in range(1, len(s)):
        if s[i] - s[keep[-1]] >= SHORT:
            keep.append(i)
    if keep[-1] != len(s) - 1 and len(keep) > 1:
        keep[-1] = len(s) - 1
    return np.array(keep, dtype=np.int64)


def kinks_and_stops(poses: FloatArray, s: FloatArray, body: Body) -> tuple[BoolArray, BoolArray]:
    """Return where the twist's direction jumps, and where the body must therefore rest."""
    n = len(s)
    kink, stop = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    kink[0] = kink[-1] = stop[0] = stop[-1] = True
    if n > 2 and not body.flies:
        unit = twists(poses) / np.diff(s)[:, None]
        kink[1:-1] = np.abs(np.diff(unit, axis=0)).max(axis=1) > 1e-6  # more than rounding
        if body.mobility.steers or body.mobility.rolls:
            stop[1:-1] = np.diff(rolls_of(poses, body.kinematics).kinds) != 0
        elif not body.mobility.sideways:
            # a velocity may not jump: chords of smooth curves turn little from sample to sample
            chord = np.diff(poses, axis=0) / np.diff(s)[:, None]
            stop[1:-1] = np.abs(np.diff(chord, axis=0)).max(axis=1) > 0.1
    return kink, stop


@kernel
def _tops_within(
    s: FloatArray, tops: FloatArray, low: FloatArray, high: FloatArray, most: float
) -> FloatArray:
    """Return the least of ``most`` and the top speeds between samples at ``s`` that stretches from
    ``low`` to ``high`` meet.
    """
    caps = np.full(len(low), most)
    for i in range(len(low)):
        k = max(0, np.searchsorted(s, low[i], side="right") - 1)
        while k < len(tops) and s[k] < high[i]:
            caps[i] = min(caps[i], tops[k])
            k += 1
    return caps


# ------------------ Fixed paths
# A path keeps the shape of a planner's trajectory and forgets its timing. Its parameter ``s`` (m)
# is driven length for cars, and for bodies that turn on the spot where they drive; for
# omnidirectional bodies, and on the spot, it is the larger of the length and the turn scaled by
# ``v_max / omega_max``, so that ``|ds/dt| <= v_max`` bounds speed and turn rate at once.


Solid = tuple[tuple[tuple[float, float], ...], str | None, float]
"""What a body looks like to others: its footprint, mesh and height."""


def solid_of(body: Body) -> Solid:
    """Return what a body looks like to others."""
    return body.footprint, body.mesh, body.height


_numbers = itertools.count()


def radius_of(body: Body) -> float:
    """Return the greatest distance (m) of a body's surface from its reference point."""
    if body.flies:
        assert body.mesh is not None
        return load_mesh(body.mesh).radius
    return hull_of(body).radius


def hull_of(body: Body) -> Hull:
    """Return the (cached) convex parts of a planar body."""
    return _hull(shape_of(body))


@lru_cache(maxsize=1024)
def _hull(shape: Shape) -> Hull:
    verts, counts = padded(shape.parts)
    beside = shapely.Polygon(shape.footprint).distance(shapely.Point(0.0, 0.0))
    return Hull(verts, counts, float(shape.circumscribed), float(shape.inscribed - beside))


@dataclass(frozen=True, eq=False)
class Path:
    """A body's path. Arrays by sample: ``poses`` (n, 3), in space (n, 7), ``s`` (n,) from 0 and
    strictly increasing, ``kink`` (n,) whether the curvature changes there, ``stop`` (n,) whether it
    must rest there.

    Arrays by cell boundary: ``edges`` (m + 1,) values of ``s``, ``halt`` (m + 1,) whether it must
    rest there. Extended cell 0 is the rest at the start, cells 1..m are the path's, cell m + 1 is
    the rest at the end. ``tunable`` says whether speeds along it may be chosen freely.
    """

    body: Body
    poses: FloatArray
    s: FloatArray
    kink: BoolArray
    stop: BoolArray
    edges: FloatArray
    halt: BoolArray
    tunable: bool
    natural: Trajectory
    """The trajectory it came from, shifted to start at time 0."""
    natural_s: FloatArray
    """``s`` at each sample of ``natural``."""
    tops: FloatArray
    """Top speeds (m/s) between samples, shape (n - 1,): tight arcs have lower ones."""
    steady: BoolArray
    """Between which samples the body keeps to one speed, shape (n - 1,)."""
    push: float
    """The acceleration (m/s^2) that it may have all along."""
    cleared: set[tuple[Solid, Configuration]] = field(default_factory=set)
    """Resting bodies that the path's planner has proven it keeps clear of."""
    number: int = field(default_factory=lambda: next(_numbers))

    @cached_property
    def cells(self) -> int:
        """Number of cells without the two rests."""
        return len(self.edges) - 1

    @property
    def length(self) -> float:
        """Whole length in ``s`` (m)."""
        return float(self.s[-1])

    @property
    def fastest(self) -> float:
        """A time (s) that no timing of the path beats (a car's natural timing is the fastest)."""
        kin = self.body.kinematics
        if kin.mobility.steers or not self.tunable:
            return self.natural.duration
        return self.length / kin.v_max

    @cached_property
    def caps(self) -> FloatArray:
        """Top speeds (m/s) at the cell boundaries: none that a cell beside it may not have."""
        return self.tops_within(
            np.concatenate([self.edges[:1], self.edges[:-1]]),
            np.concatenate([self.edges[1:], self.edges[-1:]]),
        )

    def tops_within(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the top speeds (m/s) on stretches from ``low`` (k,) to ``high`` (k,) m."""
        return _tops_within(self.s, self.tops, low, high, self.body.kinematics.v_max)

    @cached_property
    def entries(self) -> IntArray:
        """By extended cell, the one at whose beginning the body stands that is kept from it: that
        cell, or the first one of its way through zones in which nobody stops; shape (cells + 2,).
        """
        inside = np.zeros(self.cells, dtype=np.bool_)
        for zone in self.body.kinematics.no_stops:
            inside |= steps_in(zone, self.poses_at(self.edges), self.body)
        # where it may stand: at its beginning, and behind cells outside: it may stop a little early
        may = np.ones(self.cells + 2, dtype=np.bool_)
        may[2:-1] = ~inside[:-1]
        may[-1] = may[-2]
        return np.maximum.accumulate(np.where(may, np.arange(self.cells + 2), 0))

    @cached_property
    def heeds_stops(self) -> bool:
        """Whether it leads through zones in which nobody stops."""
        return bool(np.any(self.entries != np.arange(len(self.entries))))

    @cached_property
    def held(self) -> BoolArray:
        """In which cells the body keeps to one speed, shape (cells,)."""
        # a cell meets a steady piece if more of them began by its end than ended by its beginning
        first, last = self.s[:-1][self.steady] + 1e-9, self.s[1:][self.steady] - 1e-9
        begun = np.searchsorted(first, self.edges[1:], side="left")
        return np.asarray(begun > np.searchsorted(last, self.edges[:-1], side="right"))

    @cached_property
    def _ways(self) -> tuple[FloatArray, FloatArray]:
        return ways_at(self.poses, self.s, self.stop)

    @cached_property
    def ends(self) -> tuple[Configuration, Configuration]:
        """Where the body rests at first and in the end."""
        return tuple(self.poses[0].tolist()), tuple(self.poses[-1].tolist())

    @cached_property
    def rests(self) -> tuple[tuple[Solid, Configuration], tuple[Solid, Configuration]]:
        """What the body looks like, and where it rests at first and in the end."""
        first, last = self.ends
        return (solid_of(self.body), first), (solid_of(self.body), last)

    @cached_property
    def radius(self) -> float:
        """The greatest distance (m) of the body's surface from its reference point."""
        return radius_of(self.body)

    @cached_property
    def hull(self) -> Hull:
        """The body's convex parts."""
        return hull_of(self.body)

    @cached_property
    def swept(self) -> Swept:
        """Swept bounds of all extended cells and their halves."""
        return Swept(sweep_table(self.s, self.poses, self.edges), self.hull)

    @cached_property
    def solid(self) -> SweptSolid:
        """The body's surface along the path, in space."""
        ratio = 1.0
        if not self.body.flies and len(self.s) > 1:
            moved = travels(self.poses, self.radius) / np.diff(self.s)
            ratio = ROUND * float(moved.max())
        return SweptSolid(self.body, self.radius, self.edges, self.poses_at, ratio)

    def middle(self, cell: int) -> Configuration:
        """Return the pose in the middle of an extended cell."""
        low, high = self.edges[max(cell - 1, 0)], self.edges[min(cell, self.cells)]
        return tuple(self.poses_at(np.array([0.5 * (low + high)]))[0].tolist())

    @cached_property
    def natural_held(self) -> FloatArray:
        """When ``natural`` enters each extended cell (it rests there for ever before and after)."""
        times = self.natural.times
        return occupancy(times, self.natural_s, self.edges, -math.inf, math.inf)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Bounding box (x low, y low, x high, y high) of everything the body sweeps (m)."""
        reach = self.radius + 1e-6
        low, high = self.poses[:, :2].min(axis=0) - reach, self.poses[:, :2].max(axis=0) + reach
        # between two samples an arc may leave their box by its sagitta, less than the half step
        bulge = 0.5 * float(np.max(np.diff(self.s), initial=0.0))
        return (
            float(low[0]) - bulge,
            float(low[1]) - bulge,
            float(high[0]) + bulge,
            float(high[1]) + bulge,
        )

    def poses_at(self, s: FloatArray) -> FloatArray:
        """Return the poses, shape (k, 3), at the parameters ``s`` (k,), along constant twists; of a
        body that moves sideways along cubics (Hermite), which keep its direction from jumping.
        """
        if len(self.s) == 1:
            return np.repeat(self.poses, len(s), axis=0)
        if self.body.flies:
            at = np.interp(s, self.natural_s, self.natural.times)
            return np.array([self.natural.at(float(t)) for t in at])
        i = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2)
        share = np.clip((s - self.s[i]) / (self.s[i + 1] - self.s[i]), 0.0, 1.0)
        if self.body.mobility.sideways:
            out = between_bends(self.poses, self.s, self._ways, i, share)
        else:
            out = partway(self.poses[i], self.poses[i + 1], share)
        out[s <= self.s[0]] = self.poses[0]
        out[s >= self.s[-1]] = self.poses[-1]
        return out


def path_of(
    trajectory: Trajectory,
    body: Body,
    waypoints: Sequence[Configuration] = (),
    *,
    decided: bool = False,
) -> Path:
    """Cut a body's trajectory through ``waypoints`` into a :class:`Path`, slowed to what zones and
    a limit backwards allow, unless its times are ``decided``.

    It must rest where the trajectory pauses and where its direction jumps, and pass the waypoints
    between exactly, at any speed.
    """
    if not decided:
        trajectory = slowed(trajectory, body)
    poses = np.asarray(trajectory.poses, dtype=np.float64)
    natural_s = np.concatenate([[0.0], np.cumsum(path_steps(poses, body, radius_of(body)))])
    keep = kept_samples(natural_s)
    s, kept = natural_s[keep], poses[keep]
    kink, stop = kinks_and_stops(kept, s, body)
    tunable = not (body.mobility.own_law or body.flies)
    if tunable:
        stop |= _pauses(trajectory, natural_s, s)
        stop[1:-1] |= limits_in_bends(kept, body.kinematics).rests
        for zone in body.kinematics.zones:
            if zone.dock is not None and zone.binds(kept[-1]):
                stop[max(last_stay(zone, kept) - 1, 0)] = True  # slow cells begin there
        kink |= stop | _waypoints(trajectory, natural_s, s, waypoints[1:-1])
    most = allowed_speeds(kept, body) if tunable else np.full(len(kept) - 1, math.inf)
    push = push_along(kept, body)
    tops, steady, stop = _tops(Trajectory(trajectory.times[keep], kept), s, stop, body, most, push)
    edges, halt = _cells(s, stop, tops, body, push, np.isfinite(most))
    return Path(
        body,
        kept,
        s,
        kink,
        stop,
        edges,
        halt,
        tunable,
        trajectory.shifted(-trajectory.start),
        natural_s,
        tops,
        steady,
        push,
    )


def _tops(
    motion: Trajectory,
    s: FloatArray,
    stop: BoolArray,
    body: Body,
    most: FloatArray,
    push: float,
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Return the top speeds (m/s) between a path's samples, whether it keeps to one speed there,
    and at which samples it rests, with those at which it has to ``stop``; ``most`` is what zones
    and bends allow, and ``push`` the acceleration (m/s^2) everywhere.
    """
    kin = body.kinematics
    steady, rests = np.zeros(len(most), dtype=np.bool_), np.zeros(len(s), dtype=np.bool_)
    tops = np.minimum(kin.v_max, most)
    if body.mobility.rolls:
        rolls = rolls_of(motion.poses, kin)
        tops = np.where(np.abs(rolls.kinds) == 2, kin.v_max, np.minimum(rolls.tops, most))
    elif body.mobility.sideways and len(s) > 1:
        tops, steady, rests = bends_of(motion.poses, s, motion.times, body, most)
    at_rest = stop | rests
    limits = tops < _reached(s, at_rest, body)
    more = not (body.mobility.flies or body.mobility.own_law)
    while more:  # a stretch of several crawls is cut at the slower ones again
        crawled = _crawled(s, at_rest, np.where(limits, tops, -tops), push, steady)
        more = bool((crawled > at_rest).any())
        at_rest |= crawled
        limits = tops < _reached(s, at_rest, body)
    # what rests at both ends of a piece drives no bend there at speed
    steady &= ~(at_rest[1:] & at_rest[:-1])
    return np.where(limits, tops, kin.v_max), steady, at_rest


def through_zones(rows: IntArray, one: IntArray, other: IntArray) -> IntArray:
    """Return the conflicting cells (i, j first, j last) of two paths with all cells in which a body
    is on its way to one of them without a stop: ``one`` and ``other`` are their cells' entries.
    """
    if np.array_equal(one, np.arange(len(one))) and np.array_equal(other, np.arange(len(other))):
        return rows
    cells = np.zeros((len(one), len(other)), dtype=np.bool_)
    for i, first, last in rows:
        cells[one[i] : i + 1, other[first] : last + 1] = True
    return runs_in(cells)


def resting_path(body: Body, pose: Configuration) -> Path:
    """Return the path of a body that stays where it is."""
    trajectory = Trajectory(np.zeros(1), np.array([pose], dtype=np.float64))
    return path_of(trajectory, body)


def _waypoints(
    trajectory: Trajectory, natural_s: FloatArray, s: FloatArray, inner: Sequence[Configuration]
) -> BoolArray:
    """Return which samples of the path stand for the ``inner`` waypoints."""
    found: list[float] = []
    after = 0
    for pose in inner:
        gap = np.abs(trajectory.poses[after:, :2] - np.array(pose[:2])).max(axis=1)
        turn = trajectory.poses[after:, 2] - pose[2]
        gap = np.maximum(gap, np.abs(turn - 2 * np.pi * np.round(turn / (2 * np.pi))))
        hits = np.flatnonzero(gap < 1e-6)
        after += int(hits[0]) if len(hits) else int(np.argmin(gap))
        found.append(natural_s[after])
    return _marks(s, found)


def _pauses(trajectory: Trajectory, natural_s: FloatArray, s: FloatArray) -> BoolArray:
    """Return at which samples of the path the trajectory stands still for a while."""
    still = np.diff(natural_s) < SHORT
    paused = np.flatnonzero(still & (np.diff(trajectory.times) > 0.5 * Trajectory.MAX_STEP))
    return _marks(s, natural_s[paused])


def _marks(s: FloatArray, values: Iterable[float]) -> BoolArray:
    """Return which samples are nearest to the ``values`` of ``s``."""
    marks = np.zeros(len(s), dtype=np.bool_)
    for value in values:
        marks[int(np.argmin(np.abs(s - value)))] = True
    return marks


def _cell_length(body: Body) -> float:
    """Return the wished length (m) of a cell: short beside the body, about so many speeds."""
    k, radius = body.kinematics, radius_of(body)
    return float(np.clip(k.v_max**2 / (2 * k.a_max * LEVELS), 0.1 * radius, 0.2 * radius))


def _crawled(
    s: FloatArray,
    stop: BoolArray,
    tops: FloatArray,
    push: float,
    steady: BoolArray,
    most: int = 1_200,
) -> BoolArray:
    """Return where a body rests, too, that crawls somewhere between two stops, where cells that are
    short enough for it (see :func:`_cells`) would be more than ``most``: before and after that, and
    at the bends in it, beside which it would be ``steady``. Top speeds that limit nothing are
    negative.
    """
    found = np.zeros(len(s), dtype=np.bool_)
    bends = np.append(steady, False) & np.append(False, steady)
    for low, high in itertools.pairwise(np.flatnonzero(stop)):
        least = math.sqrt(4 * push * float(s[high] - s[low]) / most)
        slow = np.concatenate([[False], np.abs(tops[low:high]) < least, [False]])
        for begin, end in np.flatnonzero(slow[1:] != slow[:-1]).reshape(-1, 2) + low:
            if (tops[begin:end] > 0.0).any():
                found[begin : end + 1] |= bends[begin : end + 1]
                found[[begin, end]] = True
    return found


def _cells(
    s: FloatArray, stop: BoolArray, tops: FloatArray, body: Body, push: float, ruled: BoolArray
) -> tuple[FloatArray, BoolArray]:
    """Cut every stretch between two stops into an even number of equally long cells.

    Where speeds are ``ruled`` (n - 1,), the slowest is one of those that cells of this length have.
    """
    if len(s) == 1:
        return np.zeros(1), np.ones(1, dtype=np.bool_)
    kin, wish = body.kinematics, _cell_length(body)
    edges: list[FloatArray] = []
    halt: list[bool] = []
    for low, high in itertools.pairwise(np.flatnonzero(stop)):
        top, length = float(tops[low:high].min()), float(s[high] - s[low])
        size = wish
        if top < kin.v_max:  # cells so short that there are speeds below the slowest arc's
            least = 1 if body.mobility.sideways else 2
            size = min(wish, top**2 / (2 * push * least))
        if ruled[low:high].any():
            most = top**2 / (2 * push) * (1.0 - ROUNDED)
            size = most / math.ceil(most / size)
        count = 2 * max(1, math.ceil(length / size / 2))
        edges.append(np.linspace(s[low], s[high], count + 1)[:-1])
        halt += [True] + [False] * (count - 1)
    edges.append(s[-1:])
    return np.concatenate(edges), np.array([*halt, True], dtype=np.bool_)
