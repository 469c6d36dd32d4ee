"""Dependencies in plan files (version 1.1, see docs/plan-format.md): written, read and checked.

Nothing that a file says is believed. A graph is valid if every execution that it allows is. What it
has to hold is made again: from the motions alone who lets whom pass and which motion of an object
comes after which, and with the problem all that the problem asks for. What does not follow from the
file's edges is named.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.execution.build import Dependencies, dependencies_of, graph_of, tasks_of, with_avoid
from up_samp.execution.graph import (
    MEETING,
    ORIGIN,
    At,
    Bound,
    Choice,
    Edge,
    Event,
    Graph,
    Narrow,
    PlannedTask,
)
from up_samp.execution.lives import DriveCells, Life, drives_of, in_turn, lives_of
from up_samp.execution.meetings import Meeting, meetings_of, steps_of
from up_samp.execution.tolerances import TOLERANCES
from up_samp.io.files import is_number, shape_fault
from up_samp.io.plan_dict import PlanDict, snapshot_of, with_minor
from up_samp.model import MotionModel, ProblemError, SampError, UnsupportedError
from up_samp.model.errors import short
from up_samp.upio.movers import named_as_planned


def with_dependencies(
    problem: SchedulingProblem,
    plan: PlanDict,
    *,
    localisation: float = TOLERANCES.localisation,
) -> PlanDict:
    """Return a plan dictionary of version 1.1: with ``dependencies``, each motion's ``progress`` at
    its samples, and what it must keep clear of.
    """
    dependencies = dependencies_of(problem, plan, localisation=localisation)
    problem = named_as_planned(problem, plan)
    snapshot = snapshot_of(problem, float(plan["seconds_per_unit"]))
    drives = drives_of(dependencies.lives)
    data = with_avoid({k: v for k, v in plan.items() if k != "dependencies"}, snapshot)
    data["motions"] = [
        _with_progress(m, drives.get((m["activity"], m["object"]))) for m in data["motions"]
    ]
    data["dependencies"] = graph_to_dict(dependencies.graph)
    if dependencies.choices:
        data["dependencies"]["choices"] = [*map(_choice_to_dict, dependencies.choices)]
    if localisation:
        data["dependencies"]["localisation"] = localisation
        data["dependencies"]["narrow"] = [_narrow_to_dict(n) for n in dependencies.narrow]
    return with_minor(data)


def shown_with_dependencies(problem: SchedulingProblem, plan: PlanDict) -> tuple[PlanDict, str]:
    """Return a plan as :func:`with_dependencies` does and "", or as it is and why it has none: a
    plan that was found is shown, though nobody could follow it.
    """
    try:
        return with_dependencies(problem, plan), ""
    except (ProblemError, UnsupportedError) as error:
        return plan, f"no dependencies in the plan: {error}"


def _with_progress(motion: Mapping[str, Any], drive: DriveCells | None) -> dict[str, Any]:
    if drive is None:  # it goes nowhere
        return {**motion, "progress": [0.0] * len(motion["samples"])}
    return {**motion, "progress": [round(float(s), 6) for s in drive.planned[1]]}


def _narrow_to_dict(place: Narrow) -> dict[str, Any]:
    return {
        "objects": list(place.objects),
        "activities": list(place.activities),
        "where": [round(v, 3) + 0.0 for v in place.where],
        "kept": round(place.kept, 6),
    }


def graph_to_dict(graph: Graph) -> dict[str, Any]:
    """Return a graph as JSON would hold it."""
    return {
        "margin": graph.margin,
        "edges_before_reduction": graph.before_reduction,
        "tasks": [
            {"activity": t.name, "expected": round(t.expected, 6), "who": list(t.who)}
            for t in graph.tasks.values()
        ],
        "edges": [
            {**_pair_to_dict(e), "lag": round(e.lag, 6), "kind": e.kind, "why": e.why}
            for e in graph.edges
        ],
        "bounds": [
            {**_pair_to_dict(b), "most": round(b.most, 6), "why": b.why} for b in graph.bounds
        ],
    }


def _pair_to_dict(pair: Edge | Bound) -> dict[str, Any]:
    return {"first": event_to_list(pair.first), "then": event_to_list(pair.then)}


def edge_from_dict(entry: Mapping[str, Any]) -> Edge:
    """Return the edge that an entry of a plan file means."""
    return Edge(*_pair(entry), float(entry["lag"]), str(entry["kind"]), str(entry["why"]))


def _choice_to_dict(choice: Choice) -> dict[str, Any]:
    ways = [{**_pair_to_dict(w), "lag": round(w.lag, 6)} for w in choice]
    return {"ways": ways, "kind": choice[0].kind, "why": choice[0].why}


def _choice_from_dict(entry: Mapping[str, Any]) -> Choice:
    one, two = (replace(edge_from_dict({**entry, **w}), free=True) for w in entry["ways"])
    return one, two


def event_to_list(event: Event) -> list[Any]:
    """Return an event as ``["start", activity]`` or ``["reach", activity, object, progress]``."""
    if event.at is At.ORIGIN:
        return ["origin"]
    if event.at in (At.START, At.END):
        return [event.at.value, event.activity]
    return [event.at.value, event.activity, event.object, round(event.progress, 6)]


def event_from_list(item: Any) -> Event:
    """Return the event that a list of a plan file means."""
    try:
        at = At(item[0])
        if at is At.ORIGIN:
            return Event(at)
        if at in (At.START, At.END):
            return Event(at, str(item[1]))
        return Event(at, str(item[1]), str(item[2]), float(item[3]))
    except (ValueError, IndexError, TypeError, KeyError) as error:
        raise ProblemError(f"the plan's dependencies name no event: {item!r}") from error


def dependencies_from_plan(
    plan: PlanDict, problem: SchedulingProblem | None = None
) -> Dependencies:
    """Return what a plan file says; the geometry is made again from its motions. With ``problem``
    the graph is made again, too.

    Raises :class:`ProblemError` for plans without dependencies (and without a problem), and where
    the graph in the file lacks what the motions alone ask for, or what the problem asks for.
    """
    if problem is not None:
        refuse(dependency_faults(problem, plan), plan)
        if "dependencies" not in plan:
            return dependencies_of(problem, plan)
        return dependencies_of(problem, plan, localisation=_localisation(plan))
    if not isinstance(plan.get("dependencies"), dict):
        raise ProblemError(
            f"the plan of '{plan['problem']}' has no dependencies: give its problem, too"
        )
    refuse(shape_faults(plan) or motion_faults(plan), plan)
    told = _as_told(plan)
    refuse(_faults_alone(plan, told), plan)
    return told


def _localisation(plan: PlanDict) -> float:
    """Return the localisation error (m) that the graph in a plan file was made for."""
    return float(plan["dependencies"].get("localisation", 0.0))


def dependency_faults(problem: SchedulingProblem, plan: PlanDict) -> list[str]:
    """Return, in words, why not every execution that the graph in a plan file allows is valid
    (nothing: it holds all that the problem asks for), and where its progress and what its motions
    keep clear of are not as they should be.
    """
    named = named_as_planned(problem, plan)
    own = with_avoid(plan, snapshot_of(named, float(plan["seconds_per_unit"])))
    found = _avoid_faults(plan, own)
    if "dependencies" not in plan:
        return found
    wrong = shape_faults(plan) or motion_faults(plan)
    if wrong:
        return [*found, *wrong]
    try:
        margin = float(plan["dependencies"]["margin"])
        made = dependencies_of(problem, plan, margin=margin, localisation=_localisation(plan))
        told = _as_told(own)
        found += _faults_alone(plan, told, alone=False) or graph_faults(told.graph, made.graph)
    except SampError as error:
        return [*found, str(error)]
    left = [{**_choice_to_dict(choice), "why": ""} for choice in made.choices]
    extra = [c for c in told.choices if {**_choice_to_dict(c), "why": ""} not in left]
    return [*found, *(f"the choice '{c[0].why}' is none that the problem leaves" for c in extra)]


def _avoid_faults(plan: PlanDict, by_problem: PlanDict) -> list[str]:
    """Return which motions do not say what they have to keep clear of (absent: everything)."""
    found = []
    for told, own in zip(plan["motions"], by_problem["motions"], strict=True):
        if "avoid" not in told:
            continue
        mine = told["avoid"] if isinstance(told["avoid"], list) else []
        where, wanted = motion_named(told), own.get("avoid")
        if wanted is None:
            found.append(f"{where} keeps clear of {mine} only, by the problem of everything")
        elif sorted(map(str, mine)) != wanted:
            found.append(f"{where} keeps clear of {mine}, by the problem of {wanted}")
    return found


def _faults_alone(plan: PlanDict, told: Dependencies, *, alone: bool = True) -> list[str]:
    """Return what is wrong with a graph whatever the problem is."""
    graph = told.graph
    choices = (e for c in told.choices for way in c for e in (way.first, way.then))
    found = place_faults(plan, told.lives, [*graph.events, *choices])
    _ = graph.order
    if found or not alone:
        return found
    needs = needs_of_motions(plan, told.lives, told.meetings)
    return named(lacking(graph.tasks, graph.edges, needs))


def _as_told(plan: PlanDict) -> Dependencies:
    """Return what a plan file says."""
    data = plan["dependencies"]
    lives = lives_of(plan)
    drives = drives_of(lives)
    who = {t["activity"]: tuple(t["who"]) for t in data["tasks"]}
    tasks = tasks_of(plan, who, {t["activity"]: float(t["expected"]) for t in data["tasks"]})
    choices = tuple(_choice_from_dict(entry) for entry in data.get("choices", ()))
    free = {(planned.first, planned.then) for planned, _ in choices}
    edges = [
        replace(e, free=(e.first, e.then) in free and e.kind != MEETING)
        for e in map(edge_from_dict, data["edges"])
    ]
    bounds = [Bound(*_pair(b), float(b["most"]), b["why"]) for b in data["bounds"]]
    graph = graph_of(tasks, drives, edges, bounds, float(data["margin"]))
    graph = replace(graph, before_reduction=int(data["edges_before_reduction"]))
    localisation = _localisation(plan)
    meetings = tuple(meetings_of(lives, float(data["margin"]), localisation))
    return Dependencies(graph, lives, meetings, choices, localisation)


def _pair(entry: Mapping[str, Any]) -> tuple[Event, Event]:
    return event_from_list(entry["first"]), event_from_list(entry["then"])


# ------------------ The file by itself


def check_motions(plan: PlanDict) -> None:
    """Raise :class:`ProblemError` for a plan in which nobody drives, or that nobody can drive."""
    if not plan["motions"]:
        raise ProblemError(f"the plan of '{plan['problem']}' has no motions: nobody drives")
    refuse(motion_faults(plan), plan)


def motion_faults(plan: PlanDict) -> list[str]:
    """Return which motions nobody can drive: faster than the body is, or from where it is not."""
    bodies = {entry["name"]: entry for entry in plan["objects"]}
    found = []
    for motion in plan["motions"]:
        entry = bodies[motion["object"]]
        rows = np.asarray(motion["samples"], dtype=np.float64)
        if MotionModel(entry["model"]).mobility.own_law or "v_max" not in entry:
            continue
        far = np.hypot(*np.diff(rows[:, 1:3], axis=0).T)
        most = 2.0 * float(entry["v_max"]) * np.diff(rows[:, 0]) + TOLERANCES.grip
        if np.any(far > most):
            k = int(np.argmax(far - most))
            place = ", ".join(f"{v:g}" for v in rows[k + 1, 1:])
            found.append(f"{motion_named(motion)} leads to ({place}) faster than it can drive")
    return found or list(_leaps(plan))


def motion_named(motion: Mapping[str, Any]) -> str:
    """Return a motion of a plan in words."""
    return f"the motion of '{motion['object']}' in activity '{motion['activity']}'"


def _leaps(plan: PlanDict) -> Iterator[str]:
    """Yield which motions begin elsewhere than their object is then."""
    for entry in plan["objects"]:
        rides = {r["activity"] for r in plan.get("rides", ()) if r["object"] == entry["name"]}
        here = entry["initial"]
        for item in in_turn(plan, entry["name"], rides):
            if "samples" not in item:
                here = item["configuration"]
                continue
            first, here_before = item["samples"][0][1:], here
            here = item["samples"][-1][1:]
            if here_before is not None and math.dist(first[:2], here_before[:2]) > TOLERANCES.grip:
                place, name = ", ".join(f"{v:g}" for v in first), entry["name"]
                yield f"{motion_named(item)} begins at ({place}), where '{name}' is not then"


def shape_faults(plan: PlanDict) -> list[str]:
    """Return what is wrong with the fields of a plan's dependencies, and of its motions' progress:
    types, ranges, names of activities.
    """
    data = plan["dependencies"]
    fault = shape_fault(data, "dependencies")
    if fault:
        return [fault]
    names = Counter(a["name"] for a in plan["activities"])
    told = Counter(task["activity"] for task in data["tasks"])
    found = [f"task '{n}' is no activity of the plan" for n in told if n not in names]
    found += [f"activity '{n}' is {told[n]} times among the tasks" for n in names if told[n] != 1]
    ways = [way for choice in data.get("choices", ()) for way in choice["ways"]]
    said = (*data["edges"], *data["bounds"], *ways)
    events = (one[side] for one, side in itertools.product(said, ("first", "then")))
    unknown = dict.fromkeys(e[1] for e in events if e[1:] and e[1] not in names)
    found += [f"the dependencies speak of {short(n)}, which is not in the plan" for n in unknown]
    for motion in plan["motions"]:
        progress = motion.get("progress")
        if not isinstance(progress, list) or not all(is_number(p, 0.0) for p in progress):
            found.append(f"{motion_named(motion)} has no progress: a list of numbers from 0")
        elif len(progress) != len(motion["samples"]):
            count = f"{len(progress)} values of progress for {len(motion['samples'])} samples"
            found.append(f"{motion_named(motion)} has {count}")
        elif any(b < a for a, b in itertools.pairwise(progress)):
            found.append(f"{motion_named(motion)} has progress that goes back")
    return found


# ------------------ The file and its motions


def place_faults(plan: PlanDict, lives: Mapping[str, Life], events: Iterable[Event]) -> list[str]:
    """Return which values of progress are not those of the samples on their path, and which events
    speak of what is not driven there.
    """
    drives = drives_of(lives)
    found = []
    for motion in plan["motions"]:
        drive = drives.get((motion["activity"], motion["object"]))
        told = np.asarray(motion["progress"], dtype=np.float64)
        real = 0.0 * told if drive is None else drive.planned[1]
        off = np.abs(told - real)
        if np.any(off > TOLERANCES.place):
            k = int(np.argmax(off))
            said = f"progress {told[k]:g} m at {motion['samples'][k][0]:g} s"
            found.append(f"{motion_named(motion)} has {said}, where its path is at {real[k]:g} m")
    return [*found, *dict.fromkeys(_lost(events, drives))]


def _lost(events: Iterable[Event], drives: Mapping[tuple[str, str], DriveCells]) -> Iterator[str]:
    for event in events:
        if event.at not in (At.REACH, At.LEAVE):
            continue
        drive = drives.get((event.activity, event.object))
        if drive is None:
            yield f"the dependencies speak of {event}, which is not driven"
        elif event.progress > drive.path.length + TOLERANCES.place:
            yield f"the dependencies speak of {event}, whose path has {drive.path.length:g} m"


def needs_of_motions(
    plan: PlanDict, lives: Mapping[str, Life], meetings: Iterable[Meeting]
) -> list[Edge]:
    """Return what the motions ask for, whatever the problem is."""
    found = [step for meeting in meetings for step in steps_of(meeting)]
    for name, life in lives.items():
        turns = dict.fromkeys(
            (item["activity"], "samples" in item or item["activity"] in life.rides)
            for item in in_turn(plan, name, life.rides)
        )
        for (one, _), (two, drives) in itertools.pairwise(turns):
            then = Event(At.START if drives else At.END, two)
            lag = TOLERANCES.strict if drives else 0.0
            found.append(
                Edge(Event(At.END, one), then, lag, "object", f"{one} and {two} both move {name}")
            )
    return found


# ------------------ What follows from what


def lacking(
    tasks: Mapping[str, PlannedTask], edges: Iterable[Edge], needs: Sequence[Edge]
) -> list[Edge]:
    """Return the needs that do not follow from ``edges``, with their lags.

    Raises :class:`ProblemError` where the edges have a cycle.
    """
    edges = list(edges)
    direct: dict[tuple[Event, Event], float] = {}
    for edge in edges:
        pair = (edge.first, edge.then)
        direct[pair] = max(edge.lag, direct.get(pair, 0.0))
    ends = [Event(at, name) for name, at in itertools.product(tasks, (At.START, At.END))]
    found = dict.fromkeys([ORIGIN, *ends])
    found.update(dict.fromkeys(e for n in (*edges, *needs) for e in (n.first, n.then)))
    made = tuple(Edge(*pair, lag) for pair, lag in direct.items())
    graph = Graph(tasks, tuple(found), (0.0,) * len(found), made)
    number = graph.number
    rank = {k: place for place, k in enumerate(graph.order)}
    after: dict[int, list[tuple[int, float]]] = {}
    for before, then in graph.implied:
        after.setdefault(before, []).append((then, 0.0))
    for (before, then), edge in zip(graph.pairs, made, strict=True):
        after.setdefault(before, []).append((then, edge.lag))
    later = _later(graph.order, after)
    left: dict[Event, list[Edge]] = {}
    for need in needs:
        follows = need.lag <= TOLERANCES.rounded and later[number[need.first]] >> number[need.then]
        if not follows & 1 and (
            direct.get((need.first, need.then), -1.0) < need.lag - TOLERANCES.rounded
        ):
            left.setdefault(need.first, []).append(need)
    missing: list[Edge] = []
    for first, wanted in left.items():
        latest = {number[first]: 0.0}
        for k in graph.order[rank[number[first]] :]:
            for then, lag in after.get(k, ()) if k in latest else ():
                latest[then] = max(latest.get(then, 0.0), latest[k] + lag)
        never = -math.inf
        missing += [
            n for n in wanted if latest.get(number[n.then], never) < n.lag - TOLERANCES.rounded
        ]
    return missing


def _later(order: Sequence[int], after: Mapping[int, Sequence[tuple[int, float]]]) -> list[int]:
    """Return for each number those that come after it, as the bits of a whole number."""
    found = [0] * len(order)
    for k in reversed(order):
        for then, _ in after.get(k, ()):
            found[k] |= found[then] | 1 << then
    return found


def named(items: Sequence[object], most: int = 12) -> list[str]:
    """Return faults in words, the first ``most`` of them one by one."""
    found = [str(item) for item in items[:most]]
    if len(items) > most:
        found.append(f"... and {len(items) - most} more of the kind")
    return found


# ------------------ The file and its problem


def graph_faults(told: Graph, made: Graph) -> list[str]:
    """Return what a file's graph lacks of the one that its problem asks for, and which of its own
    edges the plan itself does not keep.
    """
    fixed = ([e for e in graph.edges if e.fixed] for graph in (told, made))
    lost, every = lacking(told.tasks, *fixed), lacking(told.tasks, told.edges, made.edges)
    found = named(list(dict.fromkeys(map(str, (*lost, *every)))))
    own = {(n.first, n.then): n.lag for n in made.edges}
    broken = [
        need
        for need, (first, then) in zip(told.edges, told.pairs, strict=True)
        if need.lag > own.get((need.first, need.then), -math.inf) + TOLERANCES.rounded
        and told.times[then] < told.times[first] + need.lag - TOLERANCES.late
    ]
    found += named(
        [f"the plan itself does not keep that {n.then} waits for {n.first}" for n in broken]
    )
    return [*found, *_bound_faults(told, made), *_task_faults(told, made)]


def _bound_faults(told: Graph, made: Graph) -> list[str]:
    known: dict[tuple[Event, Event], float] = {}
    for b in told.bounds:
        pair = b.first, b.then
        known[pair] = min(b.most, known.get(pair, math.inf))
    lost = []
    for b in made.bounds:
        if known.get((b.first, b.then), math.inf) > b.most + TOLERANCES.rounded:
            lost.append(
                f"no bound says that {b.then} is at most {b.most:g} s after {b.first} ({b.why})"
            )
    return named(list(dict.fromkeys(lost)))


def _task_faults(told: Graph, made: Graph) -> list[str]:
    found = []
    for name, own in made.tasks.items():
        task = told.tasks[name]
        if set(task.who) != set(own.who):
            who, whom = (", ".join(sorted(w)) or "nobody" for w in (task.who, own.who))
            found.append(
                f"the task '{name}' is done by {who} in the file, by {whom} in the problem"
            )
        if abs(task.expected - own.expected) > TOLERANCES.rounded:
            lasts = f"{task.expected:g} s in the file, {own.expected:g} s in the plan"
            found.append(f"the task '{name}' lasts {lasts}")
    return named(found)


def refuse(faults: Sequence[str], plan: PlanDict) -> None:
    """Raise :class:`ProblemError` that names all faults, if there are any."""
    if faults:
        raise ProblemError(
            f"the plan of '{plan['problem']}' cannot be followed: {'; '.join(faults)}"
        )
