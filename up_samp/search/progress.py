"""Progress displays: every event of a search as one line of text."""

from __future__ import annotations

from collections.abc import Callable

from up_samp.search.events import (
    Observer,
    Phase,
    PlanEvent,
    RefusalEvent,
    RestartEvent,
    RoundEvent,
    StageEvent,
    State,
)
from up_samp.search.history import ProgressEvent

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
        self.show(ProgressEvent(state.rounds, phase, message, *bounds, state.elapsed))

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
        """Show a plan's makespan."""
        makespan = event.incumbent.schedule.makespan
        self._tell(event.state, "plan", f"plan with makespan {makespan}")

    def on_refusal(self, event: RefusalEvent) -> None:
        """Show what the validator had against a plan."""
        first = event.refusals[0]
        self._tell(event.state, "refused", f"{first.kind}: {first.what}")

    def on_restart(self, event: RestartEvent) -> None:
        """Show that the search begins anew."""
        message = f"motion queries may take {event.query_seconds:g} s now"
        self._tell(event.state, "restart", message)
