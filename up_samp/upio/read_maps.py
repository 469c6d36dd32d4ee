"""Read occupancy maps with their frames, what zones ask of them, and what moves: footprint or mesh,
limits, and the law of its motion.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from unified_planning.model.motion import (
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)

from up_samp.model import (
    Body,
    Configuration,
    ControlLaw,
    Kinematics,
    MotionModel,
    Movable,
    ProblemError,
    TrafficZone,
    UnsupportedError,
)
from up_samp.model.errors import short
from up_samp.model.frames import Frame, PlacedMap
from up_samp.model.snapshot import MotionTask, TermKind

# ------------------ What is refused by name: results would be wrong, or never come

FARTHEST = 1e7
"""Largest coordinate, of a configuration or a map's frame, m: further out, floating-point numbers
do not tell 1 cm from 0."""
MOST_TURNED = 1e4
"""Largest heading, rad."""
MOST_MOVERS = 200
"""Most choices of objects that one activity may move."""
LARGEST = 1e5
"""Largest coordinate of a footprint, m."""


# ------------------ Read occupancy maps and their frames of reference
# Poses are in the world frame. A map's reference frame is where the map's own frame, in which its
# YAML states the ``origin``, lies in the world: the map is moved by it, the poses are not.


def read_maps(
    problem: SchedulingMotionProblem, configurations: Mapping[str, Configuration]
) -> tuple[tuple[PlacedMap, ...], dict[str, int]]:
    """Return a problem's maps, in the order in which its configurations name them, and the number
    of each configuration's map. Maps of types without configurations count if there are no others.
    """
    found: dict[PlacedMap, int] = {}
    map_of = {}
    for name in configurations:
        placed = _placed(problem.object(name).type)
        map_of[name] = found.setdefault(placed, len(found))
    if not found:
        for user_type in problem.user_types:
            if user_type.is_configuration_type():
                found.setdefault(_placed(user_type), len(found))
    return tuple(found), map_of


def check_flat(maps: Sequence[PlacedMap], objects: Mapping[str, Movable]) -> None:
    """Raise :class:`UnsupportedError` where something in space meets several maps."""
    flyers = [n for n, o in objects.items() if o.body.flies]
    if len(maps) > 1 and flyers:
        raise UnsupportedError(
            f"object '{min(flyers)}' is in space (SE3) and the problem has several maps "
            f"({', '.join(m.label for m in maps)}): floors are for bodies that move in the plane"
        )


def map_driven(starting: Any, known: Sequence[PlacedMap]) -> int:
    """Return the number of the map that a motion drives on: its starting configuration's (UP
    allows no motion between configurations of two types).
    """
    placed = _placed(starting.type)
    return known.index(placed) if placed in known else 0


def _placed(user_type: Any) -> PlacedMap:
    given = user_type.occupancy_map
    if not isinstance(given, OccupancyMap):
        raise ProblemError(
            f"configuration type '{user_type.name}' needs an OccupancyMap, not {short(given)}"
        )
    frame, height = _frame(user_type.name, given.reference_frame)
    return PlacedMap(os.fspath(given.filename), frame, height)


def _frame(type_name: str, given: Any) -> tuple[Frame, float]:
    """Return a reference frame: ``SE2``, ``SE3``, or a bare tuple such as ``(0, 0)``."""
    what = f"configuration type '{type_name}': its map's reference frame"
    try:
        values = tuple(float(v) for v in given)
    except (TypeError, ValueError, OverflowError) as error:
        raise ProblemError(f"{what} must be numbers, not {short(given)}") from error
    if len(values) not in (2, 3, 7):
        raise ProblemError(f"{what} has {len(values)} numbers; SE2 has 3, SE3 has 7")
    if not all(math.isfinite(v) and abs(v) <= FARTHEST for v in values):
        raise ProblemError(f"{what} is {short(values)}: up to {FARTHEST:g} m makes sense")
    if len(values) < 7:
        return Frame(*values), 0.0
    x, y, z, qx, qy, qz, qw = values
    if not any(values):
        return Frame(), 0.0
    if abs(math.hypot(qx, qy, qz, qw) - 1.0) > 1e-3:
        raise ProblemError(f"{what} has the quaternion {short(values[3:])}, which is no rotation")
    if max(abs(qx), abs(qy)) > 1e-9:
        raise UnsupportedError(f"{what} is tilted: only turns about the upright axis are supported")
    return Frame(x, y, 2.0 * math.atan2(qz, qw)), z


# ------------------ Read what moves: footprint or mesh, limits, and the law of its motion


_PARAMETERS = ("turning_radius", "v_max", "a_max", "omega_max")
_HEIGHT = "height"
_REVERSE = "reverse"
_V_BACK = "reverse_v_max"
_BACK_COST = "reverse_cost"
_TURNS = ("lateral_a_max", "alpha_max")
_ZONES = "zones"
_ALONG = "drives_along"
_BICYCLE = {"v_min", "v_max", "phi_min", "phi_max"}


def read_movable(obj: MovableObject) -> Movable:
    """Return the body of a movable object (footprint in m, in its own frame; or a mesh file).

    :raises ProblemError: where the model, the footprint or a parameter is wrong.
    :raises UnsupportedError: where it is right but beyond this package.
    """
    if not isinstance(obj.motion_model, MotionModels):
        raise ProblemError(f"object '{obj.name}': unknown motion model {obj.motion_model!r}")
    model = MotionModel[obj.motion_model.name]
    footprint = obj.footprint
    if footprint is None and not model.mobility.flies:
        raise ProblemError(f"object '{obj.name}' needs a footprint to move in the plane")
    corners = _corners(obj.name, footprint or ())
    finite = all(map(math.isfinite, itertools.chain(*corners)))
    if footprint is not None and (len(corners) < 3 or not finite):
        raise ProblemError(f"object '{obj.name}': a footprint needs three or more finite corners")
    mesh = obj.geometric_model
    if mesh is not None and model.mobility.flies and not os.path.isfile(mesh):
        raise ProblemError(f"object '{obj.name}': geometric model '{mesh}' is not a file")
    body = Body(corners, _read_kinematics(obj, model), mesh, _read_height(obj, model))
    return Movable(obj.name, obj.type.name, body)


def _told(obj: MovableObject) -> dict[str, Any]:
    """Return the motion parameters of an object."""
    return obj.motion_parameters or {}


def _read_height(obj: MovableObject, model: MotionModel) -> float:
    """Return how high (m) a body that moves in the plane is: to the sky where it is not said."""
    height = _told(obj).get(_HEIGHT, math.inf)
    if _HEIGHT in _told(obj) and model.mobility.flies:
        raise ProblemError(f"object '{obj.name}': its mesh tells its height, not '{_HEIGHT}'")
    try:
        value = float(height)
    except (TypeError, ValueError, OverflowError):
        value = math.nan
    if not value > 0:
        raise ProblemError(
            f"object '{obj.name}': its height is a positive number of m, not {short(height)}"
        )
    return value


def _corners(name: str, footprint: Any, most: float = LARGEST) -> tuple[tuple[float, float], ...]:
    """Return a footprint, or another polygon, as plain numbers, of ``most`` m."""
    try:
        corners = tuple((float(x), float(y)) for x, y in footprint)
    except (TypeError, ValueError, OverflowError) as error:
        raise ProblemError(
            f"object '{name}': a footprint is a list of corners (x, y), not {short(footprint)}"
        ) from error
    if any(abs(v) > most for corner in corners for v in corner):
        raise ProblemError(f"object '{name}': corners up to {most:g} m off make sense")
    return corners


def _read_kinematics(obj: MovableObject, model: MotionModel) -> Kinematics:
    own = (_HEIGHT, _REVERSE, _V_BACK, _BACK_COST, *_TURNS, _ZONES, _ALONG)
    given = {k: v for k, v in _told(obj).items() if k not in own}
    if obj.control_model is None:
        # UP's own examples put the turning radius there
        given = {**(obj.control_parameters or {}), **given}
    unknown = sorted(set(given) - set(_PARAMETERS))
    if unknown:
        raise ProblemError(
            f"object '{obj.name}': unknown motion parameter '{unknown[0]}' "
            f"(known: {', '.join((*_PARAMETERS, *own))})"
        )
    try:
        numbers: dict[str, Any] = {k: float(v) for k, v in given.items()}
        if model.mobility.steers and numbers.get("turning_radius") == 0.0:
            if obj.control_model is not None:
                raise ProblemError(
                    f"object '{obj.name}': turning_radius 0 (turns on the spot) and a control "
                    "model contradict each other"
                )
            del numbers["turning_radius"]
            model = MotionModel.PIVOT
        limits = Kinematics(model, **numbers)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"object '{obj.name}': {error}") from error
    if obj.control_model is not None:
        limits = _read_control(obj, limits)
    return _with_rules(obj, limits)


def _with_rules(obj: MovableObject, limits: Kinematics) -> Kinematics:
    """Return the limits with what is said of driving backwards, and of places."""
    who, own = f"object '{obj.name}'", _told(obj)

    def positive(key: str, unit: str = "") -> Any:
        most = own.get(key, math.inf)
        if not isinstance(most, (int, float)) or isinstance(most, bool) or not most > 0:
            raise ProblemError(f"{who}: '{key}' is a positive number{unit}, not {short(most)}")
        return most

    def limited(told: str, **values: Any) -> Kinematics:
        try:
            return replace(limits, **values)
        except ValueError as error:
            raise UnsupportedError(f"{who}: {told}{error}") from error

    reverse, along = own.get(_REVERSE, True), own.get(_ALONG, False)
    for key, value in ((_REVERSE, reverse), (_ALONG, along)):
        if not isinstance(value, bool):
            raise ProblemError(f"{who}: '{key}' is True or False, not {short(value)}")
    limits = limited(f"'{_ALONG}' is True: ", drives_along=along)
    told = f"it has '{_V_BACK}'" if reverse else f"'{_REVERSE}' is False"
    back = min(limits.v_back, float(positive(_V_BACK, " of m/s")))
    limits = limited(f"{told}: ", reverse=reverse, v_back=back)
    if _BACK_COST in own:
        cost = float(positive(_BACK_COST))
        if not 1.0 <= cost < math.inf:
            raise ProblemError(f"{who}: '{_BACK_COST}' is 1 or more, not {cost}")
        limits = limited(f"it has '{_BACK_COST}': ", back_cost=cost)
    limits = limited("", **{key: positive(key) for key in _TURNS if key in own})
    return limited(f"it has '{_ZONES}': ", zones=_read_zones(obj.name, own.get(_ZONES, ())))


def _read_zones(name: str, given: Any) -> tuple[TrafficZone, ...]:
    """Return the rules of places that an object is given, in an order that means nothing."""
    import shapely  # half a second, for those who have zones

    zones = given if isinstance(given, Sequence) else (given,)
    for zone in zones:
        if not isinstance(zone, TrafficZone):
            raise ProblemError(f"object '{name}': '{_ZONES}' holds TrafficZone, not {short(zone)}")
        corners = _corners(name, zone.polygon, FARTHEST)
        heading = zone.one_way or 0.0
        simple = len(corners) > 2 and shapely.Polygon(corners).is_valid
        limits = f"v_max is positive and prefer 1 at least, not {zone.v_max} and {zone.prefer}"
        for told, right in (
            (f"the zone {short(corners)} is no simple polygon", simple),
            (f"a zone's one_way is a heading, not {heading}", math.isfinite(heading)),
            (f"a zone's {limits}", zone.v_max > 0 and 1.0 <= zone.prefer < math.inf),
        ):
            if not right:
                raise ProblemError(f"object '{name}': {told}")
        if zone.dock is not None:
            _check_dock(name, zone)
    return tuple(sorted(set(zones), key=repr))


def _check_dock(name: str, zone: TrafficZone) -> None:
    """Raise where a zone's dock is no pose, where no straight way through the zone leads to it, or
    where the zone says more than how its dock is come to.
    """
    import shapely  # see above

    try:
        x, y, heading = (float(v) for v in zone.dock or ())
    except (TypeError, ValueError):
        x = y = heading = math.nan
    if not all(map(math.isfinite, (x, y, heading))):
        raise ProblemError(f"object '{name}': a zone's dock is (x, y, heading), not {zone.dock}")
    far, area = zone.long - 2e-3, shapely.Polygon(zone.polygon)
    ends = (Frame(x, y, heading).of((side * far, 0.0, 0.0))[:2] for side in (-1.0, 1.0))
    # by a millimetre: who drives along an edge is inside or outside by rounding
    if not any(area.covers(shapely.LineString([(x, y), end]).buffer(1e-3)) for end in ends):
        raise ProblemError(
            f"object '{name}': the zone of the dock {zone.dock} has to hold the dock, and the "
            "straight way to it along its heading from where the zone is farthest, 1 mm inside"
        )
    only = replace(zone, one_way=None, pivots=True, stops=True, cost=0.0, prefer=1.0)
    if zone != only:
        raise UnsupportedError(
            f"object '{name}': the zone of the dock {zone.dock} may say 'v_max' and nothing else; "
            "give other rules to a zone without a dock"
        )


def _read_control(obj: MovableObject, limits: Kinematics) -> Kinematics:
    """Return limits under a control model: a car where it is a bicycle, else a free ODE."""
    given = dict(obj.control_parameters or {})
    bounds = _control_bounds(obj.name, given)
    if set(given) <= _BICYCLE and {"v_max", "phi_max"} <= set(given):
        curvature = _bicycle_curvature(obj.name, obj.control_model, given)
        if curvature is not None:
            if curvature <= 0:
                raise ProblemError(f"object '{obj.name}': its control model cannot turn")
            return _bicycle(obj, limits, curvature, given)
    law = ControlLaw(obj.control_model, bounds, obj.name)
    return replace(limits, model=MotionModel.CONTROL, control=law)


def _bicycle(
    obj: MovableObject, limits: Kinematics, curvature: float, given: Mapping[str, Any]
) -> Kinematics:
    """Return a car's limits. The model can reverse, at ``-v_min`` at most where that is negative; a
    positive ``v_min`` is a speed, not a direction.
    """
    own = _told(obj)
    speed = float(given["v_max"])
    speed = min(limits.v_max, speed) if "v_max" in own else speed
    back = -float(given.get("v_min", -speed))
    radius = 1.0 / curvature
    # a bicycle drives along its heading: a body that could move anywhere is a car with it
    return replace(
        limits,
        model=MotionModel.REEDSSHEPP if limits.mobility.sideways else limits.model,
        turning_radius=max(limits.turning_radius, radius) if "turning_radius" in own else radius,
        v_max=speed,
        v_back=back if 0 < back < speed else math.inf,
    )


def _control_bounds(name: str, given: Mapping[str, Any]) -> tuple[tuple[str, float, float], ...]:
    stems = [k[: -len("_max")] for k in given if k.endswith("_max")]
    bounds = []
    for stem in stems:
        low = float(given.get(f"{stem}_min", -float(given[f"{stem}_max"])))
        high = float(given[f"{stem}_max"])
        if not low <= high:
            raise ProblemError(f"object '{name}': {stem}_min is above {stem}_max")
        bounds.append((stem, low, high))
    known = {f"{s}_max" for s in stems} | {f"{s}_min" for s in stems}
    unknown = sorted(set(given) - known)
    if unknown:
        raise ProblemError(f"object '{name}': unknown control parameter '{unknown[0]}'")
    return tuple(bounds)


def _bicycle_curvature(name: str, function: Any, given: Mapping[str, Any]) -> float | None:
    """Return the largest curvature both ways (1/m) if ``function`` is a kinematic bicycle."""
    largest = []
    steer = (float(given.get("phi_min", -given["phi_max"])), float(given["phi_max"]))
    for phi, theta, speed in itertools.product(steer, (0.0, 0.7, -2.1), (1.0, 0.4)):
        rate = [0.0, 0.0, 0.0]
        try:
            function([0.3, -0.2, theta], [speed, phi], rate)
        except (TypeError, IndexError):
            return None
        except Exception as error:  # a user's code may raise anything
            raise ProblemError(
                f"object '{name}': its control_model raised {type(error).__name__}: {error}"
            ) from error
        straight = (speed * math.cos(theta), speed * math.sin(theta))
        miss = math.hypot(rate[0] - straight[0], rate[1] - straight[1])
        if not (miss <= 1e-9 and math.isfinite(rate[2])):
            return None
        largest.append(abs(rate[2]) / speed)
    by_phi = largest[:6], largest[6:]
    if any(max(part) - min(part) > 1e-9 for part in by_phi):
        return None
    return min(by_phi[0][0], by_phi[1][0])


# ------------------ What zones ask: maps where they lie, and straight ways to docks


def check_docks(
    objects: Mapping[str, Movable],
    configurations: Mapping[str, Configuration],
    maps: Sequence[PlacedMap],
    tasks: Sequence[MotionTask],
) -> None:
    """Check motions on maps with docks.

    :raises ProblemError: where one does not say from where it comes straight to a dock.
    :raises UnsupportedError: where it goes on from there, or any of its poses is decided later.
    """
    for task in tasks:
        zones = [
            zone
            for zone in objects[task.object].body.kinematics.zones
            if zone.dock and zone.height == maps[task.map].height
        ]
        if not zones:
            continue
        what = f"activity '{task.activity}': '{task.object}', which has docks,"
        if any(term.kind is not TermKind.CONSTANT for term in task.terms):
            raise UnsupportedError(f"{what} needs named configurations as start and waypoints")
        poses = [configurations[term.name] for term in task.terms]
        for zone in zones:
            if any(zone.binds(pose) for pose in poses[1:-1]):
                raise UnsupportedError(f"{what} goes on from a dock: let the motion end there")
            begins = len(poses) == 2 or abs(zone.off_dock(poses[-2])[0]) > zone.long - 1e-4
            if zone.binds(poses[-1]) and not (begins and zone.leads_in(poses[-2])):
                raise ProblemError(
                    f"{what} has to come straight to {task.terms[-1].name}: give it, as the last "
                    "waypoint before, a pose on the line along that heading where the zone begins"
                )


def check_zones(maps: Sequence[PlacedMap], objects: Mapping[str, Movable]) -> None:
    """Raise where a zone is at a height at which there is no map: it would mean nothing."""
    heights = {placed.height for placed in maps}
    for name, movable in objects.items():
        for zone in movable.body.kinematics.zones:
            if zone.height not in heights:
                raise ProblemError(
                    f"object '{name}': a zone is {zone.height:g} m up, and no map is"
                )
