"""A simulated floor: robots that drive along their paths and do what is to be done at places, what
goes wrong there, and one clock.

Robots know nothing of a plan but their paths and what they are told. What they tell of it, and what
they really did, is kept apart, for whoever judges it.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from up_samp.execution.build import Dependencies
from up_samp.execution.executor import Executor
from up_samp.execution.reports import Command, Do, Go, Hold, Report
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import TravelProfile
from up_samp.model import ProblemError
from up_samp.model.arrays import FloatArray
from up_samp.motion.fleet.paths import Path

Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Delays:
    """Delays as the field's benchmarks draw them.

    ``slow``: each robot drives at a share of its speed drawn from [1 - slow, 1].
    ``stops``: random stops, on average so many for a minute of driving, each of a length drawn
    from an exponential distribution with mean ``stop_seconds``.
    ``long_stop``: one robot stops once for so many seconds, at a random time.
    ``late``: tasks that drive nothing take up to this share longer.

    What robots tell is wrong, too: by a constant of up to ``bias`` m (each robot's own, either
    sign), by up to ``noise`` m more that is drawn anew for each report, and it is told ``lag`` s
    late. Some drive by what they tell, some better than that (others tell where they are).
    """

    slow: float = 0.0
    stops: float = 0.0
    stop_seconds: float = 5.0
    long_stop: float = 0.0
    late: float = 0.0
    bias: float = 0.0
    noise: float = 0.0
    lag: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.slow < 1.0:
            raise ProblemError(f"delays: 'slow' must be at least 0 and below 1, not {self.slow}")
        for name in ("stops", "stop_seconds", "long_stop", "late", "bias", "noise", "lag"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ProblemError(f"delays: '{name}' must be a number, and not negative")

    @staticmethod
    def of_share(share: float) -> Delays:
        """Return delays of all kinds that grow with ``share`` (0.3: delays of 30 %)."""
        return Delays(slow=share, stops=2.0 * share, stop_seconds=5.0, late=share)

    @staticmethod
    def parse(text: str) -> Delays:
        """Read ``30%`` or ``slow=0.3,stops=1,stop_seconds=5,long_stop=20,late=0.5``."""
        delays = Delays()
        for part in filter(None, (p.strip() for p in text.split(","))):
            key, equals, value = part.partition("=")
            try:
                if not equals and key.endswith("%"):
                    delays = Delays.of_share(float(key[:-1]) / 100)
                elif equals and key in Delays.__dataclass_fields__:
                    delays = replace(delays, **{key: float(value)})
                else:
                    raise ValueError(part)
            except ValueError as error:
                known = ", ".join(Delays.__dataclass_fields__)
                raise ProblemError(
                    f"delays '{part}': write a share such as 30%, or NAME=NUMBER of {known}"
                ) from error
        return delays


@dataclass(frozen=True)
class Luck:
    """What goes wrong with one robot in one draw, the same for every way of execution: ``pace``
    (share of its speed), ``stops`` (after so many seconds of driving, length), one ``halt`` (time,
    length).

    And how wrong its reports are: ``bias`` (m, told minus true progress), ``noise`` (m, drawn from
    [-noise, noise] by a generator of ``seed``) and ``lag`` (s). A ``tracked`` robot drives by the
    truth, and others tell where it is.
    """

    pace: float = 1.0
    stops: tuple[tuple[float, float], ...] = ()
    halt: tuple[float, float] | None = None
    bias: float = 0.0
    noise: float = 0.0
    lag: float = 0.0
    tracked: bool = False
    seed: str = ""


def draw(delays: Delays, dependencies: Dependencies, seed: int) -> dict[str, Luck]:
    """Draw each robot's luck in one run of a plan."""
    names = sorted(life.object for life in dependencies.lives.values() if life.drives)
    makespan, halts = dependencies.graph.planned, {}
    if delays.long_stop > 0.0 and names:
        rng = random.Random(f"halt {seed}")
        held = rng.choice(names)
        halts[held] = rng.uniform(0.05, 0.6) * makespan, delays.long_stop
    return {n: luck_of(delays, n, seed, 4 * makespan, halts.get(n)) for n in names}


