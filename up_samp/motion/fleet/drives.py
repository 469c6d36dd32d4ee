"""Drives along a few arcs among movers, at sampled poses: how long they take, when they clash."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner
from up_samp.geometry.kernels import advance
from up_samp.motion.curves.reeds_shepp import Pose
from up_samp.motion.fleet.movers import Fineness, Me, Movers, visits

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@inner
def ramp(run: float, v: float, a: float) -> float:
    """Return the time (s) from rest over ``run`` m at full acceleration."""
    on_ramp = v * v / (2 * a)
    return math.sqrt(2 * run / a) if run <= on_ramp else v / a + (run - on_ramp) / v


@inner
def stop(run: float, v: float, a: float) -> float:
    """Return the time (s) lost by coming to rest after ``run`` m instead of driving on."""
    return min(v, math.sqrt(2 * a * abs(run))) / (2 * a)


class Drive(NamedTuple):
    """Sampled poses of a drive: ``at`` (pieces,) time after its begin from rest, ``on`` (pieces,)
    the same when begun in motion, ``busy`` (pieces, visits, 2), ``many`` (pieces,) how many visits.
    """

    at: FloatArray
    on: FloatArray
    busy: FloatArray
    many: IntArray


@inner
def new_drive(fine: Fineness) -> Drive:
    """Return room for a drive."""
    return Drive(
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
    me: Me, movers: Movers, begin: Begin, arcs: FloatArray, n: int, brake: bool, drive: Drive
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
def clash(drive: Drive, count: int, times: FloatArray, begin: float) -> float:
    """Return by how much a begin must be delayed at least because of the first clash (0: none)."""
    for k in range(count):
        t = begin + times[k]
        for q in range(drive.many[k]):
            if drive.busy[k, q, 0] < t < drive.busy[k, q, 1]:
                return drive.busy[k, q, 1] - t + 1e-6
    return 0.0


@inner
def delayed(drive: Drive, count: int, begin: float, latest: float) -> float:
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
def safe_until(drive: Drive, k: int, t: float) -> float:
    """Return until when it is safe to stay at sampled pose ``k`` from ``t`` on."""
    for q in range(drive.many[k]):
        if drive.busy[k, q, 0] >= t:
            return drive.busy[k, q, 0]
    return math.inf
