"""Limits of motions (speed, acceleration, curvature): finite differences, with stated tolerances.

Speeds are means over a piece between two samples, so that a body within its limits always
passes: a mean speed is at most the largest speed, and means over neighbouring pieces differ by at
most the largest acceleration times the time between the pieces' middles. Beyond that, allowed are
``TOLERANCES.limits`` of each limit, positions that are off by ``TOLERANCES.noise``, and what a car
of that turning radius can do between two samples unseen (an arc and a straight inside one piece).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.model.violation import Violation
from up_samp.validation.control import breaks_law
from up_samp.validation.limits import Limits
from up_samp.validation.tolerances import TOLERANCES
from up_samp.validation.tracks import Pieces, pieces_of


def motion_violations(
    what: str, limits: Limits, times: FloatArray, poses: FloatArray
) -> Iterator[Violation]:
    """Yield how a trajectory (plan time, s; poses (n, 3) or (n, 7)) breaks the body's limits.

    ``what`` names the activity and the object.
    """
    if len(times) < 2:
        return
    if poses.shape[1] == 7:
        yield from _flyer(what, limits, times, poses)
        return
    pieces = pieces_of(times, poses)
    yield from _sampling(what, times, pieces.dt, pieces.at_rest)
    turns = np.abs(pieces.turn)
    if turns.max() > math.pi / 2:
        i = int(turns.argmax())
        text = f"{what}: turns by {turns[i]:.3f} rad between two samples at {times[i]:.3f} s"
        yield Violation("sampling", text)
    yield from speeds_on_way(what, limits, times, poses)
    yield from _turn_acceleration(what, limits, times, pieces)
    if limits.law is not None:
        yield from breaks_law(what, limits, times, poses, pieces)
    elif limits.model == "REEDSSHEPP":
        yield from _car(what, limits, times, pieces)
    elif limits.model == "PIVOT":
        yield from _pivoting(what, limits, times, pieces)
    else:
        speed = pieces.chord / pieces.dt[:, None]
        yield from _free(what, limits, times, pieces.dt, speed, pieces.turn)


def _worst(
    what: str,
    kind: str,
    unit: str,
    times: FloatArray,
    value: FloatArray,
    limit: FloatArray | float,
    slack: FloatArray | float,
) -> Iterator[Violation]:
    """Yield one violation for where ``value`` exceeds ``limit`` by most beyond what is allowed."""
    bound = np.broadcast_to(limit * (1 + TOLERANCES.limits) + slack, value.shape)
    excess = value - bound
    if len(value) and excess.max() > 0:
        i = int(excess.argmax())
        most = float(np.broadcast_to(limit, value.shape)[i])
        text = f"{what}: {value[i]:.4g} {unit} at {times[i]:.3f} s, at most {most:.4g} allowed"
        yield Violation(kind, text)


def _sampling(
    what: str, times: FloatArray, dt: FloatArray, rests: BoolArray
) -> Iterator[Violation]:
    gaps = np.where(rests, 0.0, dt)
    if gaps.max() > TOLERANCES.sampling + 1e-9:
        i = int(gaps.argmax())
        text = f"{what}: no sample for {gaps[i]:.3f} s after {times[i]:.3f} s while it moves"
        yield Violation("sampling", text)


def _car(what: str, limits: Limits, times: FloatArray, pieces: Pieces) -> Iterator[Violation]:
    """A car: along its heading, no turn too tight, at rest where it changes direction."""
    radius, dt, length = limits.turning_radius, pieces.dt, pieces.length
    # between two samples a car of this radius can bend to and fro: its chord then leaves the
    # heading in the middle by at most length / (4 radius)
    unseen = length**2 / (4 * radius)
    slip = np.abs(pieces.across)
    yield from _worst(what, "side-slip", "m sideways", times, slip, unseen, 10 * TOLERANCES.noise)
    yield from _drift(what, times, pieces)
    curl = np.abs(pieces.turn)
    tightest = length / radius
    yield from _worst(what, "curvature", "rad turned", times, curl, tightest, 10 * TOLERANCES.noise)
    speed = np.copysign(length, pieces.along) / dt
    yield from _worst(what, "speed", "m/s", times, speed, limits.v_max, TOLERANCES.noise / dt)
    # an S-bend inside a piece makes its arc look shorter than its way by length^3 / (96 radius^2)
    fuzz = TOLERANCES.noise + length**3 / (96 * radius**2)
    yield from _acceleration(what, limits, times, dt, speed[:, None], fuzz, pieces.at_rest)


def speeds_on_way(
    what: str, limits: Limits, times: FloatArray, poses: FloatArray
) -> Iterator[Violation]:
    """A body is not too fast backwards, nor in bends (speed times turn rate is what pulls it
    outwards); also asked of what was driven.
    """
    yield from driven_backwards(what, limits, times, poses)
    if math.isinf(limits.lateral):
        return
    pieces, noise = pieces_of(times, poses), TOLERANCES.noise
    speed, rate = pieces.length / pieces.dt, np.abs(pieces.turn) / pieces.dt
    slack = noise * (speed + rate + noise / pieces.dt) / pieces.dt
    yield from _worst(
        what, "lateral-acceleration", "m/s^2", times, speed * rate, limits.lateral, slack
    )


def _turn_acceleration(
    what: str, limits: Limits, times: FloatArray, pieces: Pieces
) -> Iterator[Violation]:
    """The turn rate changes no faster than it may, from rest to rest, over any time: since any
    piece before, by no more than is allowed between the pieces' middles and in one ``turn_step``.
    """
    if math.isinf(limits.alpha):
        return
    alpha = limits.alpha * (1 + TOLERANCES.limits)
    middle = np.concatenate((times[:1], (times[1:] + times[:-1]) / 2, times[-1:]))
    rate = np.concatenate(([0.0], pieces.turn / pieces.dt, [0.0]))
    off = np.concatenate(([0.0], TOLERANCES.noise / pieces.dt, [0.0]))
    for way in (rate, -rate):
        grown = way - alpha * middle
        excess = grown - off - np.minimum.accumulate(grown + off)
        i = int(excess.argmax())
        if excess[i] > alpha * TOLERANCES.turn_step:
            text = f"{what}: the turn rate comes to {rate[i]:.4g} rad/s at {middle[i]:.3f} s too"
            text = f"{text} soon, at most {limits.alpha:.4g} rad/s^2 allowed"
            yield Violation("turn-acceleration", text)
            return


def driven_backwards(
    what: str, limits: Limits, times: FloatArray, poses: FloatArray
) -> Iterator[Violation]:
    """A body is no faster against its heading than it may be; where it may not drive so, never is
    it behind where it has been, however slowly it got there (along its way; rounding is allowed for
    once, not for each piece).
    """
    pieces = pieces_of(times, poses)
    if limits.v_back > 0.0:
        if limits.model in ("REEDSSHEPP", "PIVOT"):
            back, slack = limits.v_back, TOLERANCES.noise / pieces.dt
            speed = np.copysign(pieces.length, -pieces.along) / pieces.dt
            yield from _worst(what, "speed", "m/s backwards", times, speed, back, slack)
        return
    ahead = np.concatenate(([0.0], np.cumsum(pieces.along)))
    behind = np.maximum.accumulate(ahead) - ahead
    if behind.max() > 10 * TOLERANCES.noise:
        i = int(np.argmax(behind > 10 * TOLERANCES.noise))
        text = f"{what}: drives {behind.max():.3g} m against its heading, from {times[i - 1]:.3f} s"
        yield Violation("backwards", f"{text} on; its reverse is forbidden")


def _pivoting(what: str, limits: Limits, times: FloatArray, pieces: Pieces) -> Iterator[Violation]:
    """Two driven wheels: along its heading, turns at will, at rest where it changes direction."""
    dt, length = pieces.dt, pieces.length
    # inside one piece it may turn and drive in any order: its chord then leaves the heading in
    # the middle by at most half of what it can turn
    unseen = length * np.minimum(1.0, 0.5 * limits.omega_max * dt)
    yield from _worst(
        what, "side-slip", "m sideways", times, np.abs(pieces.across), unseen, TOLERANCES.noise
    )
    yield from _drift(what, times, pieces)
    yield from _turn_rate(what, limits, times, dt, pieces.turn)
    speed = np.copysign(length, pieces.along) / dt
    yield from _worst(
        what, "speed", "m/s", times, np.abs(speed), limits.v_max, TOLERANCES.noise / dt
    )
    # turning while driving makes its way look shorter than it is, by less than this
    fuzz = TOLERANCES.noise + length * np.minimum(1.0, (limits.omega_max * dt) ** 2 / 8)
    fuzz = np.where(np.abs(pieces.turn) < 1e-9, TOLERANCES.noise, fuzz)
    yield from _acceleration(what, limits, times, dt, speed[:, None], fuzz, length < 1e-9)


def _turn_rate(
    what: str, limits: Limits, times: FloatArray, dt: FloatArray, turn: FloatArray
) -> Iterator[Violation]:
    rate, slack = np.abs(turn) / dt, TOLERANCES.noise / dt
    yield from _worst(what, "turn-rate", "rad/s", times, rate, limits.omega_max, slack)


def _drift(what: str, times: FloatArray, pieces: Pieces) -> Iterator[Violation]:
    """Small slips may not add up: within any such stretch of way, however slowly driven."""
    way = np.concatenate(([0.0], np.cumsum(pieces.length)))
    side = np.concatenate(([0.0], np.cumsum(pieces.across)))
    until = np.searchsorted(way, way + TOLERANCES.slip_window, side="right") - 1
    drift = np.abs(side[until] - side)
    bound = TOLERANCES.limits * TOLERANCES.slip_window
    if drift.max() > bound:
        i = int(drift.argmax())
        within = f"within {TOLERANCES.slip_window} m from {times[i]:.3f} s"
        text = f"{what}: slips {drift[i]:.3g} m sideways {within}"
        yield Violation("side-slip", text)


def _free(
    what: str,
    limits: Limits,
    times: FloatArray,
    dt: FloatArray,
    speed: FloatArray,
    turn: FloatArray,
) -> Iterator[Violation]:
    """A body that moves in any direction: ``speed`` (n - 1, d) m/s, ``turn`` (n - 1,) rad."""
    size = np.linalg.norm(speed, axis=1)
    yield from _worst(what, "speed", "m/s", times, size, limits.v_max, TOLERANCES.noise / dt)
    yield from _turn_rate(what, limits, times, dt, turn)
    rests = (size * dt < 1e-9) & (np.abs(turn) < 1e-9)
    fuzz = np.full(len(dt), TOLERANCES.noise)
    yield from _acceleration(what, limits, times, dt, speed, fuzz, rests)


def _acceleration(
    what: str,
    limits: Limits,
    times: FloatArray,
    dt: FloatArray,
    speed: FloatArray,
    fuzz: FloatArray,
    rests: BoolArray,
) -> Iterator[Violation]:
    """Changes of speed, from rest at the first sample to rest at the last one.

    ``speed`` has shape (n - 1, d): a car's is signed. ``fuzz`` (m) is how far off each piece's
    way may be. Next to a rest, and at a cusp, the speed is zero at the sample itself.
    """
    uncertain = fuzz / dt
    half = dt / 2
    change = np.linalg.norm(np.diff(speed, axis=0), axis=1)
    between = np.where(rests[1:], half[:-1], np.where(rests[:-1], half[1:], half[:-1] + half[1:]))
    slack = (uncertain[1:] + uncertain[:-1]) / between
    middle = times[1:-1]
    yield from _worst(what, "acceleration", "m/s^2", middle, change / between, limits.a_max, slack)
    for i, kind in ((0, "rest-at-start"), (-1, "rest-at-end")):
        rate = np.linalg.norm(speed[[i]], axis=1) / half[[i]]
        if rests[i]:
            continue
        text = f"{what} is not at rest"
        yield from _worst(
            text, kind, "m/s^2", times[[i]], rate, limits.a_max, uncertain[[i]] / half[[i]]
        )
    if speed.shape[1] == 1:
        v = speed[:, 0]
        cusp = np.flatnonzero((v[:-1] * v[1:] < 0) & ~rests[:-1] & ~rests[1:])
        for side in (cusp, cusp + 1):
            rate = np.abs(v[side]) / half[side]
            slack = uncertain[side] / half[side]
            text = f"{what} does not stop at its cusp"
            yield from _worst(text, "cusp", "m/s^2", middle[cusp], rate, limits.a_max, slack)


def _flyer(what: str, limits: Limits, times: FloatArray, poses: FloatArray) -> Iterator[Violation]:
    """A free flyer: positions and unit quaternions (x, y, z, w)."""
    dt = np.diff(times)
    norms = np.linalg.norm(poses[:, 3:], axis=1)
    if np.abs(norms - 1).max() > 1e-3:
        yield Violation("quaternion", f"{what}: a quaternion is not of length 1")
        return
    units = poses[:, 3:] / norms[:, None]
    cosine = np.abs(np.sum(units[1:] * units[:-1], axis=1)).clip(0, 1)
    # the angle between neighbours, by the chord: accurate also where it is tiny
    chords = [np.linalg.norm(units[1:] + sign * units[:-1], axis=1) for sign in (-1, 1)]
    nearest = np.minimum(*chords)
    turn = np.where(cosine > 0.9, 4 * np.arcsin((nearest / 2).clip(0, 1)), 2 * np.arccos(cosine))
    moves = np.diff(poses[:, :3], axis=0)
    resting = (np.linalg.norm(moves, axis=1) < 1e-9) & (turn < 1e-9)
    yield from _sampling(what, times, dt, resting)
    yield from _free(what, limits, times, dt, moves / dt[:, None], turn)
