"""Plans on a simulated floor with delays: how long it takes, who waits, who collides; what is left
then, planned anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any, Literal

from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import OneshotPlanner

from up_samp.execution.build import Dependencies, timed
from up_samp.execution.executor import Executor
from up_samp.execution.files import with_dependencies
from up_samp.execution.floor import Delays, SimulatedFloor, SimulatedRobot, draw
from up_samp.execution.judge import Contact, broken_rules, contacts_of, record_of
from up_samp.execution.remaining import Remaining, Surprise
from up_samp.execution.reports import Do
from up_samp.execution.travel import pose_at
from up_samp.io.plan_dict import PlanDict, result_to_dict
from up_samp.model import ProblemError

_PATIENCE = 30.0
"""Times as long as planned, and 60 s more, may a run take."""
_PAUSE, _THRESHOLD = 4.0, 1.5
"""s between two looks at who goes first; and s by which all has to end later for one."""
_STILL = 5.0
"""s in which nothing happens, though nothing is disturbed and nobody waits for the clock: a
deadlock.
"""


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


class Floor(SimulatedFloor):
    """A simulated floor on which an executor is followed, with the delays of ``seed``: it is told
    at once what happens. ``by_clock``: robots drive by the plan's clock, never ahead of it, know
    where they are and wait for nobody.
    """

    tick = 0.1
    """Seconds between two looks."""

    def __init__(
        self, executive: Executor, delays: Delays, seed: int, by_clock: bool = False
    ) -> None:
        luck = draw(delays, executive.dependencies, seed)
        if by_clock:
            luck = {n: replace(one, bias=0.0, noise=0.0, lag=0.0) for n, one in luck.items()}
        lives = executive.dependencies.lives
        first = {}
        for name in luck:
            x, y, theta = pose_at(lives[name].drives[0].path, 0.0)
            first[name] = (x, y, theta)
        super().__init__(first, luck, delays, seed)
        self.executive, self.by_clock = executive, by_clock
        self.idle = 0.0
        self.follow(executive)

    @property
    def goes_on(self) -> bool:
        """Whether the run is neither over nor stuck nor hopelessly late."""
        latest = _PATIENCE * self.executive.dependencies.graph.planned + 60.0
        return not self.executive.finished and self.now < latest and not self.stuck

    @property
    def stuck(self) -> bool:
        """Whether nothing has happened for long, though nothing is disturbed, nor waits for the
        clock.
        """
        return self.idle >= _STILL

    def step(self) -> None:
        """Let one tick pass: do what is commanded, and tell what happened."""
        began, before = self.now, self._state()
        commands = self.executive.commands(began)
        self.tell(commands, began)
        self.drive(began, self.tick)
        disturbed = {n for n, robot in self.robots.items() if began < robot.held_until}
        for name in self.stood:
            working = isinstance(commands.get(name), Do) or name in disturbed
            for whom in () if working or self.by_clock else self.executive.waits_for(name)[:1]:
                self.waited(name, self.tick, whom)
        for robot in self.robots.values():
            self._tell(robot)
        for activity in self.done(self.now):
            self.executive.done(activity, self.now)
        awaited = disturbed or self.executive.awaits_time
        still = not awaited and not self._may and before == self._state()
        self.idle = self.idle + self.tick if still else 0.0

    def _state(self) -> tuple[Any, ...]:
        return len(self.executive.state.fired), tuple((r.motion, r.s) for r in self.robots.values())

    def _begin(self, robot: SimulatedRobot, motion: str, now: float) -> None:
        super()._begin(robot, motion, now)
        if self.by_clock:
            robot.timetable = self.executive.drives[motion, robot.name].planned

    def _tell(self, robot: SimulatedRobot) -> None:
        """Let a robot tell where it takes itself to be, and that it has come to its end."""
        for report in self.told_by(robot, self.now):
            name, at = report.activity, report.progress
            if report.done:
                self.executive.done(name, self.now, robot.name)
            else:
                self.executive.update(robot.name, progress=at, motion=name, now=self.now)


class Reorderer:
    """Reorders when the predicted makespan has grown by more than a threshold since it last did,
    but not too often.
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
        if ahead < self.known + _THRESHOLD:
            return 0
        self.since = executor.now
        changed = executor.reorder()
        self.known = executor.predicted_makespan()
        return changed


def simulate(
    dependencies: Dependencies,
    plan: PlanDict,
    delays: Delays,
    seed: int = 0,
    *,
    policy: Policy = "staircase",
    judged: bool = True,
    watch: Callable[[Executor], int] | None = None,
) -> Simulation:
    """Execute a plan once with the delays of ``seed``, which are the same for every policy.

    ``policy``: "timed" follows the clock; "staircase" the graph; "reorder" also changes who
    goes first. ``judged``: look for collisions.
    ``watch`` is called about every second with the executor and returns how often it changed an
    order.
    """
    by_clock = policy == "timed"
    followed = timed(dependencies) if by_clock else dependencies
    executive = Executor(plan, dependencies=followed)
    if policy == "reorder" and watch is None:
        watch = Reorderer()
    floor = Floor(executive, delays, seed, by_clock)
    reorders, looked = 0, 0.0
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
    floor.close()
    executive, dependencies = floor.executive, floor.executive.dependencies
    spans = executive.times()
    makespan = max((end for _, end in spans.values() if end is not None), default=0.0)
    every = ((since, until, n, w) for n, m in floor.waits.items() for since, until, _, w in m)
    waits = tuple((name, since, until, whom) for since, until, name, whom in sorted(every))
    drivings = {(d.activity, d.robot): d.trace for d in floor.drives}
    record = record_of(plan, dependencies.lives, spans, drivings, waits, floor.now)
    finished = executive.finished
    time = len(floor.robots) * floor.now
    # what is not over may still come to keep what is asked
    known = judged and finished
    broken, missed = broken_rules(dependencies, record) if known else ((), ())
    return Simulation(
        policy=policy,
        seed=seed,
        planned=dependencies.graph.planned,
        makespan=makespan,
        waiting=min(1.0, sum(b - a for _, a, b, _ in waits) / time) if time else 0.0,
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
    plan = result_to_dict(left.problem, result)
    return with_dependencies(left.problem, plan, localisation=left.localisation)


def remaining_at(
    problem: SchedulingProblem,
    plan: PlanDict,
    time: float,
    surprise: Surprise = Surprise(),
    broken_down: Collection[str] = (),
) -> Remaining:
    """Return what is left of a plan that was carried out without delays until ``time`` (s), when a
    ``surprise`` is told, and robots ``broken_down`` are out of order, wherever they stand.

    Raises :class:`ProblemError` where all was over by then.
    """
    executor = Executor(plan, problem)
    floor = Floor(executor, Delays(), 0)
    while floor.goes_on and floor.now < time - 1e-9:
        floor.step()
    if not floor.goes_on:
        raise ProblemError(f"nothing is left at {time:g} s: the plan is over after {floor.now:g} s")
    return executor.remaining_problem(broken_where_they_stand(executor, surprise, broken_down))


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
