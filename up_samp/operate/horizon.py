"""Where a plan is cut: what of it stays, and where everybody stands once that is done.

What has begun stays, and so does what begins before a new plan can be there, and everything that
any of it waits for: a set of activities closed under what comes before. An order that is picked up
is delivered by the same robot, so it stays whole. Nothing else has been told to anybody.

Where a robot is out of order, an area must not be entered any more, or activities are withdrawn
(their order was cancelled, or changed), events never happen; whoever waits for one of them stops
where it would wait, and is free from there.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from up_samp.execution.executor import Executor
from up_samp.execution.graph import At, Event
from up_samp.execution.meetings import moving
from up_samp.execution.state import Forecast, TaskPhase
from up_samp.execution.tolerances import TOLERANCES
from up_samp.fleet.meanings import Kind, Meaning
from up_samp.io.plan_dict import PlanDict
from up_samp.model import Body
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.model.frames import Frame
from up_samp.model.graphs import reached
from up_samp.motion.fleet.conflicts import conflicting_cells
from up_samp.motion.fleet.paths import Path, resting_path
from up_samp.operate.records import Pose

DELIVERS = (Kind.DELIVERY, Kind.TASK)
"""What ends an order or a task."""


def driven_before(motion: Mapping[str, Any]) -> float:
    """Return how much (m) a robot had driven of a motion of a plan when that began: its progress on
    the plan's motion counts from there, and robots count all of it.
    """
    return float(motion.get("from", 0.0))


@dataclass(frozen=True)
class Cut:
    """``kept``: activities that stay, in the plan's order. ``starts``: from where on (m) motions
    under way are part of it. ``stops``: how far (m) motions that have
    begun still go, where they end early. ``poses``: where each robot, and each door, stands when
    all that is done; ``free``: in how many seconds. ``carrying``: the orders that are on board
    then, and of whom. ``jobs``: orders and tasks that stay as they are.
    """

    since: float
    kept: tuple[str, ...] = ()
    stops: Mapping[str, float] = field(default_factory=dict)
    starts: Mapping[str, float] = field(default_factory=dict)
    poses: Mapping[str, Pose] = field(default_factory=dict)
    free: Mapping[str, float] = field(default_factory=dict)
    carrying: Mapping[str, str] = field(default_factory=dict)
    jobs: tuple[str, ...] = ()
    begun: Mapping[str, float] = field(default_factory=dict)
    """What had begun by then, and for how long (s)."""
    gone: Mapping[str, float] = field(default_factory=dict)
    """How far (m) robots told to be on what is left of motions under way."""
    away: frozenset[str] = frozenset()
    """Robots that did nothing then, and stand at their ``poses``."""

    def part_of(self, motion: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is kept of a motion; progress on it counts from where it begins."""
        name, rows, s = motion["activity"], [*motion["samples"]], [*motion["progress"]]
        begin, end = self.starts.get(name, 0.0), self.stops.get(name, math.inf)
        if end - TOLERANCES.arrived <= s[-1]:
            k = max(1, int(np.searchsorted(s, end - TOLERANCES.arrived)))
            s[k:], rows[k:] = [round(end, 6)], [_sample(rows, s, k, end)]
        if not begin:
            return {**motion, "samples": rows, "progress": s}
        k = min(int(np.searchsorted(s, begin, side="right")), len(s) - 1)
        rows = [_sample(rows, s, k, begin), *rows[k:]]
        s = [0.0, *(round(float(p - begin), 6) for p in s[k:])]
        before = round(driven_before(motion) + begin, 6)
        return {**motion, "samples": rows, "progress": s, "from": before}

    def on_part(self, event: Event) -> Event | None:
        """Return an event by its progress on what is kept of its motion (None: that begins beyond
        it, or does not come to it).
        """
        begin, end = self.starts.get(event.activity), self.stops.get(event.activity, math.inf)
        if event.at not in (At.REACH, At.LEAVE):
            return None if event.at is At.END and end < math.inf else event
        if event.progress > end or (begin is not None and event.progress <= begin):
            return None
        return replace(event, progress=event.progress - (begin or 0.0))

    def on_whole(self, event: Event) -> Event:
        """Return an event of what is kept by its progress on the motion that was cut."""
        return replace(event, progress=event.progress + self.starts.get(event.activity, 0.0))


