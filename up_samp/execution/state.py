"""The state of a plan on the floor: which events have happened, where everybody is, which gates are
open; and when the rest will happen.

Reported progress is not believed progress. A robot that tells p is somewhere in [p - L, p + L],
where L is the localisation error. So *reach* counts late: a robot has surely come to x once it
tells x + L; and *leave* counts early: it may have left x as soon as it tells more than x - L, which
is why it is told to go no farther. A closed gate stays closed whatever is told.
"""

from __future__ import annotations

import enum
import heapq
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

from up_samp.execution.graph import (
    ORIGIN,
    At,
    Bound,
    Edge,
    Event,
    Graph,
    Narrow,
    chained,
    entangled,
)
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import TravelProfile
from up_samp.model import Configuration

_MEMORY = 20.0
"""s of free driving over which a robot's pace is averaged."""
_LEAST_PACE = 0.05
"""Share of its speed; no robot is taken for slower."""


class RobotPace:
    """Each robot's pace, from what it told while nothing held it up (1: as fast as allowed)."""

    def __init__(self) -> None:
        self._driven: dict[str, float] = {}
        self._needed: dict[str, float] = {}
        self._speed: dict[str, float] = {}
        self._last: dict[str, tuple[str, float, float]] = {}

    def told(self, way: MotionUnderWay, progress: float, now: float, until: float) -> None:
        """Take in where a robot is. What it drives on its way to a closed gate does not count."""
        name = way.object
        before = self._last.get(name)
        self._last[name] = (way.activity, progress, now)
        if before is None or before[0] != way.activity or now <= before[2]:
            return
        speed = (progress - before[1]) / (now - before[2])
        rising = speed > 1.02 * self._speed.get(name, 0.0)
        self._speed[name] = speed
        if rising or speed < 1e-3:
            return  # a stop, and getting going again, say nothing of how fast it drives
        brake = way.travel.speed_at(progress) ** 2 / (2 * way.travel.accel)
        if until < way.length and progress + 1.5 * brake + 0.5 >= until:
            return
        ideal = way.travel.time_at(progress) - way.travel.time_at(before[1])
        seconds = now - before[2]
        fade = max(0.0, 1.0 - seconds / _MEMORY)
        self._driven[name] = fade * self._driven.get(name, _MEMORY / 4) + ideal
        self._needed[name] = fade * self._needed.get(name, _MEMORY / 4) + seconds

    def saved(self) -> dict[str, Any]:
        """Return all that it knows, as JSON would hold it."""
        last = {name: list(told) for name, told in self._last.items()}
        known = {"driven": self._driven, "needed": self._needed, "speed": self._speed}
        return {**{k: dict(v) for k, v in known.items()}, "last": last}

    def load(self, known: Mapping[str, Any]) -> None:
        """Take over what another one knew."""
        self._driven, self._needed = dict(known["driven"]), dict(known["needed"])
        self._speed = dict(known["speed"])
        self._last = {n: (str(a), float(p), float(t)) for n, (a, p, t) in known["last"].items()}

    @property
    def shares(self) -> dict[str, float]:
        """Each robot's share of its speed, of those that have driven freely so far."""
        ratios = {name: ideal / self._needed[name] for name, ideal in self._driven.items()}
        return {name: min(1.0, max(_LEAST_PACE, ratio)) for name, ratio in ratios.items()}


# ------------------ How far robots drive on


REACTION = 0.5
"""Seconds that pass before a robot obeys a new command, at least."""


# ------------------ What has happened so far


