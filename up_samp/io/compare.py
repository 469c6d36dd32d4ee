"""What a plan file says about its problem, against the problem itself."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from unified_planning.engines import PlanGenerationResultStatus
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.geometry import load_map
from up_samp.geometry.atlas import in_world
from up_samp.io.floors import map_number, maps_of
from up_samp.io.plan_dict import PlanDict, described_objects, described_rides, told_by_fluents
from up_samp.io.precision import PRECISION
from up_samp.io.restore import plan_from_dict
from up_samp.model import ProblemError
from up_samp.model.frames import PlacedMap
from up_samp.model.snapshot import ChangeTask, Snapshot, Term, TermKind
from up_samp.upio.movers import named_as_planned
from up_samp.upio.read import read_problem

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
        *_on_maps(plan, snapshot),
        *_changes(problem, plan, snapshot),
        *_rides(plan, snapshot),
    ]


def poses_beyond(problem: SchedulingMotionProblem, plan: PlanDict) -> list[str]:
    """Return, in words, which motions lead further from the map than it is large, or turn round
    and round: nobody can have planned them, and sweeping them has no end.
    """
    snapshot = read_problem(named_as_planned(problem, plan), plan["seconds_per_unit"])
    limits = [_limits(m) for m in snapshot.maps]
    everywhere = (-math.inf, -math.inf), (math.inf, math.inf)
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


def _limits(placed: PlacedMap) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the lowest and highest coordinates within a map's length of it."""
    grid = in_world(placed)
    rows, cols = grid.shape
    corners = [grid.point_of(r, c) for r in (0, rows) for c in (0, cols)]
    reach = math.hypot(*grid.size)
    low = min(x for x, _ in corners) - reach, min(y for _, y in corners) - reach
    high = max(x for x, _ in corners) + reach, max(y for _, y in corners) + reach
    return low, high


