"""Plans on a simulated floor with delays: how long it takes, who waits, who collides; what is left
then, planned anew.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import OneshotPlanner

from up_samp.execution.build import Dependencies, timed
from up_samp.execution.executor import Executor
from up_samp.execution.files import with_dependencies
from up_samp.execution.judge import Contact, Drivings, broken_rules, contacts_of, record_of
from up_samp.execution.remaining import Remaining, Surprise
from up_samp.execution.reports import Do, Go, Hold
from up_samp.execution.state import TaskPhase
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import TravelProfile
from up_samp.io.plan_dict import PlanDict, result_to_dict
from up_samp.model import ProblemError
from up_samp.tuning import Tuning

_PATIENCE = 30.0
"""Times as long as planned, and 60 s more, may a run take."""
_PAUSE = 4.0
"""s between two looks at who goes first."""
_STILL = 5.0
"""s in which nothing happens, though nothing is disturbed and nobody waits for the clock: a
deadlock.
"""


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
            if getattr(self, name) < 0.0:
                raise ProblemError(f"delays: '{name}' must not be negative")

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
    truth, and others tell where it is; a ``silent`` one does not say that it has come to its end.
    """

    pace: float = 1.0
    stops: tuple[tuple[float, float], ...] = ()
    halt: tuple[float, float] | None = None
    bias: float = 0.0
    noise: float = 0.0
    lag: float = 0.0
    tracked: bool = False
    silent: bool = False
    seed: str = ""


def draw(
    delays: Delays, dependencies: Dependencies, seed: int
) -> tuple[dict[str, Luck], dict[str, float]]:
    """Draw one run's delays: each robot's luck, and a factor on each task's duration. Every robot
    and task has a generator of its own.
    """
    names = sorted(life.object for life in dependencies.lives.values() if life.drives)
    tasks, makespan = dependencies.graph.tasks, dependencies.graph.planned
    halts = {}
    if delays.long_stop > 0.0 and names:
        rng = random.Random(f"halt {seed}")
        held = rng.choice(names)
        halts[held] = rng.uniform(0.05, 0.6) * makespan, delays.long_stop
    found = {}
    for name in names:
        rng = random.Random(f"robot {name} {seed}")
        pace = 1.0 - delays.slow * rng.random()
        stops = tuple(_stops(delays, rng, 4 * makespan))
        rng = random.Random(f"senses {name} {seed}")
        bias = rng.choice((-1.0, 1.0)) * delays.bias * rng.choice((1.0, 1.0, rng.random()))
        tracked, silent = rng.random() < 0.5, rng.random() < 0.5
        found[name] = Luck(
            pace, stops, halts.get(name), bias, delays.noise, delays.lag, tracked, silent,
            f"noise {name} {seed}",
        )  # fmt: skip
    return found, {
        name: 1.0 + delays.late * random.Random(f"task {name} {seed}").random() for name in tasks
    }


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


