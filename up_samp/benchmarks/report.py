"""Reports on sweeps: the paper's Table 1 with ours beside it, Markdown."""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

from up_samp.benchmarks.instances import instances
from up_samp.benchmarks.runner import Record, RunSpec
from up_samp.model.graphs import grouped

GROUPS = ("OC-DO", "OC-DC", "ALL-DO", "ALL-DC", "JSP")
SIZES = (24, 24, 24, 24, 36)

PAPER: dict[str, tuple[float, ...]] = {
    "CPSE, no fluents": (16.7, 14.7, 14.0, 11.7, 13.0, 70.0, 378),
    "Aries, no fluents": (9.0, 11.0, 9.3, 10.3, 12.0, 51.7, 132),
    "Aries, fluents": (18.3, 19.3, 17.0, 16.0, 17.0, 87.7, 343),
    "CPSE-opt, no fluents": (13.3, 12.3, 9.7, 7.3, 11.7, 54.3, 332),
    "Aries-opt, no fluents": (10.3, 8.0, 7.3, 2.3, 12.3, 40.3, 194),
    "Aries-opt, fluents": (12.7, 10.0, 8.3, 6.0, 17.7, 54.7, 227),
}
"""Table 1 of the paper: solved per group, in total, and mean seconds of the solved (1800 s and
20 GB per instance, means of three runs, AMD EPYC 7413)."""


def solved(record: Record) -> bool:
    """Return whether the run found a plan that the independent validator accepts."""
    return record.get("valid") is True


def proven(record: Record) -> bool:
    """Return whether the run's plan is valid and was proven optimal."""
    return solved(record) and record.get("status") == "SOLVED_OPTIMALLY"


def counts(record: Record) -> bool:
    """Return whether the run did what its column asks for: a plan, or a proven optimal one."""
    return proven(record) if record["optimal"] else solved(record)


def column(record: Record) -> str:
    """Return the column that a record counts under."""
    fields = RunSpec.__dataclass_fields__
    return RunSpec(**{k: record[k] for k in fields}).column


def _groups() -> dict[str, str]:
    return {i.name: i.group for i in instances("paper")}


def write(records: Sequence[Record], folder: Path) -> Path:
    """Write ``report.md`` into ``folder``; return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = [
        "# Benchmark report",
        summary(records),
        "## Solved, beside the paper's Table 1",
        table_one(records),
        "A run counts as solved if its plan is valid by the independent validator; in the "
        "*optimal* columns only if it was also proven optimal (relative to the durations that the "
        "motion planner finds), with the number of valid plans after the slash. Numbers are means "
        "over repeated runs. The paper's figures: 1800 s and 20 GB per instance, three runs.",
        "## Drawn anew",
        "Instances of the same sizes from seeds (0: the paper's): runs with a valid plan, with a "
        "proven optimal one, and the mean of (makespan - lower bound) / makespan.",
        table_drawn(records),
        "## Runs that were not solved",
        table_failures(records),
        "## Every instance",
        "Makespan (and the lower bound where it is not met) and seconds; a dash is no plan.",
        table_instances(records),
    ]
    path = folder / "report.md"
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path


def summary(records: Sequence[Record]) -> str:
    """Return one sentence on what was solved, and on invalid plans if there are any."""
    runs = len(records)
    text = (
        f"{sum(map(solved, records))} of {runs} runs found a valid plan, "
        f"{sum(map(proven, records))} proven optimal."
    )
    wrong = [r["instance"] for r in records if r.get("valid") is False]
    return text + (f" **{len(wrong)} invalid plans**: {', '.join(wrong)}." if wrong else "")


def table_one(records: Sequence[Record]) -> str:
    """Return the paper's Table 1 with a row for each of our columns."""
    group_of = _groups()
    sizes = [*(f"{g} ({n})" for g, n in zip(GROUPS, SIZES, strict=True)), "total (132)", "mean s"]
    rows = [["engine", *sizes]]
    for title, figures in PAPER.items():
        rows.append([f"paper: {title}", *(f"{v:g}" for v in figures)])
    for title, ours in grouped([r for r in records if r["instance"] in group_of], column).items():
        repeats = len({r["number"] for r in ours})
        parts = grouped(ours, lambda r: group_of[r["instance"]])
        cells = [_solved_cell(parts.get(group, ()), repeats) for group in GROUPS]
        seconds = [r["seconds"] for r in ours if counts(r)]
        mean = f"{statistics.fmean(seconds):.3g}" if seconds else "-"
        rows.append([title, *cells, _solved_cell(ours, repeats), mean])
    return _table(rows)


