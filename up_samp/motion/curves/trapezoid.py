"""Rest-to-rest timing of paths: trapezoidal speed on each run, rest at each cusp."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import kernel
from up_samp.model import Configuration, Kinematics, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.arcs import nodes_of
from up_samp.motion.curves.reeds_shepp import DriveLimits, run_time

SHORTEST = 1e-6
"""Arcs shorter than this (m) are no samples of their own. They turn all the same: what comes after
them lies where they lead (1e-6 m of an arc are 0.1 mm after 100 m).
"""

MOST_TURN = 1.0
"""A car turns by so much (rad) at most between two samples: with a radius of millimetres it turns
round in no time, and which way has to be told.
"""


def limits_of(kinematics: Kinematics) -> DriveLimits:
    """Return the limits of a car.

    Nothing is kept in hand: a motion that takes 17 s takes 17 s, not a hair more. Rounding (1e-12)
    stays far within what any judge of limits has to allow.
    """
    return DriveLimits(
        float(kinematics.turning_radius),
        float(kinematics.v_max),
        float(kinematics.a_max),
        0.0 if kinematics.reverse else 1.0,
    )


def time_of_distance(s: FloatArray, length: float, v: float, a: float) -> FloatArray:
    """Return when a rest-to-rest trapezoid over ``length`` m has driven ``s`` m (sorted)."""
    if math.isinf(a):
        return s / v
    total = run_time(length, v, a)
    ramp = min(v / a, 0.5 * total)
    on_ramp = 0.5 * a * ramp * ramp
    top = a * ramp
    rise = np.sqrt(2.0 * np.minimum(s, on_ramp) / a)
    rest = np.clip(length - s, 0.0, None)
    fall = total - np.sqrt(2.0 * np.minimum(rest, on_ramp) / a)
    cruise = ramp + (s - on_ramp) / top
    return np.where(s <= on_ramp, rise, np.where(rest <= on_ramp, fall, cruise))


def distance_of_time(t: FloatArray, length: float, v: float, a: float) -> FloatArray:
    """Return the distance (m) driven at times ``t`` (s) by a rest-to-rest trapezoid."""
    if math.isinf(a):
        return v * t
    total = run_time(length, v, a)
    ramp = min(v / a, 0.5 * total)
    on_ramp, top = 0.5 * a * ramp * ramp, a * ramp
    left = np.clip(total - t, 0.0, None)
    return np.where(
        t <= ramp,
        0.5 * a * t * t,
        np.where(left <= ramp, length - 0.5 * a * left * left, on_ramp + top * (t - ramp)),
    )


def runs_of(arcs: FloatArray) -> list[FloatArray]:
    """Split a path at its cusps."""
    return [arcs[some] for some in _long_ones(arcs)]


def _long_ones(arcs: FloatArray) -> list[npt.NDArray[np.intp]]:
    """Return the numbers of the arcs that are sampled, run by run."""
    some = np.nonzero(np.abs(arcs[:, 1]) > SHORTEST)[0]
    if len(some) == 0:
        return []
    cusps = np.nonzero(np.diff(np.sign(arcs[some, 1])))[0] + 1
    return np.split(some, cusps)


def _run_samples(arcs: FloatArray, v: float, a: float) -> tuple[FloatArray, FloatArray]:
    """Return sample times and driven distances of one run, without its start.

    Every arc's end is a sample, and samples are at most ``Trajectory.MAX_STEP`` s and
    ``MOST_TURN`` rad apart.
    """
    ends = np.cumsum(np.abs(arcs[:, 1]))
    length = float(ends[-1])
    knots = np.concatenate([[0.0], time_of_distance(ends, length, v, a)])
    counts = np.ceil(np.diff(knots) / Trajectory.MAX_STEP - 1e-9).astype(np.int64)
    turns = np.ceil(np.abs(arcs[:, 0] * arcs[:, 1]) / MOST_TURN - 1e-9).astype(np.int64)
    counts = np.maximum(1, np.maximum(counts, turns))
    last = np.cumsum(counts) - 1
    which = np.repeat(np.arange(len(ends)), counts)
    share = (np.arange(len(which)) - last[which] + counts[which]) / counts[which]
    times = knots[which] + share * np.diff(knots)[which]
    where = distance_of_time(times, length, v, a)
    times[last], where[last] = knots[1:], ends
    return times, where


def trajectory_of(
    poses: Sequence[Configuration], legs: Sequence[FloatArray], kinematics: Kinematics
) -> Trajectory:
    """Return the timed motion along ``legs`` (arcs between successive ``poses``), from time 0.

    The car rests at each pose. It starts and passes exactly at the poses (theta modulo 2 pi, but
    continuous).
    """
    v, a = limits_of(kinematics)[1:3]
    times = [np.zeros(1)]
    rows = [np.array([poses[0][:3]], dtype=np.float64)]
    now = 0.0
    for target, arcs in zip(poses[1:], legs, strict=True):
        begins = nodes_of(rows[-1][-1], np.ascontiguousarray(arcs))
        for some in _long_ones(arcs):
            run = arcs[some]
            t, s = _run_samples(run, v, a)
            times.append(now + t)
            ends = np.cumsum(np.abs(run[:, 1]))
            rows.append(poses_on(begins[some], run, ends, s))
            now = float(times[-1][-1])
        end = rows[-1][-1]
        turns = round((float(end[2]) - target[2]) / (2 * math.pi))
        end[:] = (target[0], target[1], target[2] + turns * 2 * math.pi)
    return Trajectory(np.concatenate(times), np.concatenate(rows))


@kernel
def poses_on(begins: FloatArray, arcs: FloatArray, ends: FloatArray, s: FloatArray) -> FloatArray:
    """Return the poses (n, 3) at driven distances ``s`` (sorted, m) along one run.

    ``begins`` (m, 3): pose at each arc's start; ``ends``: distance driven at its end.
    """
    out = np.empty((s.shape[0], 3))
    k, begin = 0, 0.0
    for i in range(s.shape[0]):
        while s[i] > ends[k] and k + 1 < ends.shape[0]:
            begin = ends[k]
            k += 1
        x, y, th = begins[k, 0], begins[k, 1], begins[k, 2]
        part = s[i] - begin
        if arcs[k, 1] < 0.0:
            part = -part
        out[i, 0], out[i, 1], out[i, 2] = advance(x, y, th, arcs[k, 0], part)
    return out
