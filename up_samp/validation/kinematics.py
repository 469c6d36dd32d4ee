"""Limits of motions (speed, acceleration, curvature, equations of motion): read from the problem,
and judged by finite differences, with stated tolerances.

Speeds are means over a piece between two samples, so that a body within its limits always
passes: a mean speed is at most the largest speed, and means over neighbouring pieces differ by at
most the largest acceleration times the time between the pieces' middles. Beyond that, allowed are
``TOLERANCES.limits`` of each limit, positions that are off by ``TOLERANCES.noise``, and what a car
of that turning radius can do between two samples unseen (an arc and a straight inside one piece).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import shapely

from up_samp.model import ProblemError, TrafficZone, UnsupportedError
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.model.violation import Violation
from up_samp.validation.collisions import Pieces, pieces_of, rotations
from up_samp.validation.tolerances import TOLERANCES

_KNOWN = ("turning_radius", "v_max", "a_max", "omega_max")
_HEIGHT = "height"
_REVERSE = "reverse"
_V_BACK = "reverse_v_max"
_WISHES = ("reverse_cost",)
_TURNS = ("lateral_a_max", "alpha_max")
_ZONES = "zones"
_ALONG = "drives_along"


Law = Callable[[Any, Any, Any], None]
"""``law(q, u, qdot)`` fills how fast a state q = (x, y, theta) changes under controls u."""


@dataclass(frozen=True)
class Limits:
    """Limits of one object's motion: m, m/s, m/s^2, rad/s; each is 1.0 where the problem is silent.

    ``model``: REEDSSHEPP with ``turning_radius`` 0 is called PIVOT: it turns on the spot.

    ``v_back`` is the largest speed backwards: 0 where ``reverse`` is False. ``lateral`` (m/s^2) and
    ``alpha`` (rad/s^2): the largest lateral acceleration and change of the turn rate. ``law`` with
    ``controls`` (low, high for each) is set for control models that are no bicycle. ``zones``: the
    rules of places that it is given. ``along``: it drives while another object takes it along, too.
    """

    name: str
    model: str
    turning_radius: float
    v_max: float
    v_back: float
    a_max: float
    omega_max: float
    law: Law | None = None
    controls: tuple[tuple[float, float], ...] = ()
    zones: tuple[TrafficZone, ...] = ()
    lateral: float = math.inf
    alpha: float = math.inf
    along: bool = False


def limits_of(item: Any) -> Limits:
    """Read the limits of a UP ``MovableObject``; unknown parameters are errors, and so is
    ``reverse`` where it is no truth value, or False for what does not drive along its heading.
    """
    limits = _limits(item)
    own = item.motion_parameters or {}
    reverse = own.get(_REVERSE, True)
    along = limits.model in ("REEDSSHEPP", "PIVOT")
    allowed = (True, False) if along else (True,)
    if reverse not in allowed:
        words = " or ".join(map(str, allowed))
        raise ProblemError(f"object {item.name}: its reverse must be {words}, not {reverse}")
    driving = own.get(_ALONG, False)
    if driving not in ((True, False) if limits.model == "SE2" else (False,)):
        raise ProblemError(f"object {item.name}: its drives_along cannot be {driving}")
    most = [own.get(key, math.inf) for key in (_V_BACK, *_TURNS)]
    for key, value in zip((_V_BACK, *_TURNS), most, strict=True):
        if not (isinstance(value, (int, float)) and value > 0 and (along or value == math.inf)):
            raise ProblemError(f"object {item.name}: its {key} cannot be {value}")
    back, lateral, alpha = most
    back, zones = min(limits.v_back, back) * reverse, _zones(item.name, limits, own)
    rules = {"zones": zones, "lateral": lateral, "alpha": alpha, "along": driving}
    return replace(limits, v_back=back, **rules)


def _zones(name: str, limits: Limits, own: Mapping[str, Any]) -> tuple[TrafficZone, ...]:
    """Read the rules of places that an object is given."""
    zones = tuple(own.get(_ZONES, ()))
    for zone in zones:
        if not isinstance(zone, TrafficZone):
            raise ProblemError(f"object {name}: {zone!r} is no TrafficZone")
        area = shapely.Polygon(zone.polygon)
        if not (area.is_valid and area.area > 0 and zone.v_max > 0):
            raise ProblemError(f"object {name}: a zone needs a simple polygon and a positive v_max")
        if not math.isfinite(zone.one_way or 0.0):
            raise ProblemError(f"object {name}: a zone's one_way is a heading, not {zone.one_way}")
        if zone.dock is not None and len(zone.dock) != 3:
            raise ProblemError(f"object {name}: a zone's dock is (x, y, heading), not {zone.dock}")
    if zones and (limits.law is not None or limits.model == "SE3"):
        raise UnsupportedError(f"object {name}: no zones for what moves in space or by its own law")
    return zones


def _limits(item: Any) -> Limits:
    """Read all limits but those of driving backwards and of places.

    A control model with ``v_max`` and ``phi_max`` (and optionally ``v_min``, ``phi_min``) that
    moves along its heading with speed u[0] is a bicycle: its speed is at most ``v_max``
    (backwards at most ``-v_min`` where ``v_min`` is negative; a positive ``v_min`` is no limit,
    as motions start and end at rest), and its curvature is at most what the model itself gives
    for the steering limits.
    """
    own = (_HEIGHT, _REVERSE, _V_BACK, *_WISHES, *_TURNS, _ZONES, _ALONG)
    given = {k: v for k, v in (item.motion_parameters or {}).items() if k not in own}
    if item.control_model is None:
        # parameters without a control model are motion parameters too (UP's examples do so)
        given = {**(item.control_parameters or {}), **given}
    for key, value in given.items():
        if key not in _KNOWN:
            raise ProblemError(f"object {item.name}: unknown motion parameter '{key}'")
        least = _least(item, key)
        if not (isinstance(value, (int, float)) and math.isfinite(value) and value >= least):
            raise ProblemError(f"object {item.name}: {key} must be a positive number, not {value}")
    radius, v_max, a_max, omega_max = (float(given.get(k, 1.0)) for k in _KNOWN)
    model = item.motion_model.name if radius > 0 else "PIVOT"
    limits = Limits(item.name, model, radius, v_max, v_max, a_max, omega_max)
    if item.control_model is None:
        return limits
    control = {k: float(v) for k, v in (item.control_parameters or {}).items()}
    controls = _controls(item.name, control)
    curvature = _bicycle_curvature(item.name, item.control_model, control)
    if curvature is None:
        return replace(limits, model="CONTROL", law=item.control_model, controls=controls)
    forward = min(v_max, control["v_max"]) if "v_max" in given else control["v_max"]
    back = min(forward, -control["v_min"]) if control.get("v_min", 0.0) < 0 else forward
    tightest = max(radius if "turning_radius" in given else 0.0, 1 / curvature)
    # a bicycle drives along its heading, whatever else the motion model would allow
    model = "REEDSSHEPP" if model == "SE2" else model
    return replace(limits, model=model, turning_radius=tightest, v_max=forward, v_back=back)


def height_of(item: Any) -> float:
    """Read how high (m) a body that moves in the plane is: to the sky where it is not said."""
    height = (item.motion_parameters or {}).get(_HEIGHT, math.inf)
    if not (isinstance(height, (int, float)) and height > 0):
        raise ProblemError(f"object {item.name}: its height must be positive, not {height}")
    return float(height)


def _least(item: Any, key: str) -> float:
    """Return the least value of a parameter: only a turning radius along the heading may be 0, of
    what has no control model.
    """
    pivots = (key, item.motion_model.name) == ("turning_radius", "REEDSSHEPP")
    pivots = pivots and item.control_model is None
    return 0.0 if pivots else math.nextafter(0.0, 1.0)


def _controls(name: str, given: dict[str, float]) -> tuple[tuple[float, float], ...]:
    """Return (low, high) of each control, in the order of the ``..._max`` parameters."""
    stems = [key[:-4] for key in given if key.endswith("_max")]
    unknown = set(given) - {f"{s}_max" for s in stems} - {f"{s}_min" for s in stems}
    if unknown:
        raise ProblemError(f"object {name}: unknown control parameter '{min(unknown)}'")
    return tuple((given.get(f"{s}_min", -given[f"{s}_max"]), given[f"{s}_max"]) for s in stems)


def _bicycle_curvature(name: str, law: Law, given: dict[str, float]) -> float | None:
    """Return the tightest curvature (1/m) that a bicycle can drive both ways, ``None`` if ``law``
    is no bicycle. Tried at one pose and speed: it must move along its heading with speed u[0].
    """
    if not {"v_max", "phi_max"} <= set(given) <= {"v_min", "v_max", "phi_min", "phi_max"}:
        return None
    theta, speed, curvatures = 0.4, 0.5, []
    for phi in (given["phi_max"], given.get("phi_min", -given["phi_max"])):
        try:
            rate = _rate(name, law, np.array([1.0, 2.0, theta]), np.array([speed, phi]))
        except UnsupportedError:
            return None
        slip = math.hypot(rate[0] - speed * math.cos(theta), rate[1] - speed * math.sin(theta))
        if not (slip <= 1e-9 and math.isfinite(rate[2])):
            return None
        curvatures.append(abs(rate[2] / speed))
    return min(curvatures) if min(curvatures) > 0 else None


def _rate(name: str, law: Law, state: FloatArray, control: FloatArray) -> FloatArray:
    """Return what a control model says of a state (x, y, theta) under a control."""
    rate = np.zeros(3)
    try:
        law(state, control, rate)
    except (IndexError, TypeError) as error:
        raise UnsupportedError(
            f"object {name}: its control model does not take (x, y, theta) and "
            f"{len(control)} controls: {error}"
        ) from error
    except Exception as error:  # a user's code may raise anything
        raise ProblemError(
            f"object {name}: its control model raised {type(error).__name__}: {error}"
        ) from error
    return rate


# ------------------ What a motion breaks


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
    if excess.max(initial=0.0) > 0:
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
    turned = rotations(poses[:, 3:])
    turn = (turned[:-1].inv() * turned[1:]).magnitude()
    moves = np.diff(poses[:, :3], axis=0)
    resting = (np.linalg.norm(moves, axis=1) < 1e-9) & (turn < 1e-9)
    yield from _sampling(what, times, dt, resting)
    yield from _free(what, limits, times, dt, moves / dt[:, None], turn)


# ------------------ Control models: is there an admissible control for each piece?


def breaks_law(
    what: str, limits: Limits, times: FloatArray, poses: FloatArray, pieces: Pieces
) -> Iterator[Violation]:
    """Yield a violation for the piece that admissible controls explain worst.

    In the middle of each piece the body's rate (constant twist) is compared with the nearest one
    that the model has for a control within its bounds, by Gauss-Newton steps projected on
    the bounds. Models whose state is not (x, y, theta) are unsupported.
    """
    middle = poses[:-1, 2] + pieces.turn / 2
    rates = np.column_stack(
        (
            (pieces.along * np.cos(middle) - pieces.across * np.sin(middle)) / pieces.dt,
            (pieces.along * np.sin(middle) + pieces.across * np.cos(middle)) / pieces.dt,
            pieces.turn / pieces.dt,
        )
    )
    worst, where = 0.0, 0
    control = np.mean(limits.controls, axis=1)
    for i, rate in enumerate(rates):
        half = (poses[i] + poses[i + 1]) / 2
        state = np.array([half[0], half[1], middle[i]])
        miss, control = _nearest(limits, state, rate, control)
        excess = miss - TOLERANCES.control_rate * float(np.abs(rate).max()) - 1e-3
        if excess > worst:
            worst, where = excess, i
    if worst > 0:
        text = f"{what}: no admissible control gives its motion at {times[where]:.3f} s"
        yield Violation("control", f"{text} (off by {worst:.3g})")


def _nearest(
    limits: Limits, state: FloatArray, rate: FloatArray, guess: FloatArray
) -> tuple[float, FloatArray]:
    """Return how near the model's rates come to ``rate``, and the control that does it."""
    assert limits.law is not None
    model = partial(_rate, limits.name, limits.law, state)
    low, high = np.array(limits.controls).T
    steps = 1e-6 * np.eye(len(guess))
    best, best_control = math.inf, guess
    for start in (guess, (low + high) / 2, low, high):
        control = start.copy()
        for _ in range(12):
            value = model(control)
            miss = float(np.linalg.norm(value - rate))
            if miss < best:
                best, best_control = miss, control.copy()
            if miss < 1e-9:
                break
            # derivatives (3, m) of the rates by the controls, by differences
            slope = np.column_stack([(model(control + own) - value) / 1e-6 for own in steps])
            step = np.linalg.lstsq(slope, rate - value, rcond=None)[0]
            control = np.clip(control + step, low, high)
        if best < 1e-6:
            break
    return best, best_control