def _solved_cell(part: Sequence[Record], repeats: int) -> str:
    if not part:
        return "not run"
    cell = f"{sum(map(counts, part)) / repeats:g}"
    if any(r["optimal"] for r in part):
        cell += f" / {sum(map(solved, part)) / repeats:g}"
    return cell


def table_drawn(records: Sequence[Record]) -> str:
    """Return for each family and engine what was found for each seed that it was drawn from."""

    def place(record: Record) -> tuple[str, str, int]:
        family, _, rest = record["instance"].partition("-")
        seed = re.search(r"-s(\d+)$", rest)
        return family, column(record), int(seed[1]) if seed else 0

    runs = grouped(records, place)
    seeds = sorted({seed for *_, seed in runs})
    rows = [["family", "engine", *(f"seed {seed}" for seed in seeds)]]
    for head in dict.fromkeys((family, title) for family, title, _ in runs):
        rows.append([*head, *(_drawn_cell(runs.get((*head, seed), ())) for seed in seeds)])
    return _table(rows)


def _drawn_cell(part: Sequence[Record]) -> str:
    if not part:
        return "not run"
    plans = [(r["makespan"], r.get("metrics", {}).get("lower_bound", 0)) for r in part if solved(r)]
    gaps = [max(0.0, 1 - bound / max(1, makespan)) for makespan, bound in plans]
    mean = f"{statistics.fmean(gaps):.1%}" if gaps else "-"
    return f"{len(plans)} / {sum(map(proven, part))} of {len(part)}, gap {mean}"


def table_failures(records: Sequence[Record]) -> str:
    """Return every run that did not do what was asked, with its reason."""
    rows = [
        [r["instance"], column(r), str(r.get("status")), _reason(r)]
        for r in records
        if not counts(r)
    ]
    return _table([["instance", "engine", "status", "reason"], *rows]) if rows else "None."


def table_instances(records: Sequence[Record]) -> str:
    """Return a row per instance with the makespan, bound and time of each column's first run."""
    names = {r["instance"] for r in records}
    published = [name for name in _groups() if name in names]
    titles, runs = grouped(records, column), grouped(records, lambda r: (r["instance"], column(r)))
    rows = [["instance", *titles]]
    for name in (*published, *sorted(names - set(published))):
        rows.append([name, *(_outcome(runs.get((name, title), ())) for title in titles)])
    return _table(rows)


def _outcome(repeated: Sequence[Record]) -> str:
    """Return what came of the first of some runs."""
    if not repeated:
        return ""
    record = repeated[0]
    if not solved(record):
        return f"- ({record.get('seconds') or record['timeout']:.0f} s)"
    bound = record.get("metrics", {}).get("lower_bound")
    gap = "" if bound is None or bound >= record["makespan"] else f" (≥ {bound})"
    return f"{record['makespan']}{gap}, {record['seconds']:.1f} s"


def _reason(record: Record) -> str:
    if record.get("valid") is False:
        text = "invalid plan: " + "; ".join(record.get("violations", []))
    elif solved(record):
        bound = record.get("metrics", {}).get("lower_bound", "none")
        text = f"valid plan of {record.get('makespan')}, not proven optimal (lower bound {bound})"
    else:
        text = record.get("error") or "; ".join(record.get("messages", []))
    return " ".join(text.split()).replace("|", "\\|")[:200]


def _table(rows: Sequence[Sequence[str]]) -> str:
    line: Callable[[Sequence[str]], str] = lambda cells: "| " + " | ".join(cells) + " |"  # noqa: E731
    return "\n".join([line(rows[0]), "|" + "---|" * len(rows[0]), *map(line, rows[1:])])
