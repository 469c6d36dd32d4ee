"""Presets side by side on the same instances, and each idea of the default switched off.

    python benchmarks/search/compare.py --out results/search [--ablations] [--timeout 20] [--jobs 2]

Each run is a process of its own with its own limits; a run that was stopped goes on where it was.
Writes ``runs.jsonl`` (every run), ``compare.json`` (figures) and ``compare.md`` (tables).
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Sequence
from pathlib import Path

from up_samp.benchmarks.builder import ENCODINGS
from up_samp.benchmarks.report import REFINEMENTS, counts, proven, solved
from up_samp.benchmarks.runner import executor_for, run_sweep, warm_up
from up_samp.benchmarks.runs import Record, select, sweep
from up_samp.search import ABLATIONS

PRESETS = ("default", "paper", "sequential")
INSTANCES = ("logistics-*-r[12]-i[123]", "jobshop-r[12]-j[12]-m[12]")
FEW = ("logistics-d?-*-r2-i[23]", "jobshop-r2-j2-m[12]")
"""The instances on which ideas are switched off: those where robots meet."""


def main() -> None:
    """Run what has no record yet, and write the tables."""
    options = arguments()
    presets = ("default", *ABLATIONS) if options.ablations else PRESETS
    chosen = select(options.instances or (FEW if options.ablations else INSTANCES))
    specs = sweep(
        chosen,
        [options.engine],
        encodings=[options.encoding],
        presets=presets,
        optimal=options.optimal,
        runs=options.runs,
        timeout=options.timeout,
    )
    with executor_for(options.jobs) as executor:
        if options.warm_up:
            warm_up(specs, executor)
        records = run_sweep(specs, options.out, executor, again=("CRASH",))
    figures = {
        "timeout": options.timeout,
        "optimal": options.optimal,
        "presets": {p: summary(records, p) for p in presets},
        "against": {p: against(records, p) for p in presets if p != "default"},
    }
    name = "ablations" if options.ablations else "compare"
    text = json.dumps(figures, indent=1) + "\n"
    (options.out / f"{name}.json").write_text(text, encoding="utf-8")
    text = markdown(records, presets, figures)
    (options.out / f"{name}.md").write_text(text, encoding="utf-8")
    print(text)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of records and tables")
    parser.add_argument("--instances", nargs="+", help="names or patterns")
    parser.add_argument("--ablations", action="store_true", help="switch ideas off one by one")
    parser.add_argument("--engine", default="samp-refine[cpsat]")
    parser.add_argument("--encoding", choices=ENCODINGS, default="lean")
    parser.add_argument("--optimal", action="store_true", help="go on until proven optimal")
    parser.add_argument("--timeout", type=float, default=20.0, help="seconds per run")
    parser.add_argument("--runs", type=int, default=1, help="repetitions (seeds)")
    parser.add_argument("--jobs", type=int, default=2, help="runs at a time")
    parser.add_argument("--no-warm-up", dest="warm_up", action="store_false")
    return parser.parse_args()


def metric(record: Record, *names: str) -> int | None:
    """Return the sum of an engine's metrics, None where it has none."""
    metrics = record.get("metrics") or {}
    return sum(int(metrics[n]) for n in names) if all(n in metrics for n in names) else None


def search_seconds(record: Record) -> float | None:
    """Return the seconds in the scheduler and in motion planning."""
    metrics = record.get("metrics") or {}
    parts = [metrics.get(f"seconds_{name}") for name in ("scheduler", "motion")]
    return None if None in parts else sum(float(p) for p in parts)


def summary(records: Sequence[Record], preset: str) -> dict[str, object]:
    """Return the figures of one preset over all of its runs."""
    own = [r for r in records if r["preset"] == preset]
    good = [r for r in own if counts(r)]
    return {
        "runs": len(own),
        "solved": sum(solved(r) for r in own),
        "proven": sum(proven(r) for r in own),
        "invalid": sum(r.get("valid") is False for r in own),
        "median_seconds": median([r["seconds"] for r in good]),
        "median_rounds": median([metric(r, "rounds") for r in good]),
        "median_refinements": median([metric(r, *REFINEMENTS) for r in good]),
        "makespans": sum(r["makespan"] for r in good),
    }


