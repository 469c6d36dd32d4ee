"""What a movable object's motion parameters and control model allow (own reading)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import shapely

from up_samp.model import ProblemError, TrafficZone, UnsupportedError

_KNOWN = ("turning_radius", "v_max", "a_max", "omega_max")
_HEIGHT = "height"
_REVERSE = "reverse"
_V_BACK = "reverse_v_max"
_WISHES = ("reverse_cost",)
_TURNS = ("lateral_a_max", "alpha_max")
_ZONES = "zones"
_ALONG = "drives_along"


@dataclass(frozen=True)
class Limits:
    """Limits of one object's motion: m, m/s, m/s^2, rad/s; each is 1.0 where the problem is silent.

    ``model``: REEDSSHEPP with ``turning_radius`` 0 is called PIVOT: it turns on the spot.

    ``v_back`` is the largest speed backwards: 0 where ``reverse`` is False. ``lateral`` (m/s^2) and
    ``alpha`` (rad/s^2): the largest lateral acceleration and change of the turn rate. ``law`` with
    ``controls`` (low, high for each) is set for control models that are no bicycle: ``law(q, u,
    qdot)`` fills ``qdot``. ``zones``: the rules of places that it is given. ``along``: it drives
    while another object takes it along, too.
    """

    name: str
    model: str
    turning_radius: float
    v_max: float
    v_back: float
    a_max: float
    omega_max: float
    law: Callable[[Any, Any, Any], None] | None = None
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
        if zone.one_way is not None and not math.isfinite(zone.one_way):
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


def _bicycle_curvature(
    name: str, law: Callable[[Any, Any, Any], None], given: dict[str, float]
) -> float | None:
    """Return the tightest curvature (1/m) that a bicycle can drive both ways, ``None`` if ``law``
    is no bicycle. Tried at one pose and speed: it must move along its heading with speed u[0].
    """
    if set(given) - {"v_min", "v_max", "phi_min", "phi_max"} or not {"v_max", "phi_max"} <= set(
        given
    ):
        return None
    theta, speed, curvatures = 0.4, 0.5, []
    for phi in (given["phi_max"], given.get("phi_min", -given["phi_max"])):
        rate = [0.0, 0.0, 0.0]
        try:
            law([1.0, 2.0, theta], [speed, phi], rate)
        except (IndexError, TypeError):
            return None
        except Exception as error:  # a user's code may raise anything
            text = f"object {name}: its control model raised {type(error).__name__}: {error}"
            raise ProblemError(text) from error
        slip = math.hypot(rate[0] - speed * math.cos(theta), rate[1] - speed * math.sin(theta))
        if not (slip <= 1e-9 and math.isfinite(rate[2])):
            return None
        curvatures.append(abs(rate[2] / speed))
    return min(curvatures) if min(curvatures) > 0 else None
