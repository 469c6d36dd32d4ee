"""Timing of bodies that drive along their heading and turn at will (two driven wheels).

Their way is a list of poses with a constant twist from each to the next: a line or an arc that is
driven ahead or backwards, or a turn on the spot. They turn by ``omega_max`` at most, so an
arc of radius r is driven at ``min(v_max, omega_max r)``. They rest where they turn on the spot, and
where their direction changes. Without a limit ``alpha_max`` they need no time to begin a turn: arcs
are driven straight on from a line; with one, turns on the spot are trapezoids of the turn rate (for
arcs see :mod:`.turning`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from up_samp.model import Kinematics, Trajectory
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.arcs import nodes_of
from up_samp.motion.curves.blending import profile
from up_samp.motion.curves.trapezoid import MOST_TURN
from up_samp.motion.curves.twists import partway, twists

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
    """Return the pieces between poses (n, 3), theta continuous, each another one than the next."""
    ahead, _, turns = twists(rows).T
    way, size = np.abs(ahead), np.abs(turns)
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
