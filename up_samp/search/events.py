"""What a search tells those who observe it, one named event for each thing that happens, and the
observers that write it: a line of text an event, or one readable file a round.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from up_samp.model.refinement import Refinement
from up_samp.search.history import ProgressEvent
from up_samp.system.files import write_whole
from up_samp.upio.objective import Measure, Number

if TYPE_CHECKING:
    from up_samp.model import Refusal, ScheduleReport
    from up_samp.model.refinement import Refinement
    from up_samp.search.history import History
    from up_samp.search.knowledge import Incumbent


@dataclass(frozen=True)
class State:
    """Where a search is. Bounds are costs by ``measure`` (makespans in units; of what is maximised,
    with the other sign; None: there is none), times in s since its start.

    ``last_plan_at`` and ``last_plan_round``: when the best plan was found (None: there is none).
    """

    rounds: int
    restarts: int
    lower_bound: Number | None
    upper_bound: Number | None
    elapsed: float
    last_plan_at: float | None = None
    last_plan_round: int | None = None
    measure: Measure = field(default_factory=lambda: Measure(lambda s: s.makespan))


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


# ------------------ Progress displays: every event of a search as one line of text


_TEXTS: dict[Phase, Callable[[StageEvent], str]] = {
    Phase.PREPARE: lambda e: e.name if not e.total else f"{e.name} {e.count}/{e.total}",
    Phase.SCHEDULE: lambda e: "scheduling",
    Phase.MOTIONS: lambda e: f"checking {e.count} motions",
    Phase.GROUP: lambda e: f"{e.count} motions together",
    Phase.REPAIR: lambda e: "giving motions the time they need",
    Phase.PROOF: lambda e: f"trying {e.count} proven facts alone",
    Phase.NEIGHBOURHOOD: lambda e: f"deciding anew for {e.count} robots ({e.name})",
    Phase.TIDY: lambda e: "leaving out motions that nothing needs",
}


class ProgressObserver(Observer):
    """Calls ``show`` with a :class:`ProgressEvent` for each step."""

    def __init__(self, show: Callable[[ProgressEvent], None]) -> None:
        self.show = show

    def _tell(self, state: State, phase: str, message: str) -> None:
        bounds = state.lower_bound, state.upper_bound
        named = state.measure.name, state.measure.sign
        self.show(ProgressEvent(state.rounds, phase, message, *bounds, state.elapsed, *named))

    def on_stage(self, event: StageEvent) -> None:
        """Show what begins."""
        self._tell(event.state, event.phase.value, _TEXTS[event.phase](event))

    def on_round(self, event: RoundEvent) -> None:
        """Show what a candidate told."""
        if event.report is not None:
            count = len(event.rejecting)
            message = f"{count} refinements" if count else "candidate fits"
            self._tell(event.state, "round", message)

    def on_plan(self, event: PlanEvent) -> None:
        """Show what a plan is worth."""
        measure, cost = event.state.measure, event.state.upper_bound
        told = "-" if cost is None else measure.told(cost)
        self._tell(event.state, "plan", f"plan with {measure.name} {told}")

    def on_refusal(self, event: RefusalEvent) -> None:
        """Show what the validator had against a plan."""
        first = event.refusals[0]
        self._tell(event.state, "refused", f"{first.kind}: {first.what}")

    def on_restart(self, event: RestartEvent) -> None:
        """Show that the search begins anew."""
        message = f"motion queries may take {event.query_seconds:g} s now"
        self._tell(event.state, "restart", message)


# ------------------ A readable trace
# A readable trace: every candidate schedule and every refinement, one text file a round.


class TraceObserver(Observer):
    """Writes ``round-NNN.txt`` into a folder, and the history so far."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def on_round(self, event: RoundEvent) -> None:
        """Write what a candidate was and what was learned from it."""
        self.folder.mkdir(parents=True, exist_ok=True)
        number = len(event.history.rounds)
        lines = [*_candidate(event, number), ""]
        if event.report is not None:
            lines += _listed(event.rejecting, "that the candidate breaks")
        kept = [r for r in event.learned if r not in event.rejecting]
        first = event.report is None
        lines += _listed(kept, "stated before the first schedule" if first else "more")
        write_whole(self.folder / f"round-{number:03d}.txt", "\n".join(lines) + "\n")
        event.history.write_json(self.folder / "history.json")
        event.history.write_csv(self.folder / "rounds.csv")


def _candidate(event: RoundEvent, number: int) -> list[str]:
    report, state = event.report, event.state
    if report is None:
        return ["before the first schedule"]
    cost, measure = state.upper_bound, state.measure
    best = "none" if cost is None else f"{measure.name} {measure.told(cost)}"
    lines = [
        f"round {number}: schedule {report.status.value}, lower bound {state.lower_bound}, "
        f"best plan: {best}"
    ]
    if report.schedule is not None:
        lines += ["", f"candidate schedule, makespan {report.schedule.makespan}:"]
        times = report.schedule.times.items()
        for name, (start, end) in sorted(times, key=lambda item: (item[1], item[0])):
            lines.append(f"  [{start:5d}, {end:5d}]  {name}")
    return lines


def _listed(refinements: Sequence[Refinement], which: str) -> list[str]:
    noun = "refinement" if len(refinements) == 1 else "refinements"
    return [f"{len(refinements)} {noun} {which}", *(f"  {r}" for r in refinements)]
