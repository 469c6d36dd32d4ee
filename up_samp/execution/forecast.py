"""The forecast of all events if nothing more goes wrong: the longest path over the graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from up_samp.execution.graph import At, Bound, Event, Graph
from up_samp.execution.state import FloorState, MotionUnderWay, TaskPhase

Routes = tuple[tuple[tuple[tuple[int, float, str], ...], ...], tuple[float, ...]]
"""What each event of a graph follows by itself, with the times this takes without disturbance:
(event, s, robot); and by how much (s) it is late if one must stop there.
"""


@dataclass(frozen=True)
class Forecast:
    """``times[k]`` (s) for each event of ``graph``, as soon as possible from ``now`` on."""

    graph: Graph
    now: float
    times: tuple[float, ...]
    routes: Routes
    pace: Mapping[str, float]

    @cached_property
    def latest(self) -> tuple[float, ...]:
        """The latest time (s) of each event that delays neither the makespan nor a bound."""
        graph, times, number = self.graph, self.times, self.graph.number
        latest = [max(times, default=0.0)] * len(times)
        for bound in graph.bounds:
            then = number[bound.then]
            latest[then] = min(latest[then], times[number[bound.first]] + bound.most)
        outgoing: list[list[tuple[int, float]]] = [[] for _ in times]
        for (first, then), edge in zip(graph.pairs, graph.edges, strict=True):
            outgoing[first].append((then, edge.lag))
        for k, before in enumerate(self.routes[0]):
            for first, seconds, who in before:
                outgoing[first].append((k, seconds / self.pace.get(who, 1.0)))
        for k in reversed(graph.order):
            for then, seconds in outgoing[k]:
                # what the forecast adds for stopping and starting is no slack
                latest[k] = min(latest[k], latest[then] - min(seconds, times[then] - times[k]))
        return tuple(latest)

    @cached_property
    def makespan(self) -> float:
        """When the last activity ends (s)."""
        number = self.graph.number
        ends = (self.times[number[Event(At.END, name)]] for name in self.graph.tasks)
        return max(ends, default=self.now)

    def span(self, name: str) -> tuple[float, float]:
        """Return when an activity starts and ends (s)."""
        number = self.graph.number
        return (
            self.times[number[Event(At.START, name)]],
            self.times[number[Event(At.END, name)]],
        )

    def over(self, bound: Bound) -> float:
        """Return by how much (s) a bound is missed (negative: it is kept)."""
        number = self.graph.number
        return self.times[number[bound.then]] - self.times[number[bound.first]] - bound.most

    def slack(self, name: str) -> float:
        """Return by how much an activity may end later without delaying anything that counts."""
        end = self.graph.number[Event(At.END, name)]
        return self.latest[end] - self.times[end]


def routes_of(graph: Graph, ways: Mapping[tuple[str, str], MotionUnderWay]) -> Routes:
    """Return travel times between neighbouring events."""
    before: list[list[tuple[int, float, str]]] = [[] for _ in graph.events]
    loss = [0.0] * len(graph.events)
    at_time: dict[int, float] = {}
    for k, event in enumerate(graph.events):
        if event.at in (At.REACH, At.LEAVE):
            travel = ways[event.activity, event.object].travel
            at_time[k] = travel.time_at(event.progress)
            if event.at is At.LEAVE:
                loss[k] = travel.speed_at(event.progress) / (2 * travel.accel)
    for first, then in graph.implied:
        one, two = graph.events[first], graph.events[then]
        seconds, who = 0.0, ""
        if one.at is At.START and two.at is At.END:
            task = graph.tasks[one.activity]
            if task.moves:
                seconds = max(
                    (w.travel.whole for k, w in ways.items() if k[0] == task.name),
                    default=0.0,
                )
                who = task.moves[0]
            else:
                seconds = task.expected
        elif two.at is At.END:
            whole = ways[one.activity, one.object].travel.whole
            seconds, who = whole - at_time[first], one.object
        elif one.at is not At.ORIGIN:
            seconds = at_time[then] - at_time.get(first, 0.0)
            who = two.object
        before[then].append((first, seconds, who))
    return tuple(map(tuple, before)), tuple(loss)


def forecast(state: FloorState, routes: Routes, pace: Mapping[str, float]) -> Forecast:
    """Return when everything happens from now on; ``pace`` scales each robot's speed (1: full)."""
    graph, now = state.graph, state.now
    count = len(graph.events)
    times = [now] * count
    moved = _since_now(state, pace)
    paces = dict(pace)
    when, (before, loss), into = state.when, routes, state.into
    for k in graph.order:
        past = when[k]
        if past is not None:
            times[k] = past
            continue
        came = now
        for first, seconds, who in before[k]:
            at = times[first] + seconds / paces.get(who, 1.0)
            came = max(came, at)
        came = moved.get(k, came)
        allowed = now
        for first, edge in into[k]:
            at = times[first] + edge.lag
            allowed = max(allowed, at)
        if allowed > came:
            # it stops at the gate and has to get going again
            times[k] = allowed + min(loss[k], allowed - came)
        else:
            times[k] = came
    return Forecast(graph, now, tuple(times), routes, paces)


def _since_now(state: FloorState, pace: Mapping[str, float]) -> dict[int, float]:
    """Return when motions under way come to their next events: they have gone on since they told
    where they are.
    """
    found, graph = {}, state.graph
    for way in state.ways.values():
        if state.phase[way.activity] is not TaskPhase.RUNNING:
            continue
        speed = pace.get(way.object, 1.0)
        here, silent = way.travel.time_at(way.progress), state.silent(way.object)
        ahead = [m for m in (way.marks[way.mark :], way.gates[way.gate :]) if m]
        # what comes after the first of them follows from it: it may have to wait there
        for progress, k in sorted((p[0] for p in ahead), key=lambda p: _on_path(graph, p[1]))[:1]:
            left = (way.travel.time_at(progress) - here) / speed - silent
            found[k] = state.now + max(0.0, left)
        end = state.end_number[way.activity]
        left = (way.travel.whole - here) / speed - silent
        found[end] = max(found.get(end, state.now), state.now + left)
    # an end waits for the events on the way, too: only the first is taken from here
    for way in state.ways.values():
        if way.marks[way.mark :] or way.gates[way.gate :]:
            found.pop(state.end_number[way.activity], None)
    return found


def _on_path(graph: Graph, number: int) -> tuple[float, bool]:
    event = graph.events[number]
    return event.progress, event.at is At.LEAVE
