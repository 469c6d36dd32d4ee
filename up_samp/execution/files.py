"""Dependencies in plan files (version 1.1, see docs/plan-format.md), and back."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.execution.build import Dependencies, dependencies_of, tasks_of, with_avoid
from up_samp.execution.graph import At, Bound, Choice, Edge, Event, Graph, PlannedTask, Precedence
from up_samp.execution.lives import Drive, lives_of
from up_samp.execution.meetings import Narrow, meetings_of
from up_samp.execution.reduce import MEETING
from up_samp.execution.tolerances import TOLERANCES
from up_samp.io.plan_dict import PlanDict, snapshot_of
from up_samp.io.versions import VERSIONS
from up_samp.model import ProblemError
from up_samp.upio.movers import named_as_planned


def with_dependencies(
    problem: SchedulingProblem,
    plan: PlanDict,
    *,
    margin: float | None = None,
    localisation: float = TOLERANCES.localisation,
) -> PlanDict:
    """Return a plan dictionary of version 1.1: with ``dependencies``, each motion's ``progress`` at
    its samples, and what it must keep clear of.
    """
    dependencies = dependencies_of(problem, plan, margin=margin, localisation=localisation)
    problem = named_as_planned(problem, plan)
    snapshot = snapshot_of(problem, float(plan["seconds_per_unit"]))
    drives = {d.key: d for life in dependencies.lives.values() for d in life.drives}
    data: PlanDict = {}
    for key, value in with_avoid(plan, snapshot).items():
        if key == "motions":
            value = [_with_progress(m, drives.get((m["activity"], m["object"]))) for m in value]
        if key not in ("minor", "dependencies"):
            data[key] = value
        if key == "version":
            data["minor"] = max(VERSIONS.dependencies, plan.get("minor", 0))
    data["dependencies"] = graph_to_dict(dependencies.graph)
    if dependencies.choices:
        data["minor"] = max(VERSIONS.choices, data["minor"])
        data["dependencies"]["choices"] = [_choice_to_dict(c) for c in dependencies.choices]
    if localisation:
        data["minor"] = max(VERSIONS.localisation, data["minor"])
        data["dependencies"]["localisation"] = localisation
        data["dependencies"]["narrow"] = [_narrow_to_dict(n) for n in dependencies.narrow]
    return data


def _with_progress(motion: Mapping[str, Any], drive: Drive | None) -> dict[str, Any]:
    if drive is None:  # it goes nowhere
        return {**motion, "progress": [0.0] * len(motion["samples"])}
    progress = np.maximum.accumulate(drive.path.natural_s)
    return {**motion, "progress": [round(float(s), 6) for s in progress]}


def _narrow_to_dict(place: Narrow) -> dict[str, Any]:
    return {
        "objects": list(place.objects),
        "activities": list(place.activities),
        "where": [round(v, 3) + 0.0 for v in place.where],
        "kept": round(place.kept, 6),
    }


def graph_to_dict(graph: Graph) -> dict[str, Any]:
    """Return a graph as JSON would hold it."""
    events = graph.events
    return {
        "margin": graph.margin,
        "edges_before_reduction": graph.before_reduction,
        "tasks": [
            {"activity": t.name, "expected": round(t.expected, 6), "who": list(t.who)}
            for t in graph.tasks.values()
        ],
        "edges": [
            {
                "first": event_to_list(events[e.first]),
                "then": event_to_list(events[e.then]),
                "lag": round(e.lag, 6),
                "kind": e.kind,
                "why": e.why,
            }
            for e in graph.edges
        ],
        "bounds": [
            {
                "first": event_to_list(events[b.first]),
                "then": event_to_list(events[b.then]),
                "most": round(b.most, 6),
                "why": b.why,
            }
            for b in graph.bounds
        ],
    }


def _choice_to_dict(choice: Choice) -> dict[str, Any]:
    ways = [
        {"first": event_to_list(w.first), "then": event_to_list(w.then), "lag": round(w.lag, 6)}
        for w in choice.ways
    ]
    return {"ways": ways, "kind": choice.kind, "why": choice.why}


def _choice_from_dict(entry: Mapping[str, Any]) -> Choice:
    one, two = (
        Precedence(event_from_list(w["first"]), event_from_list(w["then"]), float(w["lag"]))
        for w in entry["ways"]
    )
    return Choice((one, two), str(entry["kind"]), str(entry["why"]))


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


def dependencies_from_plan(plan: PlanDict) -> Dependencies:
    """Return what a plan file says; the geometry is made again from its motions.

    Raises :class:`ProblemError` for plans without dependencies.
    """
    data = plan.get("dependencies")
    if not isinstance(data, dict):
        raise ProblemError(
            f"the plan of '{plan['problem']}' has no dependencies: give its problem, too"
        )
    lives = lives_of(plan)
    drives = {d.key: d for life in lives.values() for d in life.drives}
    who = {t["activity"]: tuple(t["who"]) for t in data["tasks"]}
    tasks = tasks_of(plan, who)
    expected = {t["activity"]: float(t["expected"]) for t in data["tasks"]}
    tasks = {
        n: PlannedTask(n, t.planned, expected.get(n, t.expected), t.who, t.moves)
        for n, t in tasks.items()
    }
    choices = tuple(_choice_from_dict(entry) for entry in data.get("choices", ()))
    for event in (e for c in choices for w in c.ways for e in (w.first, w.then)):
        if event.activity not in tasks:
            raise ProblemError(f"the plan's choices speak of {event}, which is not in it")
    graph = _graph(data, tasks, drives, {(c.ways[0].first, c.ways[0].then) for c in choices})
    _ = graph.order
    localisation = float(data.get("localisation", 0.0))
    meetings = tuple(meetings_of(lives, float(data["margin"]), localisation))
    return Dependencies(graph, lives, meetings, choices, localisation=localisation)


def _graph(
    data: Mapping[str, Any],
    tasks: Mapping[str, PlannedTask],
    drives: Mapping[tuple[str, str], Drive],
    free: Collection[tuple[Event, Event]],
) -> Graph:
    events: dict[Event, int] = {Event(At.ORIGIN): 0}
    for name in tasks:
        for at in (At.START, At.END):
            events[Event(at, name)] = len(events)

    def number(item: Any) -> int:
        event = event_from_list(item)
        unknown = event.at is not At.ORIGIN and event.activity not in tasks
        if unknown or (event.object and (event.activity, event.object) not in drives):
            raise ProblemError(f"the plan's dependencies speak of {event}, which is not in it")
        return events.setdefault(event, len(events))

    def edge(e: Mapping[str, Any]) -> Edge:
        pair = (event_from_list(e["first"]), event_from_list(e["then"]))
        open_ = pair in free and e["kind"] != MEETING
        first, then = number(e["first"]), number(e["then"])
        return Edge(first, then, float(e["lag"]), e["kind"], e["why"], open_)

    edges = tuple(edge(e) for e in data["edges"])
    bounds = tuple(
        Bound(number(b["first"]), number(b["then"]), float(b["most"]), b["why"])
        for b in data["bounds"]
    )
    times = tuple(_planned(event, tasks, drives) for event in events)
    lengths = {key: round(drive.path.length, 6) for key, drive in drives.items()}
    before = int(data["edges_before_reduction"])
    return Graph(tasks, tuple(events), times, edges, bounds, before, float(data["margin"]), lengths)


def _planned(
    event: Event, tasks: Mapping[str, PlannedTask], drives: Mapping[tuple[str, str], Drive]
) -> float:
    if event.at is At.ORIGIN:
        return 0.0
    if event.at in (At.START, At.END):
        return tasks[event.activity].planned[0 if event.at is At.START else 1]
    drive = drives[event.activity, event.object]
    at = np.array([event.progress])
    return float((drive.reached if event.at is At.REACH else drive.left)(at)[0])
