"""From a problem and its plan to the graph of what depends on what."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.execution.differences import Difference, Planned, Point
from up_samp.execution.graph import (
    ORIGIN,
    STRICT,
    At,
    Bound,
    Edge,
    Event,
    Graph,
    Task,
)
from up_samp.execution.lives import Life, lives_of
from up_samp.execution.meetings import MARGIN, Meeting, meetings_of
from up_samp.execution.orders import Order, orders_of, performers
from up_samp.execution.reduce import MEETING, reduced
from up_samp.execution.staircase import Step, steps_of, switched
from up_samp.io.plan_dict import PlanDict, snapshot_of
from up_samp.model import UnsupportedError
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling.compilers.read import read_problem as read_plain

EPSILON = 1e-6
"""Times (s) closer than this are the same."""

STILL = 1e-6
"""A motion whose poses differ by less than this (m, rad) goes nowhere."""


@dataclass(frozen=True, eq=False)
class Dependencies:
    """A plan's graph with the geometry that it came from."""

    graph: Graph
    lives: Mapping[str, Life]
    meetings: tuple[Meeting, ...]


def dependencies_of(
    problem: SchedulingProblem, plan: PlanDict, *, margin: float = MARGIN
) -> Dependencies:
    """Return the dependency graph of a valid plan: acyclic, transitively reduced, with reasons.

    Raises :class:`ProblemError` where the plan breaks the problem,
    :class:`UnsupportedError` for what no executive can keep.
    """
    unit = float(plan["seconds_per_unit"])
    snapshot = snapshot_of(problem, unit)
    if snapshot.rides:
        ride = snapshot.rides[0]
        raise UnsupportedError(
            f"activity '{ride.activity}' carries '{ride.load}' along: dependency graphs for robots "
            "whose footprint changes with their load are not supported"
        )
    plan = with_avoid(plan, snapshot)
    planned = planned_of(problem, plan)
    lives = lives_of(plan)
    meetings = meetings_of(lives, margin)
    draft = Draft(tasks_of(plan, performers(planned, snapshot)), lives)
    for order in orders_of(planned, snapshot):
        draft.add_order(order, unit)
    for meeting in meetings:
        draft.add_meeting(meeting)
    return Dependencies(draft.graph(margin), lives, tuple(meetings))


def planned_of(problem: SchedulingProblem, plan: PlanDict) -> Planned:
    """Return a problem as plain values, under a plan."""
    times = {a["name"]: (int(a["start"]), int(a["end"])) for a in plan["activities"]}
    values = dict(plan.get("parameters", {}))
    for entry in plan["activities"]:
        for short, value in entry.get("parameters", {}).items():
            values[f"{entry['name']}.{short}"] = value
    return Planned(read_plain(problem), times, values)


def with_avoid(plan: PlanDict, snapshot: Snapshot) -> PlanDict:
    """Return the plan with what each motion must keep clear of (``avoid``; absent: everything)."""
    avoid = {(t.activity, t.object): t.avoid for t in snapshot.tasks}
    motions = []
    for motion in plan["motions"]:
        listed = avoid[motion["activity"], motion["object"]]
        entry = {k: v for k, v in motion.items() if k != "avoid"}
        if listed is not None:
            entry["avoid"] = sorted(listed)
        motions.append(entry)
    return {**plan, "motions": motions}


def tasks_of(plan: PlanDict, who: Mapping[str, tuple[str, ...]]) -> dict[str, Task]:
    """Return the plan's activities; one that mentions nobody belongs to whom its name mentions."""
    unit = float(plan["seconds_per_unit"])
    movers = sorted({m["object"] for m in plan["motions"]})
    tasks = {}
    for entry in plan["activities"]:
        name = entry["name"]
        moves = tuple(
            m["object"] for m in plan["motions"] if m["activity"] == name and _goes(m["samples"])
        )
        doers = who.get(name) or tuple(m for m in movers if _mentions(name, m))
        start, end = entry["start"] * unit, entry["end"] * unit
        tasks[name] = Task(name, (start, end), end - start, doers or moves, moves)
    return tasks


def _goes(samples: list[list[float]]) -> bool:
    """Return whether a motion goes anywhere."""
    return any(
        abs(a - b) > STILL for row in samples for a, b in zip(row[1:], samples[0][1:], strict=True)
    )


def _mentions(text: str, name: str) -> bool:
    return bool(re.search(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])", text))


