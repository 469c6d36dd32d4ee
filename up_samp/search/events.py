"""What a search tells those who observe it: one named event for each thing that happens."""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from up_samp.model import Refusal, ScheduleReport
    from up_samp.model.refinement import Refinement
    from up_samp.search.bounds import Incumbent
    from up_samp.search.history import History


@dataclass(frozen=True)
class State:
    """Where a search is. Bounds are makespans in units, times in s since its start.

    ``last_plan_at`` and ``last_plan_round``: when the best plan was found (None: there is none).
    """

    rounds: int
    restarts: int
    lower_bound: int
    upper_bound: int | None
    elapsed: float
    last_plan_at: float | None = None
    last_plan_round: int | None = None


class Phase(enum.Enum):
    """What a search is doing."""

    PREPARE = "prepare"
    SCHEDULE = "schedule"
    MOTIONS = "motions"
    GROUP = "group"
    REPAIR = "repair"
    PROOF = "proof"
    NEIGHBOURHOOD = "neighbourhood"
    TIDY = "tidy"


@dataclass(frozen=True)
class StageEvent:
    """Something begins that may take a while; ``count`` of ``total`` is done, or it is about so
    many things; ``name`` says which statement is made in ``PREPARE``.
    """

    state: State
    phase: Phase
    name: str = ""
    count: int = 0
    total: int = 0


@dataclass(frozen=True)
class ScheduleEvent:
    """The scheduler has answered."""

    state: State
    report: ScheduleReport


@dataclass(frozen=True)
class RefinementEvent:
    """Something new was told to the scheduler (all of what one step learned)."""

    state: State
    refinements: Sequence[Refinement]


@dataclass(frozen=True)
class RoundEvent:
    """A candidate was checked: its ``report``, all that was ``learned`` from it and what of that is
    ``rejecting`` it. ``report`` is None before the first schedule.
    """

    state: State
    report: ScheduleReport | None
    learned: Sequence[Refinement]
    rejecting: Sequence[Refinement]
    history: History


@dataclass(frozen=True)
class PlanEvent:
    """A plan was found that is better than all before it."""

    state: State
    incumbent: Incumbent


@dataclass(frozen=True)
class RefusalEvent:
    """The independent validator refused a plan."""

    state: State
    refusals: Sequence[Refusal]


@dataclass(frozen=True)
class RestartEvent:
    """The search begins anew without its guesses; motion queries may take ``query_seconds`` now."""

    state: State
    query_seconds: float


class Observer:
    """Observes a search: override what is of interest. Nothing is done here.

    Called in the thread of the search, which waits meanwhile; what it raises ends the search.
    """

    def on_stage(self, event: StageEvent) -> None:
        """Something begins that may take a while."""

    def on_schedule(self, event: ScheduleEvent) -> None:
        """The scheduler has answered."""

    def on_refinement(self, event: RefinementEvent) -> None:
        """Something new was told to the scheduler."""

    def on_round(self, event: RoundEvent) -> None:
        """A candidate was checked."""

    def on_plan(self, event: PlanEvent) -> None:
        """A better plan was found."""

    def on_refusal(self, event: RefusalEvent) -> None:
        """The validator refused a plan."""

    def on_restart(self, event: RestartEvent) -> None:
        """The search begins anew."""


@dataclass(frozen=True)
class Telling:
    """Tells all observers; ``state`` is asked only where there are any."""

    observers: tuple[Observer, ...]
    state: Callable[[], State]

    def stage(self, phase: Phase, name: str = "", count: int = 0, total: int = 0) -> None:
        """Tell that something begins."""
        for observer in self.observers:
            observer.on_stage(StageEvent(self.state(), phase, name, count, total))

    def schedule(self, report: ScheduleReport) -> None:
        """Tell what the scheduler answered."""
        for observer in self.observers:
            observer.on_schedule(ScheduleEvent(self.state(), report))

    def refinements(self, new: Sequence[Refinement]) -> None:
        """Tell what was learned, if anything."""
        for observer in self.observers if new else ():
            observer.on_refinement(RefinementEvent(self.state(), new))

    def round(
        self,
        report: ScheduleReport | None,
        learned: Sequence[Refinement],
        rejecting: Sequence[Refinement],
        history: History,
    ) -> None:
        """Tell what came of a candidate."""
        for observer in self.observers:
            observer.on_round(RoundEvent(self.state(), report, learned, rejecting, history))

    def plan(self, incumbent: Incumbent) -> None:
        """Tell of a better plan."""
        for observer in self.observers:
            observer.on_plan(PlanEvent(self.state(), incumbent))

    def refusal(self, refusals: Sequence[Refusal]) -> None:
        """Tell of a refused plan."""
        for observer in self.observers:
            observer.on_refusal(RefusalEvent(self.state(), refusals))

    def restart(self, query_seconds: float) -> None:
        """Tell of a new beginning."""
        for observer in self.observers:
            observer.on_restart(RestartEvent(self.state(), query_seconds))