class SimulatedRobot:
    """One motion after the other. ``trace`` holds (time, progress) of the motion under way."""

    def __init__(self, name: str, luck: Luck):
        self.name, self.luck = name, luck
        self._noise = random.Random(luck.seed)
        self.stops, self.halt = deque(luck.stops), luck.halt
        self.driven = 0.0
        """Seconds of driving so far, without stops."""
        self.held_until = -math.inf
        self.overruns = 0
        self.motion: str | None = None
        self.trace: list[tuple[float, float]] = []
        self.s = self.v = self.until = 0.0
        """True progress (m), speed (m/s), and how far it has been told that it may go (m)."""
        self.wrong = 0.0
        """Told minus true progress (m)."""
        self.hold = False
        """Whether it has been told to stay where it is."""
        self.known: deque[tuple[float, float]] = deque()
        """(time, progress) that is still to be told."""

    def begin(self, motion: str, travel: TravelProfile, now: float) -> None:
        """Take up a motion, at rest."""
        self.motion, self.travel = motion, travel
        self.s = self.v = self.until = 0.0
        self.length = travel.length
        self.next_stop = 0
        self.trace = [(now, 0.0)]
        self.known.clear()
        self._look()

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

    def step(self, now: float, dt: float, ceiling: float = math.inf) -> None:
        """Drive for ``dt`` s from ``now`` on: not beyond ``until`` (m, as it believes), where it
        can stop, and not beyond ``ceiling`` (m) at the step's end, as far as its brakes allow.
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


# ------------------ Plans on a simulated floor with delays


Policy = Literal["timed", "staircase", "reorder"]


@dataclass(frozen=True)
class Simulation:
    """One execution. Times in s; ``waiting`` is the share of all robots' time until the run's end
    that they stood because of others (0 to 1); ``waits`` are (robot, from, until, for whom).
    """

    policy: str
    seed: int
    planned: float
    makespan: float
    waiting: float
    finished: bool
    deadlock: bool
    overruns: int
    reorders: int
    contacts: tuple[Contact, ...]
    record: PlanDict
    waits: tuple[tuple[str, float, float, str], ...] = ()
    broken: tuple[str, ...] = ()
    """What the problem asks and the run did not keep, in words (where the problem is known and the
    run came to its end)."""
    missed: tuple[str, ...] = ()
    """Deadlines, windows and longest durations that were overrun: no executive can keep them."""

    @property
    def ratio(self) -> float:
        """Realised over planned makespan."""
        return self.makespan / self.planned if self.planned else 1.0

    @property
    def collisions(self) -> int:
        """How many pairs of motions, or of a motion and a resting object, met."""
        return len(self.contacts)


@dataclass
class Floor:
    """The simulated world: robots, tasks under way, what was driven and who waited."""

    executive: Executor
    dependencies: Dependencies
    luck: Mapping[str, Luck]
    longer: Mapping[str, float]
    by_clock: bool = False
    """Whether robots drive by the plan's clock: never ahead of it, waiting for nobody."""
    now: float = 0.0
    drivings: Drivings = field(default_factory=dict)
    ends: dict[str, float] = field(default_factory=dict)
    """When tasks under way will be over (s)."""
    waits: list[list[Any]] = field(default_factory=list)
    idle: float = 0.0

    def __post_init__(self) -> None:
        self.tick = self.executive.tuning.tick
        """Seconds between two looks."""
        self.travels = self.dependencies.travels
        self.robots = {
            life.object: SimulatedRobot(life.object, self.luck[life.object])
            for life in self.dependencies.lives.values()
            if life.drives
        }
        self.waiting: dict[str, float] = dict.fromkeys(self.robots, 0.0)
        self.last: dict[str, float] = dict.fromkeys(self.robots, 0.0)

    @property
    def goes_on(self) -> bool:
        """Whether the run is neither over nor stuck nor hopelessly late."""
        latest = _PATIENCE * self.dependencies.graph.planned + 60.0
        return not self.executive.finished and self.now < latest and not self.stuck

    @property
    def stuck(self) -> bool:
        """Whether nothing has happened for long, though nothing is disturbed, nor waits for the
        clock.
        """
        return self.idle >= _STILL

    def step(self) -> None:
        """Let one tick pass: do what is commanded, and tell what happened."""
        commands = self.executive.commands(self.now)
        before = self._state()
        disturbed = False
        for robot in self.robots.values():
            self._drive(robot, commands.get(robot.name))
            disturbed |= self.now < robot.held_until
        self.now = round(self.now + self.tick, 9)
        for robot in self.robots.values():
            self._tell(robot)
        self._tasks(commands)
        still = not disturbed and not self.ends and before == self._state()
        still = still and not self.executive.awaits_time
        self.idle = self.idle + self.tick if still else 0.0

    def _tell(self, robot: SimulatedRobot) -> None:
        """Let a robot tell where it takes itself to be, and that it has come to its end."""
        progress = robot.told(self.now) if robot.motion is not None else None
        if progress is None or robot.motion is None:
            return
        name, motion, executive = robot.name, robot.motion, self.executive
        if self.by_clock:
            progress = robot.length if robot.arrived else robot.s
        executive.update(name, progress=progress, now=self.now, motion=motion)
        if not robot.arrived or robot.luck.silent:
            return
        if executive.phase(motion) is not TaskPhase.DONE:
            executive.done(motion, self.now)

    def _state(self) -> tuple[Any, ...]:
        return self.executive.left, tuple((r.motion, r.s) for r in self.robots.values())

    def _drive(self, robot: SimulatedRobot, command: Any) -> None:
        name = robot.name
        if isinstance(command, Go):
            if robot.motion != command.motion:
                self.keep(robot)
                robot.begin(command.motion, self.travels[command.motion, name], self.now)
            robot.until = command.until
        robot.hold = isinstance(command, Hold) and bool(command.waiting_for) and not self.by_clock
        if robot.motion is None:
            self._wait(robot, command)
            return
        ceiling = float("inf")
        if self.by_clock:
            times, s = self.executive.drives[robot.motion, name].planned
            ceiling = float(np.interp(self.now + self.tick, times, s))
        was = robot.s
        robot.step(self.now, self.tick, ceiling)
        if robot.s > was:
            self.last[name] = self.now
        elif self.now >= robot.held_until:
            self._wait(robot, command)

    def _wait(self, robot: SimulatedRobot, command: Any) -> None:
        if isinstance(command, Do) or self.by_clock:
            self.last[robot.name] = self.now
            return
        for whom in self.executive.waits_for(robot.name)[:1]:
            self.waiting[robot.name] += self.tick
            mine = [w for w in self.waits[-12:] if w[0] == robot.name]
            last = mine[-1] if mine else None
            if last is not None and last[3] == whom and last[2] >= self.now - 1e-6:
                last[2] = self.now + self.tick
            else:
                self.waits.append([robot.name, self.now, self.now + self.tick, whom])

    def keep(self, robot: SimulatedRobot) -> None:
        """Put what a robot has driven on record."""
        if robot.motion is not None:
            self.drivings[robot.motion, robot.name] = list(robot.trace)

    def _tasks(self, commands: Mapping[str, Any]) -> None:
        may = {c.activity: c.may_end for c in commands.values() if isinstance(c, Do)}
        tasks = self.dependencies.graph.tasks
        for name in may:
            if name not in self.ends:
                longer = self.longer.get(name, 1.0)
                self.ends[name] = self.now - self.tick + tasks[name].expected * longer
        for name, end in list(self.ends.items()):
            if end <= self.now + 1e-9 and may.get(name, False):
                self.executive.done(name, self.now)
                del self.ends[name]


