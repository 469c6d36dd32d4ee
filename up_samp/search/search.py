"""One search: the components that it is made of (a preset is a list of these), its parts, and how
they are told of what is found.
"""

from __future__ import annotations

import logging
import operator
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Plan, Schedule

from up_samp.model import CandidateSchedule, Trajectory, Violation
from up_samp.model.frames import Frame
from up_samp.model.refinement import Refinement, Strength
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling import Scheduler, open_scheduler
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.session import refuted
from up_samp.search.budget import Budget, Restarts, SchedulerPace
from up_samp.search.check import Check, CheckAlone, Checker
from up_samp.search.cuts import SmallCuts, rejecting
from up_samp.search.events import Telling
from up_samp.search.facts import Facts
from up_samp.search.knowledge import VALIDATING, Bounds, History, Incumbent, Knowledge
from up_samp.search.params import Parameters
from up_samp.search.proof import Prover
from up_samp.search.world import Motions
from up_samp.tuning import Tuning, tuning_of
from up_samp.upio import (
    Itinerary,
    Relaxation,
    SampSchedule,
    build_plan,
    read_itinerary,
    relax,
    trajectory_key,
)
from up_samp.upio.objective import Measure, Number, measure_of

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Statement:
    """Something that is told to the scheduler; ``find`` returns it as refinements; ``guess`` what
    else may be told where candidates come to nothing for want of it, guesses among it.
    """

    name: str
    find: Callable[[Search], Sequence[Refinement]]
    guess: Callable[[Search], Sequence[Refinement]] = lambda search: ()


Shaper = Callable[["Search", CandidateSchedule], CandidateSchedule]
"""Makes a candidate schedule easier to drive before its motions are checked."""
Builder = Callable[["Search", Itinerary], Incumbent | None]
"""Makes a plan of a candidate without asking whether its motions fit as scheduled, if it can."""
Repair = Callable[["Search", CandidateSchedule, Check], Incumbent | None]
"""Makes a plan of a candidate whose motions do not fit, if it can."""
Improver = Callable[["Search", bool], Iterator[Incumbent]]
"""Yields plans made of the best one, each better than all before it, for a share of the time. It is
asked in every round, and told whether the scheduler found nothing better in its time.
"""
Finisher = Callable[["Search", Incumbent], Incumbent | None]
"""Makes the best plan better in what no metric tells, in the end; None, and what is not valid,
leaves it as it is."""


@dataclass(frozen=True)
class Components:
    """The parts of a search, in the order in which they act.

    ``statements`` come before the first schedule; ``improvers`` in every round, once there is a
    plan. Without ``learns`` a search ends with its first candidate.
    """

    statements: tuple[Statement, ...]
    layers: tuple[CheckAlone, ...]
    cuts: SmallCuts
    pace: SchedulerPace
    shapers: tuple[Shaper, ...] = ()
    builders: tuple[Builder, ...] = ()
    repairs: tuple[Repair, ...] = ()
    improvers: tuple[Improver, ...] = ()
    finishers: tuple[Finisher, ...] = ()
    learns: bool = True


@dataclass(frozen=True)
class Wrapped:
    """The engine that schedules, with its parameters and the judges of its schedules (``check``)
    and of plans made of them (``judge``).

    ``native``: it is our own. ``worth`` is what the problem's metric makes of a schedule, asked
    where that is another one than the makespan.
    """

    engine: Any
    params: Mapping[str, Any]
    check: Callable[[Any, Schedule], list[str]]
    judge: Callable[[SampSchedule], list[Violation]]
    native: bool
    worth: Callable[[CandidateSchedule], Number] = operator.attrgetter("makespan")


@dataclass(frozen=True)
class Problem:
    """The problem as UP has it (``source``), how it was read, and what it is solved with: a search
    asks it for relaxations, schedulers and plans.
    """

    source: SchedulingMotionProblem
    snapshot: Snapshot
    wrapped: Wrapped
    params: Parameters

    @cached_property
    def tuning(self) -> Tuning:
        """Of our own scheduler, whatever engine is wrapped."""
        return tuning_of(self.params.tuning)

    @property
    def unheard(self) -> Parameters:
        """The parameters of a search within the search, of which nobody is told."""
        return replace(self.params, progress=None, trace=None, observers=())

    @property
    def unjudged(self) -> Wrapped:
        """The engine for plans that nobody judges."""
        return replace(self.wrapped, judge=lambda plan: [])

    @property
    def native(self) -> bool:
        """Whether our own engine schedules, which knows unary places, if only to draw what another
        one is handed over: but where the preset asks nothing of ours.
        """
        return self.wrapped.native or "incumbents" not in self.params.without

    @cached_property
    def measure(self) -> Measure:
        """What tells what a schedule costs."""
        return measure_of(self.source, self.wrapped.worth)

    def relax(self) -> Relaxation:
        """Return the relaxation, made anew, without refinements."""
        return relax(self.source, self.snapshot)

    def schedule(self, relaxation: Relaxation, attempt: int) -> Scheduler:
        """Return a scheduler opened on a relaxation, for the attempt of that number."""
        wrapped, seed = self.wrapped, self.params.seed + attempt
        scheduler: Any = open_scheduler(
            wrapped.engine,
            relaxation.problem,
            params={**({"tuning": self.tuning} if wrapped.native else {}), **wrapped.params},
            seed=seed,
            check=wrapped.check,
            environment=self.source.environment,
        )
        if wrapped.native:
            scheduler.soon = True  # better schedules are driven before more is proven of them
        if wrapped.native or not self.native:
            return scheduler
        from up_samp.scheduling.thinned import ThinnedScheduler  # and all compilers

        return ThinnedScheduler(scheduler, relaxation, seed=seed, tuning=self.tuning)

    def known(self, plan: Plan | None) -> Mapping[str, Trajectory]:
        """Return what a UP plan drives, as far as it tells, as its parts are called in plans."""
        found: Mapping[str, Trajectory] = getattr(plan, "trajectories", {})
        return self._moved(found, [frame.inverse for frame in self.snapshot.to_world])

    def _moved(
        self, found: Mapping[str, Trajectory], frames: Sequence[Frame]
    ) -> Mapping[str, Trajectory]:
        """Return trajectories taken out of the frame of their map, if there are any frames."""
        moved = dict(found)
        for task in self.snapshot.tasks if frames else ():
            key = trajectory_key(task.activity, task.index)
            if key in found:
                own = found[key]
                moved[key] = replace(own, poses=frames[task.map].out(own.poses))
        return moved

    def build(
        self, schedule: CandidateSchedule, trajectories: Mapping[str, Trajectory]
    ) -> SampSchedule:
        """Return the UP plan of a schedule; trajectories are in the world frame there."""
        snapshot, margin = self.snapshot, self.params.margin
        found = self._moved(trajectories, snapshot.to_world)
        return build_plan(self.source, snapshot, schedule, found, margin)