def _head(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    if plan["problem"] != snapshot.name:
        yield f"the plan is for problem '{plan['problem']}', not '{snapshot.name}'"
    statuses = [s.name for s in PlanGenerationResultStatus]
    if plan["status"] and plan["status"] not in statuses:
        yield f"the plan's status '{plan['status']}' is none of Unified Planning's"
    latest = max((a["end"] for a in plan["activities"]), default=0)
    if plan["makespan"] != latest:
        yield f"the plan's makespan is {plan['makespan']}, but its last activity ends at {latest}"
    bound = plan["lower_bound"]
    if bound is not None and bound > latest:
        yield f"the plan's lower bound {bound} is above its makespan {latest}"
    solved = PlanGenerationResultStatus.SOLVED_OPTIMALLY.name
    if bound is not None and plan["status"] == solved and bound < latest:
        yield f"the plan is called optimal with makespan {latest} and lower bound {bound}"


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


def _objects(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    own = {entry["name"]: entry for entry in described_objects(snapshot)}
    yield from _names("object", [o["name"] for o in plan["objects"]], list(own))
    for stated in plan["objects"]:
        known = own.get(stated["name"], {})
        for key in [*known, *({"height"} & stated.keys() - known.keys())]:
            value = known.get(key)
            if key == "mesh" and value is not None:
                same = stated.get(key) is not None and _same_file(stated[key], value)
            else:
                same = _equal(stated.get(key), value)
            if not same:
                name = stated["name"]
                yield f"object '{name}' has {key} {stated.get(key)} in the plan, not {value}"


def _same_file(one: str, two: str) -> bool:
    return os.path.abspath(one) == os.path.abspath(two)


def _names(what: str, stated: Sequence[str], known: Sequence[str]) -> Iterator[str]:
    """Yield which names are stated twice, unknown, or left out."""
    for name, count in Counter(stated).items():
        if count > 1:
            yield f"{what} '{name}' is in the plan {count} times"
        if name not in known:
            yield f"{what} '{name}' of the plan is not in the problem"
    for name in known:
        if what == "object" and name not in stated:
            yield f"object '{name}' of the problem is not in the plan"


def _activities(problem: SchedulingMotionProblem, plan: PlanDict) -> Iterator[str]:
    known = {a.name: a for a in problem.activities}
    yield from _names("activity", [a["name"] for a in plan["activities"]], list(known))
    for stated in plan["activities"]:
        name = stated["name"]
        if name in known:
            own = {p.name.removeprefix(f"{name}.") for p in known[name].parameters}
            for extra in sorted(set(stated.get("parameters", {})) - own):
                yield f"activity '{name}' has no parameter '{extra}' in the problem"
    variables = {v.name for v in problem.base_variables}
    for extra in sorted(set(plan.get("parameters", {})) - variables):
        yield f"the problem has no variable '{extra}'"


def _motions(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    present = {a["name"] for a in plan["activities"]}
    needed = Counter((t.activity, t.object) for t in snapshot.tasks if t.activity in present)
    stated = Counter((m["activity"], m["object"]) for m in plan["motions"])
    for activity, name in sorted(needed.keys() | stated.keys()):
        want, have = needed[activity, name], stated[activity, name]
        if have > want:
            said = f"{have} motions" if have > 1 else "a motion"
            where = f"of '{name}' in activity '{activity}'"
            yield f"the plan has {said} {where}, the problem {want or 'none'}"
        elif have < want:
            yield f"the plan has no motion of '{name}' in activity '{activity}'"


def _rides(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    own = described_rides(snapshot, {a["name"] for a in plan["activities"]})
    stated = plan.get("rides", [])
    for ride in own:
        if ride not in stated:
            yield f"the plan does not say that '{ride['object']}' rides in '{ride['activity']}'"
    for ride in stated:
        if ride not in own:
            yield f"'{ride['object']}' rides otherwise in '{ride['activity']}', by the problem"


def _on_maps(plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    """Yield which motions and changes are not on the map that the problem has them on."""
    drives = {(t.activity, t.object): t.map for t in snapshot.tasks}
    for motion in plan["motions"]:
        wanted = drives.get((motion["activity"], motion["object"]))
        if wanted is not None and map_number(motion) != wanted:
            where = f"of '{motion['object']}' in activity '{motion['activity']}'"
            yield f"the motion {where} is on map {map_number(motion)}, not on map {wanted}"


def _changes(problem: SchedulingMotionProblem, plan: PlanDict, snapshot: Snapshot) -> Iterator[str]:
    ends = {a["name"]: a["end"] * snapshot.seconds_per_unit for a in plan["activities"]}
    stated: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for entry in plan["changes"]:
        stated.setdefault((entry["activity"], entry["object"]), []).append(entry)
    rides = [ChangeTask(r.activity, r.load, r.goal) for r in snapshot.rides]
    changes = [c for c in (*snapshot.changes, *rides) if c.activity in ends]
    told = {}
    if any(c.term.kind is TermKind.FLUENT for c in changes):
        # where the schedule is broken no fluent has a value; that is the validator's to say
        with contextlib.suppress(ProblemError):
            told = told_by_fluents(problem, plan_from_dict(problem, plan))
    for change in changes:
        name = told.get((change.activity, change.object), _named(plan, change.term))
        where = f"'{change.object}' by activity '{change.activity}'"
        found = stated.pop((change.activity, change.object), [])
        if not found:
            yield f"the plan lacks the change of {where}"
            continue
        if len(found) > 1:
            yield f"the plan has {len(found)} changes of {where}"
        wanted = ends[change.activity], name
        yield from _change(snapshot, found[0], wanted, where)
    for activity, name in stated:
        yield f"the plan changes '{name}' by activity '{activity}', the problem does not"


def _named(plan: PlanDict, term: Term) -> str:
    return str(_parameter(plan, term.name)) if term.kind is TermKind.PARAMETER else term.name


def _change(
    snapshot: Snapshot, stated: Mapping[str, Any], wanted: tuple[float, str], where: str
) -> Iterator[str]:
    """Compare a change with when (s) it is to be, and the configuration that it leads to."""
    end, name = wanted
    if not math.isclose(stated["time"], end, rel_tol=1e-9, abs_tol=_CLOSE):
        yield f"the change of {where} is at {stated['time']} s in the plan, not at {end:g} s"
    pose = snapshot.configurations.get(name)
    if pose is not None and not _equal(stated["configuration"], list(pose)):
        yield f"the change of {where} puts it at {stated['configuration']}, not at {list(pose)}"
    if map_number(stated) != snapshot.map_of.get(name, 0) and pose is not None:
        yield f"the change of {where} is on map {map_number(stated)}"


def _parameter(plan: PlanDict, name: str) -> object:
    """Return the plan's value of ``activity.parameter`` or of a variable."""
    for activity in plan["activities"]:
        own, _, short = name.rpartition(".")
        if own == activity["name"] and short in activity.get("parameters", {}):
            return activity["parameters"][short]
    return plan.get("parameters", {}).get(name)


def _equal(one: Any, two: Any) -> bool:
    """Return whether two values are the same, numbers within the rounding of plan files."""
    if isinstance(one, list | tuple) and isinstance(two, list | tuple):
        return len(one) == len(two) and all(map(_equal, one, two))
    if isinstance(one, int | float) and isinstance(two, int | float):
        return math.isclose(one, two, rel_tol=1e-9, abs_tol=_CLOSE)
    return bool(one == two)