class Reorderer:
    """Reorders when the predicted makespan has grown by more than a threshold since it last did,
    but not too often (``executor.tuning``).
    """

    def __init__(self) -> None:
        self.known: float | None = None
        self.since = -math.inf

    def __call__(self, executor: Executor) -> int:
        """Look at the executor; return how many orders were changed."""
        if executor.now < self.since + _PAUSE:
            return 0
        ahead = executor.predicted_makespan()
        if self.known is None:
            self.known = min(ahead, executor.state.graph.planned)
        if ahead < self.known + executor.tuning.threshold:
            return 0
        self.since = executor.now
        changed = executor.reorder()
        self.known = executor.predicted_makespan()
        return changed


def floor_of(executor: Executor, delays: Delays, seed: int) -> Floor:
    """Return a floor on which an executor is followed, with the delays of ``seed``."""
    return Floor(executor, executor.dependencies, *draw(delays, executor.dependencies, seed))


def simulate(
    dependencies: Dependencies,
    plan: PlanDict,
    delays: Delays,
    seed: int = 0,
    *,
    policy: Policy = "staircase",
    judged: bool = True,
    tuning: Tuning = Tuning(),
    watch: Callable[[Executor], int] | None = None,
) -> Simulation:
    """Execute a plan once with the delays of ``seed``, which are the same for every policy.

    ``policy``: "timed" follows the clock; "staircase" the graph; "reorder" also changes who
    goes first. ``judged``: look for collisions. ``tuning`` are the numbers of docs/tuning.md.
    ``watch`` is called about every second with the executor and returns how often it changed an
    order.
    """
    by_clock = policy == "timed"
    followed = timed(dependencies) if by_clock else dependencies
    executive = Executor(plan, dependencies=followed, tuning=tuning)
    if policy == "reorder" and watch is None:
        watch = Reorderer()
    drawn = draw(delays, dependencies, seed)
    floor = Floor(executive, dependencies, *drawn, by_clock)
    reorders = 0
    looked = 0.0
    while floor.goes_on:
        floor.step()
        if watch is not None and floor.now >= looked + 1.0:
            looked = floor.now
            reorders += watch(executive)
    return simulation_of(floor, plan, policy, seed, reorders=reorders, judged=judged)


