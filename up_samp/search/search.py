"""One search: the components that it is made of (a preset is a list of these), its parts, and how
they are told of what is found.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from up_samp.model import CandidateSchedule, Trajectory, Violation
from up_samp.model.refinement import Refinement, Strength
from up_samp.scheduling import Scheduler
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.session import refuted
from up_samp.search.budget import Budget, Restarts, SchedulerPace
from up_samp.search.check import Check, CheckAlone, Checker
from up_samp.search.cuts.protocol import rejecting
from up_samp.search.cuts.small import SmallCuts
from up_samp.search.events import State, Telling
from up_samp.search.facts import Facts
from up_samp.search.history import VALIDATING, History
from up_samp.search.knowledge import Bounds, Incumbent, Knowledge
from up_samp.search.motions import Motions
from up_samp.search.proof import Prover
from up_samp.tuning import Tuning
from up_samp.upio import Itinerary, Relaxation, SampSchedule, read_itinerary
from up_samp.upio.objective import Measure

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
"""Makes the best plan better in what no metric tells, in the end; None leaves it as it is."""


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
class Problem:
    """What a search asks of the problem as UP has it.

    ``relax`` makes the relaxation anew, without refinements; ``schedule`` opens a scheduler on one,
    for the attempt of that number (``native``: our own, which knows unary places, if only to draw
    what another engine is handed over); ``build`` makes the UP plan of a schedule and its
    trajectories; ``judge`` is the independent validator; ``measure`` tells what a schedule costs.
    """

    relax: Callable[[], Relaxation]
    schedule: Callable[[Relaxation, int], Scheduler]
    build: Callable[[CandidateSchedule, Mapping[str, Trajectory]], SampSchedule]
    judge: Callable[[SampSchedule], list[Violation]]
    native: bool
    measure: Measure = field(default_factory=lambda: Measure(lambda s: s.makespan))


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
    stop: Callable[[State], bool] | None = None
    relative: bool = False
    """Whether the planner's own motions are short enough for a proof (see :class:`Parameters`)."""
    seed: int = 0
    tuning: Tuning = field(default_factory=Tuning)
    """Of our own scheduler, whatever engine is wrapped."""
    start: CandidateSchedule | None = None
    """What to begin from: see :mod:`up_samp.search.resolve`."""
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
        return self.stop is not None and self.stop(self.tell.state())

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
            return self.problem.judge(plan)

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
