"""Other bodies as the compiled searches see them, and drives along a few arcs among them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import inner, kernel
from up_samp.motion.curves.reeds_shepp import CarLimits, Pose
from up_samp.motion.fleet.conflicts import Hull, Part, SweptPiece, apart, piece, standing
from up_samp.motion.fleet.paths import A_AVOIDS, B_AVOIDS

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Movers(NamedTuple):
    """Other bodies: ``rows`` (n, 9) poses in the middle of their extended cells (as in
    ``sweep_table``, but without extent), body k has ``first[k]:first[k + 1]``; ``held``
    its occupancy from ``first[k] + k`` on; ``hull`` (m,) the index of its shape in ``verts``
    (h, p, c, 2), ``counts`` (h, p; 0: no part), ``radii`` (h,);
    ``steps`` (m,) distance between middles at most; ``flags`` (m,) who keeps clear of whom.
    """

    rows: FloatArray
    first: IntArray
    held: FloatArray
    hull: IntArray
    verts: FloatArray
    counts: IntArray
    radii: FloatArray
    steps: FloatArray
    flags: IntArray


class MoverFineness(NamedTuple):
    """How finely drives are looked at: at so many ``pieces`` at most, ``piece`` m apart or more;
    so many ``visits`` are kept for a pose, each with ``guard`` s before and after it.
    """

    pieces: int
    piece: float
    visits: int
    guard: float


class Me(NamedTuple):
    """The body that is planned: its ``hull``, the ``margin`` (m) it keeps, its limits as a ``car``
    (the turning radius in m, m/s, m/s^2), when it may leave (``release``, s), after which time its
    goal stays free (``goal_free``, s), and how ``fine`` its drives are looked at.
    """

    hull: Hull
    margin: float
    car: CarLimits
    release: float
    goal_free: float
    fine: MoverFineness


@kernel
def visits(me: Me, movers: Movers, pose: Pose, resting: bool, out: FloatArray) -> int:
    """Fill ``out`` (visits, 2) with the times at which movers are at a pose; return how many."""
    here = standing(pose[0], pose[1], pose[2])
    count, guard = 0, me.fine.guard
    for k in range(len(movers.hull)):
        flags, hull = movers.flags[k], movers.hull[k]
        low, high = movers.first[k], movers.first[k + 1]
        shift = k
        reach = me.hull.radius + me.margin + movers.radii[hull]
        step = movers.steps[k]
        j = low
        if resting or not flags & A_AVOIDS:
            if not flags & B_AVOIDS:
                continue
            j += 1
            high -= 1
        open_from = -1
        while j < high:
            b = piece(movers.rows[j])
            gap = math.sqrt((here.x - b.x) ** 2 + (here.y - b.y) ** 2) - reach
            hit = False
            if gap <= 0.0:
                hit = _touch(here, me, b, movers, hull)
            if hit and open_from < 0:
                open_from = j
            if not hit and open_from >= 0:
                since, until = movers.held[open_from + shift], movers.held[j + shift]
                count = _add(out, count, since - guard, until + guard)
                open_from = -1
            j += 1 if gap <= 0.0 else max(1, int(gap / step))
        if open_from >= 0:
            since, until = movers.held[open_from + shift], movers.held[high + shift]
            count = _add(out, count, since - guard, until + guard)
    return count


@inner
def _touch(here: SweptPiece, me: Me, b: SweptPiece, movers: Movers, hull: int) -> bool:
    for i in range(len(me.hull.counts)):
        mine = Part(me.hull.verts[i], me.hull.counts[i], me.hull.radius)
        for j in range(movers.counts.shape[1]):
            n = movers.counts[hull, j]
            if n > 0:
                other = Part(movers.verts[hull, j], n, movers.radii[hull])
                if apart(here, mine, b, other, me.margin) == 0:
                    return True
    return False


@inner
def _add(out: FloatArray, count: int, low: float, high: float) -> int:
    """Add [low, high] to sorted disjoint intervals; return how many there are then."""
    k = 0
    while k < count and out[k, 1] < low:
        k += 1
    last = k
    while last < count and out[last, 0] <= high:
        low, high = min(low, out[last, 0]), max(high, out[last, 1])
        last += 1
    if last == k:
        if count == len(out):
            return count
        for i in range(count, k, -1):
            out[i, 0], out[i, 1] = out[i - 1, 0], out[i - 1, 1]
        count += 1
    else:
        for i in range(last, count):
            out[i - last + k + 1, 0], out[i - last + k + 1, 1] = out[i, 0], out[i, 1]
        count -= last - k - 1
    out[k, 0], out[k, 1] = low, high
    return count


# ------------------ Drives along a few arcs among movers
# Drives along a few arcs among movers, at sampled poses: how long they take, when they clash.


@inner
def ramp(run: float, v: float, a: float) -> float:
    """Return the time (s) from rest over ``run`` m at full acceleration."""
    on_ramp = v * v / (2 * a)
    return math.sqrt(2 * run / a) if run <= on_ramp else v / a + (run - on_ramp) / v


@inner
def stop(run: float, v: float, a: float) -> float:
    """Return the time (s) lost by coming to rest after ``run`` m instead of driving on."""
    return min(v, math.sqrt(2 * a * abs(run))) / (2 * a)


class ArcDrive(NamedTuple):
    """Sampled poses of a drive: ``at`` (pieces,) time after its begin from rest, ``on`` (pieces,)
    the same when begun in motion, ``busy`` (pieces, visits, 2), ``many`` (pieces,) how many visits.
    """

    at: FloatArray
    on: FloatArray
    busy: FloatArray
    many: IntArray


@inner
def new_drive(fine: MoverFineness) -> ArcDrive:
    """Return room for a drive."""
    return ArcDrive(
        np.empty(fine.pieces),
        np.empty(fine.pieces),
        np.empty((fine.pieces, fine.visits, 2)),
        np.zeros(fine.pieces, dtype=np.int64),
    )


class Begin(NamedTuple):
    """Where a drive begins: at a ``pose``, in a run of signed length ``run`` (m)."""

    pose: Pose
    run: float


@inner
def sample(
    me: Me, movers: Movers, begin: Begin, arcs: FloatArray, n: int, brake: bool, drive: ArcDrive
) -> tuple[int, float, Pose]:
    """Sample ``n`` arcs; return the number of poses, the last run's signed length, and the end.

    With ``brake`` the drive ends at rest, otherwise it may go on.
    """
    v, a = me.car.v, me.car.a
    total = 0.0
    for i in range(n):
        total += abs(arcs[i, 1])
    step = max(me.fine.piece, total / (me.fine.pieces - n))
    pose = begin.pose
    count = 0
    rest, on, run, ahead = 0.0, 0.0, 0.0, 0.0
    moving = abs(begin.run) if begin.run * arcs[0, 1] > 0 else 0.0
    for i in range(n):
        kappa, s = arcs[i, 0], arcs[i, 1]
        if i == 0 or run * s < 0:
            # a cusp: the last run has come to rest, measure the next one
            if i > 0:
                rest += ramp(ahead, v, a) + stop(ahead, v, a)
                on += rolling(moving, ahead, v, a) + stop(moving + ahead, v, a)
                moving = 0.0
            run, ahead = 0.0, 0.0
            k = i
            while k < n and arcs[k, 1] * s > 0:
                ahead += abs(arcs[k, 1])
                k += 1
        braked = brake or ahead < abs(total) - 1e-9
        pieces = max(1, math.ceil(abs(s) / step))
        for k in range(1, pieces + 1):
            there = advance(pose[0], pose[1], pose[2], kappa, s * k / pieces)
            gone = abs(run) + abs(s) * k / pieces
            first, second = ramp(gone, v, a), rolling(moving, gone, v, a)
            left = max(0.0, ahead - gone)
            if braked and left < min(v * v / (2 * a), 0.5 * ahead):
                late = ramp(left, v, a)
                first = max(first, ramp(ahead, v, a) + stop(ahead, v, a) - late)
                whole = rolling(moving, ahead, v, a) + stop(moving + ahead, v, a)
                second = max(second, whole - late)
            drive.at[count], drive.on[count] = rest + first, on + second
            drive.many[count] = visits(me, movers, there, False, drive.busy[count])
            count += 1
        pose = advance(pose[0], pose[1], pose[2], kappa, s)
        run += s
    return count, run, pose


@inner
def rolling(before: float, run: float, v: float, a: float) -> float:
    """Return the time (s) over ``run`` m, ``before`` m after starting at full acceleration."""
    return ramp(before + run, v, a) - ramp(before, v, a)


@inner
def clash(drive: ArcDrive, count: int, times: FloatArray, begin: float) -> float:
    """Return by how much a begin must be delayed at least because of the first clash (0: none)."""
    for k in range(count):
        t = begin + times[k]
        for q in range(drive.many[k]):
            if drive.busy[k, q, 0] < t < drive.busy[k, q, 1]:
                return drive.busy[k, q, 1] - t + 1e-6
    return 0.0


@inner
def delayed(drive: ArcDrive, count: int, begin: float, latest: float) -> float:
    """Return the first begin from rest in [begin, latest] without a clash (inf: none)."""
    for _ in range(200):
        if begin > latest:
            return math.inf
        delay = clash(drive, count, drive.at, begin)
        if delay == 0.0:
            return begin
        begin += delay
    return math.inf


@inner
def safe_until(drive: ArcDrive, k: int, t: float) -> float:
    """Return until when it is safe to stay at sampled pose ``k`` from ``t`` on."""
    for q in range(drive.many[k]):
        if drive.busy[k, q, 0] >= t:
            return drive.busy[k, q, 0]
    return math.inf
