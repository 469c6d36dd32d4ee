"""Ways from rest to rest of what turns at will, along a line: it turns while it sets off, and while
it comes to its rest.

Speeding up at ``a`` from a rest and turning by ``omega`` all the while, a body has driven
``R theta^2 / 2`` when it has turned by theta, with ``R = a / omega^2``: its way is the involute of
a circle of radius R (Lawrence, "A catalog of special plane curves", 1972). At its top speed v it
goes on along an arc of radius ``v / omega``. Nothing turns as much sooner, or is farther by then.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from up_samp.model import Configuration, Kinematics
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.rolling import NOWHERE, ON_SPOT, moves_on, rolling_time
from up_samp.motion.curves.trapezoid import MOST_TURN

ComplexArray = npt.NDArray[np.complex128]

GRAIN, SLOWER = 0.1, 0.99
"""An involute is as many arcs as take as long as turns of so many rad: each is as tight as its
speed at its end allows, a little ``SLOWER``, so full acceleration from a rest needs no look at turn
rates.
"""


def swerves(start: Configuration, goal: Configuration, kinematics: Kinematics) -> list[FloatArray]:
    """Return such ways, poses (n, 3) with constant twists between, the fastest one first: ahead,
    and backwards where the body may drive so. What it has no room for is turned on the spot.
    """
    shares = itertools.product((0.0, 0.5, 1.0), (0.0, 0.5, 1.0))
    found = [*_swerves(start, goal, kinematics, next(shares))]
    if not found:
        found = [rows for spot in shares for rows in _swerves(start, goal, kinematics, spot)]
    return sorted(found, key=lambda rows: rolling_time(rows, kinematics))


def _swerves(
    start: Configuration, goal: Configuration, kinematics: Kinematics, spot: tuple[float, float]
) -> Iterator[FloatArray]:
    """Yield such a way ahead and one backwards; ``spot``: shares of both turns on the spot."""
    for back in (0.0, math.pi) if kinematics.reverse else (0.0,):
        turned = np.array([0.0, 0.0, back])
        p, q = (np.array(pose[:3], dtype=np.float64) + turned for pose in (start, goal))
        way = math.atan2(q[1] - p[1], q[0] - p[0])
        for _ in range(16):  # the line's heading comes nearer each time, soon by far, or never
            # it comes to its rest as it would set off backwards from it
            off = _setting_off(p, way, spot[0], kinematics, 1.0)
            on = _setting_off(q, way, spot[1], kinematics, -1.0)[::-1]
            dx, dy = on[0, :2] - off[-1, :2]
            before, way = way, math.atan2(dy, dx)
            if abs(math.remainder(way - before, 2 * math.pi)) < NOWHERE:
                rows = np.concatenate([off, on]) - turned
                rows[:, 2] = np.unwrap(rows[:, 2])
                yield rows[moves_on(rows)]
                break


def _setting_off(
    pose: FloatArray, way: float, share: float, kinematics: Kinematics, ahead: float
) -> FloatArray:
    """Return the poses (n, 3) of a body that sets off along a line that leads ``way`` (rad),
    ``ahead`` (1) or backwards (-1); the ``share`` of its turn is one on the spot.
    """
    turn = math.remainder(way - float(pose[2]), 2 * math.pi)
    side, start = math.copysign(1.0, turn), pose[2] + share * turn
    there, turned = _driven((1.0 - share) * abs(turn), kinematics)
    there = (there.real + 1j * side * there.imag) * ahead * np.exp(1j * start)
    rows = np.column_stack((there.real, there.imag, start + side * turned))
    rows[:, :2] += pose[:2]
    return np.concatenate([pose[None], rows])


def _driven(turn: float, kinematics: Kinematics) -> tuple[ComplexArray, FloatArray]:
    """Return where a body is (n,), as complex numbers, and by how much it has turned (n,), that
    sets off along the real axis and turns left by ``turn`` rad: along arcs, each of which it may
    drive a little faster than it is at its end (samples are rounded where they are kept).
    """
    v, a, omega = kinematics.v_max, kinematics.a_max, SLOWER * kinematics.omega_max
    # turns (rad) by so many arcs that take as long as a turn of GRAIN, of which each turns by half
    # of that or more
    number = np.arange(1, 1 + math.floor(min(v * omega / a, 2.0 * turn + GRAIN) / GRAIN))
    each = 1.0 - 0.5 / number
    most = min(len(number), 1 + int(np.searchsorted(GRAIN * np.cumsum(each), turn)))
    number, each = number[:most], each[:most]
    grain = min(GRAIN, turn / each.sum()) if most else 0.0
    left = max(turn - grain * float(each.sum()), 0.0)  # at top speed
    arcs = math.ceil(left / MOST_TURN)
    turns = np.concatenate([grain * each, np.full(arcs, left / max(arcs, 1))])
    radii = np.concatenate([a / omega**2 * grain * number, np.full(arcs, v / omega)])
    if np.any(radii < 2.0 * ON_SPOT):  # as good as on the spot, and timed as such
        return np.zeros(2, dtype=np.complex128), np.array([0.0, turn])
    turned = np.concatenate([[0.0], np.cumsum(turns)])
    chords = 2.0 * radii * np.sin(0.5 * turns) * np.exp(1j * (turned[:-1] + 0.5 * turns))
    return np.concatenate([[0.0], np.cumsum(chords)]), turned
