"""Plans as plain dictionaries, ready for JSON. The format is documented in docs/plan-format.md."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Container, Mapping
from typing import Any

from unified_planning.engines import PlanGenerationResult
from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule

from up_samp.io.precision import PRECISION
from up_samp.io.sampling import trajectory_rows
from up_samp.model import Configuration, Movable, ProblemError, TrafficZone
from up_samp.model.frames import PlacedMap
from up_samp.model.refinement import ABSOLUTE
from up_samp.model.snapshot import ChangeTask, Snapshot, Term, TermKind
from up_samp.upio.movers import named_as_planned
from up_samp.upio.plan import figures_told, trajectories, trajectory_key, words_told
from up_samp.upio.read import read_problem

# ------------------ Plans as plain dictionaries


FORMAT, VERSION = "up-samp-plan", 1
"""A file of another (major) version is refused; minor versions only add fields."""
AREA = "zone"
"""The type of objects that are parts of the floor, and no bodies."""


PlanDict = dict[str, Any]
"""A plan as JSON would hold it; see docs/plan-format.md."""


def word(name: str) -> re.Pattern[str]:
    """Return what finds a name in another one, as a word of its own (``r1`` not in ``r10``)."""
    return re.compile(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])")


def plan_to_dict(
    problem: SchedulingProblem,
    plan: Schedule,
    *,
    engine: str = "",
    status: str = "",
    lower_bound: float | None = None,
    seconds_per_unit: float | None = None,
) -> PlanDict:
    """Return ``plan`` as a self-contained dictionary: who is where, at every instant.

    ``engine``, ``status`` (a name such as ``SOLVED_OPTIMALLY``) and ``lower_bound`` (proven bound
    on the makespan, schedule units) are written down as they are given. Activities are in schedule
    units of ``seconds_per_unit`` s (by default the plan's own, or 1 where it has none), everything
    about motions in s, m and rad in the map's world frame. The order of everything is that of the
    problem; motions are in the order of their start.

    Raises :class:`ProblemError` where the plan does not fit the problem, or was made with another
    unit than ``seconds_per_unit``.
    """
    seconds_per_unit = _unit(seconds_per_unit, getattr(plan, "seconds_per_unit", None))
    activities = _activities(problem, plan)
    snapshot = snapshot_of(named_as_planned(problem, {"activities": activities}), seconds_per_unit)
    times = {a["name"]: (a["start"], a["end"]) for a in activities}
    maps = described_maps(snapshot)
    data: PlanDict = {
        "format": FORMAT,
        "version": VERSION,
        "problem": snapshot.name,
        "engine": engine,
        "status": status,
        "makespan": max((end for _, end in times.values()), default=0),
        "lower_bound": _plain(lower_bound),
        # not rounded: it is multiplied with times of any size
        "seconds_per_unit": _exact(seconds_per_unit),
        "map": dict(maps[0]) if maps else {"yaml": None},
        "objects": described_objects(snapshot),
        "activities": activities,
        "motions": _motions(plan, snapshot, times),
        "changes": described_changes(problem, plan, snapshot, times),
    }
    margin = getattr(plan, "margin", None)
    more: dict[str, tuple[Any, Any]] = {
        "rides": (described_rides(snapshot, times), []),
        "maps": (maps, maps[:1]),
        "margin": (PRECISION.margin if margin is None else margin, PRECISION.margin),
        # only by these can a plan with variables be read back and judged
        "parameters": ({v.name: value_of(plan.get(v)) for v in problem.base_variables}, {}),
    }
    return with_minor(data | _said(more))


def with_minor(plan: PlanDict) -> PlanDict:
    """Return a plan with its minor version behind the major one: the last one that brought
    something that the plan has (none: it has nothing newer).
    """
    said = plan.get("dependencies", {})
    brought = (
        "dependencies" in plan,
        len(plan.get("maps", ())) > 1 or "frame" in plan["map"] or "height" in plan["map"],
        "choices" in said,
        "margin" in plan,
        "localisation" in said,
        "bound_kind" in plan,
        any({"localisation", "latency"} & o.keys() for o in plan.get("objects", ())),
    )
    known = plan.get("minor", 0)
    minor = max(known, *(k for k, there in enumerate(brought, start=1) if there), 0)
    head = {"format": plan["format"], "version": plan["version"], **_said({"minor": (minor, 0)})}
    return {**head, **{key: value for key, value in plan.items() if key not in (*head, "minor")}}


def result_to_dict(
    problem: SchedulingProblem,
    result: PlanGenerationResult,
    *,
    seconds_per_unit: float | None = None,
) -> PlanDict:
    """Return the plan of an engine's result as :func:`plan_to_dict` does, with the engine's name,
    status, and the ``lower_bound`` and ``bound_kind`` of its metrics. The length of a unit is the
    one that the engine planned with. Raises :class:`ProblemError` without a plan, with what the
    engine says of why, or if ``seconds_per_unit`` differs.
    """
    if result.plan is None:
        why = "; ".join(words_told(result))
        told = f"{result.engine_name} found no plan ({result.status.name})"
        raise ProblemError(f"{told}: {why}" if why else told)
    metrics = figures_told(result)
    bound = metrics.get("lower_bound")
    known = metrics.get("seconds_per_unit")
    if known is not None and getattr(result.plan, "seconds_per_unit", None) is None:
        seconds_per_unit = _unit(seconds_per_unit, float(known))
    data = plan_to_dict(
        problem,
        result.plan,
        engine=result.engine_name,
        status=result.status.name,
        lower_bound=None if bound in (None, "", "None") else float(bound),
        seconds_per_unit=seconds_per_unit,
    )
    kind = metrics.get("bound_kind", ABSOLUTE)
    return with_minor(data if kind == ABSOLUTE else {**data, "bound_kind": kind})


def _unit(wanted: float | None, known: float | None) -> float:
    """Return the length of a schedule unit (s) that the caller names and the plan was made with."""
    if known is None:
        return 1.0 if wanted is None else wanted
    if wanted is not None and not math.isclose(wanted, known):
        raise ProblemError(
            f"the plan was made with seconds_per_unit={known:g}, not {wanted:g}: leave it out"
        )
    return known


def snapshot_of(problem: SchedulingProblem, seconds_per_unit: float) -> Snapshot:
    """Return the problem's plain values; a problem without motions has no objects and no map."""
    if isinstance(problem, SchedulingMotionProblem):
        return read_problem(problem, seconds_per_unit)
    name = problem.name or "problem"
    return Snapshot(name, (), {}, {}, {}, (), (), seconds_per_unit)


def _plain(value: float | None) -> float | int | None:
    """Return a whole number as an int, anything else rounded; bounds that say nothing as None."""
    if value is None or not math.isfinite(value):
        return None
    return int(value) if float(value).is_integer() else round(float(value), PRECISION.decimals)


def described_maps(snapshot: Snapshot) -> list[dict[str, Any]]:
    """Return the maps as plan files have them: ``frame`` and ``height`` where they are not 0."""

    def described(placed: PlacedMap) -> dict[str, Any]:
        frame = placed.frame
        more = {
            "frame": (_pose((frame.x, frame.y, frame.yaw)), [0.0, 0.0, 0.0]),
            "height": (round(placed.height, PRECISION.decimals), 0.0),
        }
        return {"yaml": os.path.abspath(placed.file), **_said(more)}

    return [described(m) for m in snapshot.maps]


def on_map(snapshot: Snapshot, number: int) -> dict[str, int]:
    """Return what an entry says about its map: nothing where there is one map."""
    return {"map": number} if len(snapshot.maps) > 1 else {}


def described_objects(snapshot: Snapshot) -> list[dict[str, Any]]:
    """Return the problem's movable objects as a plan file describes them."""
    return [_object(o, snapshot) for o in snapshot.objects.values()]


def _object(movable: Movable, snapshot: Snapshot) -> dict[str, Any]:
    limits = movable.body.kinematics
    place = snapshot.initial.get(movable.name)
    entry: dict[str, Any] = {
        "name": movable.name,
        "type": movable.type_name,
        "footprint": [[_plain(x), _plain(y)] for x, y in movable.body.footprint],
        "model": limits.model.value,
        "turning_radius": _plain(limits.turning_radius),
        "v_max": _plain(limits.v_max),
        "a_max": _plain(limits.a_max),
        "initial": None if place is None else _pose(snapshot.configurations[place]),
    }
    if place is not None:
        entry |= on_map(snapshot, snapshot.map_of[place])
    steers, mesh = limits.mobility.steers, movable.body.mesh
    more: dict[str, tuple[Any, Any]] = {
        "omega_max": (None if steers else _plain(limits.omega_max), None),
        "reverse": (limits.reverse, True),
        "drives_along": (limits.drives_along, False),
        "reverse_v_max": (_plain(limits.v_back), None),
        "lateral_a_max": (_plain(limits.lateral_a_max), None),
        "alpha_max": (_plain(limits.alpha_max), None),
        "reverse_cost": (_plain(limits.back_cost), 1),
        "zones": ([zone_entry(zone) for zone in limits.zones], []),
        "height": (_plain(movable.body.height), None),
        "mesh": (None if mesh is None else os.path.abspath(mesh), None),
    }
    return entry | _said(more)


def _said(entries: Mapping[str, tuple[Any, Any]]) -> dict[str, Any]:
    """Return those of some entries (value, what it is where it is absent) that say something."""
    return {key: value for key, (value, absent) in entries.items() if value != absent}


def zone_entry(zone: TrafficZone) -> dict[str, Any]:
    """Return the rules of a place: only what it says."""
    entry: dict[str, Any] = {"polygon": [[_plain(x), _plain(y)] for x, y in zone.polygon]}
    more = {
        "height": (_plain(zone.height), 0),
        "v_max": (_plain(zone.v_max), None),
        "one_way": (_plain(zone.one_way), None),
        "pivots": (zone.pivots, True),
        "stops": (zone.stops, True),
        "cost": (_plain(zone.cost), 0),
        "prefer": (_plain(zone.prefer), 1),
        "dock": (None if zone.dock is None else _pose(zone.dock), None),
    }
    return entry | _said(more)


def _pose(configuration: Configuration) -> list[float]:
    return [round(float(v), PRECISION.decimals) + 0.0 for v in configuration]


def _activities(problem: SchedulingProblem, plan: Schedule) -> list[dict[str, Any]]:
    """Return the present activities in the order of their start, then of the problem."""
    known = {a.name: i for i, a in enumerate(problem.activities)}
    entries = []
    for activity in plan.activities:
        if activity.name not in known:
            raise ProblemError(f"the plan's activity '{activity.name}' is not in the problem")
        entry: dict[str, Any] = {
            "name": activity.name,
            "start": _number(plan.get(activity.start)),
            "end": _number(plan.get(activity.end)),
        }
        if activity.parameters:
            entry["parameters"] = {
                p.name.removeprefix(f"{activity.name}."): value_of(plan.get(p))
                for p in activity.parameters
            }
        entries.append(entry)
    return sorted(entries, key=lambda e: (e["start"], known[e["name"]]))


def _number(value: FNode) -> float | int:
    return _exact(value.constant_value())


def _exact(number: Any) -> float | int:
    """Return a whole number as an int, anything else as it is, as JSON would hold it."""
    return int(number) if number % 1 == 0 else float(number)


def value_of(value: FNode) -> bool | int | float | str:
    """Return a constant expression as JSON would hold it: objects by their name."""
    if value.is_object_exp():
        name: str = value.object().name
        return name
    if value.is_bool_constant():
        return bool(value.bool_constant_value())
    return _number(value)


def _motions(
    plan: Schedule,
    snapshot: Snapshot,
    times: Mapping[str, tuple[float, float]],
) -> list[dict[str, Any]]:
    timed = trajectories(plan, snapshot.seconds_per_unit)
    entries = []
    for task in snapshot.tasks:
        if task.activity not in times:
            continue
        key = trajectory_key(task.activity, task.index)
        if key not in timed:
            raise ProblemError(
                f"the plan has neither a trajectory nor a path for '{task.object}' in activity "
                f"'{task.activity}'"
            )
        entries.append(
            {
                "activity": task.activity,
                "object": task.object,
                "samples": trajectory_rows(timed[key]),
                **on_map(snapshot, task.map),
            }
        )
    return sorted(entries, key=lambda e: (times[e["activity"]][0], e["samples"][0][0]))


def described_changes(
    problem: SchedulingProblem,
    plan: Schedule,
    snapshot: Snapshot,
    times: Mapping[str, tuple[float, float]],
) -> list[dict[str, Any]]:
    """Return what the activities of a plan put elsewhere at their ends."""
    rides = [ChangeTask(r.activity, r.load, r.goal) for r in snapshot.rides]
    changes = [c for c in (*snapshot.changes, *rides) if c.activity in times]
    fluents = any(c.term.kind is TermKind.FLUENT for c in changes)
    told = told_by_fluents(problem, plan) if fluents else {}
    entries = []
    for change in changes:
        name = told.get((change.activity, change.object)) or _configuration_name(plan, change.term)
        entries.append(
            {
                "activity": change.activity,
                "object": change.object,
                "time": _plain(times[change.activity][1] * snapshot.seconds_per_unit),
                "configuration": _pose(snapshot.configurations[name]),
                **on_map(snapshot, snapshot.map_of[name]),
            }
        )
    return sorted(entries, key=lambda e: e["time"])


def described_rides(snapshot: Snapshot, present: Container[str]) -> list[dict[str, Any]]:
    """Return which loads travel with whom, and where they are in their carrier's frame."""
    return [
        {
            "activity": ride.activity,
            "object": ride.load,
            "carrier": task.object,
            "offset": _pose(ride.offset),
        }
        for task in snapshot.tasks
        for ride in task.rides
        if ride.activity in present
    ]


def _configuration_name(plan: Schedule, term: Term) -> str:
    """Return the configuration that a constant or a decision of the plan names."""
    for variable, value in plan.assignment.items() if term.kind is TermKind.PARAMETER else ():
        if getattr(variable, "name", None) == term.name:
            return str(value_of(value))
    return term.name


def told_by_fluents(problem: SchedulingProblem, plan: Schedule) -> dict[tuple[str, str], str]:
    """Return the configuration that each motion effect (activity, object) means in a plan: fluents
    are read at their activity's end, by the validator's rules.
    """
    from up_samp.validation.scene import JudgedScene
    from up_samp.validation.schedule import judge_schedule

    _, timeline = judge_schedule(problem, plan)
    if timeline is None:
        raise ProblemError("the plan's schedule is broken: no fluent has a value in it")
    return {(e.activity, e.object): e.place for e in JudgedScene(problem, timeline).effects}
