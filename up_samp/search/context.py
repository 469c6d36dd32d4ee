"""What one search shares: the problem in its forms, the services, and what was found so far."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from up_samp.model import (
    Body,
    CandidateSchedule,
    Configuration,
    Deadline,
    Refusal,
    ScheduledMotion,
    Trajectory,
)
from up_samp.model.refinement import Refinement, Strength
from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.motion.proofs.after_opening import AfterOpening
from up_samp.search.cases import MotionCase, case_of, cases_of
from up_samp.search.history import History, ProgressEvent
from up_samp.search.params import Parameters
from up_samp.upio import Itinerary, Relaxation, write_refinement

if TYPE_CHECKING:
    from up_samp.motion import MotionService
    from up_samp.scheduling import Scheduler

Signature = tuple[Body, tuple[Configuration, ...]]
"""What a motion is to the motion planner: motions of equal signatures are equivalent."""

FIRST_PROOF_SECONDS = 15.0
"""Time (s) of the scheduler's first attempt at a proof, once there is a plan."""

SCHEDULE_SHARE = 0.4
"""Share of the remaining time that our own scheduler may take for a schedule, until there is a
plan: its schedules get better with time, but their motions have to be checked, too."""

LATE = 9e-7
"""Lateness (s) that counts as rounding: less than the validator forgives (1e-6 s)."""

GROUP_SHARE = 0.2
"""Share of the remaining time that one group of motions may take."""


@dataclass(frozen=True)
class Incumbent:
    """A schedule with trajectories for all of its motions (by activity, s from the start)."""

    schedule: CandidateSchedule
    trajectories: Mapping[str, Trajectory]


