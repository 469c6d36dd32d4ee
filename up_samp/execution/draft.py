"""Edges under construction: what the problem asks for, who goes first, what may be turned round."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from up_samp.execution.graph import (
    ORIGIN,
    At,
    Bound,
    Choice,
    Edge,
    Event,
    Graph,
    PlannedTask,
    Precedence,
)
from up_samp.execution.lives import Life
from up_samp.execution.meetings import Meeting
from up_samp.execution.reduce import MEETING, reduced
from up_samp.execution.staircase import Step, steps_of
from up_samp.execution.tolerances import TOLERANCES
from up_samp.model import UnsupportedError
from up_samp.scheduling.partial_order.differences import Difference, Point
from up_samp.scheduling.partial_order.order import OrderConstraint


class Draft:
    """Edges under construction, by events."""

    def __init__(self, tasks: Mapping[str, PlannedTask], lives: Mapping[str, Life]):
        self.tasks = tasks
        self.drives = {d.key: d for life in lives.values() for d in life.drives}
        self.edges: dict[tuple[Event, Event], tuple[float, str, str]] = {}
        self.bounds: list[tuple[Event, Event, float, str]] = []
        self.tight: list[tuple[Event, Event, float, str, str]] = []
        self.free: set[tuple[Event, Event]] = set()
        self.after: dict[Event, set[Event]] = {}
        """Which events wait for which, also as long as it is open how (``tight``)."""
        self.orders: list[tuple[OrderConstraint, float]] = []
        """Orders that could be the other way round (see ``settle_choices``)."""

    def add_orders(self, orders: Iterable[OrderConstraint], unit: float) -> None:
        """Add differences. Of two that ask for one instant the first one settles who goes first:
        what a change leaves behind for others comes before what is only to happen together.
        """
        for order in sorted(orders, key=_rank):
            self.add_order(order, unit)

    def add_order(self, order: OrderConstraint, unit: float) -> None:
        """Add a difference: an edge, or a bound where the plan has it the other way round.

        Raises :class:`UnsupportedError` where two changes of one instant each wait for the other.
        """
        if order.instead is not None:
            self.orders.append((order, unit))
            return
        need = order.difference
        firsts, thens = self._events(need.first), self._events(need.then)
        for first, then in itertools.product(firsts, thens):
            lag = need.lag * unit + (TOLERANCES.strict if need.strict else 0.0)
            if first == then:
                continue
            # two that are to happen at once: the second follows the first, and that is watched
            at_once = need.lag <= 0 and self._at_once(then, first)
            if at_once and need.lag == 0 and order.kind not in _WATCHED:
                raise UnsupportedError(
                    f"{first} and {then} happen at one instant, and each has to come first "
                    f"({order.why}): no executive could keep it"
                )
            late = self.time(then) < self.time(first) - TOLERANCES.same_time
            if then == ORIGIN or at_once or late or _backward(need):
                self.bounds.append((then, first, -need.lag * unit, order.why))
                continue
            self._edge(first, then, max(0.0, lag), order.kind, order.why)
            if need.lag < 0:
                self.bounds.append((then, first, -need.lag * unit, order.why))

    def _at_once(self, first: Event, then: Event) -> bool:
        """Return whether ``then`` has to wait for ``first``, and both happen at one instant."""
        now = self.time(first)
        if abs(self.time(then) - now) > TOLERANCES.same_time:
            return False
        seen, stack = {first}, [first]
        while stack:
            event = stack.pop()
            after = [*self.after.get(event, ())]
            if event.at is At.START:
                after.append(Event(At.END, event.activity))
            for later in after:
                if later not in seen and abs(self.time(later) - now) <= TOLERANCES.same_time:
                    seen.add(later)
                    stack.append(later)
        return then in seen

    def settle_choices(self) -> tuple[Choice, ...]:
        """Return the choices that all other orders leave open; what is not open is an order."""
        after = self._after()
        found: dict[tuple[Event, ...], Choice] = {}
        for order, unit in self.orders:
            one = self._precedence(order.difference, unit)
            two = None if order.instead is None else self._precedence(order.instead, unit)
            if (
                one is None
                or two is None
                or self.time(one.then) < self.time(one.first) - TOLERANCES.same_time
                or any(_leads(after, way.then, way.first) for way in (one, two))
            ):
                self.add_order(replace(order, instead=None), unit)
                continue
            key = (one.first, one.then, two.first, two.then)
            known = found.get(key)
            if known is not None:
                one, two = (
                    replace(way, lag=max(way.lag, old.lag))
                    for way, old in zip((one, two), known.ways, strict=True)
                )
            found[key] = Choice((one, two), order.kind, order.why)
        self.orders = []
        for choice in found.values():
            self.put_choice(choice)
        return tuple(found.values())

    def put_choice(self, choice: Choice, way: int = 0) -> None:
        """Add the edge of one way of a choice, unless it is asked for anyhow."""
        p = choice.ways[way]
        pair = (p.first, p.then)
        if pair not in self.edges or pair in self.free:
            self.put(p.first, p.then, p.lag, choice.kind, choice.why)
            self.free.add(pair)
        else:
            self.put(p.first, p.then, p.lag, choice.kind, choice.why)

    def _precedence(self, need: Difference, unit: float) -> Precedence | None:
        """Return a difference as a precedence, where one end has to wait for another activity."""
        if need.lag < 0 or need.first[0] != "end" or need.then[0] not in ("start", "end"):
            return None
        if need.first[1] == need.then[1]:
            return None
        lag = need.lag * unit + (TOLERANCES.strict if need.strict else 0.0)
        if need.then[0] == "end":
            # what lasts as long as it lasts is held back before it begins
            task = self.tasks[need.then[1]]
            if task.moves:
                return None
            lag = max(0.0, lag - task.expected)
        return Precedence(Event(At.END, need.first[1]), Event(At.START, need.then[1]), lag)

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
            self._edge(step.first, step.then, 0.0, MEETING, why_of(meeting, step))

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
                self.put(whole.first, whole.then, 0.0, MEETING, why_of(meeting, whole))
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
            if self.time(first) >= self.time(begun) - TOLERANCES.same_time:
                self.after.setdefault(first, set()).add(then)
                self.tight.append((first, then, lag, kind, why))
                return
            then, lag = begun, max(0.0, lag - task.expected)
        self.put(first, then, lag, kind, why)

    def put(self, first: Event, then: Event, lag: float, kind: str, why: str) -> None:
        """Add an edge, unless there is a stronger one already."""
        if first == ORIGIN and lag <= 0.0:
            return
        known = self.edges.get((first, then))
        self.after.setdefault(first, set()).add(then)
        self.free.discard((first, then))
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
        return _leads(self._after(), first, then)

    def _after(self) -> dict[Event, list[Event]]:
        """Return which events follow which directly, in whatever way it will be seen to."""
        graph = self._full(0.0)
        after: dict[Event, list[Event]] = {}
        for a, b in [*graph.implied, *((e.first, e.then) for e in graph.edges)]:
            after.setdefault(graph.events[a], []).append(graph.events[b])
        for first, then, *_ in self.tight:
            after.setdefault(first, []).append(then)
        return after

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


_WATCHED = ("constraint", "duration")
"""Kinds of orders that may ask for two things to happen together."""


def _rank(order: OrderConstraint) -> tuple[bool, bool, Point, Point]:
    need = order.difference
    # what begins when another thing ends, ends it by nothing that it does
    backward = need.then[0] == "end" and need.first[0] != "end"
    return order.kind in _WATCHED, backward, need.first, need.then


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
        tuple(replace(e, first=number[e.first], then=number[e.then]) for e in edges),
        tuple(Bound(number[b.first], number[b.then], b.most, b.why) for b in full.bounds),
        len(full.edges),
        full.margin,
        full.lengths,
    )
    _ = graph.order  # a cycle is an error now, not on the floor
    return graph


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
        Edge(number[first], number[then], lag, kind, why, (first, then) in draft.free)
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


def why_of(meeting: Meeting, step: Step) -> str:
    """Return in words who would meet where."""
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
