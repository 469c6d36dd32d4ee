"""Rest-to-rest timing: trapezoidal speed on each run of a car's path, which rests at each cusp, and
on each straight piece of a chain (SE2 and SE3 bodies), with a rest at each node.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import kernel
from up_samp.model import Configuration, Kinematics, Trajectory, interpolate
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import DriveLimits, nodes_of, run_time
from up_samp.motion.curves.trajectories import rotations, with_ends

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
    ends: Sequence[Configuration], arcs: FloatArray, kinematics: Kinematics
) -> Trajectory:
    """Return a car's timed motion along ``arcs`` from the first of two poses exactly to the other
    one (theta modulo 2 pi, but continuous), from time 0.
    """
    v, a = limits_of(kinematics)[1:3]
    times, rows = [np.zeros(1)], [np.array([ends[0][:3]], dtype=np.float64)]
    begins = nodes_of(rows[0][0], np.ascontiguousarray(arcs))
    for some in _long_ones(arcs):
        run = arcs[some]
        t, s = _run_samples(run, v, a)
        times.append(times[-1][-1] + t)
        rows.append(poses_on(begins[some], run, np.cumsum(np.abs(run[:, 1])), s))
    motion = Trajectory(np.concatenate(times), np.concatenate(rows))
    return with_ends(motion, ends[0], ends[1])


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


# ------------------ Chains of straight motions


def turn_between(a: FloatArray, b: FloatArray) -> float:
    """Return the angle (rad) between two poses: (x, y, theta), theta continuous, or with a
    quaternion (x, y, z, qx, qy, qz, qw), where it is at most pi.
    """
    if len(a) == 3:
        return abs(float(b[2] - a[2]))
    return float(np.linalg.norm(rotations(np.array([a, b]))))


def leg_profile(a: FloatArray, b: FloatArray, kinematics: Kinematics) -> tuple[float, float, float]:
    """Return (seconds, top speed, acceleration) of a rest-to-rest trapezoid over the *share* (0 to
    1) of the straight motion from ``a`` to ``b``; speeds and accelerations in shares.

    Distance and turn share the trapezoid, so that ``v_max``, ``a_max`` and ``omega_max`` all hold.
    A turn on the spot runs at a constant rate where nothing limits ``alpha_max``.
    """
    size = 2 if len(a) == 3 else 3
    turn = turn_between(a, b)
    way = float(np.linalg.norm(b[:size] - a[:size])) + kinematics.reach * turn
    if way < 1e-9:
        if turn < 1e-12:
            return 0.0, 0.0, 0.0
        speed = kinematics.omega_max / turn
        acceleration = kinematics.alpha_max / turn
        return float(run_time(1.0, speed, acceleration)), speed, acceleration
    speed = kinematics.v_max / way
    if turn > 1e-12:
        speed = min(speed, kinematics.omega_max / turn)
    acceleration = kinematics.a_max / way
    return float(run_time(1.0, speed, acceleration)), speed, acceleration


def timed_chain(nodes: FloatArray, kinematics: Kinematics) -> Trajectory:
    """Return the motion through ``nodes``, shape (n, 3) or (n, 7), from time 0, at rest at each.

    Positions move straight, headings turn at the same share (quaternions by slerp).
    """
    times, rows = [np.zeros(1)], [np.array(nodes[:1])]
    now = 0.0
    for a, b in itertools.pairwise(nodes):
        seconds, speed, acceleration = leg_profile(a, b, kinematics)
        if seconds <= 1e-9:
            continue
        count = max(2, math.ceil(seconds / Trajectory.MAX_STEP - 1e-9))
        grid = np.linspace(0.0, seconds, count + 1)[1:]
        shares = distance_of_time(grid, 1.0, speed, acceleration)
        if len(a) == 3:
            poses = a + shares[:, None] * (b - a)
        else:
            poses = np.array([interpolate(a, b, float(s)) for s in shares])
        poses[-1] = b
        times.append(now + grid)
        rows.append(poses)
        now += seconds
    return Trajectory(np.concatenate(times), np.concatenate(rows))
