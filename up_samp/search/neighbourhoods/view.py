"""The plan that a neighbourhood is chosen in: who is busy when, who waits for whom, who meets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from up_samp.model import ScheduledMotion, Trajectory, UnsupportedError
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling.compilers.read import read_problem as read_plain
from up_samp.scheduling.partial_order import Difference, Planned, orders_of
from up_samp.scheduling.partial_order.differences import HORIZON, ZERO, Point
from up_samp.search.bounds import Incumbent
from up_samp.search.neighbourhoods.owners import Owners
from up_samp.upio import Relaxation, read_itinerary
from up_samp.upio.restrict import restrict


@dataclass(frozen=True)
class Wait:
    """``who`` could do something sooner at ``time`` (units), were it not for ``whom``."""

    who: str
    whom: str
    time: int


@dataclass(frozen=True)
class View:
    """A plan, and what is told of it by the differences that the problem asks for."""

    relaxation: Relaxation
    snapshot: Snapshot
    owners: Owners
    plan: Incumbent

    @property
    def times(self) -> Mapping[str, tuple[int, int]]:
        """Start and end (units) of what is present."""
        return self.plan.schedule.times

    @cached_property
    def robots(self) -> list[str]:
        """The robots that are busy in the plan or could be."""
        return self.owners.robots

    @cached_property
    def last_ends(self) -> dict[str, int]:
        """Robot -> when it is done (units)."""
        found = dict.fromkeys(self.robots, 0)
        for name, (_, end) in self.times.items():
            for robot in self.owners.of.get(name, ()):
                found[robot] = max(found[robot], end)
        return found

    def busy(self, since: float, until: float) -> list[str]:
        """Return the robots that do something between two times (units)."""
        found = {
            robot
            for name, (start, end) in self.times.items()
            if start < until and since < end
            for robot in self.owners.of.get(name, ())
        }
        return sorted(found)

    @cached_property
    def motions(self) -> tuple[ScheduledMotion, ...]:
        """The motions of the plan, in order of time."""
        return read_itinerary(self.relaxation, self.plan.schedule).motions

    def trajectory(self, motion: ScheduledMotion) -> Trajectory | None:
        """Return how a motion is made in the plan."""
        return self.plan.trajectories.get(motion.activity)

    @cached_property
    def tight(self) -> Sequence[Difference]:
        """The differences that leave no slack: neither end of one can shift alone. Empty where the
        problem asks for more than differences.
        """
        schedule = self.plan.schedule
        problem = restrict(self.relaxation, self.snapshot, schedule)
        try:
            planned = Planned(read_plain(problem), schedule.times, schedule.parameters)
            orders = orders_of(planned, self.snapshot)
        except UnsupportedError:
            return ()
        asked = (o.difference for o in orders)
        return [d for d in asked if _slack(planned, d) <= 0 and HORIZON not in (d.first, d.then)]

    @cached_property
    def waits(self) -> list[Wait]:
        """Who waits for whom, in order of time."""
        found = set()
        for d in self.tight:
            if ZERO in (d.first, d.then):
                continue
            for who in self.owners.of.get(d.then[1], ()):
                for whom in self.owners.of.get(d.first[1], ()):
                    if who != whom:
                        found.add(Wait(who, whom, self._time(d.then)))
        return sorted(found, key=lambda w: (w.time, w.who, w.whom))

    @cached_property
    def critical(self) -> list[str]:
        """Activities that the plan's end hangs on, the last one first."""
        before: dict[Point, list[Point]] = {}
        for d in self.tight:
            before.setdefault(d.then, []).append(d.first)
        makespan = self.plan.schedule.makespan
        todo = [("end", n) for n, (_, end) in sorted(self.times.items()) if end == makespan]
        seen: dict[Point, None] = dict.fromkeys(todo)
        while todo:
            point = todo.pop(0)
            inside = [("start", point[1])] if point[0] == "end" else []
            for first in sorted({*before.get(point, ()), *inside}):
                if first not in seen and first != ZERO:
                    seen[first] = None
                    todo.append(first)
        names = dict.fromkeys(name for _, name in seen)
        return sorted(names, key=lambda n: (-self.times[n][1], n))

    def _time(self, point: Point) -> int:
        return self.times[point[1]][0 if point[0] == "start" else 1]

    # -- who is near ---------------------------------------------------------------------------
    def near(self, motion: ScheduledMotion) -> list[str]:
        """Return the robots that move at the same time as a motion, the nearest first."""
        mine = self.trajectory(motion)
        if mine is None:
            return []
        found: dict[str, float] = {}
        for other in self.motions:
            if other.object == motion.object or not _overlap(motion, other):
                continue
            theirs = self.trajectory(other)
            if theirs is not None:
                gap = min(_gap(mine, theirs), found.get(other.object, math.inf))
                found[other.object] = gap
        return sorted(found, key=lambda name: (found[name], name))


def _slack(planned: Planned, d: Difference) -> int:
    return planned.time(d.then) - planned.time(d.first) - d.lag - d.strict


def _overlap(one: ScheduledMotion, two: ScheduledMotion) -> bool:
    return one.start < two.end and two.start < one.end


def _gap(one: Trajectory, two: Trajectory, moments: int = 16) -> float:
    """Return how far (m) two bodies are from each other at the nearest of some ``moments``: it only
    says who is worth a look.
    """
    since, until = max(one.start, two.start), min(one.end, two.end)
    if since > until:
        return math.inf
    times = np.linspace(since, until, moments)
    apart = [
        np.interp(times, one.times, one.poses[:, k]) - np.interp(times, two.times, two.poses[:, k])
        for k in (0, 1)
    ]
    return float(np.hypot(*apart).min())
