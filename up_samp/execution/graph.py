"""The dependency graph of a plan: events, and which may not happen before which.

A temporal plan graph (Hönig et al., "Multi-agent path finding with kinematic constraints", ICAPS
2016) over continuous motions: its events are starts and ends of activities and points on paths.
Times and lags in s, progress in m along a path (the parameter ``s`` of
:class:`up_samp.motion.fleet.paths.Path`).
"""

from __future__ import annotations

import enum
import heapq
import itertools
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from graphlib import CycleError, TopologicalSorter

from up_samp.execution.tolerances import TOLERANCES
from up_samp.model import ProblemError


class At(enum.Enum):
    """What happens in an event. ``LEAVE`` is going beyond a point, ``REACH`` is having come to it:
    a robot may stand at a gate that it may not leave. A *gate* is an event ``LEAVE`` for which an
    edge asks something, and is closed until that has happened.
    """

    ORIGIN = "origin"
    START = "start"
    END = "end"
    REACH = "reach"
    LEAVE = "leave"


@dataclass(frozen=True)
class Event:
    """``activity`` starts or ends, or its ``object`` reaches or leaves ``progress`` (m)."""

    at: At
    activity: str = ""
    object: str = ""
    progress: float = 0.0

    def __str__(self) -> str:
        if self.at is At.ORIGIN:
            return "the plan's start"
        if self.at in (At.START, At.END):
            return f"{self.at.value} of {self.activity}"
        verb = "reaches" if self.at is At.REACH else "leaves"
        return f"{self.object} {verb} {self.progress:.2f} m in {self.activity}"


ORIGIN = Event(At.ORIGIN)

MEETING = "meeting"
"""The kind of edges that say who goes first where two bodies would meet."""
ZONE = "zone"
"""The kind of edges that say who has to have left a zone before who may come into it."""


@dataclass(frozen=True)
class Edge:
    """Event ``then`` may not happen before ``lag`` s after event ``first``.

    ``kind`` is a stable word, ``why`` names who, where and which constraint.
    """

    first: Event
    then: Event
    lag: float
    kind: str = ""
    why: str = ""
    free: bool = False
    """Whether it is one way of a choice, and the other one would do as well."""

    @property
    def fixed(self) -> bool:
        """Whether it stays when meetings are re-ordered and choices are turned round."""
        return self.kind != MEETING and not self.free

    def __str__(self) -> str:
        lag = f"{self.lag:g} s after " if self.lag > TOLERANCES.strict else ""
        return f"{self.then} does not wait for {lag}{self.first} ({self.why})"


Choice = tuple[Edge, Edge]
"""Two edges either of which does what the problem asks: which job a machine takes first, who has a
place or the only unit of a resource first. The first one is the plan's.
"""


@dataclass(frozen=True)
class Bound:
    """Event ``then`` is wanted at most ``most`` s after event ``first``: a deadline, a window, the
    longest duration. No executive can enforce it; it is watched.
    """

    first: Event
    then: Event
    most: float
    why: str


@dataclass(frozen=True)
class Narrow:
    """Where less than the localisation error is covered: an error of ``kept`` m.

    Two ``objects`` pass each other near ``where`` (x, y; m), in ``activities`` (``""``: at rest);
    or one has to stand between two points ``where`` (m) of its motion: it has to have come to the
    first before it may leave the second.
    """

    objects: tuple[str, ...]
    activities: tuple[str, ...]
    where: tuple[float, float]
    kept: float

    def __str__(self) -> str:
        names = " and ".join(f"'{name}'" for name in self.objects)
        doing = "; ".join(name or "resting" for name in self.activities)
        a, b = self.where
        kept = f"a localisation error of {self.kept:.3f} m is covered, not more"
        if len(self.objects) == 1:
            return f"{names} has to stand between {a:.3f} and {b:.3f} m of '{doing}': {kept}"
        return f"{names} ({doing}) pass near ({a:.1f}, {b:.1f}) so closely that {kept}"


@dataclass(frozen=True)
class PlannedTask:
    """An activity of the plan. ``planned`` start and end in s; ``expected`` is how long (s) it
    lasts without disturbance where it drives nothing; ``who`` are the robots that do it.
    """

    name: str
    planned: tuple[float, float]
    expected: float
    who: tuple[str, ...] = ()
    moves: tuple[str, ...] = ()
    """The objects that it drives."""


@dataclass(frozen=True)
class Graph:
    """Events, edges and bounds of a plan. Within a motion, events follow each other by progress
    without edges; so do an activity's start, its motions and its end.

    ``times[k]`` is when event ``k`` happens as planned (s). ``before_reduction`` counts the edges
    that there were before those that follow from others were dropped.
    """

    tasks: Mapping[str, PlannedTask]
    events: tuple[Event, ...]
    times: tuple[float, ...]
    edges: tuple[Edge, ...]
    bounds: tuple[Bound, ...] = ()
    before_reduction: int = 0
    margin: float = 0.0
    lengths: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """Length (m) of each motion's path, by (activity, object)."""

    @cached_property
    def number(self) -> dict[Event, int]:
        """Each event's number."""
        return {event: k for k, event in enumerate(self.events)}

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """The edges by their events' numbers."""
        return [(self.number[e.first], self.number[e.then]) for e in self.edges]

    @property
    def planned(self) -> float:
        """When the last activity ends as planned (s)."""
        return max((task.planned[1] for task in self.tasks.values()), default=0.0)

    @cached_property
    def implied(self) -> tuple[tuple[int, int], ...]:
        """Pairs of events (first, then) that follow each other by themselves."""
        on_path = {
            k: event.progress
            for k, event in enumerate(self.events)
            if event.at in (At.REACH, At.LEAVE)
        }
        return tuple(chained(self, on_path))

    @cached_property
    def order(self) -> tuple[int, ...]:
        """All events in an order in which they can happen; :class:`ProblemError` on a cycle."""
        pairs = [*self.pairs, *self.implied]
        found = topological(len(self.events), pairs, self.times)
        if len(found) < len(self.events):
            names = ", ".join(str(self.events[k]) for k in _circle(pairs))
            raise ProblemError(f"the dependencies have a cycle: nobody could go first of {names}")
        return tuple(found)