class Draft:
    """Edges under construction, by events."""

    def __init__(self, tasks: Mapping[str, Task], lives: Mapping[str, Life]):
        self.tasks = tasks
        self.drives = {d.key: d for life in lives.values() for d in life.drives}
        self.edges: dict[tuple[Event, Event], tuple[float, str, str]] = {}
        self.bounds: list[tuple[Event, Event, float, str]] = []
        self.tight: list[tuple[Event, Event, float, str, str]] = []

    def add_order(self, order: Order, unit: float) -> None:
        """Add a difference: an edge, or a bound where the plan has it the other way round."""
        need = order.difference
        firsts, thens = self._events(need.first), self._events(need.then)
        for first, then in itertools.product(firsts, thens):
            lag = need.lag * unit + (STRICT if need.strict else 0.0)
            if first == then:
                continue
            # two that are to happen at once: the second follows the first, and that is watched
            at_once = need.lag == 0 and (then, first) in self.edges and lag <= 0.0
            late = self.time(then) < self.time(first) - EPSILON
            if then == ORIGIN or at_once or late or _backward(need):
                self.bounds.append((then, first, -need.lag * unit, order.why))
                continue
            self._edge(first, then, max(0.0, lag), order.kind, order.why)
            if need.lag < 0:
                self.bounds.append((then, first, -need.lag * unit, order.why))

    def _events(self, point: Point) -> tuple[Event, ...]:
        anchor, name = point
        if anchor == "zero":
            return (ORIGIN,)
        if anchor == "horizon":
            return tuple(Event(At.END, task) for task in self.tasks)
        return (Event(At.START if anchor == "start" else At.END, name),)

    def add_meeting(self, meeting: Meeting) -> None:
        """Add the steps of a meeting."""
        for step in steps_of(meeting):
            self._edge(step.first, step.then, 0.0, MEETING, _why(meeting, step))

    def coarsen(self, meetings: Iterable[Meeting]) -> None:
        """Let motions that meet wait for each other as a whole, where one goes first all the way
        and no cycle comes of it.
        """
        self._settle()
        graph = self._full(0.0)
        after: dict[Event, list[Event]] = {}
        for first, then in graph.implied:
            after.setdefault(graph.events[first], []).append(graph.events[then])
        for one, two in self.edges:
            after.setdefault(one, []).append(two)
        for meeting in meetings:
            whole = _whole(steps_of(meeting))
            if whole is not None and not _leads(after, whole.then, whole.first):
                self.put(whole.first, whole.then, 0.0, MEETING, _why(meeting, whole))
                after.setdefault(whole.first, []).append(whole.then)

    def _edge(self, first: Event, then: Event, lag: float, kind: str, why: str) -> None:
        task = self.tasks.get(then.activity)
        if (
            then.at is At.END
            and task is not None
            and not task.moves
            and first.activity != task.name
        ):
            # what lasts as long as it lasts can only be held back before it begins
            begun = Event(At.START, task.name)
            if self.time(first) > self.time(begun) + EPSILON:
                self.tight.append((first, then, lag, kind, why))
                return
            then, lag = begun, max(0.0, lag - task.expected)
        self.put(first, then, lag, kind, why)

    def put(self, first: Event, then: Event, lag: float, kind: str, why: str) -> None:
        """Add an edge, unless there is a stronger one already."""
        if first == ORIGIN and lag <= 0.0:
            return
        known = self.edges.get((first, then))
        if known is None or known[0] < lag:
            self.edges[first, then] = (lag, kind, why)

    def _settle(self) -> None:
        """Hold tasks back before they begin, not before they end, wherever that makes no cycle."""
        for first, then, lag, kind, why in self.tight:
            begun = Event(At.START, then.activity)
            if not self._follows(begun, first):
                then, lag = begun, max(0.0, lag - self.tasks[then.activity].expected)
            self.put(first, then, lag, kind, why)
        self.tight = []

    def _follows(self, first: Event, then: Event) -> bool:
        """Return whether ``then`` has to wait for ``first`` by the edges so far."""
        graph = self._full(0.0)
        after: dict[Event, list[Event]] = {}
        for a, b in [*graph.implied, *((e.first, e.then) for e in graph.edges)]:
            after.setdefault(graph.events[a], []).append(graph.events[b])
        return _leads(after, first, then)

    def time(self, event: Event) -> float:
        """Return when an event happens as planned (s)."""
        if event.at is At.ORIGIN:
            return 0.0
        if event.at in (At.START, At.END):
            return self.tasks[event.activity].planned[0 if event.at is At.START else 1]
        drive = self.drives[event.activity, event.object]
        at = np.array([event.progress])
        return float((drive.reached if event.at is At.REACH else drive.left)(at)[0])

    def _full(self, margin: float) -> Graph:
        events: dict[Event, None] = {ORIGIN: None}
        for name in self.tasks:
            events[Event(At.START, name)] = None
            events[Event(At.END, name)] = None
        for first, then in [*self.edges, *((t[0], t[1]) for t in self.tight)]:
            events[first] = events[then] = None
        lengths = {key: round(drive.path.length, 6) for key, drive in self.drives.items()}
        return _graph(self, list(events), self.edges.items(), margin, lengths)

    def graph(self, margin: float) -> Graph:
        """Return the finished graph."""
        self._settle()
        return _finished(self._full(margin))


