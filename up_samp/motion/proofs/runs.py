"""What no body that drives along its heading beats between two poses.

A car rests wherever it turns back, and its shortest way is rarely the fastest one. Let the longest
run leave ``rest`` metres of the way to the others: they take at least what one run over them all
takes. If they are short, the car has hardly moved before and after the longest run, which is no
shorter than a Dubins curve between poses as near as that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from up_samp.model import Configuration, Kinematics
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import DriveLimits, run_time

RESTS = 0.5 * 1.2 ** np.arange(-80.0, 1.0)
"""Shares of the whole way for which the runs beside the longest one are told apart."""


def fastest_runs(
    start: Configuration, goal: Configuration, car: DriveLimits, length: float
) -> float:
    """Return seconds that no motion of a car between two poses beats whose way is ``length`` m at
    least: from rest to rest, resting at each cusp.
    """
    least = run_time(length, car.v, car.a)
    if car.sense != 0.0:
        return least
    rest = length * RESTS
    ways = ahead(start, goal, car.radius, rest), ahead(goal, start, car.radius, rest)
    longest = np.maximum(np.minimum(*ways), length - rest)
    found = 2 * run_time(0.5 * length, car.v, car.a)  # no run is longer than half the way
    before = 0.0
    for run, beside in zip(longest, rest, strict=True):
        found = min(found, run_time(run, car.v, car.a) + run_time(before, car.v, car.a))
        before = beside
    return max(least, found)


def ahead(
    start: Configuration, goal: Configuration, radius: float, moved: FloatArray
) -> FloatArray:
    """Return metres that no curve driven ahead alone beats, by how far (n, m) its two ends together
    may have been driven from the two poses: bounds on Dubins' words (see
    :mod:`up_samp.motion.curves.reeds_shepp`), each of their parts as short as it may be then.
    """
    near = moved / radius
    best = np.full(len(near), np.inf)
    for side in (1.0, -1.0):
        x, y = (goal[0] - start[0]) / radius, side * (goal[1] - start[1]) / radius
        best = np.minimum(best, _words(x, y, side * start[2], side * goal[2], near))
    return radius * best * (1 - 1e-9)


def _words(x: float, y: float, t0: float, t1: float, near: FloatArray) -> FloatArray:
    """Return bounds on the words that begin with a left turn, for a radius of 1: from (0, 0, t0) to
    (x, y, t1), both moved by ``near`` together.
    """
    # a turn's centre moves by as much as the car does and turns
    cx, cy = x + math.sin(t0), y - math.cos(t0)
    low, high, off, toward = _between(cx - math.sin(t1), cy + math.cos(t1), near)
    same = low + _arc(toward - t0, off) + _arc(t1 - toward, off)
    least, most = np.arcsin(np.minimum(low / 4, 1.0)), np.arcsin(np.minimum(high / 4, 1.0))
    tilt, wide = 0.5 * (least + most), off + 0.5 * (most - least)
    turns = _arc(toward - t0 - tilt + math.pi, wide) + _arc(t1 - toward - tilt - math.pi, wide)
    thrice = np.where(low > 4, np.inf, 2 * math.pi - 2 * most + turns)
    low, high, off, toward = _between(cx + math.sin(t1), cy - math.cos(t1), near)
    least, most = np.arcsin(2 / np.maximum(high, 2.0)), np.arcsin(2 / np.maximum(low, 2.0))
    tilt, wide = 0.5 * (least + most), off + 0.5 * (most - least)
    turns = _arc(toward + tilt - t0, wide) + _arc(toward + tilt - t1, wide)
    across = np.where(high < 2, np.inf, np.sqrt(np.maximum(low, 2.0) ** 2 - 4) + turns)
    return np.minimum(same, np.minimum(thrice, across))


def _between(
    x: float, y: float, near: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return how far apart two turns' centres are at least and at most, by how much (rad) a heading
    from one to the other may be off beside the car's own, and that heading.
    """
    apart = math.hypot(x, y)
    share = 2 * near / apart if apart > 0 else np.full(len(near), np.inf)
    off = np.where(share < 1, np.arcsin(np.minimum(share, 1.0)), math.pi)
    return np.maximum(apart - 2 * near, 0.0), apart + 2 * near, off + near, math.atan2(y, x)


def _arc(angle: float | FloatArray, off: FloatArray) -> FloatArray:
    """Return the least turn (rad, below a full one) to an angle that may be ``off`` (rad)."""
    turn = np.mod(angle, 2 * math.pi)
    wide = off + 1e-9  # for rounding
    return np.where((turn < wide) | (turn + wide >= 2 * math.pi), 0.0, turn - wide)


# ------------------ Bodies that turn on the spot


def fastest_roll(
    start: Configuration, goal: Configuration, kinematics: Kinematics, least: float
) -> float:
    """Return seconds that no motion between two poses beats of a body that drives along its heading
    and turns at will, by ``omega_max`` at most; none is faster than ``least``.

    It comes nearer to its goal as fast as it drives that way, and looks that way no sooner than it
    can have turned there, nor later than it has to turn from it.
    """
    toward = math.atan2(goal[1] - start[1], goal[0] - start[0])
    far = math.dist(start[:2], goal[:2])
    offs = [_off(pose[2] - toward, kinematics.reverse) for pose in (start, goal)]
    high = run_time(far, kinematics.v_max, kinematics.a_max) + sum(offs) / kinematics.omega_max
    if high <= least or _nearer(least, offs, kinematics) >= far:
        return least
    for _ in range(20):
        middle = 0.5 * (least + high)
        if _nearer(middle, offs, kinematics) < far:
            least = middle
        else:
            high = middle
    return least


def _off(angle: float, reverse: bool) -> float:
    """Return by how much (rad) a body looks away from where it drives, perhaps backwards."""
    off = abs(math.remainder(angle, 2 * math.pi))
    return min(off, math.pi - off) if reverse else off


def _nearer(
    seconds: float, offs: Sequence[float], kinematics: Kinematics, parts: int = 256
) -> float:
    """Return metres that a body which looks so far (rad) away in the beginning and in the end
    comes nearer at most, from rest to rest: an upper sum.
    """
    times = np.linspace(0.0, seconds, parts + 1)
    since, left = times[1:], times[:0:-1]  # the most that any part's moments have
    speed = np.minimum(kinematics.v_max, kinematics.a_max * np.minimum(since, left))
    turned = (
        off - kinematics.omega_max * some for off, some in zip(offs, (since, left), strict=True)
    )
    off = np.clip(np.maximum(*turned), 0.0, 0.5 * math.pi)
    return float((speed * np.cos(off)).sum()) * seconds / parts
