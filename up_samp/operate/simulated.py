"""Simulated robots for a day: noise, delays, lost and repeated messages, breakdowns.

They drive as :class:`up_samp.execution.simulate.SimulatedRobot` does, know nothing of the plan but
what they are told, and keep what they really drove, for whoever judges it.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from up_samp.execution.executor import Executor
from up_samp.execution.reports import Command, Do, Go, Hold
from up_samp.execution.simulate import Delays, Luck, SimulatedRobot
from up_samp.fleet.batteries import first_level
from up_samp.fleet.records import FleetRecords
from up_samp.model.arrays import FloatArray
from up_samp.operate.records import Pose, Report
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


@dataclass
class Drive:
    """What a robot drove: rows (t, x, y, theta), at rest before and after, shape (n, 4)."""

    robot: str
    activity: str
    rows: FloatArray = field(default_factory=lambda: np.empty((0, 4)))

    def __post_init__(self) -> None:
        self.rows = np.asarray(self.rows, dtype=np.float64)  # lists take six times the memory


def driven_until(rows: FloatArray) -> float:
    """Return when a robot came to the pose at which a drive ends (s)."""
    before = np.flatnonzero(np.any(rows[:, 1:] != rows[-1, 1:], axis=1))
    return float(rows[np.max(before, initial=-1) + 1, 0])


@dataclass(frozen=True)
class Handled:
    """What was done at a place: ``kind`` as in :class:`up_samp.fleet.statements.Kind` by its value,
    of which order (``what``), by whom, from when to when (s).
    """

    kind: str
    what: str
    robot: str
    start: float
    end: float


Told = tuple[Mapping[tuple[str, str], Any], Mapping[tuple[str, str], Any], Mapping[str, float], Any]
"""What robots know of a plan: their paths and how fast these may be driven (by activity and robot),
how long tasks last (s), and what activities stand for.
"""


def routes_told(executor: Executor) -> Told:
    """Return what robots know of an executor's plan."""
    return (
        {key: drive.path for key, drive in executor.drives.items()},
        dict(executor.dependencies.travels),
        {n: t.expected for n, t in executor.state.graph.tasks.items()},
        executor.plan["meanings"],
    )