def _sample(rows: Sequence[Sequence[float]], s: Sequence[float], k: int, at: float) -> list[float]:
    """Return the sample of a motion at ``at`` m, between its samples ``k`` - 1 and ``k``."""
    low, high = s[k - 1 : k + 1]
    share = (at - low) / (high - low) if high > low else 0.0
    pairs = zip(rows[k - 1], rows[k], strict=True)
    return [round(float(a + share * (b - a)), 9) for a, b in pairs]


LEAST = 0.1
"""m of a motion under way that are left of it at least."""
ROUNDED = 1e-5
"""m by which what is left of a motion is shorter than its cells, so that rounding adds none."""


class Opened(enum.Enum):
    """What of a robot's work is planned anew: all that is not begun, or what comes after its last
    stop.
    """

    ALL = "all"
    TAIL = "tail"


def meanings_of(plan: PlanDict) -> dict[str, Meaning]:
    """Return what the activities of a plan stand for."""
    return {name: Meaning(Kind(k), what, who) for name, (k, what, who) in plan["meanings"].items()}


class Cutter:
    """Finds where a plan can be cut.

    ``broken``: robots that drive no more, and where they stand. ``limits``: how far (m) motions may
    go, where that is less than their whole length. ``opened``: the robots whose work is planned
    anew; what others do stays. ``cramped``: those of them that drive on until
    they stand in nobody's way; who comes to where another one stands waits until that has gone.
    ``opening``: what ``broken`` ones do that goes on without them, a door that opens: it stays.
    """

    def __init__(
        self,
        executor: Executor,
        *,
        broken: Mapping[str, Pose] = MappingProxyType({}),
        limits: Mapping[str, float] = MappingProxyType({}),
        opened: Mapping[str, Opened] = MappingProxyType({}),
        cramped: Collection[str] = (),
        opening: Collection[str] = (),
    ) -> None:
        self.executor, self.state, self.cramped = executor, executor.state, cramped
        self.opening = opening
        self.broken, self.limits, self.opened = broken, limits, opened
        self.meanings = meanings_of(executor.plan)
        self.turns = executor.turns
        self.events = self.state.graph.events
        self.before: dict[int, list[int]] = {}
        self.after: dict[int, list[int]] = {}
        for first, then in self._pairs():
            self.before.setdefault(then, []).append(first)
            self.after.setdefault(first, []).append(then)
        self.dead = self._dead()
        self.stops: dict[str, float] = {}

    def _pairs(self) -> Iterable[tuple[int, int]]:
        graph = self.state.graph
        yield from graph.pairs
        yield from graph.implied
        for turn in self.turns.values():
            for one, two in itertools.pairwise(turn):
                yield self.state.end_number[one], self.state.start_number[two]

    def _open(self, name: str) -> bool:
        return self.state.phase[name] is not TaskPhase.DONE

    def _dead(self) -> frozenset[int]:
        """Return the events that never happen."""
        seeds = []
        for k, event in enumerate(self.events):
            if event.at is At.ORIGIN or self.state.when[k] is not None:
                continue
            limit = self.limits.get(event.activity)
            beyond = limit is not None and (
                event.at is At.END or (event.object and event.progress > limit)
            )
            gone = event.activity in self.executor.withdrawn
            if gone or self.meanings[event.activity].robot in self.broken or beyond:
                seeds.append(k)
        return self._closure(seeds, self.after)

    def _closure(self, seeds: Iterable[int], next_: Mapping[int, list[int]]) -> frozenset[int]:
        """Return what hangs on some events and has not happened, these included."""

        def to_come(some: Iterable[int]) -> list[int]:
            return [k for k in some if self.state.when[k] is None]

        return frozenset(reached(to_come(seeds), lambda k: to_come(next_.get(k, ()))))

    def _alive(self, name: str) -> bool:
        return self.state.end_number[name] not in self.dead

    def cut(self, ahead: float) -> Cut:
        """Return where nothing that begins within ``ahead`` s is touched."""
        now, forecast = self.state.now, self.executor.retime()
        running = self.state.those(TaskPhase.RUNNING)
        stays = {n for robot, turn in self.turns.items() for n in self._staying(robot, turn)}
        waiting = self.state.those(TaskPhase.WAITING)
        soon = [n for n in waiting if n in stays or forecast.span(n)[0] <= now + ahead]
        # what does not come to its end may begin nevertheless, and goes as far as it can
        begun = (n for n in soon if self.state.start_number[n] not in self.dead)
        some = (*running, *(n for n in begun if forecast.span(n)[0] <= now + ahead))
        ended = {n: s for n in some if not self._alive(n) if (s := self._stop(n)) is not None}
        kept = self._whole({n for n in (*running, *soon) if self._alive(n)}, ended)
        stay = kept | ended.keys()
        tails = {n: s for n in kept if (s := self._tail(n, stay, ahead, forecast)) is not None}
        kept = (kept - tails.keys()).union(self.opening)
        # who has not moved does not move
        self.stops = stops = {n: s for n, s in (ended | tails).items() if s > 0.0}
        order = {n: i for turn in self.turns.values() for i, n in enumerate(turn)}
        listed = sorted((*kept, *stops), key=lambda n: (order[n], n))
        free: dict[str, float] = {}
        for name in listed:
            who = self.meanings[name].robot
            end = max(now, forecast.span(name)[1])
            if name in stops:
                way, since = self.state.ways_of[name][0], max(now, forecast.span(name)[0])
                end = since + way.travel.time_at(stops[name]) - self.state.driven(way) + 1.0
            free[who] = max(free.get(who, 0.0), end - now)
        starts = self._starts(listed)
        under_way = {n: w for n in listed for w in self.state.ways_of[n] if n in running}
        over = kept | {n for n in self.meanings if not self._open(n)}
        return Cut(
            since=now,
            kept=tuple(listed),
            stops=stops,
            starts=starts,
            poses=self._poses(over, stops),
            free=free,
            carrying=on_board(self.executor, self.meanings, over),
            jobs=tuple(sorted({self.meanings[n].what for n in kept if self.meanings[n].what})),
            begun={n: now - since for n, (since, _) in self.executor.times().items()},
            gone={n: max(0.0, w.told - starts.get(n, 0.0)) for n, w in under_way.items()},
            away=frozenset(self.broken),
        )

    def _starts(self, names: Iterable[str]) -> dict[str, float]:
        """Return from where on (m) motions under way count: what is driven is over, and others may
        stand there by now.
        """
        found = {}
        for name in names:
            for way in self.state.ways_of[name]:
                if self.state.phase[name] is TaskPhase.RUNNING:
                    most = self.stops.get(name, way.length) - LEAST
                    most = min(way.progress - way.error, most)
                    edges = self._edges(name, way.object) + ROUNDED
                    found[name] = float(edges[edges <= most].max(initial=0.0))
        return found

    def _staying(self, robot: str, turn: list[str]) -> list[str]:
        """Return what stays of a robot's work because it is not planned anew."""
        if self.opened.get(robot) is Opened.ALL:
            return []
        if robot not in self.opened:
            return turn
        last = max((i for i, n in enumerate(turn) if self._does_job(n)), default=-1)
        return turn[: last + 1]

    def _whole(self, chosen: set[str], ended: dict[str, float]) -> set[str]:
        """Return activities with all that they wait for, and orders whole. ``ended``: how far (m)
        motions go that end early; those are added on whose way there somebody is waited for.
        """
        size = -1
        while len(chosen) + len(ended) != size:
            size = len(chosen) + len(ended)
            ends = [self.state.end_number[n] for n in chosen]
            ends += list(itertools.starmap(self._last, ended.items()))
            names = {self.events[k].activity for k in self._closure(ends, self.before)} - {""}
            chosen |= {n for n in names if self._alive(n)}
            halves = {n: self._stop(n) for n in names - chosen - ended.keys()}
            ended |= {n: s for n, s in halves.items() if s is not None}
            picked = {
                self.meanings[n].what
                for n, phase in self.state.phase.items()
                if self.meanings[n].kind is Kind.PICKUP and (n in chosen or phase is TaskPhase.DONE)
            }
            chosen |= {
                n
                for n, meaning in self.meanings.items()
                if meaning.kind is Kind.DELIVERY
                and meaning.what in picked
                and self._open(n)
                and self._alive(n)
            }
            # who is on the way to an order does it: the robot's next stop stays, too
            chosen |= {n for n in map(self._stop_after, chosen) if n is not None}
        return chosen

    def _stop_after(self, name: str) -> str | None:
        """Return what a robot drives somewhere for, where that can still be done."""
        if self.meanings[name].kind not in (Kind.MOVE, Kind.CARRY):
            return None
        return next(
            (n for n in self._after(name)[:1] if self._alive(n) and self._does_job(n)), None
        )

    def _after(self, name: str) -> list[str]:
        """Return what a robot is to do after an activity."""
        turn = self.turns[self.meanings[name].robot]
        return turn[turn.index(name) + 1 :]

    def _does_job(self, name: str) -> bool:
        return self.meanings[name].kind in (Kind.PICKUP, *DELIVERS)

    def _stop(self, name: str) -> float | None:
        """Return how far (m) a motion goes that does not come to its end (None: nobody drives)."""
        ways = self.state.ways_of[name]
        if not ways or ways[0].object in self.broken:
            return None
        way = ways[0]
        gates = [place for place, number in way.gates if number in self.dead]
        limit = self.limits.get(name, way.length)
        most, waits = min([limit, *gates]), self.state.phase[name] is TaskPhase.WAITING
        # it goes to where it was told that it may, but stops at a limit, if it has not passed that
        least = 0.0 if waits else max(min(self.state.committed(way), limit), way.told)
        edges = self._edges(name, way.object) - ROUNDED
        found = float(edges[edges <= most].max(initial=0.0))
        return found if found >= least else max(most, least)

    def _edges(self, name: str, robot: str) -> FloatArray:
        """Return where on its way (m) a motion can be cut so that what is kept has the same cells,
        and robots wait for the same others at the same places as before: every second edge of them.
        """
        return np.asarray(self.executor.drives[name, robot].path.edges[2::2])

    def _last(self, name: str, stop: float) -> int:
        """Return the last event of a motion that ends early (m)."""
        (way, *_), events = self.state.ways_of[name], self.events
        passed = [
            k
            for _, k in (*way.marks, *way.gates)
            if events[k].progress <= stop and k not in self.dead
        ]
        start = self.state.start_number[name]
        return max(
            passed, key=lambda k: (events[k].progress, events[k].at is At.LEAVE), default=start
        )

    def _tail(
        self, name: str, kept: Collection[str], ahead: float, forecast: Forecast
    ) -> float | None:
        """Return how far (m) a robot that is planned anew goes on in a drive that leads to nothing
        it has to do: until it can stand where nobody comes to rest, or, one of ``cramped``, in
        nobody's way (None: it is no such drive, or to its end). ``kept``: all that stays, also what
        ends early.
        """
        robot, ways = self.meanings[name].robot, self.state.ways_of[name]
        if (
            robot not in self.opened
            or self.meanings[name].kind is not Kind.MOVE
            or any(self._alive(n) or n in kept for n in self._after(name))
            or len(ways) != 1
        ):
            return None
        way, now = ways[0], self.state.now
        since = max(now, forecast.span(name)[0])
        time = self.state.driven(way) + max(0.0, now + ahead - since)
        least = float(np.interp(time, way.travel.time, way.travel.progress))
        if self.state.phase[name] is TaskPhase.WAITING and now + ahead <= since:
            least = 0.0
        else:
            # at full speed, and what it told last is a moment old
            least += way.travel.fastest * way.reaction + LEAST + way.reach(self.executor.ahead)
        drives = self.executor.drives
        path = drives[name, way.object].path
        margin = self.state.graph.margin + way.error
        others = [
            (
                drives[n, w.object].path,
                w.progress if robot in self.cramped else w.length - LEAST,
                margin + w.error,
            )
            for n in kept
            for w in self.state.ways_of[n]
            if w.object != way.object and (n, w.object) in drives
        ]
        edges = np.append(0.0, self._edges(name, way.object) - ROUNDED)
        tried = -math.inf
        for at in edges[(edges >= least) & (edges < way.length - path.radius)]:
            if at < tried + path.radius:
                continue
            tried = at
            rest = resting_path(path.body, pose_of(path.poses_at(np.array([at]))[0]))
            if not any(_meets(other, gone, rest, apart) for other, gone, apart in others):
                return float(at)
        return None

    def _poses(self, over: Collection[str], stops: Mapping[str, float]) -> dict[str, Pose]:
        """Return where robots and doors stand once activities are ``over``, and motions end that
        do so early.
        """
        found = {o["name"]: pose_of(o["initial"]) for o in self.executor.plan["objects"]}
        drives = self.executor.drives
        for turn in self.turns.values():
            for name in turn:
                for way in self.state.ways_of[name]:
                    at = way.length if name in over else stops.get(name)
                    if at is not None:
                        path = drives[name, way.object].path
                        found[way.object] = pose_of(path.poses_at(np.array([at]))[0])
        for change in sorted(self.executor.plan["changes"], key=lambda c: c["time"]):
            if change["activity"] in over:
                found[change["object"]] = pose_of(change["configuration"])
        return {**found, **self.broken}


