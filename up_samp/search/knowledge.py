"""What a search knows: refinements, bounds with the incumbent, and the history of its rounds."""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from up_samp.model import CandidateSchedule, Trajectory
from up_samp.model.deadline import clock
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.search.facts import Signature
from up_samp.system.child import peak_memory
from up_samp.system.files import write_whole
from up_samp.upio import Relaxation, SampSchedule, write_refinement
from up_samp.upio.objective import Measure, Number, shown

READING, STATING, SCHEDULING = "reading", "stating", "scheduling"
BUILDING = "building"
CHECKING, REPAIRING, LEARNING, VALIDATING = "checking", "repairing", "learning", "validating"
STAGES = (READING, STATING, SCHEDULING, BUILDING, CHECKING, REPAIRING, LEARNING, VALIDATING)
"""What every search does."""
TOLD = {
    READING: "reading the problem",
    STATING: "what holds before the first schedule",
    BUILDING: "assigning the work",
    CHECKING: "motions",
    REPAIRING: "motions of schedules that were mended",
}
"""What a user calls the stages; the others are called what they are."""


@dataclass
class Stages:
    """By stage, in all its turns together: ``seconds`` as time limits count them, ``cpu`` seconds
    of this process (all its threads), and ``peak``: the most memory (MiB) that the process had held
    by the end of its last turn (empty where the system does not tell).
    """

    seconds: dict[str, float] = field(default_factory=dict)
    cpu: dict[str, float] = field(default_factory=dict)
    peak: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Count what is done meanwhile for a stage."""
        began, worked = clock(), time.process_time()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + clock() - began
            self.cpu[stage] = self.cpu.get(stage, 0.0) + time.process_time() - worked
            held = peak_memory()
            if held is not None:
                self.peak[stage] = held

    def metrics(self) -> dict[str, str]:
        """Return everything as a result's metrics: ``seconds_validating``, ``mib_checking``, ..."""
        tables = {"seconds": (self.seconds, 3), "cpu": (self.cpu, 3), "mib": (self.peak, 0)}
        return {
            f"{told}_{stage}": f"{value:.{digits}f}"
            for told, (table, digits) in tables.items()
            for stage, value in table.items()
        }


@dataclass(frozen=True)
class ProgressEvent:
    """One step of the search, for progress displays. Bounds are costs by the objective that is
    ``named``: makespans in units; of what is maximised, with the other sign.
    """

    round: int
    phase: str
    message: str
    lower_bound: int | Fraction | None
    upper_bound: int | Fraction | None
    elapsed: float
    named: str = "makespan"
    sign: int = 1

    @property
    def bounds(self) -> str:
        """What is known of the objective, in the user's values ("": nothing)."""
        least, most = (">=", self.lower_bound), ("<=", self.upper_bound)
        if self.sign < 0:
            least, most = (">=", self.upper_bound), ("<=", self.lower_bound)
        other = self.named != "makespan"
        known = [(op, v) for op, v in (least, most) if v or (other and v is not None)]
        told = [f"{op} {shown(self.sign * v)}" for op, v in known if v is not None]
        return f"{self.named} {', '.join(told)}" if told else ""


@dataclass
class Round:
    """One candidate schedule and what came of it (times in s, bounds in units)."""

    number: int
    makespan: int | None
    lower_bound: int | Fraction | None
    upper_bound: int | Fraction | None
    refinements: int
    seconds_scheduler: float
    seconds_motion: float
    elapsed: float
    outcome: str


@dataclass
class History:
    """All rounds and refinements of a search."""

    rounds: list[Round] = field(default_factory=list)
    refinements: list[Refinement] = field(default_factory=list)
    seconds_scheduler: float = 0.0
    seconds_motion: float = 0.0
    stages: Stages = field(default_factory=Stages)
    """What each stage took."""
    restarts: int = 0
    recognised: tuple[str, ...] = ()
    """Structures that the scheduler found in the problem ..."""
    left_over: tuple[str, ...] = ()
    """... and what it took as it is written."""
    handed_over: list[str] = field(default_factory=list)
    """What of the problem another engine was asked for, and what it answered."""
    refused: list[str] = field(default_factory=list)
    """What the validator had against plans that the search took for valid; it learned from it."""
    missed: list[str] = field(default_factory=list)
    """Each time that motions were not found, or not in time: which, and among what that rests."""
    refuted: list[str] = field(default_factory=list)
    """Claims of ours that were refuted: errors of the package."""

    may_be_shorter: dict[str, float] = field(default_factory=dict)
    """Motions of the best plan that may be shorter than the planner's own, which a relative bound
    rests on: by what share of its time each is longer than is proven to be needed, worst first.
    """

    without_traffic: int | None = None
    """The least makespan (units) found of a large problem in which robots heed each other at shared
    places only, each taken by one at a time with the least handover that a plan has shown.
    """

    last_plan_round: int | None = None
    """In which round the best plan was found ..."""
    last_plan_at: float | None = None
    """... and when (s since the start)."""

    def planned(self, number: int, at: float) -> None:
        """Note that a better plan was found."""
        self.last_plan_round, self.last_plan_at = number, at

    def count(self, layer: Layer) -> int:
        """Return how many refinements a layer gave."""
        return sum(1 for r in self.refinements if r.layer is layer)

    def by_kind(self) -> dict[str, int]:
        """Return how many refinements there were of each layer and strength."""
        kinds = Counter(f"{r.layer.value}/{r.strength.value}" for r in self.refinements)
        return dict(sorted(kinds.items()))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "rounds": [asdict(r) for r in self.rounds],
            "refinements": [
                {
                    "layer": r.layer.value,
                    "strength": r.strength.value,
                    "statement": str(r.statement),
                    "why": r.why,
                }
                for r in self.refinements
            ],
            "refinements_by_kind": self.by_kind(),
            "seconds_scheduler": self.seconds_scheduler,
            "seconds_motion": self.seconds_motion,
            "stages": asdict(self.stages),
            "restarts": self.restarts,
            "refused": self.refused,
            "refuted": self.refuted,
        }

    def write_json(self, path: str | Path) -> None:
        """Write the history as JSON."""
        write_whole(Path(path), json.dumps(self.to_dict(), indent=1, default=float) + "\n")


# ------------------ What it has learned: refinements, and what they rest on


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
