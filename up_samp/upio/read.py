"""Read a ``SchedulingMotionProblem`` into a :class:`~up_samp.model.snapshot.Snapshot`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from unified_planning.model import FNode
from unified_planning.model.motion import (
    SE2,
    SE3,
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    MovableObject,
    SchedulingMotionProblem,
)

from up_samp.model import (
    Configuration,
    ProblemError,
    UnsupportedError,
)
from up_samp.model.errors import short
from up_samp.model.frames import PlacedMap
from up_samp.model.graphs import grouped
from up_samp.model.snapshot import ChangeTask, MotionTask, Snapshot, Term, TermKind
from up_samp.upio.expressions import told_by
from up_samp.upio.plan import trajectory_key
from up_samp.upio.read_maps import (
    FARTHEST,
    MOST_TURNED,
    check_docks,
    check_flat,
    check_zones,
    map_driven,
    read_maps,
    read_movable,
)
from up_samp.upio.rides import RideFloor, find_rides, laden_bodies


def read_problem(problem: SchedulingMotionProblem, seconds_per_unit: float = 1.0) -> Snapshot:
    """Return the plain values of a SAMP problem.

    Raises :class:`ProblemError` naming the object or activity where the problem is wrong, and
    :class:`UnsupportedError` where it is right but beyond this package.
    """
    if not seconds_per_unit > 0:
        raise ProblemError(f"seconds_per_unit must be positive, not {seconds_per_unit}")
    _check_names(problem)
    _check_durations(problem)
    objects = {o.name: read_movable(o) for o in problem.all_objects if isinstance(o, MovableObject)}
    configurations = _read_configurations(problem)
    maps, map_of = read_maps(problem, configurations)
    tasks, changes = _read_activities(problem, frozenset(objects), maps)
    initial = _read_initial(problem)
    heights = {name: maps[number].height for name, number in map_of.items()}
    floor = RideFloor(objects, configurations, initial, heights)
    users = [(t.activity, t.object, tuple(t.terms)) for t in tasks]
    users += [(c.activity, c.object, (c.term,)) for c in changes]
    _check_places(floor, users)
    check_flat(maps, objects)
    check_zones(maps, objects)
    check_docks(objects, configurations, maps, tasks)
    alike = _alike(configurations, map_of)
    names = _names_of(users, initial, alike)
    initial = {name: names[name].get(place, place) for name, place in initial.items()}
    tasks = [replace(t, terms=_renamed(t.terms, names[t.object])) for t in tasks]
    changes = [replace(c, term=_renamed((c.term,), names[c.object])[0]) for c in changes]
    floor = replace(floor, initial=initial)
    tasks, changes = find_rides(tasks, changes, floor)
    return Snapshot(
        name=problem.name or "problem",
        maps=maps,
        objects=objects,
        configurations=configurations,
        initial=initial,
        tasks=tuple(tasks),
        changes=tuple(changes),
        seconds_per_unit=seconds_per_unit,
        map_of=map_of,
        laden=laden_bodies(tasks, floor),
        alike=alike,
        renamed=frozenset(name for name, known in names.items() if known),
    )


def _alike(
    configurations: Mapping[str, Configuration], map_of: Mapping[str, int]
) -> dict[str, tuple[str, ...]]:
    """Return the names of each pose that has several, by each of them. Poses are the same where
    they differ by rounding, or by whole turns.
    """
    at: dict[tuple[object, ...], list[str]] = {}
    maps = grouped(configurations, lambda name: (len(configurations[name]), map_of.get(name)))
    for number, names in enumerate(maps.values()):
        numbers = np.array([_without_turns(configurations[name]) for name in names])
        # no grid: what rounding takes to two sides of its lines may be as near as anything
        order = np.argsort(numbers, axis=0, kind="stable")
        steps = np.diff(np.take_along_axis(numbers, order, 0), axis=0) > 1e-6
        ranks = np.zeros(numbers.shape, dtype=np.int64)
        np.put_along_axis(ranks, order[1:], np.cumsum(steps, axis=0), axis=0)
        for name, rank in zip(names, ranks, strict=True):
            at.setdefault((number, *rank.tolist()), []).append(name)
    return {name: tuple(some) for some in at.values() if len(some) > 1 for name in some}


def _without_turns(pose: Configuration) -> tuple[float, ...]:
    """Return numbers that are the same for poses that whole turns lie between."""
    if len(pose) != 3:  # a quaternion and its negative turn alike
        return *pose[:3], *map(float, np.outer(pose[3:], pose[3:]).flat)
    return *pose[:2], math.cos(pose[2]), math.sin(pose[2])


def _names_of(
    users: Users, initial: Mapping[str, str], alike: Mapping[str, tuple[str, ...]]
) -> dict[str, dict[str, str]]:
    """Return for each object the one name that stands for each name of a pose that it has several
    names for, where any is: the first that the problem has. Where a place of an object is decided
    later it may be of any name.
    """
    told: dict[str, set[str]] = {name: {place} for name, place in initial.items()}
    for _, name, terms in users:
        own = told.setdefault(name, set())
        own.update(term.name for term in terms if term.kind is TermKind.CONSTANT)
        if any(term.kind is not TermKind.CONSTANT for term in terms):
            own.update(alike)
    found: dict[str, dict[str, str]] = {}
    for name, places in told.items():
        first = {
            place: next(filter(places.__contains__, alike[place]))
            for place in places & alike.keys()
        }
        found[name] = {place: known for place, known in first.items() if known != place}
    return found


def _renamed(terms: Iterable[Term], names: Mapping[str, str]) -> tuple[Term, ...]:
    """Return configurations by the names that stand for theirs."""
    return tuple(
        replace(t, name=names[t.name]) if t.kind is TermKind.CONSTANT and t.name in names else t
        for t in terms
    )


def _check_durations(problem: SchedulingMotionProblem) -> None:
    """Raise where an activity can have no duration at all, whatever else holds."""
    for activity in problem.activities:
        low, high = activity.duration.lower, activity.duration.upper
        if not (high.is_constant() and low.is_constant()):
            continue
        least, most = low.constant_value(), high.constant_value()
        if most < 0 or most < least:
            raise ProblemError(
                f"activity '{activity.name}' lasts from {least} to {most}: no duration is that"
            )


def _check_names(problem: SchedulingMotionProblem) -> None:
    counts = Counter(a.name for a in problem.activities)
    twice = sorted(name for name, n in counts.items() if n > 1)
    if twice:
        raise ProblemError(f"activity name '{twice[0]}' is used {counts[twice[0]]} times")
    for activity in problem.motion_activities:
        for k in range(1, len(activity.motion_constraints)):
            name = trajectory_key(activity.name, k)
            if name in counts:
                raise ProblemError(
                    f"activity '{name}' has the name of a motion of '{activity.name}'"
                )


def _read_configurations(problem: SchedulingMotionProblem) -> dict[str, Configuration]:
    configurations: dict[str, Configuration] = {}
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
        configurations[obj.name] = _pose(obj.name, value)
    return configurations


def _pose(name: str, value: SE2 | SE3) -> Configuration:
    """Return a configuration as numbers, if they are numbers of a size that makes sense."""
    try:
        pose = tuple(float(v) for v in value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ProblemError(f"configuration '{name}' must be numbers: {short(str(error))}") from None
    if not all(math.isfinite(v) for v in pose):
        raise ProblemError(f"configuration '{name}' has a coordinate that is not finite")
    if any(abs(v) > FARTHEST for v in pose) or (len(pose) == 3 and abs(pose[2]) > MOST_TURNED):
        raise ProblemError(
            f"configuration '{name}' is at {short(pose)}: coordinates up to "
            f"{FARTHEST:g} m and headings up to {MOST_TURNED:g} rad make sense"
        )
    return pose


def _read_activities(
    problem: SchedulingMotionProblem, objects: frozenset[str], maps: Sequence[PlacedMap]
) -> tuple[list[MotionTask], list[ChangeTask]]:
    tasks: list[MotionTask] = []
    changes: list[ChangeTask] = []
    for activity in problem.activities:
        if not isinstance(activity, MotionActivity):
            continue
        goals: dict[str, Term] = {}
        for index, constraint in enumerate(activity.motion_constraints):
            task = _read_constraint(activity.name, index, constraint, objects)
            task = replace(task, map=map_driven(constraint.starting, maps))
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
    return [_without_load(t, changes, objects) for t in tasks], changes


def _without_load(
    task: MotionTask, changes: Sequence[ChangeTask], objects: frozenset[str]
) -> MotionTask:
    """Return a task that lists no obstacles with all of them listed, but for what its activity
    carries: moves by motion effects alone.
    """
    load = {c.object for c in changes if c.activity == task.activity}
    if task.avoid is not None or not load:
        return task
    return replace(task, dynamic=objects - load - {task.object})


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
    for item, value in given.items() if isinstance(given, dict) else ():
        told_by(activity, item, value)
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


Users = Sequence[tuple[str, str, tuple[Term, ...]]]
"""(activity, object, places) of every motion and every change."""


def _check_places(floor: RideFloor, users: Users) -> None:
    for activity, name, _ in users:
        if name not in floor.initial:
            raise ProblemError(
                f"object '{name}', moved by activity '{activity}', has no initial configuration; "
                "call problem.set_initial_configuration"
            )
    for name, place in floor.initial.items():
        if name not in floor.objects:
            raise ProblemError(
                f"initial configuration of '{name}', which is no movable object of the problem"
            )
        _check_place(floor, f"object '{name}' starts at '{place}'", name, place)
    for activity, name, terms in users:
        for term in (t for t in terms if t.kind is TermKind.CONSTANT):
            what = f"activity '{activity}' uses the configuration '{term.name}'"
            _check_place(floor, what, name, term.name)


def _check_place(floor: RideFloor, what: str, name: str, place: str) -> None:
    """Raise where an object cannot be at a place, and say of what uses it."""
    if place not in floor.configurations:
        raise ProblemError(
            f"{what}, which is no configuration of the problem (add it with problem.add_object)"
        )
    body = floor.objects[name].body
    size = body.mobility.size
    if len(floor.configurations[place]) != size:
        raise ProblemError(
            f"{what}, which is of the wrong type for '{name}' "
            f"({body.kinematics.model.value} needs {size} numbers)"
        )
