"""Plans on a simulated floor with delays: how long it takes, who waits, who collides."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from up_samp.execution.build import Dependencies
from up_samp.execution.commands import Do, Go, Hold
from up_samp.execution.delays import Delays, Luck, draw
from up_samp.execution.executor import Executor
from up_samp.execution.judge import Contact, broken_rules, contacts_of
from up_samp.execution.record import Drivings, record_of
from up_samp.execution.reorder import Reorderer
from up_samp.execution.robot import Robot
from up_samp.execution.state import Phase
from up_samp.execution.timetable import Timetable
from up_samp.io.plan_dict import PlanDict
from up_samp.model.execution_tuning import ExecutionTuning, FloorTuning

Policy = Literal["timed", "coarse", "staircase", "reorder"]


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
    replans: int = 0
    lasted: float = 0.0
    """How long the run was watched (s)."""
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

    executive: Executor | Timetable
    dependencies: Dependencies
    luck: Luck
    tuning: FloorTuning = field(default_factory=FloorTuning)
    now: float = 0.0
    drivings: Drivings = field(default_factory=dict)
    ends: dict[str, float] = field(default_factory=dict)
    """When tasks under way will be over (s)."""
    waits: list[list[Any]] = field(default_factory=list)
    idle: float = 0.0

    def __post_init__(self) -> None:
        self.travels = self.dependencies.travels
        self.robots: dict[str, Robot] = {}
        for life in self.dependencies.lives.values():
            if life.drives:
                name = life.object
                halt = self.luck.halt
                mine = None if halt is None or halt[0] != name else (halt[1], halt[2])
                pace, stops = self.luck.pace.get(name, 1.0), self.luck.stops.get(name, ())
                self.robots[name] = Robot(name, pace, stops, mine, self.luck.senses.get(name))
        self.waiting: dict[str, float] = dict.fromkeys(self.robots, 0.0)
        self.last: dict[str, float] = dict.fromkeys(self.robots, 0.0)

    @property
    def tick(self) -> float:
        """Seconds between two looks."""
        return self.tuning.tick

    def goes_on(self, planned: float) -> bool:
        """Return whether a run that was ``planned`` to take so long (s) is neither over nor stuck
        nor hopelessly late.
        """
        latest = self.tuning.patience * planned + 60.0
        return not self.executive.finished and self.now < latest and not self.stuck

    @property
    def stuck(self) -> bool:
        """Whether nothing has happened for long, though nothing is disturbed."""
        return self.idle >= self.tuning.still

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
        self.idle = self.idle + self.tick if still else 0.0

    def _tell(self, robot: Robot) -> None:
        """Let a robot tell where it takes itself to be, and that it has come to its end."""
        progress = robot.told(self.now) if robot.motion is not None else None
        if progress is None or robot.motion is None:
            return
        name, motion, executive = robot.name, robot.motion, self.executive
        if isinstance(executive, Timetable):
            progress = robot.length if robot.arrived else robot.s
        executive.update(name, progress=progress, now=self.now, motion=motion)
        if isinstance(executive, Timetable) or not robot.arrived or robot.senses.silent:
            return
        if executive.phase(motion) is not Phase.DONE:
            executive.done(motion, self.now)

    def _state(self) -> tuple[Any, ...]:
        return self.executive.left, tuple((r.motion, r.s) for r in self.robots.values())

    def _drive(self, robot: Robot, command: Any) -> None:
        name, executive = robot.name, self.executive
        if isinstance(command, Go):
            if robot.motion != command.motion:
                self.keep(robot)
                robot.begin(command.motion, self.travels[command.motion, name], self.now)
            robot.until = command.until
        robot.hold = isinstance(command, Hold) and bool(command.waiting_for)
        if robot.motion is None:
            self._wait(robot, command)
            return
        ceiling = float("inf")
        if isinstance(executive, Timetable):
            ceiling = executive.ceiling(robot.motion, name, self.now + self.tick)
        was = robot.s
        robot.step(self.now, self.tick, ceiling)
        if robot.s > was:
            self.last[name] = self.now
        elif self.now >= robot.held_until:
            self._wait(robot, command)

    def _wait(self, robot: Robot, command: Any) -> None:
        if isinstance(command, Do):
            self.last[robot.name] = self.now
            return
        for whom in self.executive.waits_for(robot.name)[:1]:
            self.waiting[robot.name] += self.tick
            last = self.waits[-1] if self.waits else None
            mine = [w for w in self.waits[-12:] if w[0] == robot.name]
            last = mine[-1] if mine else None
            if last is not None and last[3] == whom and last[2] >= self.now - 1e-6:
                last[2] = self.now + self.tick
            else:
                self.waits.append([robot.name, self.now, self.now + self.tick, whom])

    def keep(self, robot: Robot) -> None:
        """Put what a robot has driven on record."""
        if robot.motion is not None:
            self.drivings[robot.motion, robot.name] = list(robot.trace)

    def _tasks(self, commands: Mapping[str, Any]) -> None:
        may = {c.activity: c.may_end for c in commands.values() if isinstance(c, Do)}
        tasks = self.dependencies.graph.tasks
        for name in may:
            if name not in self.ends:
                longer = self.luck.longer.get(name, 1.0)
                self.ends[name] = self.now - self.tick + tasks[name].expected * longer
        for name, end in list(self.ends.items()):
            if end <= self.now + 1e-9 and may.get(name, False):
                self.executive.done(name, self.now)
                del self.ends[name]


def simulate(
    dependencies: Dependencies,
    plan: PlanDict,
    delays: Delays,
    seed: int = 0,
    *,
    policy: Policy = "staircase",
    judged: bool = True,
    tuning: ExecutionTuning | None = None,
    watch: Callable[[Executor], int] | None = None,
) -> Simulation:
    """Execute a plan once with the delays of ``seed``, which are the same for every policy.

    ``policy``: "timed" follows the clock; "staircase" the graph; "coarse" is the same on a graph
    made with ``coarse=True``; "reorder" also changes who goes first. ``judged``: look for
    collisions. ``tuning`` are the numbers of docs/tuning.md.
    ``watch`` is called about every second with the executor and returns how often it changed an
    order.
    """
    tuning = tuning or ExecutionTuning()
    tasks = dependencies.graph.tasks
    planned = max((t.planned[1] for t in tasks.values()), default=0.0)
    robots = [life.object for life in dependencies.lives.values() if life.drives]
    luck = draw(delays, robots, tasks, planned, seed)
    executive: Executor | Timetable
    if policy == "timed":
        executive = Timetable(dependencies)
    else:
        executive = Executor(plan, dependencies=dependencies, tuning=tuning)
    if policy == "reorder" and watch is None:
        watch = Reorderer()
    floor = Floor(executive, dependencies, luck, tuning.floor)
    reorders = 0
    looked = 0.0
    while floor.goes_on(planned):
        floor.step()
        if watch is not None and isinstance(executive, Executor) and floor.now >= looked + 1.0:
            looked = floor.now
            reorders += watch(executive)
    return simulation_of(floor, plan, policy, seed, reorders=reorders, judged=judged)


def simulation_of(
    floor: Floor, plan: PlanDict, policy: str, seed: int, *, reorders: int = 0, judged: bool = True
) -> Simulation:
    """Return what has happened on a floor so far."""
    for robot in floor.robots.values():
        floor.keep(robot)
    tasks = floor.dependencies.graph.tasks
    planned = max((t.planned[1] for t in tasks.values()), default=0.0)
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
        planned=planned,
        makespan=makespan,
        waiting=min(1.0, sum(floor.waiting.values()) / time) if time else 0.0,
        finished=finished,
        deadlock=not finished and floor.stuck,
        overruns=sum(r.overruns for r in floor.robots.values()),
        reorders=reorders,
        contacts=tuple(contacts_of(record)) if judged else (),
        record=record,
        waits=waits,
        lasted=floor.now,
        broken=broken,
        missed=missed,
    )