def chained(graph: Graph, places: Mapping[int, float]) -> list[tuple[int, int]]:
    """Return pairs of events (first, then) that follow each other by themselves, where the points
    on paths come in the order of their ``places``.
    """
    events, number = graph.events, graph.number
    pairs: list[tuple[int, int]] = []
    on_path: dict[tuple[str, str], list[int]] = {}
    for k in places:
        on_path.setdefault((events[k].activity, events[k].object), []).append(k)
    origin = number[ORIGIN]
    for name in graph.tasks:
        start, end = number[Event(At.START, name)], number[Event(At.END, name)]
        pairs += [(origin, start), (start, end)]
    for (activity, _), inner in on_path.items():
        ordered = sorted(inner, key=lambda k: (places[k], events[k].at is At.LEAVE))
        chain = [number[Event(At.START, activity)], *ordered, number[Event(At.END, activity)]]
        pairs += itertools.pairwise(chain)
    return pairs


def entangled(count: int, pairs: Sequence[tuple[int, int]]) -> set[int]:
    """Return the numbers that lie on a cycle of the pairs, or between two cycles."""
    times = [0.0] * count
    placed = topological(count, pairs, times)
    return set(range(count)).difference(
        placed, topological(count, [pair[::-1] for pair in pairs], times)
    )


def _circle(pairs: Iterable[tuple[int, int]]) -> list[int]:
    """Return events that each wait for the one before, the first one for the last."""
    into: dict[int, set[int]] = {}
    for first, then in pairs:
        into.setdefault(then, set()).add(first)
    try:
        TopologicalSorter(into).prepare()
    except CycleError as error:
        return list(error.args[1][:-1])
    return []


def topological(count: int, pairs: Sequence[tuple[int, int]], times: Sequence[float]) -> list[int]:
    """Return the numbers 0 .. count - 1 so that each pair's first comes first, without those that
    lie on a cycle or after one (Kahn 1962). Of those that could come next, the one with the least
    planned time does.
    """
    after: list[list[int]] = [[] for _ in range(count)]
    missing = [0] * count
    for first, then in pairs:
        after[first].append(then)
        missing[then] += 1
    heap = [(times[k], k) for k in range(count) if missing[k] == 0]
    heapq.heapify(heap)
    found = []
    while heap:
        _, k = heapq.heappop(heap)
        found.append(k)
        for then in after[k]:
            missing[then] -= 1
            if missing[then] == 0:
                heapq.heappush(heap, (times[then], then))
    return found


# ------------------ Transitive reduction: edges that follow from others are dropped
# What happened before an event is told by the bits of a whole number. An edge is redundant where
# another edge into the same event tells as much.


def reduced(graph: Graph) -> list[Edge]:
    """Return the edges that do not follow from the others. Those with a lag of their own are all
    kept; "strictly after" follows from any way that has a lag.

    What the problem asks for is dropped only where it follows from other things that the problem
    asks for: who goes first where bodies would meet, and what is free to be turned round, may still
    change.
    """
    orders = [e for e in graph.edges if e.fixed]
    kept = set(_needed(replace(graph, edges=tuple(orders)), frozenset()))
    meetings = [e for e in graph.edges if not e.fixed]
    needed = set(_needed(replace(graph, edges=(*kept, *meetings)), frozenset(kept)))
    return [e for e in graph.edges if e in needed]


def _needed(graph: Graph, always: frozenset[Edge]) -> list[Edge]:
    """Return the edges ``always`` kept, and those others that do not follow."""
    into: dict[int, list[tuple[int, Edge]]] = defaultdict(list)
    for (first, then), edge in zip(graph.pairs, graph.edges, strict=True):
        into[then].append((first, edge))
    before: dict[int, list[int]] = defaultdict(list)
    for first, then in graph.implied:
        before[then].append(first)
    rank = {event: k for k, event in enumerate(graph.order)}

    def turn(item: tuple[int, Edge]) -> tuple[bool, int, float]:
        first, edge = item  # latest first: what comes before it follows from it
        return edge not in always, -rank[first], -edge.lag

    by_then, strictly, found = [0] * len(graph.events), [0] * len(graph.events), []
    for event in graph.order:
        known = strict = 0
        for first in before[event]:
            known |= by_then[first]
            strict |= strictly[first]
        for first, edge in sorted(into[event], key=turn):
            follows = (known if edge.lag <= 0.0 else strict) >> first & 1
            if edge in always or edge.lag > TOLERANCES.strict or not follows:
                found.append(edge)
                known |= by_then[first]
                strict |= (strictly if edge.lag <= 0.0 else by_then)[first]
        by_then[event], strictly[event] = known | 1 << event, strict
    return found