class TaskPhase(enum.Enum):
    """How far an activity is."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"


@dataclass
class MotionUnderWay:
    """A motion under way. ``marks`` and ``gates`` are (told progress, event), by progress: from
    where on it has surely come to a point, and up to where it has surely not left one.
    """

    activity: str
    object: str
    length: float
    travel: TravelProfile
    marks: list[tuple[float, int]] = field(default_factory=list)
    gates: list[tuple[float, int]] = field(default_factory=list)
    progress: float = 0.0
    """The farthest that was told and can be believed (m)."""
    told: float = 0.0
    """What was told last (m)."""
    since: float = 0.0
    """When ``progress`` last grew (s), or what was told beyond it."""
    let: float = 0.0
    """How far (m) its robot was let drive for good (0: what it is told can be taken back)."""
    at_end: bool = False
    """Whether the robot has said that it is at its end."""
    mark: int = 0
    gate: int = 0
    error: float = 0.0
    """How wrong (m) what its robot tells may be."""
    reaction: float = REACTION
    """Seconds that pass from what its robot tells until it obeys what comes of it."""

    def braked(self, speed: float) -> float:
        """Return how far (m) its robot at ``speed`` (m/s) drives on before it stands."""
        return speed * (self.reaction + speed / (2 * self.travel.accel))

    def reach(self, ahead: float | None) -> float:
        """Return how far (m) from where it is its robot may come to stand that is let drive
        ``ahead`` s farther than it can stand for good, and twice as far at a time (None: nothing is
        for good).
        """
        return self.braked(self.travel.fastest) + 2 * self.travel.fastest * (ahead or 0.0)


@dataclass(frozen=True)
class Strayed:
    """A robot told, at ``time`` (s), that it is at ``pose`` (x, y, theta; in the one plane of all
    paths), ``off`` m from wherever it can have been led.
    """

    pose: Configuration
    off: float
    time: float


class FloorState:
    """Counts, for every event, what it still waits for. Cost of an event: its edges.

    ``tolerance`` (m) is rounding: by how much less than a point may be told of one who stands
    there. ``errors`` (m) are how wrong reports of objects may be, ``latencies`` how late (s).
    """

    def __init__(
        self,
        graph: Graph,
        travels: Mapping[tuple[str, str], TravelProfile],
        tolerance: float,
        errors: Mapping[str, float] = MappingProxyType({}),
        latencies: Mapping[str, float] = MappingProxyType({}),
    ):
        self.tolerance, self.errors = tolerance, errors
        self.now = 0.0
        self.phase = dict.fromkeys(graph.tasks, TaskPhase.WAITING)
        self.fired: dict[Event, float] = {}
        self.moved_on: dict[Event, float] = {}
        """By how much (m) gates lie later than in the graph: robots were let drive so far before
        it was made."""
        self.ways = {
            key: MotionUnderWay(*key, length, travels[key]) for key, length in graph.lengths.items()
        }
        self.pace = RobotPace()
        self.of_object: dict[str, MotionUnderWay] = {}
        self.heard: dict[str, float] = {}
        """When each object last told something that was believed (s)."""
        self.strayed: dict[str, Strayed] = {}
        """Where robots told to be that are where they cannot have been led."""
        self.ways_of: dict[str, list[MotionUnderWay]] = {name: [] for name in graph.tasks}
        for way in self.ways.values():
            self.ways_of[way.activity].append(way)
            way.error = errors.get(way.object, 0.0)
            way.reaction = max(REACTION, latencies.get(way.object, 0.0))
        self.bars: dict[tuple[str, str], float] = {}
        """How far (m) motions may go at most because somebody is where nobody should be; what is
        set down there without a motion (by a lift, a door) goes nowhere."""
        self.limits: dict[str, float] = {}
        """How far (m) motions (by activity) may go at most by what people say of the floor."""
        self.load(graph)
        self.fire(self.number[ORIGIN], 0.0)

    def load(self, graph: Graph) -> None:
        """Take a graph over the same activities; what has happened stays."""
        _ = graph.order  # no cycle
        self.graph, self.number, self.routes = graph, graph.number, routes_of(graph, self.ways)
        count = len(graph.events)
        self.missing = [0] * count
        self.when = [self.fired.get(event) for event in graph.events]
        """When each event happened (s; ``None``: not yet)."""
        self.after: list[list[tuple[int, float]]] = [[] for _ in range(count)]
        self.timers: list[tuple[float, int]] = []
        self.into: list[list[tuple[int, Edge]]] = [[] for _ in range(count)]
        """The edges that hold each event back, with the number of what it waits for."""
        for (first, then), edge in zip(graph.pairs, graph.edges, strict=True):
            held, since = self._held(first, then), self.when[first]
            self.into[held].append((first, edge))
            if since is None:
                self.after[first].append((held, edge.lag))
            elif since + edge.lag <= self.now:
                continue
            else:
                heapq.heappush(self.timers, (since + edge.lag, held))
            self.missing[held] += 1
        self._place(graph)
        for way in self.ways.values():
            self._pass(way)
        self.start_number = {n: self.number[Event(At.START, n)] for n in graph.tasks}
        self.end_number = {n: self.number[Event(At.END, n)] for n in graph.tasks}

    def _held(self, first: int, then: int) -> int:
        """Return which event an edge holds back: what has begun before it may, by a graph that
        held it back elsewhere, does not end before that.
        """
        event = self.graph.events[then]
        begun = event.at is At.START and self.when[then] is not None
        if not begun or self.when[first] is not None:
            return then
        return self.number[Event(At.END, event.activity)]

    def _place(self, graph: Graph) -> None:
        places, self.squeezed = told_places(graph, self.errors)
        for way in self.ways.values():
            way.marks, way.gates, way.mark, way.gate = [], [], 0, 0
        for k, place in places.items():
            event = graph.events[k]
            place += self.moved_on.get(event, 0.0)
            way = self.ways[event.activity, event.object]
            (way.marks if event.at is At.REACH else way.gates).append((place, k))
        for way in self.ways.values():
            way.marks.sort()
            way.gates.sort()

    def those(self, *phases: TaskPhase) -> list[str]:
        """Return the activities that are as far as that."""
        return [name for name, phase in self.phase.items() if phase in phases]

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

    def silent(self, name: str) -> float:
        """Return for how long (s) an object has told nothing that was believed."""
        return max(0.0, self.now - self.heard.get(name, self.now))

    def driven(self, way: MotionUnderWay) -> float:
        """Return for how long (s) a motion is driven by now, by its profile: a robot under way has
        gone on since it told where it is.
        """
        begun = self.phase[way.activity] is TaskPhase.RUNNING
        return way.travel.time_at(way.progress) + (self.silent(way.object) if begun else 0.0)

    def move(self, way: MotionUnderWay, told: float) -> None:
        """Note what was told of a motion. It never goes back, and whatever is told, it is believed
        to be no farther than its closed gate allows.
        """
        if told > max(way.told, way.progress) + self.tolerance:
            way.since = self.now
        way.told = told
        self.follow(way)

    def follow(self, way: MotionUnderWay) -> None:
        """Believe what was told of a motion last, as far as its gates are open."""
        gate = self.closed(way)
        most = way.length if gate is None else self.nominal(gate) + way.error
        progress = min(way.told, most, way.length)
        if progress > way.progress:
            if progress > way.progress + self.tolerance:
                way.since = self.now
            way.progress = progress
        self._pass(way)

    def follow_all(self) -> None:
        """Believe what was told last of all motions under way: where one is opens the gates of
        others.
        """
        before: list[float] = []
        while before != (here := [way.progress for way in self.of_object.values()]):
            before = here
            for way in self.of_object.values():
                self.follow(way)

    def nominal(self, number: int) -> float:
        """Return how far (m) on its motion a point is."""
        event = self.graph.events[number]
        return event.progress + self.moved_on.get(event, 0.0)

    def move_gate(self, number: int, by: float) -> None:
        """Let a motion wait at one of its gates ``by`` m later than it did."""
        event = self.graph.events[number]
        way = self.ways[event.activity, event.object]
        self.moved_on[event] = self.moved_on.get(event, 0.0) + by
        way.gates = sorted((at + by if k == number else at, k) for at, k in way.gates)

    def _pass(self, way: MotionUnderWay) -> None:
        if self.phase[way.activity] is TaskPhase.WAITING:
            return
        while way.gate < len(way.gates):
            place, number = way.gates[way.gate]
            if self.when[number] is None:
                if self.missing[number] > 0 or place >= way.progress - self.tolerance:
                    break
                self.fire(number, self.now)
            way.gate += 1
        gate = self.closed(way)
        beyond = math.inf if gate is None else self.nominal(gate)
        at = way.progress + self.tolerance
        while way.mark < len(way.marks):
            place, number = way.marks[way.mark]
            if place > at or self.nominal(number) > beyond:
                break
            self.fire(number, self.now)
            way.mark += 1

    def closed(self, way: MotionUnderWay) -> int | None:
        """Return the event of a motion's next closed gate."""
        gate = self.next_gate(way)
        return None if gate is None else gate[1]

    def next_gate(self, way: MotionUnderWay) -> tuple[float, int] | None:
        """Return where (told progress, m) a motion's next closed gate is, and its event."""
        for place, number in way.gates[way.gate :]:
            if self.missing[number] > 0 and self.when[number] is None:
                return place, number
        return None

    def opened(self, way: MotionUnderWay) -> float:
        """Return how far a motion may go by what its robot tells: up to its next closed gate, less
        the localisation error.
        """
        gate = self.next_gate(way)
        return way.length if gate is None else gate[0]

    def until(self, way: MotionUnderWay) -> float:
        """Return how far a motion may go by what its robot tells, and not where somebody is
        astray, or beyond its limit.
        """
        found = self.limited(way)
        return min(found, self.bars.get((way.activity, way.object), found))

    def limited(self, way: MotionUnderWay) -> float:
        """Return how far a motion may go where nobody is astray."""
        return min(self.opened(way), self.limits.get(way.activity, math.inf))

    # ------------------------------------------------------------------ where robots come to rest

    def here(self, way: MotionUnderWay) -> float:
        """Return how far (m) a robot was on its motion when it last told so: a believed progress,
        but where it is known not to be there.
        """
        return way.told if self.astray(way) else way.progress

    def braking(self, way: MotionUnderWay) -> float:
        """Return the progress (m) at which a robot under way stands if it is told now to do so as
        soon as it can. Until it obeys it drives on as fast as it may, and has done so since it last
        told where it is (by an error more than that or less); but no farther than its next closed
        gate or its limit, nor than it was let drive for good.
        """
        here, seconds = self.here(way), way.reaction + self.silent(way.object)
        found = way.travel.stands_from(way.travel.time_at(here) + seconds) + way.error
        found = min(found, way.travel.length)
        if self.stands(way):
            # it may have set off so long ago that what it told since is within its error
            seconds += math.sqrt(4 * way.error / way.travel.accel)
            starts = way.travel.accel * seconds**2 if self.until(way) > here else 0.0
            found = min(found, here + starts)
        if self.astray(way) > 0.0:
            return found
        return min(found, self.limited(way), way.let or math.inf)

    def stands(self, way: MotionUnderWay) -> bool:
        """Return whether a robot under way stood when it told last where it is."""
        return self.heard.get(way.object, 0.0) >= way.since + TOLERANCES.settled

    def committed(self, way: MotionUnderWay) -> float:
        """Return the progress (m) that a robot under way comes to whatever it is told now."""
        return max(self.braking(way), min(way.let, self.until(way)))

    def rest(self, way: MotionUnderWay) -> tuple[float, float]:
        """Return the progress (m) at which a robot under way comes to rest that is told now to do
        so as soon as it can, and by when (s), unless something holds it up.
        """
        at, here = self.committed(way), self.here(way)
        if at <= here + self.tolerance:
            return at, self.now
        seconds = way.travel.within(here, at) / self.pace.shares.get(way.object, 1.0)
        return at, self.now + way.reaction + seconds

    def reached(self, way: MotionUnderWay, progress: float) -> bool:
        """Return whether a motion has surely come to a point (m) of its path."""
        if self.phase[way.activity] is TaskPhase.WAITING:
            return False
        over = self.phase[way.activity] is TaskPhase.DONE
        return over or way.progress >= progress + way.error - self.tolerance

    def arrived(self, way: MotionUnderWay) -> bool:
        """Return whether a motion is at its end: its robot tells so much, or tells no less than
        the error allows of one that is there, and says that it is. (One that tells as much and no
        more may stand twice the error before it, and others may be let in there.)
        """
        if self.closed(way) is not None:
            return False
        if way.progress >= way.length - self.tolerance:
            return True
        return way.at_end and way.progress >= way.length - way.error - self.tolerance

    def finish(self, way: MotionUnderWay) -> None:
        """Note that a motion is at its end: all of its points have been come to, and left."""
        way.progress = max(way.progress, way.length - way.error)
        for places in (way.marks, way.gates):
            for _, number in places:
                self.fire(number, self.now)
        way.mark, way.gate = len(way.marks), len(way.gates)
        self.bars.pop((way.activity, way.object), None)

    def astray(self, way: MotionUnderWay) -> float:
        """Return by how much (m) a motion is where it cannot have been led by its commands: surely
        beyond a closed gate (positive), or surely behind where it has been (negative).
        """
        gate = self.closed(way)
        if gate is not None:
            beyond = way.told - way.error - self.nominal(gate)
            if beyond > self.tolerance:
                return beyond
        back = way.told + 2 * way.error - way.progress
        return back if back < -self.tolerance else 0.0

    def may_happen(self, number: int) -> bool:
        """Return whether an event may happen now."""
        return self.missing[number] == 0 and not (self.bars and self.shut(number))

    def shut(self, number: int) -> tuple[str, ...]:
        """Return the objects that must not be set elsewhere now, as somebody is astray there or
        they are, for whom an event may not happen: the end of what sets them there, and the start
        of it if it drives nothing (what lasts as long as it lasts is held back before).
        """
        event = self.graph.events[number]
        if event.at is not At.END and not (
            event.at is At.START and not self.graph.tasks[event.activity].moves
        ):
            return ()
        here = event.activity
        return tuple(o for a, o in self.bars if a == here and (a, o) not in self.ways)


