"""A readable trace: every candidate schedule and every refinement, one text file a round."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from up_samp.model import ScheduleReport
from up_samp.model.refinement import Refinement
from up_samp.search.context import Context
from up_samp.system.files import write_whole


def write_trace(
    context: Context,
    report: ScheduleReport | None,
    learned: Sequence[Refinement],
    rejecting: Sequence[Refinement] = (),
) -> None:
    """Write ``round-NNN.txt`` into the trace folder, if there is one, and the history so far.

    :param report: the scheduler's answer; ``None`` before the first one (round 0).
    :param learned: what was told to the scheduler in this round.
    :param rejecting: those that the candidate schedule breaks.
    """
    if context.params.trace is None:
        return
    folder = Path(context.params.trace)
    folder.mkdir(parents=True, exist_ok=True)
    number = len(context.history.rounds)
    lines = [*_candidate(context, report, number), ""]
    if report is not None:
        lines += _listed(rejecting, "that the candidate breaks")
    kept = [r for r in learned if r not in rejecting]
    lines += _listed(kept, "stated before the first schedule" if report is None else "more")
    write_whole(folder / f"round-{number:03d}.txt", "\n".join(lines) + "\n")
    context.history.write_json(folder / "history.json")
    context.history.write_csv(folder / "rounds.csv")


def _candidate(context: Context, report: ScheduleReport | None, number: int) -> list[str]:
    if report is None:
        return ["before the first schedule"]
    best = "none" if context.upper_bound is None else f"makespan {context.upper_bound}"
    lines = [
        f"round {number}: schedule {report.status.value}, lower bound {context.lower_bound}, "
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