@dataclass
class Search:
    """The parts of one search. Only the stages of the loop take all of it; what they call takes
    what it uses.
    """

    problem: Problem
    facts: Facts
    knowledge: Knowledge
    budget: Budget
    bounds: Bounds
    motions: Motions
    checker: Checker
    prover: Prover
    scheduler: Scheduler
    components: Components
    restarts: Restarts
    tell: Telling
    start: CandidateSchedule | None = None
    """What to begin from: see :mod:`up_samp.search.resolve`."""
    driven: Mapping[str, Trajectory] = field(default_factory=dict)
    """What is driven in the plan to begin from, as far as it tells."""
    easier: Callable[[Search], Generator[Incumbent, None, Any]] | None = None
    """Yields plans by an objective that is easier, where nothing was given to begin from."""
    in_parts: Callable[[Search, bool], Generator[Incumbent, None, Any]] | None = None
    """How a large problem is solved: not as a whole, but in parts (``optimal`` or not)."""
    plain: bool = False
    """Nothing is recognised in the problem any more: what rested on it was refuted."""

    @property
    def history(self) -> History:
        """What happened so far."""
        return self.knowledge.history

    @property
    def stopped(self) -> bool:
        """Whether the user's criterion says that it is enough."""
        stop = self.problem.params.stop
        return stop is not None and stop(self.tell.state())

    @property
    def seed(self) -> int:
        """Of all that is random."""
        return self.problem.params.seed

    @property
    def tuning(self) -> Tuning:
        """Of our own scheduler, whatever engine is wrapped."""
        return self.problem.tuning

    def learn(self, refinements: Iterable[Refinement]) -> int:
        """Tell the scheduler what is new of these and return how many that were."""
        new = self.knowledge.learn(refinements)
        self.bounds.stated |= any(r.strength is Strength.RELATIVE for r in new)
        if new:
            self.tell("refinement", new)
            self.confront(new)
        return len(new)

    def confront(self, said: Iterable[Refinement]) -> None:
        """Hold what was ``said``, and is no guess, against the best plan, which is valid: what it
        breaks is a guess. By motions that are faster than the planner's own it may; if it breaks
        what is called proven, that is an error of ours, and is told.
        """
        best = self.bounds.incumbent
        if best is None:
            return
        snapshot = self.knowledge.relaxation.snapshot
        itinerary = read_itinerary(self.knowledge.relaxation, best.schedule)
        sure = [r for r in said if r.strength is not Strength.HEURISTIC]
        broken = rejecting(itinerary, snapshot, sure)
        if not broken:
            return
        self.knowledge.take_back(broken)
        self.bounds.forget_relative()
        for refinement in broken:
            if refinement.strength is Strength.PROVEN:
                self.bounds.forget()
                claim = f"{refinement.statement} ({refinement.why}) is called proven"
                self.refute(refuted(claim, "a valid plan breaks it"))

    def refute(self, told: str) -> None:
        """Tell an error of ours that does no harm any more."""
        log.error("%s", told)
        self.history.refuted.append(told)

    def judged(self, plan: SampSchedule) -> list[Violation]:
        """Return what the independent validator has against a plan."""
        with self.history.stages.of(VALIDATING):
            return self.problem.wrapped.judge(plan)

    def start_over(self) -> None:
        """Begin anew with what is proven or relative; drop what was only guessed."""
        self.scheduler.close()
        self.knowledge.start_over(self.problem.relax())
        self.scheduler = self.problem.schedule(self.knowledge.relaxation, self.restarts.done)
        if self.plain:
            self.recognise_nothing()

    def recognise_nothing(self) -> None:
        """Let our own scheduler go on without what it recognises, and drop what rested on it."""
        self.plain = True
        self.bounds.forget()
        self.prover = replace(self.prover, plain=True)
        if isinstance(self.scheduler, CpsatSession):
            self.scheduler.recognise_nothing()

    def plan_of(
        self, schedule: CandidateSchedule, trajectories: Mapping[str, Trajectory]
    ) -> Incumbent:
        """Return a schedule whose motions were found, with the UP plan of it."""
        return Incumbent(schedule, trajectories, self.problem.build(schedule, trajectories))