def told_places(
    graph: Graph, errors: Mapping[str, float]
) -> tuple[dict[int, float], tuple[Narrow, ...]]:
    """Return the progress (m) to be told at which each point of a path has surely been come to
    (``x + error``, at most the path's end), or has surely not been left (``x - error``, at least
    its start); ``errors`` (m) by object.

    So shifted, a robot's points may come in another order, and everybody could wait for everybody.
    Where the shifted graph has a cycle, the two points of a robot that changed places meet in the
    middle; these are returned, too.
    """
    events = graph.events
    places = {
        k: min(e.progress + errors.get(e.object, 0.0), graph.lengths[e.activity, e.object])
        if e.at is At.REACH
        else max(e.progress - errors.get(e.object, 0.0), 0.0)
        for k, e in enumerate(events)
        if e.at in (At.REACH, At.LEAVE)
    }
    turned = _turned(graph, places, errors)
    squeezed: list[Narrow] = []
    while turned:
        pairs = [*chained(graph, places), *graph.pairs]
        tangle = entangled(len(events), pairs)
        if not tangle:
            break
        for mark, gate in [p for p in turned if p[0] in tangle and p[1] in tangle]:
            one, two = events[mark], events[gate]
            where, whole = (one.progress, two.progress), two.progress - one.progress
            squeezed.append(Narrow((one.object,), (one.activity,), where, whole / 2))
            middle = (one.progress + two.progress) / 2
            places[mark], places[gate] = min(places[mark], middle), max(places[gate], middle)
        turned = _turned(graph, places, errors)
    return places, tuple(squeezed)