class SimulatedRobots:
    """All robots of a site on a simulated floor; times are those of the day."""

    def __init__(
        self,
        poses: Mapping[str, Pose],
        mishaps: Mishaps = Mishaps(),
        seed: int = 0,
        site: FleetRecords = NOWHERE,
    ) -> None:
        self.mishaps, self.seed = mishaps, seed
        self.faults: list[tuple[str, str]] = []
        self.site, self.batteries = site, batteries_of(site)
        self.levels = {n: first_level(site, n) / b.capacity for n, b in self.batteries.items()}
        """Shares of full batteries, by robot."""
        self.poses: dict[str, Pose] = dict(poses)
        self.initial = dict(poses)
        self.robots = {n: SimulatedRobot(n, self._luck(n, site.senses(n))) for n in poses}
        self.drives: list[Drive] = []
        self.handled: list[Handled] = []
        self.waits: dict[str, list[tuple[float, float, Pose]]] = {n: [] for n in poses}
        """(from, until, where) robots stood though they had a motion to drive, and were not broken
        down.
        """
        self.broken: dict[str, float] = {}
        self._ends: dict[str, tuple[float, str, float]] = {}
        self._paths: Mapping[tuple[str, str], Any] = {}
        self._path_of: dict[str, Any] = {}
        """The path of the motion that each robot drives, or drove last."""
        self._travels: Mapping[tuple[str, str], Any] = {}
        self._told_at: dict[str, float] = {}
        self._expected: Mapping[str, float] = {}
        self._meanings: dict[str, Any] = {}
        self._may: dict[str, bool] = {}
        self._now = 0.0
        self._random = random.Random(f"messages {seed}")
        self._later: list[Report] = []
        self._finished: set[str] = set()

    def _luck(self, name: str, senses: Mapping[str, float]) -> Luck:
        """Return what goes wrong with a robot, which may be as wrong and as late as it says."""
        d = self.mishaps.delays
        rng = random.Random(f"robot {name} {self.seed}")
        stops, at = [], 0.0
        while d.stops > 0.0 and d.stop_seconds > 0.0 and at < 12 * 3600:
            at += rng.expovariate(d.stops / 60.0)
            stops.append((at, rng.expovariate(1.0 / d.stop_seconds)))
        bias = rng.choice((-1.0, 1.0)) * d.bias * rng.random()
        tracked = rng.random() < 0.5
        noise, lag = senses.get("localisation", d.noise), senses.get("latency", d.lag)
        return Luck(
            1.0 - d.slow * rng.random(), tuple(stops), None, bias, noise, lag, tracked,
            seed=f"{name} {self.seed}",
        )  # fmt: skip

    def follow(self, executor: Executor) -> None:
        """Know the paths of another plan."""
        self.know(routes_told(executor))

    def know(self, told: Told) -> None:
        """Know the paths of another plan, without its executor."""
        self._paths, self._travels, self._expected, meanings = told
        self._meanings |= meanings

    def tell(self, commands: Mapping[str, Command], now: float) -> None:
        """Obey from now on."""
        self._may = {}
        for name, robot in self.robots.items():
            command = commands.get(name)
            if isinstance(command, Go):
                if robot.motion != command.motion:
                    self._begin(robot, command.motion, now)
                robot.until = command.until
            robot.hold = isinstance(command, Hold)
        for who, command in commands.items():
            if isinstance(command, Do):
                self._may[command.activity] = command.may_end
                if command.activity not in self._ends and command.activity not in self._finished:
                    rng = random.Random(f"task {command.activity} {self.seed}")
                    longer = 1.0 + self.mishaps.delays.late * rng.random()
                    end = now + self._expected[command.activity] * longer
                    self._ends[command.activity] = (end, who, now)

    def _begin(self, robot: SimulatedRobot, motion: str, now: float) -> None:
        self._keep(robot)
        self._path_of[robot.name] = self._paths[motion, robot.name]
        robot.begin(motion, self._travels[motion, robot.name], now)
        self.drives.append(Drive(robot.name, motion))

    def _keep(self, robot: SimulatedRobot) -> None:
        """Put what a robot has driven on record."""
        if robot.motion is None:
            return
        path = self._path_of[robot.name]
        drive = next(d for d in reversed(self.drives) if d.robot == robot.name)
        times, s = np.array(robot.trace).T
        drive.rows = np.column_stack([times, path.poses_at(np.clip(s, 0.0, path.length))])
        x, y, theta = (float(v) for v in drive.rows[-1, 1:])
        self.poses[robot.name] = (x, y, theta)

    def pose(self, name: str) -> Pose:
        """Return where a robot really is."""
        path = self._path_of.get(name)
        if path is None:
            return self.poses[name]
        s = min(self.robots[name].s, path.length)
        x, y, theta = (float(v) for v in path.poses_at(np.array([s]))[0])
        return x, y, theta

    def put(self, name: str, pose: Pose) -> None:
        """Put a robot somewhere by hand: it does nothing, and forgets what it was told."""
        robot = self.robots[name]
        self._ends = {a: end for a, end in self._ends.items() if end[1] != name}
        self._keep(robot)
        robot.motion = None
        self._path_of.pop(name, None)
        self.poses[name] = pose
        rows = np.array([[self._now, *pose], [self._now + 1e-3, *pose]])
        self.drives.append(Drive(name, "by hand", rows))

    def step(self, now: float, seconds: float) -> None:
        """Drive for some seconds from ``now`` on."""
        for when, name, lasts in self.mishaps.breakdowns:
            if when <= now < when + lasts and name not in self.broken:
                self.broken[name] = when + lasts
        self.broken = {n: end for n, end in self.broken.items() if end > now}
        self._now = round(now + seconds, 6)
        for activity, (end, who, _) in self._ends.items():
            if now < end and is_charge(self._meanings[activity][1]):
                self.charge(who, seconds)
        for name, robot in self.robots.items():
            if robot.motion is None:
                continue
            if name in self.broken:
                robot.held_until = max(robot.held_until, now + seconds)
            was = robot.s
            robot.step(now, seconds)
            self.discharge(name, robot.s - was, seconds)
            if robot.s <= was and robot.s < robot.length - 0.01 and name not in self.broken:
                self._wait(name, now, self._now)

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

    def _wait(self, name: str, since: float, until: float) -> None:
        waits = self.waits[name]
        if waits and abs(waits[-1][1] - since) < 1e-6:
            waits[-1] = (waits[-1][0], until, waits[-1][2])
        else:
            waits.append((since, until, self.pose(name)))

    def reports(self, now: float) -> Iterable[Report]:
        """Return what robots tell: where they are, and what they have done."""
        found, self._later = self._later, []
        for name, robot in self.robots.items():
            if robot.motion is None:
                continue
            told = robot.told(now)
            if now < self._told_at.get(name, 0.0) + (SELDOM if robot.v == 0.0 else OFTEN):
                continue
            self._told_at[name] = now
            if told is not None:
                told = min(max(told, 0.0), robot.length)
                found += self._sent(Report(name, now, robot.motion, told))
            if robot.arrived:
                found += self._sent(Report(name, now, robot.motion, done=True))
        for activity, (end, who, since) in list(self._ends.items()):
            if end <= now and self._may.get(activity, False) and who not in self.broken:
                report = Report(who, now, activity, done=True)
                sent = self._sent(report)
                found += sent
                if activity not in self._finished:
                    self._finished.add(activity)
                    kind, what, _ = self._meanings[activity]
                    self.handled.append(Handled(kind, what, who, since, now))
            elif activity in self._finished and activity not in self._may:
                del self._ends[activity]
        return found

    def _sent(self, report: Report) -> list[Report]:
        """Return a report as often as it arrives now."""
        if self._random.random() < self.mishaps.lost:
            return []
        if self._random.random() < self.mishaps.twice:
            self._later.append(report)
        return [report]

    def close(self) -> None:
        """Put what is driven last on record."""
        for robot in self.robots.values():
            self._keep(robot)


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