def luck_of(
    delays: Delays,
    robot: str,
    seed: int,
    seconds: float,
    halt: tuple[float, float] | None = None,
) -> Luck:
    """Draw a robot's luck for so many seconds of driving. Every robot has a generator of its own,
    and so has every task (:func:`lateness`).
    """
    rng = random.Random(f"robot {robot} {seed}")
    pace = 1.0 - delays.slow * rng.random()
    stops = tuple(_stops(delays, rng, seconds))
    rng = random.Random(f"senses {robot} {seed}")
    bias = rng.choice((-1.0, 1.0)) * delays.bias * rng.choice((1.0, 1.0, rng.random()))
    tracked = rng.random() < 0.5
    told = f"noise {robot} {seed}"
    return Luck(pace, stops, halt, bias, delays.noise, delays.lag, tracked, told)


def lateness(delays: Delays, task: str, seed: int) -> float:
    """Draw by which factor a task that drives nothing takes longer."""
    return 1.0 + delays.late * random.Random(f"task {task} {seed}").random()


def _stops(delays: Delays, rng: random.Random, horizon: float) -> list[tuple[float, float]]:
    found: list[tuple[float, float]] = []
    if delays.stops <= 0.0 or delays.stop_seconds <= 0.0:
        return found
    at = rng.expovariate(delays.stops / 60.0)
    while at < horizon:
        found.append((at, rng.expovariate(1.0 / delays.stop_seconds)))
        at += rng.expovariate(delays.stops / 60.0)
    return found


# ------------------ A simulated robot on its path
# It has bounded speed and acceleration, always able to stop in time. What
# it tells of where it is may be wrong, and so may be what it drives by.


@dataclass
class Drive:
    """What a robot drove: rows (t, x, y, theta), at rest before and after, shape (n, 4), and its
    ``trace`` along the path that it was told, rows (t, progress in m; none: it was put elsewhere).
    """

    robot: str
    activity: str
    rows: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    trace: FloatArray = field(default_factory=lambda: np.empty((0, 2)))

    def __post_init__(self) -> None:
        self.rows = np.asarray(self.rows, dtype=np.float64)


