"""Ways of bodies that drive along their heading and turn at will (two driven wheels), and their
timing.

A way is a list of poses with a constant twist from each to the next: a line or an arc that is
driven ahead or backwards, or a turn on the spot. They turn by ``omega_max`` at most, so an
arc of radius r is driven at ``min(v_max, omega_max r)``. They rest where they turn on the spot, and
where their direction changes. Without a limit ``alpha_max`` they need no time to begin a turn: arcs
are driven straight on from a line; with one, turns on the spot are trapezoids of the turn rate (for
arcs see :mod:`.slowing`).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.model import Configuration, Kinematics, Trajectory
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.blending import profile
from up_samp.motion.curves.reeds_shepp import nodes_of
from up_samp.motion.curves.trajectories import partway, twists
from up_samp.motion.curves.trapezoid import MOST_TURN

ON_SPOT = 1e-3
"""Who turns round a point nearer than this (m) turns on the spot."""
SAME = 1e-6
"""Curvatures (1/m) that differ by less are one, speeds of which a less share is missing whole."""
SHORTEST = 1e-7
"""Phases of a motion shorter than this (s) have no sample of their own."""
NOWHERE = 1e-12
"""Poses that differ by no more (m, rad) are one."""


class Rolls(NamedTuple):
    """The pieces of a way: their ``sizes`` (m; rad on the spot), ``turns`` (rad), what each is
    (``kinds``: odd ahead, negative backwards, 2 and -2 turns on the spot; it rests between two
    kinds), its top speed (m/s; rad/s on the spot), and its acceleration (``pushes``: m/s^2; rad/s^2
    on the spot, infinite: at once).
    """

    sizes: FloatArray
    turns: FloatArray
    kinds: IntArray
    tops: FloatArray
    pushes: FloatArray


def rolls_of(rows: FloatArray, kinematics: Kinematics) -> Rolls:
    """Return the pieces between poses (n, 3), theta continuous, each another one than the next (a
    car never turns on the spot, and its arcs are no slower than lines).
    """
    ahead, _, turns = twists(rows).T
    way, size = np.abs(ahead), np.abs(turns)
    if kinematics.mobility.steers:
        tops, pushes = np.full((2, len(way)), [[kinematics.v_max], [kinematics.a_max]])
        # a turn of next to nothing, between poses that are almost one, has no length
        way = np.maximum(way, NOWHERE)
        return Rolls(way, turns, np.sign(ahead).astype(np.int64), tops, pushes)
    on_spot = way < ON_SPOT * size
    kinds = np.where(on_spot, 2 * np.sign(turns), np.sign(ahead)).astype(np.int64)
    slow = kinematics.omega_max * way < kinematics.v_max * (1.0 - SAME) * size
    tops = np.where(slow, kinematics.omega_max * way / np.where(slow, size, 1.0), kinematics.v_max)
    tops = np.where(on_spot, kinematics.omega_max, tops)
    pushes = np.where(on_spot, kinematics.alpha_max, kinematics.a_max)
    return Rolls(np.where(on_spot, size, way), turns, kinds, tops, pushes)


def rolling_radius(kinematics: Kinematics) -> float:
    """Return the radius (m) of the tightest arc that such a body drives at top speed."""
    return kinematics.v_max / kinematics.omega_max * (1.0 + SAME)


def rows_of(start: FloatArray, arcs: FloatArray) -> FloatArray:
    """Return a car's way along ``arcs`` (n, 2) as poses, at most ``MOST_TURN`` rad apart."""
    turns = np.abs(arcs[:, 0] * arcs[:, 1])
    counts = np.maximum(1, np.ceil(turns / MOST_TURN)).astype(np.int64)
    parts = arcs.copy()
    parts[:, 1] /= counts
    return np.asarray(nodes_of(start, np.ascontiguousarray(np.repeat(parts, counts, axis=0))))


def rolling_time(rows: FloatArray, kinematics: Kinematics) -> float:
    """Return how long (s) the way through ``rows`` (n, 3) takes from rest to rest."""
    rolls = rolls_of(rows[moves_on(rows)], kinematics)
    return sum(p[0] for phases in _phases(rolls) for p in phases)


def rolled(rows: FloatArray, kinematics: Kinematics) -> Trajectory:
    """Return the motion through ``rows`` (n, 3) from rest to rest, from time 0, as fast as can be.

    Samples are all of them, and at most ``Trajectory.MAX_STEP`` s and ``MOST_TURN`` rad apart.
    """
    rows = rows[moves_on(rows)]
    times, at, shares = sampled_rolls(rolls_of(rows, kinematics))
    return through_rows(rows, times, at, shares)