def simulation_of(
    floor: Floor, plan: PlanDict, policy: str, seed: int, *, reorders: int = 0, judged: bool = True
) -> Simulation:
    """Return what has happened on a floor so far."""
    for robot in floor.robots.values():
        floor.keep(robot)
    spans = floor.executive.times()
    makespan = max((end for _, end in spans.values() if end is not None), default=0.0)
    waits = tuple((str(w[0]), w[1], w[2], str(w[3])) for w in floor.waits)
    record = record_of(plan, floor.dependencies.lives, spans, floor.drivings, waits, floor.now)
    finished = floor.executive.finished
    time = len(floor.robots) * floor.now
    # what is not over may still come to keep what is asked
    known = judged and finished
    broken, missed = broken_rules(floor.dependencies, record) if known else ((), ())
    return Simulation(
        policy=policy,
        seed=seed,
        planned=floor.dependencies.graph.planned,
        makespan=makespan,
        waiting=min(1.0, sum(floor.waiting.values()) / time) if time else 0.0,
        finished=finished,
        deadlock=not finished and floor.stuck,
        overruns=sum(r.overruns for r in floor.robots.values()),
        reorders=reorders,
        contacts=tuple(contacts_of(record)) if judged else (),
        record=record,
        waits=waits,
        broken=broken,
        missed=missed,
    )


# ------------------ What is left of a plan planned anew, from where everybody stands


ENGINE = "samp-refine[cpsat]"


def solve_remaining(
    left: Remaining, *, engine: str = ENGINE, seconds: float | None = None
) -> PlanDict:
    """Return a plan of what is left with its dependencies, sought from the rest of the old plan
    (``left.hint``) on, in its units and with its clearance (``left.params``).

    Raises :class:`ProblemError` where the engine finds none within ``seconds``.
    """
    with OneshotPlanner(name=engine, params=dict(left.params)) as planner:
        result = planner.solve(left.problem, timeout=seconds, warm_start_plan=left.hint)
    return with_dependencies(left.problem, result_to_dict(left.problem, result))


def remaining_at(
    problem: SchedulingProblem,
    plan: PlanDict,
    time: float,
    surprise: Surprise | None = None,
    broken_down: Collection[str] = (),
) -> Remaining:
    """Return what is left of a plan that was carried out without delays until ``time`` (s), when a
    ``surprise`` is told, and robots ``broken_down`` are out of order, wherever they stand.

    Raises :class:`ProblemError` where all was over by then.
    """
    executor = Executor(plan, problem)
    floor = floor_of(executor, Delays(), 0)
    while floor.goes_on and floor.now < time - 1e-9:
        floor.step()
    if not floor.goes_on:
        raise ProblemError(f"nothing is left at {time:g} s: the plan is over after {floor.now:g} s")
    return executor.remaining_problem(
        broken_where_they_stand(executor, surprise or Surprise(), broken_down)
    )


def broken_where_they_stand(
    executor: Executor, surprise: Surprise, names: Collection[str]
) -> Surprise:
    """Return a surprise with robots that break down where they come to a stand."""
    here = executor.remaining_problem().poses if names else {}
    broken = dict(surprise.broken)
    for name in names:
        if name not in here:
            known = ", ".join(sorted(here))
            raise ProblemError(f"'{name}' cannot break down: what stands on the floor is {known}")
        x, y, theta = here[name]
        broken[name] = (x, y, theta)
    return replace(surprise, broken=broken)
