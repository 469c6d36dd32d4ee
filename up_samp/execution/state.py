"""What has happened so far: which events, where everybody is, what may happen next."""

from __future__ import annotations

import enum
import heapq
from collections.abc import Mapping
from dataclasses import dataclass, field

from up_samp.execution.graph import ORIGIN, At, Edge, Event, Graph
from up_samp.execution.travel import Travel


class Phase(enum.Enum):
    """How far an activity is."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"


@dataclass
class Way:
    """A motion under way: ``marks`` and ``gates`` are (progress, event), by progress."""

    activity: str
    object: str
    length: float
    travel: Travel
    marks: list[tuple[float, int]] = field(default_factory=list)
    gates: list[tuple[float, int]] = field(default_factory=list)
    progress: float = 0.0
    mark: int = 0
    gate: int = 0


class State:
    """Counts, for every event, what it still waits for. Cost of an event: its edges."""

    def __init__(self, graph: Graph, travels: Mapping[tuple[str, str], Travel], tolerance: float):
        self.tolerance = tolerance
        self.now = 0.0
        self.phase = dict.fromkeys(graph.tasks, Phase.WAITING)
        self.fired: dict[Event, float] = {}
        self.ways = {key: Way(*key, length, travels[key]) for key, length in graph.lengths.items()}
        self.of_object: dict[str, Way] = {}
        self.ways_of: dict[str, list[Way]] = {name: [] for name in graph.tasks}
        for way in self.ways.values():
            self.ways_of[way.activity].append(way)
        self.load(graph)
        self.fire(self.number[ORIGIN], 0.0)

    def load(self, graph: Graph) -> None:
        """Take a graph over the same activities; what has happened stays."""
        _ = graph.order  # no cycle
        self.graph, self.number = graph, graph.number
        count = len(graph.events)
        self.missing = [0] * count
        self.when = [self.fired.get(event) for event in graph.events]
        """When each event happened (s; ``None``: not yet)."""
        self.after: list[list[tuple[int, float]]] = [[] for _ in range(count)]
        self.timers: list[tuple[float, int]] = []
        self.into: list[list[Edge]] = [[] for _ in range(count)]
        for edge in graph.edges:
            self.into[edge.then].append(edge)
            since = self.when[edge.first]
            if since is None:
                self.after[edge.first].append((edge.then, edge.lag))
            elif since + edge.lag <= self.now:
                continue
            else:
                heapq.heappush(self.timers, (since + edge.lag, edge.then))
            self.missing[edge.then] += 1
        for way in self.ways.values():
            way.marks, way.gates, way.mark, way.gate = [], [], 0, 0
        for k, event in enumerate(graph.events):
            if event.at in (At.REACH, At.LEAVE):
                way = self.ways[event.activity, event.object]
                (way.marks if event.at is At.REACH else way.gates).append((event.progress, k))
        for way in self.ways.values():
            way.marks.sort()
            way.gates.sort()
            self._pass(way)
        self.start_number = {n: self.number[Event(At.START, n)] for n in graph.tasks}
        self.end_number = {n: self.number[Event(At.END, n)] for n in graph.tasks}

    def fire(self, number: int, now: float) -> None:
        """Note that an event happened."""
        if self.when[number] is not None:
            return
        event = self.graph.events[number]
        self.fired[event] = self.when[number] = now
        for then, lag in self.after[number]:
            if lag <= 0.0:
                self.missing[then] -= 1
            else:
                heapq.heappush(self.timers, (now + lag, then))

    def tick(self, now: float) -> None:
        """Let time pass until ``now``."""
        self.now = max(self.now, now)
        while self.timers and self.timers[0][0] <= self.now + 1e-9:
            self.missing[heapq.heappop(self.timers)[1]] -= 1

    def move(self, way: Way, progress: float) -> None:
        """Note how far a motion is; it never goes back."""
        way.progress = max(way.progress, min(progress, way.length))
        self._pass(way)

    def _pass(self, way: Way) -> None:
        at = way.progress + self.tolerance
        if self.phase[way.activity] is Phase.WAITING:
            return
        while way.mark < len(way.marks) and way.marks[way.mark][0] <= at:
            self.fire(way.marks[way.mark][1], self.now)
            way.mark += 1
        while way.gate < len(way.gates) and way.gates[way.gate][0] < way.progress - self.tolerance:
            self.fire(way.gates[way.gate][1], self.now)
            way.gate += 1

    def until(self, way: Way) -> float:
        """Return how far a motion may go: up to its next closed gate."""
        for k in range(way.gate, len(way.gates)):
            progress, number = way.gates[k]
            if self.missing[number] > 0:
                return progress
        return way.length

    def arrived(self, way: Way) -> bool:
        """Return whether a motion is at its end."""
        return way.progress >= way.length - self.tolerance

    def open(self, number: int) -> bool:
        """Return whether an event may happen now."""
        return self.missing[number] == 0
