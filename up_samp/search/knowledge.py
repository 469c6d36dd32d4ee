"""What a search has learned: refinements, written into the relaxation, and what they rest on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from up_samp.model import CandidateSchedule, Trajectory
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.search.facts import Signature
from up_samp.search.history import History
from up_samp.upio import Relaxation, SampSchedule, write_refinement
from up_samp.upio.objective import Measure, Number

Cost = Number | float


@dataclass
class Knowledge:
    """``active`` are the refinements in play; ``relaxation`` holds them all.

    The rest is remembered so that nothing is asked or said twice: ``stated`` bounds (units) and
    ``durations`` (s) of motions, and groups that ``failed_together`` at some offsets.
    """

    relaxation: Relaxation
    history: History
    active: list[Refinement] = field(default_factory=list)
    stated: dict[Signature, int] = field(default_factory=dict)
    durations: dict[Signature, float] = field(default_factory=dict)
    failed_together: set[frozenset[str]] = field(default_factory=set)
    tried_alone: set[frozenset[str]] = field(default_factory=set)
    """Activities that did not come to a plan even with their motions one after another (none at
    all: no other choice of activities was found in its time)."""
    guessed: bool = False
    """Whether all is told that statements guess."""
    feasible_facts: int | None = None
    """How many proven facts alone are known to leave a schedule (or could not be refuted)."""
    _written: set[object] = field(default_factory=set)
    _ever: set[object] = field(default_factory=set)

    def learn(self, refinements: Iterable[Refinement]) -> list[Refinement]:
        """Write refinements into the relaxation and return those that are new."""
        new = []
        for refinement in refinements:
            if refinement.statement in self._written:
                continue
            self._written.add(refinement.statement)
            write_refinement(self.relaxation, refinement)
            if refinement.statement not in self._ever:  # the same guess after a restart is no news
                self._ever.add(refinement.statement)
                self.history.refinements.append(refinement)
            self.active.append(refinement)
            new.append(refinement)
        return new

    def may_guess(self, rejecting: Iterable[Refinement]) -> bool:
        """Return whether a candidate is rejected by what a bound is guessed to be, and not all of
        these guesses are told.
        """
        told = ((r.layer, r.strength) for r in rejecting)
        return not self.guessed and (Layer.BOUND, Strength.HEURISTIC) in told

    def take_back(self, wrong: Iterable[Refinement]) -> None:
        """Take what a valid plan breaks for what it is: a guess."""
        back = frozenset(wrong)
        self.active = [
            replace(r, strength=Strength.HEURISTIC) if r in back else r for r in self.active
        ]

    def start_over(self, relaxation: Relaxation) -> None:
        """Begin anew on a fresh relaxation with what is proven or relative; drop the guesses."""
        self.active = self.sure
        self.relaxation = relaxation
        self.failed_together.clear()
        self.guessed = False
        self._written = {r.statement for r in self.active}
        for refinement in self.active:
            write_refinement(relaxation, refinement)

    @property
    def proven(self) -> list[Refinement]:
        """What is proven of all that is in play."""
        return [r for r in self.active if r.strength is Strength.PROVEN]

    @property
    def sure(self) -> list[Refinement]:
        """What is in play and no guess."""
        return [r for r in self.active if r.strength is not Strength.HEURISTIC]

    @property
    def guesses(self) -> list[Refinement]:
        """What is in play and may remove valid plans."""
        return [r for r in self.active if r.strength is Strength.HEURISTIC]


# ------------------ The bounds of a search
# The best plan so far, and what no plan can be better than.


@dataclass(frozen=True)
class Incumbent:
    """A schedule with trajectories for all of its motions (by activity, s from the start), and the
    UP plan of both.
    """

    schedule: CandidateSchedule
    trajectories: Mapping[str, Trajectory]
    plan: SampSchedule


@dataclass
class Bounds:
    """What plans cost (makespans in units): ``absolute`` is the best lower bound that does not rest
    on the motion planner's durations. ``stated``: something that does was told to the scheduler.
    """

    measure: Measure = field(default_factory=lambda: Measure(lambda s: s.makespan))
    lower: Cost = 0
    absolute: Cost = 0
    stated: bool = False
    beside: Cost = 0
    """What is known beside the scheduling problem that the scheduler is told."""
    stood: Cost = -1
    """The greatest lower bound that was doubted, and not refuted."""
    incumbent: Incumbent | None = None
    _costs: tuple[Incumbent, Number] | None = None

    @staticmethod
    def by(measure: Measure) -> Bounds:
        """Return the bounds of plans of which nothing is known yet."""
        least = measure.least
        return Bounds(measure, lower=least, absolute=least, beside=least, stood=least - 1)

    @property
    def relative(self) -> bool:
        """Whether the lower bound rests on the motion planner's durations."""
        return self.lower > self.absolute

    @property
    def upper(self) -> Number | None:
        """What the best plan so far costs."""
        best = self.incumbent
        if best is None:
            return None
        if self._costs is None or self._costs[0] is not best:
            self._costs = best, self.measure.cost(best.schedule)
        return self._costs[1]

    def raise_lower(self, cost: Cost, *, relative: bool) -> None:
        """Take note of a lower bound; ``relative``: it rests on the planner's durations."""
        if not relative:
            self.absolute = max(self.absolute, cost)
        self.lower = max(self.lower, cost)

    def raise_absolute(self, cost: Number | None) -> None:
        """Take note of a bound that does not rest on the planner's durations, as far as one does
        that holds anyhow.
        """
        if cost is not None:
            self.absolute = max(self.absolute, min(cost, self.lower))

    def told_lower(self) -> Number | None:
        """Return the lower bound, if there is one."""
        return None if isinstance(self.lower, float) else self.lower

    def forget_relative(self) -> None:
        """Drop what rests on the motion planner's durations."""
        self.lower, self.beside = self.absolute, min(self.beside, self.absolute)

    def forget(self) -> None:
        """Drop the lower bounds."""
        self.lower = self.absolute = self.beside = self.measure.least

    @property
    def met(self) -> bool:
        """Whether the best plan meets the lower bound."""
        return self.upper is not None and self.upper <= self.lower

    def improves(self, schedule: CandidateSchedule) -> bool:
        """Return whether a plan with this schedule would be the best so far."""
        return self.measure.cost(schedule) < (math.inf if self.upper is None else self.upper)

    def keep(self, found: Incumbent) -> bool:
        """Make a valid plan the incumbent, if it is the best so far; return whether it is."""
        if not self.improves(found.schedule):
            return False
        self.incumbent = found
        return True