@dataclass
class Context:
    """The state of one search (the only mutable thing in it, with the history)."""

    snapshot: Snapshot
    relaxation: Relaxation
    service: MotionService
    scheduler: Scheduler
    params: Parameters
    deadline: Deadline
    query_seconds: float
    relax: Callable[[], Relaxation]
    """Makes the relaxation anew, without refinements."""
    open_scheduler: Callable[[Relaxation], Scheduler]
    native: bool = False
    """The scheduler is our own: it knows places for one."""
    validate: Callable[[Incumbent], list[Refusal]] = lambda _: []
    history: History = field(default_factory=History)
    incumbent: Incumbent | None = None
    lower_bound: int = 0
    bound_is_relative: bool = False
    proof_seconds: float = FIRST_PROOF_SECONDS
    """Limit of our own scheduler's next call, once there is a plan; doubled when it is used up."""
    schedule_share: float = SCHEDULE_SHARE
    """Share for the next schedule; all of the time once a share was not enough for any."""
    written: set[object] = field(default_factory=set)
    standing: list[Refinement] = field(default_factory=list)
    durations: dict[Signature, float] = field(default_factory=dict)
    feasible_facts: int | None = None
    """How many proven facts alone are known to leave a schedule (or could not be refuted)."""
    guesses: set[frozenset[object]] = field(default_factory=set)
    """What was guessed before each restart."""
    stale_restarts: int = 0
    """How many restarts in a row guessed nothing new."""
    handovers: dict[tuple[Signature, Signature], float | None] = field(default_factory=dict)
    handovers_guessed: bool = False
    """The gaps between the fastest motions were stated: once is enough, also after a restart."""
    """Gaps (s) between a departure and an arrival at the same place, relative to the planner."""
    hopeless: set[frozenset[str]] = field(default_factory=set)
    """Activities that found no trajectories together at some offsets."""

    @cached_property
    def after(self) -> AfterOpening:
        """Bounds on motions that wait for a door."""
        return AfterOpening(self.service.certifier)

    # ------------------------------------------------------------------ units
    def seconds(self, units: float) -> float:
        """Return schedule units in s."""
        return units * self.snapshot.seconds_per_unit

    def units(self, seconds: float) -> int:
        """Return s in schedule units, rounded up. ``LATE`` s are forgiven, whatever a unit is."""
        return math.ceil((seconds - LATE) / self.snapshot.seconds_per_unit)

    def group_seconds(self, count: int) -> float:
        """Return the time limit (s) of one query for ``count`` motions together.

        No query may use up what is left: a late answer can still be repaired.
        """
        limit = self.query_seconds * max(1, count) ** 0.5
        return min(limit, GROUP_SHARE * self.deadline.remaining())

    # ------------------------------------------------------- facts of the problem
    @cached_property
    def cases(self) -> tuple[MotionCase, ...]:
        """All motions between known configurations (none of a task with too many of them)."""
        choices = self.relaxation.choices
        return tuple(c for task in self.snapshot.tasks for c in cases_of(task, choices))

    @cached_property
    def drivers(self) -> frozenset[str]:
        """Objects that some activity drives."""
        return frozenset(t.object for t in self.snapshot.tasks)

    @cached_property
    def instant(self) -> frozenset[str]:
        """Objects that change their configuration but never drive (doors)."""
        return frozenset(c.object for c in self.snapshot.changes) - self.drivers - self.loads

    @cached_property
    def loads(self) -> frozenset[str]:
        """Objects that travel with others and never drive."""
        return frozenset(r.load for r in self.snapshot.rides) - self.drivers

    @property
    def movers(self) -> Mapping[str, frozenset[str]]:
        """Object -> activities that drive it, carry it or change it."""
        return self.snapshot.movers

    def body(self, motion: ScheduledMotion) -> Body:
        """Return what a scheduled motion drives: an object, with its loads."""
        return self.snapshot.body(motion.activity, motion.constraint, motion.object)

    def signature(self, case: MotionCase) -> Signature:
        """Return what a case is to the motion planner."""
        task = case.task
        body = self.snapshot.body(task.activity, task.index, task.object)
        return body, tuple(self.snapshot.configurations[n] for n in case.configurations)

    @cached_property
    def by_signature(self) -> dict[Signature, list[MotionCase]]:
        """Equivalent motions."""
        found: dict[Signature, list[MotionCase]] = {}
        for case in self.cases:
            found.setdefault(self.signature(case), []).append(case)
        return found

    def like(self, motion: ScheduledMotion) -> list[MotionCase]:
        """Return the case that a scheduled motion is, and all that are the same to the planner."""
        case = case_of(self.snapshot, motion)
        return list(dict.fromkeys((case, *self.by_signature.get(self.signature(case), ()))))

    def returns_to(self, obstacle: str, configuration: str) -> bool:
        """Return whether some activity may bring ``obstacle`` to ``configuration``."""
        terms = [t.terms[-1] for t in self.snapshot.tasks if t.object == obstacle]
        terms += [r.goal for r in self.snapshot.rides if r.load == obstacle]
        terms += [c.term for c in self.snapshot.changes if c.object == obstacle]
        return any(t.kind is not TermKind.CONSTANT or t.name == configuration for t in terms)

    # ------------------------------------------------------------- learning
    def learn(self, refinements: Iterable[Refinement]) -> int:
        """Write new refinements into the relaxation and return how many were new."""
        count = 0
        for refinement in refinements:
            if refinement.statement in self.written:
                continue
            self.written.add(refinement.statement)
            write_refinement(self.relaxation, refinement)
            self.history.refinements.append(refinement)
            self.standing.append(refinement)
            self.bound_is_relative |= refinement.strength is Strength.RELATIVE
            count += 1
        return count

    def start_over(self) -> None:
        """Begin anew with what is proven or relative; drop what was only guessed."""
        kept = [r for r in self.standing if r.strength is not Strength.HEURISTIC]
        self.scheduler.close()
        self.relaxation = self.relax()
        self.scheduler = self.open_scheduler(self.relaxation)
        self.standing = kept
        self.hopeless.clear()
        self.written = {r.statement for r in kept}
        for refinement in kept:
            write_refinement(self.relaxation, refinement)

    @property
    def heuristic(self) -> bool:
        """Whether some refinement in play may remove valid plans."""
        return any(r.strength is Strength.HEURISTIC for r in self.standing)

    @property
    def upper_bound(self) -> int | None:
        """Makespan of the best plan so far."""
        return None if self.incumbent is None else self.incumbent.schedule.makespan

    @property
    def is_optimal(self) -> bool:
        """Whether the best plan meets the lower bound."""
        return self.upper_bound is not None and self.upper_bound <= self.lower_bound

    @property
    def staged(self) -> bool:
        """Whether a first plan is sought before any proof: our own scheduler can go on."""
        return self.native and self.params.incumbents

    def report(self, phase: str, message: str) -> None:
        """Tell the progress callback."""
        if self.params.progress is not None:
            self.params.progress(
                ProgressEvent(
                    len(self.history.rounds),
                    phase,
                    message,
                    self.lower_bound,
                    self.upper_bound,
                    self.deadline.elapsed(),
                )
            )


def places_between(
    itinerary: Itinerary, snapshot: Snapshot, name: str, first: int, last: int
) -> set[str]:
    """Return the configurations that object ``name``'s state has during [first, last].

    As PDDL 2.1 reads it: a change at t is seen from t + 1 on.
    """
    periods = itinerary.places(snapshot, name)
    found = set()
    for index, (since, place) in enumerate(periods):
        until = periods[index + 1][0] if index + 1 < len(periods) else math.inf
        if since + 1 <= last and first <= until:
            found.add(place)
    return found
