"""Read a ``SchedulingMotionProblem`` into a :class:`~up_samp.model.snapshot.Snapshot`."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.motion import (
    SE2,
    SE3,
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    MotionModels,
    MovableObject,
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
    UnsupportedError,
)
from up_samp.model.snapshot import ChangeTask, MotionTask, Snapshot, Term, TermKind

_MODELS = {
    MotionModels.REEDSSHEPP: MotionModel.REEDSSHEPP,
    MotionModels.SE2: MotionModel.SE2,
    MotionModels.SE3: MotionModel.SE3,
}
_PARAMETERS = ("turning_radius", "v_max", "a_max", "omega_max")
_BICYCLE = {"v_min", "v_max", "phi_min", "phi_max"}


def read_problem(problem: SchedulingMotionProblem, seconds_per_unit: float = 1.0) -> Snapshot:
    """Return the plain values of a SAMP problem.

    Raises :class:`ProblemError` naming the object or activity where the problem is wrong, and
    :class:`UnsupportedError` where it is right but beyond this package.
    """
    if not seconds_per_unit > 0:
        raise ProblemError(f"seconds_per_unit must be positive, not {seconds_per_unit}")
    _check_names(problem)
    objects = {
        o.name: _read_movable(o) for o in problem.all_objects if isinstance(o, MovableObject)
    }
    configurations, maps = _read_configurations(problem)
    tasks, changes = _read_activities(problem, frozenset(objects))
    initial = _read_initial(problem)
    _check_initial(objects, configurations, initial, tasks, changes)
    _check_dimensions(objects, configurations, initial, tasks, changes)
    if len(maps) > 1:
        raise UnsupportedError(
            f"problem '{problem.name}' uses several occupancy maps ({', '.join(sorted(maps))}); "
            "give all configuration types the same map"
        )
    return Snapshot(
        name=problem.name or "problem",
        map_file=next(iter(maps), None),
        objects=objects,
        configurations=configurations,
        initial=initial,
        tasks=tuple(tasks),
        changes=tuple(changes),
        seconds_per_unit=seconds_per_unit,
    )


def _check_names(problem: SchedulingMotionProblem) -> None:
    counts = Counter(a.name for a in problem.activities)
    twice = sorted(name for name, n in counts.items() if n > 1)
    if twice:
        raise ProblemError(f"activity name '{twice[0]}' is used {counts[twice[0]]} times")


def _read_movable(obj: MovableObject) -> Movable:
    if obj.motion_model not in _MODELS:
        raise ProblemError(f"object '{obj.name}': unknown motion model {obj.motion_model!r}")
    model = _MODELS[obj.motion_model]
    footprint = obj.footprint
    if footprint is None and model is not MotionModel.SE3:
        raise ProblemError(f"object '{obj.name}' needs a footprint to move in the plane")
    corners = tuple((float(x), float(y)) for x, y in footprint or ())
    if footprint is not None and (
        len(corners) < 3 or not all(math.isfinite(v) for c in corners for v in c)
    ):
        raise ProblemError(f"object '{obj.name}': a footprint needs three or more finite corners")
    mesh = obj.geometric_model
    if mesh is not None and model is MotionModel.SE3 and not os.path.isfile(mesh):
        raise ProblemError(f"object '{obj.name}': geometric model '{mesh}' is not a file")
    return Movable(obj.name, obj.type.name, Body(corners, _read_kinematics(obj, model), mesh))


def _read_kinematics(obj: MovableObject, model: MotionModel) -> Kinematics:
    given = dict(obj.motion_parameters or {})
    if obj.control_model is None:
        # UP's own examples put the turning radius there
        given = {**(obj.control_parameters or {}), **given}
    unknown = sorted(set(given) - set(_PARAMETERS))
    if unknown:
        raise ProblemError(
            f"object '{obj.name}': unknown motion parameter '{unknown[0]}' "
            f"(known: {', '.join(_PARAMETERS)})"
        )
    try:
        numbers: dict[str, Any] = {k: float(v) for k, v in given.items()}
        limits = Kinematics(model, **numbers)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"object '{obj.name}': {error}") from error
    if obj.control_model is None:
        return limits
    return _read_control(obj, limits)


def _read_control(obj: MovableObject, limits: Kinematics) -> Kinematics:
    """Return limits under a control model: a car where it is a bicycle, else a free ODE."""
    given = dict(obj.control_parameters or {})
    bounds = _control_bounds(obj.name, given)
    if set(given) <= _BICYCLE and {"v_max", "phi_max"} <= set(given):
        curvature = _bicycle_curvature(obj.control_model, given)
        if curvature is not None:
            if curvature <= 0:
                raise ProblemError(f"object '{obj.name}': its control model cannot turn")
            return _bicycle(obj, limits, curvature, given)
    law = ControlLaw(obj.control_model, bounds)
    return Kinematics(
        MotionModel.CONTROL,
        limits.turning_radius,
        limits.v_max,
        limits.a_max,
        limits.omega_max,
        law,
    )


def _bicycle(
    obj: MovableObject, limits: Kinematics, curvature: float, given: Mapping[str, Any]
) -> Kinematics:
    """Return a car's limits. The model can reverse, at ``-v_min`` at most where that is negative
    (one top speed is used for both ways); a positive ``v_min`` is a speed, not a direction.
    """
    own = obj.motion_parameters or {}
    speed = float(given["v_max"])
    if float(given.get("v_min", -speed)) < 0:
        speed = min(speed, -float(given.get("v_min", -speed)))
    radius = 1.0 / curvature
    return Kinematics(
        limits.model,
        turning_radius=max(limits.turning_radius, radius) if "turning_radius" in own else radius,
        v_max=min(limits.v_max, speed) if "v_max" in own else speed,
        a_max=limits.a_max,
        omega_max=limits.omega_max,
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


def _bicycle_curvature(function: Any, given: Mapping[str, Any]) -> float | None:
    """Return the largest curvature both ways (1/m) if ``function`` is a kinematic bicycle."""
    largest = []
    steer = (float(given.get("phi_min", -given["phi_max"])), float(given["phi_max"]))
    for phi in steer:
        for theta in (0.0, 0.7, -2.1):
            for speed in (1.0, 0.4):
                rate = [0.0, 0.0, 0.0]
                try:
                    function([0.3, -0.2, theta], [speed, phi], rate)
                except (TypeError, IndexError):
                    return None
                straight = (speed * math.cos(theta), speed * math.sin(theta))
                if math.hypot(rate[0] - straight[0], rate[1] - straight[1]) > 1e-9:
                    return None
                largest.append(abs(rate[2]) / speed)
    by_phi = largest[:6], largest[6:]
    if any(max(part) - min(part) > 1e-9 for part in by_phi):
        return None
    return min(by_phi[0][0], by_phi[1][0])


def _read_configurations(
    problem: SchedulingMotionProblem,
) -> tuple[dict[str, Configuration], set[str]]:
    configurations: dict[str, Configuration] = {}
    maps: set[str] = set()
    for obj in problem.all_objects:
        if not obj.type.is_configuration_type():
            continue
        if not isinstance(obj, ConfigurationObject):
            raise ProblemError(
                f"object '{obj.name}' has configuration type '{obj.type.name}' but no pose; "
                "make it a ConfigurationObject"
            )
        value = obj.configuration
        if not isinstance(value, SE2 | SE3):
            raise ProblemError(
                f"configuration '{obj.name}' must be SE2 or SE3, not {type(value).__name__}"
            )
        pose = tuple(float(v) for v in value)
        if not all(math.isfinite(v) for v in pose):
            raise ProblemError(f"configuration '{obj.name}' has a coordinate that is not finite")
        configurations[obj.name] = pose
    for user_type in problem.user_types:
        if user_type.is_configuration_type():
            _check_frame(user_type)
            maps.add(os.fspath(user_type.occupancy_map.filename))
    return configurations, maps


def _check_frame(user_type: Any) -> None:
    """Raise unless the map's reference frame is the world frame.

    Frames may be given as bare tuples such as ``(0, 0)``.
    """
    frame = tuple(float(v) for v in user_type.occupancy_map.reference_frame)
    identity = (frame[:-1] == (0.0,) * 6 and frame[-1] == 1.0) if len(frame) == 7 else False
    if any(frame) and not identity:
        raise UnsupportedError(
            f"configuration type '{user_type.name}': its map has the reference frame {frame}; "
            "only the world frame (all zeros) is supported: state the offset as the map's origin"
        )


def _read_activities(
    problem: SchedulingMotionProblem, objects: frozenset[str]
) -> tuple[list[MotionTask], list[ChangeTask]]:
    tasks: list[MotionTask] = []
    changes: list[ChangeTask] = []
    for activity in problem.activities:
        if not isinstance(activity, MotionActivity):
            continue
        goals: dict[str, Term] = {}
        for index, constraint in enumerate(activity.motion_constraints):
            task = _read_constraint(activity.name, index, constraint, objects)
            if task.object in goals:
                raise UnsupportedError(
                    f"activity '{activity.name}' has two motion constraints on "
                    f"'{task.object}'; give one constraint several waypoints instead"
                )
            goals[task.object] = task.terms[-1]
            tasks.append(task)
        for movable, value in activity.motion_effects.items():
            name = _object_name(activity.name, movable, objects)
            term = _read_term(activity.name, value)
            if name not in goals:
                changes.append(ChangeTask(activity.name, name, term))
            elif goals[name] != term:
                raise ProblemError(
                    f"activity '{activity.name}' drives '{name}' to {goals[name].name} but its "
                    f"motion effect puts it at {term.name}"
                )
    return tasks, changes


def _read_constraint(
    activity: str, index: int, constraint: Any, objects: frozenset[str]
) -> MotionTask:
    if not isinstance(constraint, ActivityWaypoints):
        raise UnsupportedError(
            f"activity '{activity}': motion constraint {type(constraint).__name__} is not "
            "supported; use ActivityWaypoints"
        )
    if not constraint.waypoints:
        raise ProblemError(f"activity '{activity}': its motion constraint has no waypoint")
    terms = tuple(_read_term(activity, e) for e in (constraint.starting, *constraint.waypoints))
    moved = _object_name(activity, constraint.movable, objects)
    return MotionTask(
        activity,
        index,
        moved,
        terms,
        _obstacle_names(activity, constraint.static_obstacles, objects, moved),
        _obstacle_names(activity, constraint.dynamic_obstacles_at_start, objects, moved),
    )


def _object_name(activity: str, expression: FNode, objects: frozenset[str]) -> str:
    if not expression.is_object_exp():
        raise UnsupportedError(
            f"activity '{activity}': the moved object is given by '{expression}'; "
            "name a movable object (one activity for each object)"
        )
    name: str = expression.object().name
    if name not in objects:
        raise ProblemError(
            f"activity '{activity}' moves '{name}', which is not among the problem's movable "
            "objects (add it with problem.add_object)"
        )
    return name


def _obstacle_names(
    activity: str, given: Iterable[Any] | None, objects: frozenset[str], moved: str
) -> frozenset[str] | None:
    if given is None:
        return None
    names = {o.name for o in given}
    unknown = sorted(names - objects)
    if unknown:
        raise ProblemError(
            f"activity '{activity}' lists the obstacle '{unknown[0]}', which is not among the "
            "problem's movable objects"
        )
    return frozenset(names - {moved})


def _read_term(activity: str, expression: FNode) -> Term:
    if expression.is_object_exp():
        obj = expression.object()
        if not isinstance(obj, ConfigurationObject):
            raise ProblemError(
                f"activity '{activity}': waypoint '{obj.name}' is not a ConfigurationObject"
            )
        return Term(TermKind.CONSTANT, obj.name)
    if expression.is_parameter_exp():
        return Term(TermKind.PARAMETER, expression.parameter().name)
    if expression.is_fluent_exp():
        return Term(TermKind.FLUENT, str(expression))
    raise UnsupportedError(
        f"activity '{activity}': waypoint '{expression}' must be a configuration object, "
        "a parameter or a fluent"
    )


def _read_initial(problem: SchedulingMotionProblem) -> dict[str, str]:
    initial: dict[str, str] = {}
    for movable, value in problem.initial_configuration:
        if not movable.is_object_exp() or not value.is_object_exp():
            raise ProblemError(f"initial configuration '{movable}: {value}' must name objects")
        name, place = movable.object().name, value.object().name
        if initial.get(name, place) != place:
            raise ProblemError(
                f"object '{name}' has two initial configurations: {initial[name]} and {place}"
            )
        initial[name] = place
    return initial


def _check_initial(
    objects: Mapping[str, Movable],
    configurations: Mapping[str, Configuration],
    initial: Mapping[str, str],
    tasks: Sequence[MotionTask],
    changes: Sequence[ChangeTask],
) -> None:
    users = [(t.activity, t.object) for t in tasks] + [(c.activity, c.object) for c in changes]
    for activity, name in users:
        if name not in initial:
            raise ProblemError(
                f"object '{name}', moved by activity '{activity}', has no initial configuration; "
                "call problem.set_initial_configuration"
            )
    for name, place in initial.items():
        if name not in objects:
            raise ProblemError(
                f"initial configuration of '{name}', which is no movable object of the problem"
            )
        if place not in configurations:
            raise ProblemError(
                f"object '{name}' starts at '{place}', which is no configuration of the problem "
                "(add it with problem.add_object)"
            )


def _check_dimensions(
    objects: Mapping[str, Movable],
    configurations: Mapping[str, Configuration],
    initial: Mapping[str, str],
    tasks: Sequence[MotionTask],
    changes: Sequence[ChangeTask],
) -> None:
    for name, place in initial.items():
        model = objects[name].body.kinematics.model
        if len(configurations[place]) != (7 if model is MotionModel.SE3 else 3):
            raise ProblemError(
                f"object '{name}' starts at '{place}', which is of the wrong type for it "
                f"({model.value})"
            )
    uses = [(t.activity, t.object, t.terms) for t in tasks]
    uses += [(c.activity, c.object, (c.term,)) for c in changes]
    for activity, name, terms in uses:
        body = objects[name].body
        size = 7 if body.kinematics.model is MotionModel.SE3 else 3
        for term in terms:
            if term.kind is not TermKind.CONSTANT:
                continue
            if term.name not in configurations:
                raise ProblemError(
                    f"activity '{activity}' uses the configuration '{term.name}', which is "
                    "not in the problem (add it with problem.add_object)"
                )
            if len(configurations[term.name]) != size:
                raise ProblemError(
                    f"activity '{activity}': configuration '{term.name}' is of the wrong "
                    f"type for '{name}' ({body.kinematics.model.value} needs {size} numbers)"
                )