def on_board(
    executor: Executor, meanings: Mapping[str, Meaning], over: Collection[str]
) -> dict[str, str]:
    """Return which orders are on board, and of whom, once some activities are ``over``."""
    some = [meanings[name] for name in meanings if name in over]
    had = executor.plan.get("on_board", {})
    picked = {m.what: m.robot for m in some if m.kind is Kind.PICKUP}
    brought = {m.what for m in some if m.kind in DELIVERS}
    return {what: who for what, who in {**had, **picked}.items() if what not in brought}


def _meets(path: Path, gone: float, rest: Path, apart: float) -> bool:
    """Return whether the part of a path that begins at ``gone`` m comes too near to a rest."""
    rows = np.asarray(conflicting_cells(moving(path), moving(rest), apart))
    return bool(len(rows)) and bool(np.any(path.edges[rows[:, 0] + 1] > gone))


def pose_of(values: Iterable[float]) -> Pose:
    """Return a pose of plain numbers."""
    x, y, theta = (round(float(v), 6) for v in values)
    return x, y, theta


def touches(body: Body, poses: FloatArray, area: BaseGeometry) -> BoolArray:
    """Return at which poses (n, 3) a body touches an area."""
    shapely.prepare(area)
    corners = np.asarray(body.footprint)
    there = shapely.polygons([Frame(*pose).points(corners) for pose in poses.tolist()])
    return np.asarray(shapely.intersects(area, there), dtype=bool)


def first_inside(executor: Executor, shapes: Collection[Polygon]) -> dict[str, float]:
    """Return how far (m) the motions that are not over may go until their robot would touch one of
    some shapes. A robot that touches one already, or cannot stop before, drives on out of it: it
    comes into no other one, nor back.
    """
    found: dict[str, float] = {}
    for (name, robot), drive in executor.drives.items():
        phase = executor.state.phase[name]
        if phase is TaskPhase.DONE:
            continue
        way = executor.state.ways[name, robot]
        here = 0.0 if phase is TaskPhase.WAITING else executor.state.braking(way)
        at = np.arange(here, way.length + 0.1, 0.1).clip(max=way.length)
        for shape in shapes:
            inside = touches(drive.path.body, drive.path.poses_at(at), shape)
            out = int(np.argmin(inside))  # the first look at which it is outside
            if not inside[out] and inside[out:].any():
                hit = out + int(np.argmax(inside[out:]))
                most = float(max(at[out], at[hit] - 0.2))
                found[name] = min(most, found.get(name, most))
    return found
