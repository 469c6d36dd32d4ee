"""A readable trace: every candidate schedule and every refinement, one text file a round."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from up_samp.model.refinement import Refinement
from up_samp.search.events import Observer, RoundEvent
from up_samp.system.files import write_whole


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
    best = "none" if state.upper_bound is None else f"makespan {state.upper_bound}"
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