class SimulatedRobot:
    """One motion after the other. ``trace`` holds (time, progress) of the motion under way."""

    def __init__(self, name: str, luck: Luck, place: Pose):
        self.name, self.luck, self.place = name, luck, place
        self._noise = random.Random(luck.seed)
        self.stops, self.halt = deque(luck.stops), luck.halt
        self.driven = 0.0
        """Seconds of driving so far, without stops."""
        self.held_until = -math.inf
        self.overruns = 0
        self.motion: str | None = None
        self.trace: list[tuple[float, float]] = []
        self.drive = Drive(name, "")
        """What it drives, or drove last, on record."""
        self.s = self.v = self.until = 0.0
        """True progress (m), speed (m/s), and how far it has been told that it may go (m)."""
        self.wrong = 0.0
        """Told minus true progress (m)."""
        self.hold = False
        """Whether it has been told to stay where it is."""
        self.known: deque[tuple[float, float]] = deque()
        """(time, progress) that is still to be told."""
        self.timetable: tuple[FloatArray, FloatArray] | None = None
        """Times (s) and progress (m) ahead of which it is not to be (None: as fast as it can)."""

    def begin(self, motion: str, path: Path, travel: TravelProfile, now: float) -> None:
        """Take up a motion, at rest."""
        self.motion, self.path, self.travel = motion, path, travel
        self.s = self.v = self.until = 0.0
        self.length = travel.length
        self.next_stop = 0
        self.trace, self.drive = [(now, 0.0)], Drive(self.name, motion)
        self.known.clear()
        self._look()

    @property
    def pose(self) -> Pose:
        """Where it really is."""
        if self.motion is None:
            return self.place
        s = min(self.s, self.path.length)
        x, y, theta = (float(v) for v in self.path.poses_at(np.array([s]))[0])
        return x, y, theta

    def _look(self) -> None:
        spread = self.luck.noise
        self.wrong = self.luck.bias + (self._noise.uniform(-spread, spread) if spread else 0.0)

    @property
    def believed(self) -> float:
        """Progress (m) by which it drives."""
        return self.s if self.luck.tracked else self.s + self.wrong

    def told(self, now: float) -> float | None:
        """Return the progress (m) that it tells at ``now`` (``None``: nothing yet)."""
        self.known.append((now, self.s + self.wrong))
        found = None
        while self.known and self.known[0][0] <= now - self.luck.lag + 1e-9:
            found = self.known.popleft()[1]
        return found

    @property
    def arrived(self) -> bool:
        """Whether it takes itself to be at the end of its motion, or has come to it, and stands."""
        at_end = max(self.believed, self.s) >= self.length - TOLERANCES.step
        return self.v == 0.0 and self.until >= self.length - TOLERANCES.step and at_end

    def step(self, now: float, dt: float) -> None:
        """Drive for ``dt`` s from ``now`` on: not beyond ``until`` (m, as it believes), where it
        can stop, and not ahead of its timetable at the step's end, as far as its brakes allow.
        """
        a = self.travel.accel
        self._disturb(now)
        stops = self.travel.stops
        while self.next_stop < len(stops) - 1 and self.s >= stops[self.next_stop] - 1e-9:
            self.next_stop += 1
        until = self.until if self.luck.tracked else self.until - self.wrong
        goal = min(max(until, self.s), stops[self.next_stop], self.length)
        left = goal - self.s
        if now < self.held_until or self.hold:
            wish = 0.0
        elif left <= TOLERANCES.step and self.v <= 2 * TOLERANCES.step / dt:
            # the last bit in one go
            self.s, self.v = max(self.s, goal), 0.0
            self._note(now + dt)
            self._look()
            return
        else:
            soon = self.travel.cap_at(self.s + self.v * dt)
            wish = self.luck.pace * min(self.travel.cap_at(self.s), soon)
            if self.timetable is not None:
                ceiling = float(np.interp(now + dt, *self.timetable))
                wish = min(wish, 2 * (ceiling - self.s) / dt - self.v)
        # the largest speed at the step's end from which it stops before the goal:
        # (v + w) dt / 2 + w^2 / (2 a) = left
        room = left - 0.5 * self.v * dt
        brake = -0.5 * a * dt + math.sqrt(max(0.0, 0.25 * a * a * dt * dt + 2 * a * room))
        hard = self.v - a * dt
        if brake < hard - 1e-6 and self.v > 1e-9 and not self.hold and not self.luck.noise:
            self.overruns += 1
        w = max(0.0, hard, min(wish, brake, self.v + a * dt))
        went = 0.5 * (self.v + w) * dt
        if w == 0.0 and hard < 0.0:
            went = min(went, self.v * self.v / (2 * a) if wish <= 0.0 else went)
        self.driven += dt if now >= self.held_until else 0.0
        self.s = min(self.s + max(0.0, went), max(goal, self.s))
        self.v = w
        self._note(now + dt)
        self._look()

    def _disturb(self, now: float) -> None:
        while self.stops and self.driven >= self.stops[0][0]:
            self.held_until = max(self.held_until, now + self.stops.popleft()[1])
        if self.halt is not None and now >= self.halt[0]:
            self.held_until = max(self.held_until, now + self.halt[1])
            self.halt = None

    def _note(self, now: float) -> None:
        last = self.trace[-1]
        if len(self.trace) >= 2 and self.trace[-2][1] == last[1] == self.s:
            self.trace[-1] = (now, self.s)  # it still stands
        else:
            self.trace.append((now, self.s))


# ------------------ The floor


