"""Dependencies in plan files (version 1.1, see docs/plan-format.md), and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.execution.build import Dependencies, dependencies_of, graph_of, tasks_of, with_avoid
from up_samp.execution.check import (
    graph_faults,
    lacking,
    motion_faults,
    motion_named,
    needs_of_motions,
    place_faults,
    refuse,
    shape_faults,
)
from up_samp.execution.check import named as faults_named
from up_samp.execution.graph import MEETING, At, Bound, Choice, Edge, Event, Graph, Narrow
from up_samp.execution.lives import DriveCells, drives_of, lives_of
from up_samp.execution.meetings import meetings_of
from up_samp.execution.tolerances import TOLERANCES
from up_samp.io.plan_dict import PlanDict, snapshot_of, with_minor
from up_samp.model import ProblemError, SampError, UnsupportedError
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
    left = {_unexplained(_choice_from_dict(_choice_to_dict(choice))) for choice in made.choices}
    extra = [c for c in told.choices if _unexplained(c) not in left]
    found += [f"the choice '{c[0].why}' is none that the problem leaves" for c in extra]
    return found


def _unexplained(choice: Choice) -> Choice:
    one, two = (replace(way, why="") for way in choice)
    return one, two


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
    return faults_named(lacking(graph.tasks, graph.edges, needs))


def _as_told(plan: PlanDict) -> Dependencies:
    """Return what a plan file says."""
    data = plan["dependencies"]
    lives = lives_of(plan)
    drives = drives_of(lives)
    who = {t["activity"]: tuple(t["who"]) for t in data["tasks"]}
    tasks = tasks_of(plan, who)
    expected = {t["activity"]: float(t["expected"]) for t in data["tasks"]}
    tasks = {n: replace(t, expected=expected[n]) for n, t in tasks.items()}
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
