"""What a search tells those who observe it, a method for each thing that happens, and the
observers that write it: a line of text each time, or one readable file a round.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from up_samp.model import ScheduleReport, Violation
from up_samp.model.errors import in_words
from up_samp.model.refinement import Refinement
from up_samp.search.knowledge import History, Incumbent, ProgressEvent
from up_samp.system.files import write_whole
from up_samp.upio.objective import Measure, Number, shown

Report = ScheduleReport | None
Learned = Sequence[Refinement]


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

    @property
    def gap(self) -> float:
        """The share by which the best plan is worse than what is proven (inf: there is no plan, or
        no bound): 0.1 of a makespan of 100 where 90 is a lower bound.
        """
        upper, lower = self.upper_bound, self.lower_bound
        if upper is None or lower is None:
            return math.inf
        return float(upper - lower) / abs(float(upper)) if upper != lower else 0.0


class Phase(enum.Enum):
    """What a search is doing."""

    PREPARE = "prepare"
    SCHEDULE = "schedule"
    MOTIONS = "motions"
    GROUP = "group"
    REPAIR = "repair"
    PROOF = "proof"
    TIDY = "tidy"


class Observer:
    """Observes a search: override what is of interest. Nothing is done here.

    Each method is told first where the search is. Called in the thread of the search, which waits
    meanwhile; what it raises ends the search.
    """

    def on_stage(self, state: State, phase: Phase, name: str, count: int, total: int) -> None:
        """Something begins that may take a while; ``count`` of ``total`` is done, or it is about so
        many things; ``name`` says which statement is made in ``PREPARE``.
        """

    def on_schedule(self, state: State, report: ScheduleReport) -> None:
        """The scheduler has answered."""

    def on_refinement(self, state: State, refinements: Sequence[Refinement]) -> None:
        """Something new was told to the scheduler (all of what one step learned)."""

    def on_round(
        self, state: State, report: Report, learned: Learned, rejecting: Learned, history: History
    ) -> None:
        """A candidate was checked: its ``report``, all that was ``learned`` from it and what of
        that is ``rejecting`` it. ``report`` is None before the first schedule.
        """

    def on_plan(self, state: State, incumbent: Incumbent) -> None:
        """A plan was found that is better than all before it."""

    def on_refusal(self, state: State, refusals: Sequence[Violation]) -> None:
        """The independent validator refused a plan."""

    def on_restart(self, state: State, query_seconds: float) -> None:
        """The search begins anew without its guesses; motion queries may take ``query_seconds``."""


@dataclass(frozen=True)
class Telling:
    """Tells all observers; ``state`` is asked only where there are any."""

    observers: tuple[Observer, ...]
    state: Callable[[], State]

    def __call__(self, event: str, *told: object) -> None:
        """Tell of an event: ``plan`` for :meth:`Observer.on_plan`, say."""
        for observer in self.observers:
            getattr(observer, f"on_{event}")(self.state(), *told)

    def stage(self, phase: Phase, name: str = "", count: int = 0, total: int = 0) -> None:
        """Tell that something begins."""
        self("stage", phase, name, count, total)


# ------------------ Progress displays: every event of a search as one line of text


_TEXTS = {
    Phase.SCHEDULE: "scheduling",
    Phase.MOTIONS: "checking {count} motions",
    Phase.GROUP: "{count} motions together",
    Phase.REPAIR: "giving motions the time they need",
    Phase.PROOF: "trying {count} proven facts alone",
    Phase.TIDY: "leaving out motions that nothing needs",
}


class ProgressObserver(Observer):
    """Calls ``show`` with a :class:`ProgressEvent` for each step."""

    def __init__(self, show: Callable[[ProgressEvent], None]) -> None:
        self.show = show

    def _tell(self, state: State, phase: str, message: str) -> None:
        bounds = state.lower_bound, state.upper_bound
        named = state.measure.name, state.measure.sign
        text = in_words(message)
        self.show(ProgressEvent(state.rounds, phase, text, *bounds, state.elapsed, *named))

    def on_stage(self, state: State, phase: Phase, name: str, count: int, total: int) -> None:
        """Show what begins."""
        usual = "{name} {count}/{total}" if total else "{name}"
        text = _TEXTS.get(phase, usual).format(name=name, count=count, total=total)
        self._tell(state, phase.value, text)

    def on_round(
        self, state: State, report: Report, learned: Learned, rejecting: Learned, history: History
    ) -> None:
        """Show what a candidate told."""
        if report is not None:
            count = len(rejecting)
            self._tell(state, "round", f"{count} refinements" if count else "candidate fits")

    def on_plan(self, state: State, incumbent: Incumbent) -> None:
        """Show what a plan is worth."""
        measure, cost = state.measure, state.upper_bound
        told = "-" if cost is None else shown(measure.sign * cost)
        self._tell(state, "plan", f"plan with {measure.name} {told}")

    def on_refusal(self, state: State, refusals: Sequence[Violation]) -> None:
        """Show what the validator had against a plan."""
        self._tell(state, "refused", f"{refusals[0].kind}: {refusals[0].what}")

    def on_restart(self, state: State, query_seconds: float) -> None:
        """Show that the search begins anew."""
        self._tell(state, "restart", f"motion queries may take {query_seconds:g} s now")


# ------------------ A readable trace
# Every candidate schedule and every refinement, one text file a round.


class TraceObserver(Observer):
    """Writes ``round-NNN.txt`` into a folder, and the history so far."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def on_round(
        self, state: State, report: Report, learned: Learned, rejecting: Learned, history: History
    ) -> None:
        """Write what a candidate was and what was learned from it."""
        self.folder.mkdir(parents=True, exist_ok=True)
        number = len(history.rounds)
        lines = [*_candidate(state, report, number), ""]
        if report is not None:
            lines += _listed(rejecting, "that the candidate breaks")
        kept = [r for r in learned if r not in rejecting]
        lines += _listed(kept, "stated before the first schedule" if report is None else "more")
        write_whole(self.folder / f"round-{number:03d}.txt", "\n".join(lines) + "\n")
        history.write_json(self.folder / "history.json")


def _candidate(state: State, report: ScheduleReport | None, number: int) -> list[str]:
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
