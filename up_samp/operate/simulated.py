"""Simulated robots for a day: lost and repeated messages, breakdowns, batteries, moved by hand."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from up_samp.execution.executor import Executor
from up_samp.execution.floor import (
    Delays,
    Drive,
    Handled,
    Luck,
    SimulatedFloor,
    luck_of,
)
from up_samp.execution.reports import Report
from up_samp.fleet.batteries import first_level
from up_samp.fleet.records import FleetRecords
from up_samp.model.arrays import FloatArray
from up_samp.operate.records import Pose
from up_samp.operate.upkeep import batteries_of, is_charge, seconds_to_fill

NOWHERE = FleetRecords(map="")
"""A site without anybody."""
OFTEN, SELDOM = 0.4, 1.0
"""Seconds between two reports of a robot that drives, and of one that stands."""


@dataclass(frozen=True)
class Mishaps:
    """What goes wrong in a day: ``delays`` of driving and of tasks, ``lost`` and ``twice`` (shares
    of the reports that do not arrive, or arrive again later), and when which robot breaks down for
    how long (s).
    """

    delays: Delays = field(default_factory=Delays)
    lost: float = 0.0
    twice: float = 0.0
    breakdowns: tuple[tuple[float, str, float], ...] = ()


def driven_until(rows: FloatArray) -> float:
    """Return when a robot came to the pose at which a drive ends (s)."""
    before = np.flatnonzero(np.any(rows[:, 1:] != rows[-1, 1:], axis=1))
    return float(rows[np.max(before, initial=-1) + 1, 0])


class SimulatedRobots(SimulatedFloor):
    """All robots of a site on a simulated floor; times are those of the day."""

    def __init__(
        self,
        poses: Mapping[str, Pose],
        mishaps: Mishaps = Mishaps(),
        seed: int = 0,
        site: FleetRecords = NOWHERE,
    ) -> None:
        luck = {n: _luck(mishaps.delays, n, seed, site.senses(n)) for n in poses}
        super().__init__(poses, luck, mishaps.delays, seed)
        self.mishaps, self.initial = mishaps, dict(poses)
        self.faults: list[tuple[str, str]] = []
        self.site, self.batteries = site, batteries_of(site)
        self.levels = {n: first_level(site, n) / b.capacity for n, b in self.batteries.items()}
        """Shares of full batteries, by robot."""
        self.handled: list[Handled] = []
        self.broken: dict[str, float] = {}
        self._told_at: dict[str, float] = {}
        self._meanings: dict[str, Any] = {}
        self._random = random.Random(f"messages {seed}")
        self._later: list[Report] = []
        self._over: set[str] = set()

    def follow(self, executor: Executor) -> None:
        """Know the motions and tasks of another plan."""
        super().follow(executor)
        self._meanings |= executor.plan["meanings"]

    def pose(self, name: str) -> Pose:
        """Return where a robot really is."""
        return self.robots[name].pose

    def put(self, name: str, pose: Pose) -> None:
        """Put a robot somewhere by hand: it does nothing, and forgets what it was told."""
        robot = self.robots[name]
        self.work = {a: w for a, w in self.work.items() if w.robot != name or a in self._over}
        self._may = {a: may_end for a, may_end in self._may.items() if a in self.work}
        self._keep(robot)
        robot.motion, robot.place = None, pose
        rows = np.array([[self.now, *pose], [self.now + 1e-3, *pose]])
        self.drives.append(Drive(name, "by hand", rows))

    def step(self, now: float, seconds: float) -> None:
        """Drive for some seconds from ``now`` on."""
        for when, name, lasts in self.mishaps.breakdowns:
            if when <= now < when + lasts and name not in self.broken:
                self.broken[name] = when + lasts
        self.broken = {n: end for n, end in self.broken.items() if end > now}
        for name in self.broken:
            self.robots[name].held_until = max(self.robots[name].held_until, now + seconds)
        for name in self._may:
            work = self.work[name]
            if now < work.end and is_charge(self._meanings[name][1]):
                self.charge(work.robot, seconds)
        was = {name: robot.s for name, robot in self.robots.items()}
        self.drive(now, seconds)
        for name, robot in self.robots.items():
            self.discharge(name, robot.s - was[name], seconds)
        for name in self.stood:
            robot = self.robots[name]
            on_way = robot.motion is not None and robot.s < robot.length - 0.01
            if on_way and name not in self.broken:
                self.waited(name, seconds)

    def discharge(self, robot: str, metres: float, seconds: float) -> None:
        """Take from a battery what a drive takes; who stands uses nothing."""
        battery = self.batteries.get(robot)
        if battery is not None and metres > 0.0:
            used = battery.per_metre * metres + battery.per_second * seconds
            self.levels[robot] = max(0.0, self.levels[robot] - used / battery.capacity)

    def charge(self, robot: str, seconds: float) -> None:
        """Give a battery what a charger gives."""
        battery = self.batteries[robot]
        rate = battery.capacity / seconds_to_fill(self.site, battery, battery.capacity)
        self.levels[robot] = min(1.0, self.levels[robot] + rate * seconds / battery.capacity)

    def reports(self, now: float) -> Iterable[Report]:
        """Return what robots tell: where they are, and what they have done."""
        found, self._later = self._later, []
        for name, robot in self.robots.items():
            told = [*self.told_by(robot, now)]
            if now >= self._told_at.get(name, 0.0) + (SELDOM if robot.v == 0.0 else OFTEN):
                self._told_at[name] = now
                found += (r for report in told for r in self._sent(report))
        for name in self.done(now):
            work = self.work[name]
            if work.robot in self.broken:
                continue
            found += self._sent(Report(work.robot, now, name, done=True))
            if name not in self._over:
                self._over.add(name)
                kind, what, _ = self._meanings[name]
                self.handled.append(replace(work, kind=kind, what=what, end=now))
        return found

    def _sent(self, report: Report) -> list[Report]:
        """Return a report as often as it arrives now."""
        if self._random.random() < self.mishaps.lost:
            return []
        if self._random.random() < self.mishaps.twice:
            self._later.append(report)
        return [report]


def _luck(delays: Delays, robot: str, seed: int, senses: Mapping[str, float]) -> Luck:
    """Return what goes wrong with a robot, which may be as wrong and as late as it says."""
    found = luck_of(delays, robot, seed, 12 * 3600.0)
    noise, lag = senses.get("localisation", found.noise), senses.get("latency", found.lag)
    return replace(found, noise=noise, lag=lag)


class SteppedClock:
    """A simulated clock whose time is also that of simulated robots: they drive while it passes."""

    def __init__(self, clock: Any, robots: SimulatedRobots) -> None:
        self.clock, self.robots = clock, robots
        self.waits: bool = clock.waits

    def now(self) -> float:
        """Return the time (s)."""
        found: float = self.clock.now()
        return found

    def sleep(self, seconds: float) -> None:
        """Let time pass: robots drive, a tenth of a second at a time."""
        parts = max(1, round(seconds / 0.1))
        for _ in range(parts):
            self.robots.step(self.clock.now(), seconds / parts)
            self.clock.sleep(seconds / parts)
