"""Timing of chains of straight motions (SE2 and SE3 bodies): rest at each node."""

from __future__ import annotations

import itertools
import math

import numpy as np

from up_samp.model import Kinematics, Trajectory, interpolate
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import run_time
from up_samp.motion.curves.trapezoid import distance_of_time


def turn_between(a: FloatArray, b: FloatArray) -> float:
    """Return the angle (rad) between two poses: (x, y, theta), theta continuous, or with a
    quaternion (x, y, z, qx, qy, qz, qw), where it is at most pi.
    """
    if len(a) == 3:
        return abs(float(b[2] - a[2]))
    # by the chords to q and -q: accurate also where the angle is tiny
    near = float(np.linalg.norm(a[3:] - b[3:]))
    far = float(np.linalg.norm(a[3:] + b[3:]))
    return 4.0 * math.atan2(min(near, far), max(near, far))


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