def through_rows(
    rows: FloatArray, times: FloatArray, at: IntArray, shares: FloatArray
) -> Trajectory:
    """Return the motion that is at ``times`` the ``shares`` of the way from rows ``at`` to the next
    ones, along constant twists.
    """
    poses = rows[:1].copy()
    if len(times) > 1:
        poses = partway(rows[at], rows[at + 1], shares)
        ends = shares == 1.0
        poses[ends] = rows[at[ends] + 1]
        poses[0], poses[-1] = rows[0], rows[-1]
    return Trajectory(times, poses)


def sampled_rolls(
    rolls: Rolls, held: BoolArray | None = None
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the samples of a way's fastest motion from rest to rest: times (s), the pieces that
    they are on and the shares of these; ``held`` pieces are driven at one speed, as their
    neighbours are that are held, too.
    """
    times, pieces, shares = [0.0], [0], [0.0]
    now = 0.0
    for i, phases in enumerate(_phases(rolls, held)):
        size, turn = float(rolls.sizes[i]), abs(float(rolls.turns[i]))
        done = 0.0
        for seconds, speed, push in phases:
            driven = speed * seconds + 0.5 * push * seconds * seconds
            steps = max(seconds / Trajectory.MAX_STEP, turn * driven / size / MOST_TURN)
            count = max(1, math.ceil(steps - 1e-9)) if seconds > SHORTEST else 0
            for k in range(1, count + 1):
                t = seconds * k / count
                times.append(now + t)
                pieces.append(i)
                shares.append(min((done + speed * t + 0.5 * push * t * t) / size, 1.0))
            now += seconds
            done += driven
        if len(times) > 1 and pieces[-1] == i:
            shares[-1] = 1.0
    return np.array(times), np.array(pieces), np.array(shares)


def thinned(rows: FloatArray, kinematics: Kinematics, kept: BoolArray | None = None) -> FloatArray:
    """Return the poses (n, 3) at which the twist changes, those that are ``kept`` (n,), and as many
    more as it takes to tell how often the body turns round.
    """
    distinct = moves_on(rows)
    rows = rows[distinct]
    rolls = rolls_of(rows, kinematics)
    kinds = rolls.kinds
    bends = np.where(np.abs(kinds) == 2, 0.0, kinds * rolls.turns / rolls.sizes)
    changes = (np.diff(kinds) != 0) | (np.abs(np.diff(bends)) > SAME)
    if kept is not None:
        changes |= kept[distinct][1:-1]
    stay = [0]
    for i in range(1, len(rows) - 1):
        if changes[i - 1] or abs(rows[i + 1, 2] - rows[stay[-1], 2]) > MOST_TURN:
            stay.append(i)
    stay.append(len(rows) - 1)
    return rows[stay]


_Phase = tuple[float, float, float]
"""Seconds of a constant acceleration, the speed before it, and the acceleration (m, or on the spot
rad, and s)."""


def moves_on(rows: FloatArray) -> BoolArray:
    """Return which poses are not where the one before is."""
    return np.append(True, np.abs(np.diff(rows, axis=0)).max(axis=1) > NOWHERE)


def _phases(rolls: Rolls, held: BoolArray | None = None) -> Iterator[tuple[_Phase, ...]]:
    """Yield the phases of each piece of a way."""
    steady = [False] * len(rolls.sizes) if held is None else held.tolist()
    speeds = _speeds(rolls, steady)
    pieces = zip(rolls.sizes.tolist(), rolls.tops.tolist(), rolls.pushes.tolist(), strict=True)
    for i, (size, top, a) in enumerate(pieces):
        if a == math.inf:
            yield ((size / top, top, 0.0),)
        elif steady[i] and min(speeds[i : i + 2]) > 0.0:
            speed = min(speeds[i : i + 2])
            yield ((size / speed, speed, 0.0),)
        else:
            peak, rise, cruise, fall = profile(size, speeds[i], speeds[i + 1], top, a)
            yield (rise, speeds[i], a), (cruise, peak, 0.0), (fall, peak, -a)


def _speeds(rolls: Rolls, steady: Sequence[bool]) -> list[float]:
    """Return the largest speeds (m/s; rad/s) at the ends of all pieces."""
    kinds, tops = rolls.kinds.tolist(), rolls.tops.tolist()
    speeds = [0.0]
    for i, (before, after) in enumerate(itertools.pairwise(kinds)):
        speeds.append(min(tops[i], tops[i + 1]) if before == after else 0.0)
    speeds.append(0.0)
    # no change of speed within a piece that is held, but from a rest or to one
    gains = [
        0.0 if h and min(speeds[i], speeds[i + 1]) > 0.0 else gain
        for i, (gain, h) in enumerate(
            zip((2.0 * rolls.pushes * rolls.sizes).tolist(), steady, strict=True)
        )
    ]
    for i, gain in enumerate(gains):
        speeds[i + 1] = min(speeds[i + 1], math.sqrt(speeds[i] ** 2 + gain))
    for i in reversed(range(len(gains))):
        speeds[i] = min(speeds[i], math.sqrt(speeds[i + 1] ** 2 + gains[i]))
    return speeds


# ------------------ Ways from rest to rest along a line
# A body turns while it sets off, and while it comes to its rest. Speeding up at a from a rest and
# turning by omega all the while, it has driven R theta^2 / 2 when it has turned by theta, with
# R = a / omega^2: its way is the involute of a circle of radius R (Lawrence, "A catalog of special
# plane curves", 1972). At its top speed v it goes on along an arc of radius v / omega. Nothing
# turns as much sooner, or is farther by then.


ComplexArray = npt.NDArray[np.complex128]

GRAIN, SLOWER = 0.1, 0.99
"""An involute is as many arcs as take as long as turns of so many rad: each is as tight as its
speed at its end allows, a little ``SLOWER``, so full acceleration from a rest needs no look at turn
rates.
"""


@functools.lru_cache(1_000)  # asked again among other obstacles
def swerves(
    start: Configuration, goal: Configuration, kinematics: Kinematics
) -> tuple[FloatArray, ...]:
    """Return such ways, poses (n, 3) with constant twists between, the fastest one first: ahead,
    and backwards where the body may drive so. What it has no room for is turned on the spot.
    """
    shares = itertools.product((0.0, 0.5, 1.0), (0.0, 0.5, 1.0))
    found = [*_swerves(start, goal, kinematics, next(shares))]
    if not found:
        found = [rows for spot in shares for rows in _swerves(start, goal, kinematics, spot)]
    return tuple(sorted(found, key=lambda rows: rolling_time(rows, kinematics)))


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
    rows = np.empty((len(there) + 1, 3))
    rows[0] = pose
    rows[1:, 0], rows[1:, 1], rows[1:, 2] = there.real, there.imag, start + side * turned
    rows[1:, :2] += pose[:2]
    return rows


_ARCS = np.arange(1, 2 + math.floor((2.0 * math.pi + GRAIN) / GRAIN))
_TURNS = 1.0 - 0.5 / _ARCS
"""By how many grains each arc of an involute turns, up to half a turn: by half of one or more."""
_ENDS = GRAIN * np.cumsum(_TURNS)
_SUMS = [float(_TURNS[:n].sum()) for n in range(len(_ARCS) + 1)]


def _driven(turn: float, kinematics: Kinematics) -> tuple[ComplexArray, FloatArray]:
    """Return where a body is (n,), as complex numbers, and by how much it has turned (n,), that
    sets off along the real axis and turns left by ``turn`` rad: along arcs, each of which it may
    drive a little faster than it is at its end (samples are rounded where they are kept).
    """
    v, a, omega = kinematics.v_max, kinematics.a_max, SLOWER * kinematics.omega_max
    most = math.floor(min(v * omega / a, 2.0 * turn + GRAIN) / GRAIN)
    most = min(most, 1 + int(_ENDS.searchsorted(turn)))
    grain = min(GRAIN, turn / _SUMS[most]) if most else 0.0
    left = max(turn - grain * _SUMS[most], 0.0)  # at top speed
    arcs = math.ceil(left / MOST_TURN)
    least = min(a / omega**2 * grain if most else math.inf, v / omega if arcs else math.inf)
    if least < 2.0 * ON_SPOT:  # as good as on the spot, and timed as such
        return np.zeros(2, dtype=np.complex128), np.array([0.0, turn])
    turns, radii, turned = np.empty(most + arcs), np.empty(most + arcs), np.zeros(most + arcs + 1)
    turns[:most], turns[most:] = grain * _TURNS[:most], left / max(arcs, 1)
    radii[:most], radii[most:] = a / omega**2 * grain * _ARCS[:most], v / omega
    turns.cumsum(out=turned[1:])
    there = np.zeros(most + arcs + 1, dtype=np.complex128)
    chords = 2.0 * radii * np.sin(0.5 * turns) * np.exp(1j * (turned[:-1] + 0.5 * turns))
    chords.cumsum(out=there[1:])
    return there, turned
