"""A plan dictionary made a UP plan again, to validate or to reuse it; and what it says about its
problem, against the problem itself.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from unified_planning.engines import PlanGenerationResultStatus
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.geometry import load_map
from up_samp.geometry.atlas import in_world
from up_samp.io.files import check_plan
from up_samp.io.floors import map_number, maps_of
from up_samp.io.plan_dict import PlanDict, described_changes, described_objects, described_rides
from up_samp.io.precision import PRECISION
from up_samp.io.sampling import rows_trajectory
from up_samp.model import CandidateSchedule, ProblemError, Trajectory
from up_samp.model.errors import short
from up_samp.model.frames import PlacedMap
from up_samp.model.schedule import Value
from up_samp.model.snapshot import Snapshot
from up_samp.upio.movers import named_as_planned
from up_samp.upio.plan import SampSchedule, build_plan, trajectory_key
from up_samp.upio.read import read_problem


def plan_from_dict(problem: SchedulingMotionProblem, plan: PlanDict) -> SampSchedule:
    """Return the UP plan that ``plan`` holds, with its trajectories.

    It is read, not judged: use the validator on it. Raises :class:`ProblemError` where names of
    activities, objects or parameters do not fit the problem.
    """
    check_plan(plan, "the plan")
    unit = plan["seconds_per_unit"]
    snapshot = read_problem(named_as_planned(problem, plan), unit)
    known = {a.name: a for a in problem.activities}
    times: dict[str, tuple[int, int]] = {}
    parameters: dict[str, Value] = dict(plan.get("parameters", {}))
    for entry in plan["activities"]:
        name = entry["name"]
        if name in times:
            raise ProblemError(f"the plan has activity '{name}' twice")
        if name not in known:
            raise ProblemError(f"the plan's activity '{name}' is not in problem '{snapshot.name}'")
        times[name] = (_whole(entry, "start"), _whole(entry, "end"))
        given = entry.get("parameters", {})
        for parameter in known[name].parameters:
            own = parameter.name.removeprefix(f"{name}.")
            if own not in given:
                raise ProblemError(f"the plan gives activity '{name}' no parameter '{own}'")
            parameters[parameter.name] = given[own]
            _check_value(problem, parameter.type, f"parameter '{own}' of '{name}'", given[own])
    missing = [v.name for v in problem.base_variables if v.name not in parameters]
    if missing:
        raise ProblemError(f"the plan gives the variable '{missing[0]}' no value")
    for v in problem.base_variables:
        _check_value(problem, v.type, f"variable '{v.name}'", parameters[v.name])
    trajectories: dict[str, Trajectory] = {}
    samples: dict[tuple[str, str], Any] = {}
    for motion in plan["motions"]:
        key = (motion["activity"], motion["object"])
        if key in samples:
            raise ProblemError(f"the plan has two motions of '{key[1]}' in activity '{key[0]}'")
        samples[key] = motion["samples"]
    for task in snapshot.tasks:
        if task.activity in times:
            rows = samples.get((task.activity, task.object))
            if rows is None:
                raise ProblemError(
                    f"the plan has no motion of '{task.object}' in activity '{task.activity}'"
                )
            trajectories[trajectory_key(task.activity, task.index)] = rows_trajectory(rows)
    candidate = CandidateSchedule(times, parameters)
    return build_plan(problem, snapshot, candidate, trajectories, plan.get("margin"))


def _check_value(problem: SchedulingMotionProblem, tpe: Any, what: str, value: Value) -> None:
    """Raise :class:`ProblemError` where ``value`` is none of the type ``tpe``."""
    if tpe.is_user_type():
        known = isinstance(value, str) and problem.has_object(value)
        good = known and tpe.is_compatible(problem.object(value).type)
    elif tpe.is_bool_type():
        good = isinstance(value, bool)
    else:
        good = isinstance(value, int | float) and not isinstance(value, bool)
    if not good:
        raise ProblemError(
            f"the plan gives {what} the value {short(value)}, which is no {tpe} of the problem"
        )


def _whole(entry: dict[str, Any], key: str) -> int:
    value = entry[key]
    if not isinstance(value, int | float) or value != int(value):
        raise ProblemError(f"activity '{entry['name']}' has the {key} {value!r}, no whole number")
    return int(value)


# ------------------ Where a plan file contradicts the problem


_CLOSE = 2.0 * 10.0**-PRECISION.decimals
"""Two numbers that differ by this much may be one, rounded twice."""


def contradictions(problem: SchedulingMotionProblem, plan: PlanDict) -> list[str]:
    """Return, in words, where a plan file contradicts the problem or itself.

    Everything that docs/plan-format.md calls part of the plan is looked at, but for what the
    validator judges (the times of activities and the motions). An unknown field is none: later
    minor versions may have more.
    """
    snapshot = read_problem(named_as_planned(problem, plan), plan["seconds_per_unit"])
    return [
        *_head(plan, snapshot),
        *_map(plan, snapshot),
        *_objects(plan, snapshot),
        *_activities(problem, plan),
        *_motions(plan, snapshot),
        *_changes(problem, plan, snapshot),
        *_rides(plan, snapshot),
    ]


def poses_beyond(problem: SchedulingMotionProblem, plan: PlanDict) -> list[str]:
    """Return, in words, which motions lead further from the map than it is large, or turn round
    and round: nobody can have planned them, and sweeping them has no end.
    """
    snapshot = read_problem(named_as_planned(problem, plan), plan["seconds_per_unit"])
    grids = [in_world(m) for m in snapshot.maps]
    limits = [(g.box[0] - math.hypot(*g.size), g.box[1] + math.hypot(*g.size)) for g in grids]
    everywhere = np.full(2, -np.inf), np.full(2, np.inf)
    found = []
    for motion in plan["motions"]:
        what = f"the motion of '{motion['object']}' in activity '{motion['activity']}'"
        number = map_number(motion)
        low, high = limits[number] if number < len(limits) else everywhere
        for row in motion["samples"]:
            here, turned = row[1:3], row[3] if len(row) == 4 else 0.0
            outside = any(not a <= v <= b for a, v, b in zip(low, here, high, strict=True))
            if outside or abs(turned) > PRECISION.turned:
                place = ", ".join(f"{v:g}" for v in row[1:])
                found.append(f"{what} leads to ({place}) at {row[0]:g} s, far from the map")
                break
    return found


def _head(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    statuses = ["", *(s.name for s in PlanGenerationResultStatus)]
    latest = max((a["end"] for a in plan["activities"]), default=0)
    bound = latest if plan["lower_bound"] is None else plan["lower_bound"]
    optimal = plan["status"] == PlanGenerationResultStatus.SOLVED_OPTIMALLY.name
    wrong = {
        f"is for problem '{plan['problem']}', not '{snapshot.name}'": (
            plan["problem"] != snapshot.name
        ),
        f"has the status '{plan['status']}', which is none of Unified Planning's": (
            plan["status"] not in statuses
        ),
        f"has makespan {plan['makespan']}, but its last activity ends at {latest}": (
            plan["makespan"] != latest
        ),
        f"has the lower bound {bound}, which is above its makespan {latest}": bound > latest,
        f"is called optimal with makespan {latest} and lower bound {bound}": (
            optimal and bound < latest
        ),
    }
    return (f"the plan {what}" for what, is_so in wrong.items() if is_so)


def _map(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    stated, own = maps_of(plan), list(snapshot.maps)
    if "maps" in plan and stated and maps_of({"map": plan["map"]}) != stated[:1]:
        yield "the plan's map is not the first of its maps"
    if len(stated) != len(own):
        told, wanted = (", ".join(m.label for m in maps) or "none" for maps in (stated, own))
        yield f"the plan's map is {told}, the problem's is {wanted}"
        return
    for one, other in zip(stated, own, strict=True):
        yield from _one_map(one, other)


def _one_map(stated: PlacedMap, own: PlacedMap) -> Iterator[str]:
    place, wanted = ([*dataclasses.astuple(m.frame), m.height] for m in (stated, own))
    if not _equal(place, wanted):
        yield f"the plan's map '{stated.file}' has the frame and height {place}, not {wanted}"
    if os.path.abspath(stated.file) == os.path.abspath(own.file):
        return
    try:
        same = load_map(stated.file).digest == load_map(own.file).digest
    except ProblemError as error:
        yield f"the plan's map cannot be read: {error}"
        return
    if not same:
        yield f"the plan's map '{stated.file}' is not the problem's map '{own.file}'"


Said = tuple[str, Mapping[str, Any]]
"""An entry of a plan: what it is in words, and its fields."""


def _compared(stated: Sequence[Said], own: Sequence[Said]) -> Iterator[str]:
    """Yield which entries are stated twice, unknown, or left out, and which fields differ."""
    have, known = Counter(w for w, _ in stated), dict(own)  # the problem has each once
    for what in dict.fromkeys([*have, *known]):
        if what not in known:
            yield f"{what} of the plan is not in the problem"
        elif not have[what]:
            yield f"{what} of the problem is not in the plan"
        if have[what] > 1:
            yield f"{what} is in the plan {have[what]} times"
    for what, entry in stated:
        for key, value in known.get(what, {}).items():
            if not _equal(entry.get(key), value):
                yield f"{what} has {key} {entry.get(key)} in the plan, not {value}"


def _objects(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    stated = []
    for entry in plan["objects"]:
        mesh = entry.get("mesh")
        file = {} if mesh is None else {"mesh": os.path.abspath(mesh)}
        stated.append((f"object '{entry['name']}'", {**entry, **file}))
    own = described_objects(snapshot)
    yield from _compared(stated, [(f"object '{o['name']}'", {"height": None, **o}) for o in own])


def _activities(problem: SchedulingMotionProblem, plan: PlanDict) -> Iterator[str]:
    known = {a.name: a for a in problem.activities}
    names = [a["name"] for a in plan["activities"]]
    there = [n for n in names if n in known]  # to leave one out is no contradiction
    yield from _compared(*([(f"activity '{n}'", {}) for n in some] for some in (names, there)))
    for stated in plan["activities"]:
        activity = known.get(stated["name"])
        if activity is not None:
            own = {p.name.removeprefix(f"{activity.name}.") for p in activity.parameters}
            for extra in sorted(set(stated.get("parameters", {})) - own):
                yield f"activity '{activity.name}' has no parameter '{extra}' in the problem"
    variables = {v.name for v in problem.base_variables}
    for extra in sorted(set(plan.get("parameters", {})) - variables):
        yield f"the problem has no variable '{extra}'"


def _motions(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    def said(activity: str, name: str, number: int) -> Said:
        return f"the motion of '{name}' in activity '{activity}'", {"map": number}

    present = {a["name"] for a in plan["activities"]}
    own = [said(t.activity, t.object, t.map) for t in snapshot.tasks if t.activity in present]
    stated = [said(m["activity"], m["object"], map_number(m)) for m in plan["motions"]]
    yield from _compared(stated, own)


def _rides(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    def said(ride: Mapping[str, Any]) -> Said:
        return f"the ride of '{ride['object']}' in activity '{ride['activity']}'", ride

    own = described_rides(snapshot, {a["name"] for a in plan["activities"]})
    yield from _compared([*map(said, plan.get("rides", []))], [*map(said, own)])


def _changes(problem: SchedulingMotionProblem, plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    def said(change: Mapping[str, Any]) -> Said:
        what = f"the change of '{change['object']}' by activity '{change['activity']}'"
        return what, {**change, "map": map_number(change)}

    times = {a["name"]: (a["start"], a["end"]) for a in plan["activities"]}
    try:
        made = described_changes(problem, plan_from_dict(problem, plan), snapshot, times)
    except ProblemError:
        return  # what keeps it from being made is said by others, or by the validator
    yield from _compared([*map(said, plan["changes"])], [*map(said, made)])


def _equal(one: Any, two: Any) -> bool:
    """Return whether two values are the same, numbers within the rounding of plan files."""
    if isinstance(one, list | tuple) and isinstance(two, list | tuple):
        return len(one) == len(two) and all(map(_equal, one, two))
    if isinstance(one, int | float) and isinstance(two, int | float):
        return math.isclose(one, two, rel_tol=1e-9, abs_tol=_CLOSE)
    return bool(one == two)
