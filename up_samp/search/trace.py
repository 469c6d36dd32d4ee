"""A readable trace: every candidate schedule and every refinement, one text file a round."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from up_samp.model import ScheduleReport
from up_samp.model.refinement import Refinement
from up_samp.search.context import Context


def write_trace(
    context: Context, report: ScheduleReport, refinements: Sequence[Refinement]
) -> None:
    """Write ``round-NNN.txt`` into the trace folder, if there is one."""
    if context.params.trace is None:
        return
    folder = Path(context.params.trace)
    folder.mkdir(parents=True, exist_ok=True)
    number = len(context.history.rounds)
    lines = [
        f"round {number}: {report.status.value}, lower bound {context.lower_bound}, "
        f"best plan {context.upper_bound}",
        "",
    ]
    if report.schedule is not None:
        lines.append(f"candidate schedule, makespan {report.schedule.makespan}:")
        for name, (start, end) in sorted(
            report.schedule.times.items(), key=lambda item: (item[1], item[0])
        ):
            lines.append(f"  [{start:5d}, {end:5d}]  {name}")
    lines += ["", f"{len(refinements)} refinements that reject it:"]
    lines += [f"  {r}" for r in refinements]
    (folder / f"round-{number:03d}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