def _turned(
    graph: Graph, places: Mapping[int, float], errors: Mapping[str, float]
) -> list[tuple[int, int]]:
    """Return the (mark, gate) of one robot of which the gate holds it back from the mark, though
    the mark comes first (by less than twice its error, m).
    """
    on_way: dict[tuple[str, str], list[int]] = {}
    for k in places:
        event = graph.events[k]
        on_way.setdefault((event.activity, event.object), []).append(k)
    found = []
    for (_, robot), numbers in on_way.items():
        wide = 2 * errors.get(robot, 0.0)
        numbers.sort(key=lambda k: (graph.events[k].progress, graph.events[k].at is At.LEAVE))
        for i, mark in enumerate(numbers):
            if graph.events[mark].at is At.LEAVE:
                continue
            end = graph.events[mark].progress + wide
            for gate in numbers[i + 1 :]:
                if graph.events[gate].progress >= end:
                    break
                if graph.events[gate].at is At.LEAVE and places[gate] < places[mark]:
                    found.append((mark, gate))
    return found


# ------------------ When all of it will happen, if nothing more goes wrong


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


def forecast(state: FloorState) -> Forecast:
    """Return when everything happens as soon as possible from now on: the longest path over the
    graph, with the bodies' speed profiles and the paces seen so far.
    """
    graph, now, paces = state.graph, state.now, state.pace.shares
    times = [now] * len(graph.events)
    moved = _since_now(state, paces)
    when, (before, loss), into = state.when, state.routes, state.into
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
    return Forecast(graph, now, tuple(times), state.routes, paces)


def _since_now(state: FloorState, pace: Mapping[str, float]) -> dict[int, float]:
    """Return when motions under way come to their next events: they have gone on since they told
    where they are.
    """
    found: dict[int, float] = {}
    for way in state.ways.values():
        if state.phase[way.activity] is not TaskPhase.RUNNING:
            continue
        # what comes after the first of them follows from it: it may have to wait there
        ahead = (*way.marks[way.mark :][:1], *way.gates[way.gate :][:1])
        end = math.inf, state.end_number[way.activity]
        at, k = min(ahead, key=lambda p: _on_path(state.graph, p[1]), default=end)
        driving = way.travel.time_at(at) - way.travel.time_at(way.progress)
        left = driving / pace.get(way.object, 1.0) - state.silent(way.object)
        found[k] = max(found.get(k, state.now), state.now + left)
    # an end waits for all that drive, also for those that come by something before it
    for way in state.ways.values():
        if way.marks[way.mark :] or way.gates[way.gate :]:
            found.pop(state.end_number[way.activity], None)
    return found


def _on_path(graph: Graph, number: int) -> tuple[float, bool]:
    event = graph.events[number]
    return event.progress, event.at is At.LEAVE