def against(records: Sequence[Record], preset: str) -> dict[str, object]:
    """Return how the default compares with a preset, on runs that both of them solved.

    ``..._of_all`` is over all that the default solved: where the other ran out of time, its limit
    counts, so the true share is smaller still. ``share_of_search`` leaves out what every run has to
    do besides scheduling and motion planning (loading kernels, reading, validating).
    """
    pairs = [(d, o) for d, o in paired(records, preset) if counts(d) and counts(o)]
    late = [
        (d, o)
        for d, o in paired(records, preset)
        if counts(d) and (counts(o) or o["status"] == "TIMEOUT")
    ]
    only = [o["instance"] for d, o in paired(records, preset) if counts(o) and not counts(d)]
    return {
        "both": len(pairs),
        "only_the_other": sorted(set(only)),
        "share_of_rounds": ratio([(metric(d, "rounds"), metric(o, "rounds")) for d, o in pairs]),
        "share_of_time": ratio([(d["seconds"], o["seconds"]) for d, o in pairs]),
        "share_of_time_of_all": ratio([(d["seconds"], o["seconds"]) for d, o in late]),
        "share_of_search_of_all": ratio([(search_seconds(d), search_seconds(o)) for d, o in late]),
        "share_of_makespan": ratio([(d["makespan"], o["makespan"]) for d, o in pairs]),
    }


def paired(records: Sequence[Record], preset: str) -> list[tuple[Record, Record]]:
    """Return the default's and another preset's runs of the same instance and number."""
    default = {(r["instance"], r["number"]): r for r in records if r["preset"] == "default"}
    others = [r for r in records if r["preset"] == preset]
    found = [(default.get((r["instance"], r["number"])), r) for r in others]
    return [(d, o) for d, o in found if d is not None]


def median(values: Sequence[float | None]) -> float | None:
    """Return the median of what there is."""
    known = [v for v in values if v is not None]
    return round(statistics.median(known), 3) if known else None


def ratio(pairs: Sequence[tuple[float | None, float | None]]) -> float | None:
    """Return the median of the first's share of the second."""
    return median([a / b for a, b in pairs if a is not None and b])


def markdown(records: Sequence[Record], presets: Sequence[str], figures: dict) -> str:
    """Return tables: the presets as a whole, then instance by instance."""
    goal = "proven optimal" if figures["optimal"] else "a first plan"
    lines = [f"Goal: {goal} within {figures['timeout']:g} s each.", ""]
    heads = ("solved", "proven", "invalid", "median s", "rounds", "refinements", "makespans")
    lines += [f"| preset | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for preset, row in figures["presets"].items():
        runs, *cells = row.values()
        lines.append(f"| {preset} ({runs} runs) | {' | '.join(show(c) for c in cells)} |")
    lines += ["", "The default's share (median over what both solved) of the other's:", ""]
    heads = (
        "both solved",
        "only the other",
        "rounds",
        "time",
        "time, time-outs counted",
        "scheduling and motion, time-outs counted",
        "makespan",
    )
    lines += [f"| other | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for preset, row in figures["against"].items():
        lines.append(f"| {preset} | {' | '.join(show(c) for c in row.values())} |")
    lines += ["", "Seconds / rounds / refinements / makespan (or how it ended):", ""]
    lines += [f"| instance | {' | '.join(presets)} |", "|---" * (len(presets) + 1) + "|"]
    cells = {(r["instance"], r["preset"]): describe(r) for r in reversed(records)}
    for name in dict.fromkeys(r["instance"] for r in records):
        row = " | ".join(cells.get((name, p), "") for p in presets)
        lines.append(f"| {name} | {row} |")
    return "\n".join(lines) + "\n"


def show(cell: object) -> str:
    if isinstance(cell, list):
        return ", ".join(cell) or "none"
    return "-" if cell is None else f"{cell:g}" if isinstance(cell, float) else str(cell)


def describe(record: Record) -> str:
    """Return one run in a cell."""
    if record.get("valid") is False:
        return "INVALID"
    if not solved(record):
        return str(record.get("status", "?")).lower()
    mark = "*" if proven(record) else ""
    rounds, refinements = metric(record, "rounds"), metric(record, *REFINEMENTS)
    return f"{record['seconds']:.1f} / {rounds} / {refinements} / {record['makespan']}{mark}"


if __name__ == "__main__":
    main()