def _finished(full: Graph) -> Graph:
    """Return a graph reduced, with the events that are left, and seen to have no cycle."""
    edges = reduced(full)
    needed = {k for e in edges for k in (e.first, e.then)}
    inner = (At.REACH, At.LEAVE)
    kept = [k for k, e in enumerate(full.events) if k in needed or e.at not in inner]
    number = {k: i for i, k in enumerate(kept)}
    graph = Graph(
        full.tasks,
        tuple(full.events[k] for k in kept),
        tuple(full.times[k] for k in kept),
        tuple(Edge(number[e.first], number[e.then], e.lag, e.kind, e.why) for e in edges),
        tuple(Bound(number[b.first], number[b.then], b.most, b.why) for b in full.bounds),
        len(full.edges),
        full.margin,
        full.lengths,
    )
    _ = graph.order  # a cycle is an error now, not on the floor
    return graph


Side = Mapping[tuple[str, str, int], bool]
"""Who goes first in a component of two objects' obstacle: (one, other, component) -> whether
one.
"""


def with_sides(dependencies: Dependencies, sides: Side) -> Graph:
    """Return the graph with other sides for some components; :class:`ProblemError` on a cycle."""
    draft = _orders_again(dependencies)
    for meeting in dependencies.meetings:
        for step in steps_by(meeting, sides):
            draft.put(step.first, step.then, 0.0, MEETING, _why(meeting, step))
    return draft.graph(dependencies.graph.margin)


def coarse(dependencies: Dependencies) -> Dependencies:
    """Return the baseline in which motions that meet wait for each other as a whole, wherever one
    of them goes first all the way and no cycle comes of it.
    """
    draft = _orders_again(dependencies)
    for meeting in dependencies.meetings:
        draft.add_meeting(meeting)
    draft.coarsen(dependencies.meetings)
    graph = draft.graph(dependencies.graph.margin)
    return Dependencies(graph, dependencies.lives, dependencies.meetings)


def _orders_again(dependencies: Dependencies) -> Draft:
    """Return a draft with everything but who goes first where bodies would meet."""
    old = dependencies.graph
    draft = Draft(old.tasks, dependencies.lives)
    for edge in old.edges:
        if edge.kind != MEETING:
            pair = (old.events[edge.first], old.events[edge.then])
            draft.edges[pair] = (edge.lag, edge.kind, edge.why)
    for bound in old.bounds:
        pair = (old.events[bound.first], old.events[bound.then])
        draft.bounds.append((*pair, bound.most, bound.why))
    return draft


def steps_by(meeting: Meeting, sides: Side) -> list[Step]:
    """Return a meeting's steps, with other sides than planned for some components."""
    own = {c: sides[(*meeting.pair, c)] for c in meeting.components if (*meeting.pair, c) in sides}
    found = [] if own and len(own) == len(meeting.components) else steps_of(meeting, without=own)
    for component, one_first in own.items():
        found += switched(meeting, component, one_first)
    return found


def _graph(
    draft: Draft,
    events: list[Event],
    edges: Iterable[tuple[tuple[Event, Event], tuple[float, str, str]]],
    margin: float,
    lengths: Mapping[tuple[str, str], float],
    before: int = 0,
) -> Graph:
    number = {event: k for k, event in enumerate(events)}
    made = tuple(
        Edge(number[first], number[then], lag, kind, why)
        for (first, then), (lag, kind, why) in edges
    )
    bounds = tuple(
        Bound(number[first], number[then], most, why) for first, then, most, why in draft.bounds
    )
    times = tuple(draft.time(e) for e in events)
    return Graph(draft.tasks, tuple(events), times, made, bounds, before, margin, lengths)


def _backward(need: Difference) -> bool:
    """Return whether a difference only bounds how long something may take."""
    return need.lag < 0 and need.first[1] == need.then[1]


def _leads(after: Mapping[Event, list[Event]], first: Event, then: Event) -> bool:
    """Return whether there is a way from ``first`` to ``then``."""
    seen, stack = {first}, [first]
    while stack:
        for event in after.get(stack.pop(), ()):
            if event not in seen:
                seen.add(event)
                stack.append(event)
    return then in seen


def _why(meeting: Meeting, step: Step) -> str:
    x, y = step.where
    return f"{meeting.one.object} and {meeting.other.object} would meet near ({x:.1f}, {y:.1f})"


def _whole(steps: list[Step]) -> Step | None:
    """Return one step for a whole meeting, if one of the two goes first everywhere: the second
    may not begin before the first has ended.
    """
    sides = {(s.first.activity, s.then.activity) for s in steps}
    if len(sides) != 1:
        return None
    last = max(steps, key=lambda s: s.first_time)
    first = Event(At.END, last.first.activity)
    then = Event(At.START, last.then.activity) if last.then.at is At.LEAVE else last.then
    return Step(first, then, last.first_time, last.then_time, last.where)