@dataclass(frozen=True)
class Handled:
    """What was done at a place: ``kind`` as in :class:`up_samp.fleet.meanings.Kind` by its value,
    of which order (``what``), by whom, from when to when (s).
    """

    kind: str
    what: str
    robot: str
    start: float
    end: float


class SimulatedFloor:
    """Robots, first at ``poses``, with their ``luck``, and what they do at places, which takes
    longer by ``delays``. Times in s.
    """

    def __init__(
        self, poses: Mapping[str, Pose], luck: Mapping[str, Luck], delays: Delays, seed: int
    ) -> None:
        self.delays, self.seed, self.now = delays, seed, 0.0
        self.robots = {n: SimulatedRobot(n, luck[n], pose) for n, pose in poses.items()}
        self.drives: list[Drive] = []
        self.waits: dict[str, list[tuple[float, float, Pose, str]]] = {n: [] for n in poses}
        """(from, until, where, for whom) robots stood, as :meth:`waited` was told."""
        self.stood: list[str] = []
        """Robots that came no farther in the last step."""
        self.work: dict[str, Handled] = {}
        """All that was ever begun at places, by activity, with its end if nothing holds it up."""
        self._may: dict[str, bool] = {}
        """Activities that are to be done now, and whether they may end."""

    def follow(self, executor: Executor) -> None:
        """Know the motions and tasks of another plan."""
        self._paths = {key: drive.path for key, drive in executor.drives.items()}
        self._travels = executor.dependencies.travels
        self._tasks = executor.dependencies.graph.tasks

    def tell(self, commands: Mapping[str, Command], now: float) -> None:
        """Let everybody do something else from now on."""
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
                name = command.activity
                self._may[name] = command.may_end
                if name not in self.work:
                    takes = self._tasks[name].expected * lateness(self.delays, name, self.seed)
                    self.work[name] = Handled("", name, who, now, now + takes)

    def _begin(self, robot: SimulatedRobot, motion: str, now: float) -> None:
        self._keep(robot)
        key = motion, robot.name
        robot.begin(motion, self._paths[key], self._travels[key], now)
        self.drives.append(robot.drive)

    def _keep(self, robot: SimulatedRobot) -> None:
        """Put what a robot has driven on record."""
        if robot.motion is not None:
            robot.drive.trace = trace = np.array(robot.trace)
            poses = robot.path.poses_at(np.clip(trace[:, 1], 0.0, robot.path.length))
            robot.drive.rows = np.column_stack([trace[:, 0], poses])

    def close(self) -> None:
        """Put what is driven last on record."""
        for robot in self.robots.values():
            self._keep(robot)

    def drive(self, now: float, seconds: float) -> None:
        """Let robots drive for some seconds from ``now`` on."""
        self.now = round(now + seconds, 9)
        self.stood = []
        for name, robot in self.robots.items():
            was = robot.s
            if robot.motion is not None:
                robot.step(now, seconds)
            if robot.s <= was:
                self.stood.append(name)

    def waited(self, robot: str, seconds: float, whom: str = "") -> None:
        """Note that a robot stood for the last seconds."""
        mine, since = self.waits[robot], self.now - seconds
        if mine and mine[-1][3] == whom and mine[-1][1] >= since - 1e-6:
            mine[-1] = (mine[-1][0], self.now, *mine[-1][2:])
        else:
            mine.append((since, self.now, self.robots[robot].pose, whom))

    def told_by(self, robot: SimulatedRobot, now: float) -> Iterator[Report]:
        """Yield what a robot tells of its motion: where it takes itself to be, and that it has come
        to its end.
        """
        if robot.motion is None:
            return
        progress = robot.told(now)
        if progress is not None:
            yield Report(robot.name, now, robot.motion, progress)
        if robot.arrived:
            yield Report(robot.name, now, robot.motion, done=True)

    def done(self, now: float) -> list[str]:
        """Return what is to be done at places now, and is over."""
        some = (name for name, may_end in self._may.items() if may_end)
        return [name for name in some if self.work[name].end <= now + 1e-9]
