"""``up-samp bench``: run sweeps over the benchmark families and report on them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from up_samp.benchmarks.instances import ENCODINGS, families
from up_samp.cli.options import Command, option
from up_samp.model import ProblemError
from up_samp.tuning import read_tuning


def _run(args: argparse.Namespace) -> int:
    from up_samp.benchmarks import report, runner
    from up_samp.benchmarks.runner import select, sweep

    specs = sweep(
        select(args.names, args.seeds),
        args.engines,
        encodings=args.encodings,
        presets=args.preset,
        tunings=["", *map(_tuning, args.tuning)],
        optimal=not args.first_plan,
        runs=args.runs,
        timeout=args.timeout,
        memory=args.memory,
    )
    records = runner.run_sweep(specs, args.out, args.jobs)
    for record in records:
        print(runner.describe(record))
    path = report.write(records, args.out)
    print(f"\n{report.summary(records)}\nreport: {path}")
    return 1 if any(r.get("valid") is False for r in records) else 0


def _tuning(path: Path) -> str:
    """Return what a tuning file changes, as JSON."""
    return json.dumps(read_tuning(path).changes(), sort_keys=True)


def _report(args: argparse.Namespace) -> int:
    from up_samp.benchmarks import report, runner

    records = runner.read_records(*args.folders)
    if not records:
        raise ProblemError("no runs in " + ", ".join(map(str, args.folders)))
    path = report.write(records, args.out or args.folders[0])
    print(f"{report.summary(records)}\nreport: {path}")
    return 0


def _list(args: argparse.Namespace) -> int:
    from up_samp.benchmarks.runner import select

    for chosen in select(args.names):
        print(chosen.name)
    return 0


COMMANDS: dict[str, dict[str, tuple[str, Command]]] = {
    "bench": {
        "run": ("run a sweep (resumes where it was stopped)", (_run, (
            option("names", f"{', '.join(('paper', *families()))}; or an instance's name or a "
                   "pattern such as 'logistics-oc-*-r1-*'", "FAMILY", nargs="+"),
            option("--engines", None, "ENGINE", default=["samp-refine[cpsat]"], nargs="+"),
            option("--preset", None, "NAME", default=["default"], nargs="+"),
            option("--tuning", "tunables to sweep over: each file is one more setting beside the "
                   "defaults", "FILE.toml", Path, [], nargs="+"),
            option("--encodings", default=["fluents"], choices=ENCODINGS, nargs="+"),
            option("--first-plan", "no metric: stop at the first plan (default: minimise the "
                   "makespan, with proof)", action="store_true"),
            option("--timeout", "s per run", "S", float, 60.0),
            option("--memory", "MB per run", "MB", int, 20_000),
            option("--runs", "repetitions (seeds)", "N", int, 1),
            option("--seeds", "draw the instances anew from these seeds, all but their sizes (0: "
                   "as they are)", "N", int, [0], nargs="+"),
            option("--jobs", "runs at a time", "J", int, 1),
            option("--out", None, "DIR", Path, required=True),
        ))),
        "report": ("tables and plots of finished sweeps, as Markdown", (_report, (
            option("folders", None, "DIR", Path, nargs="+"),
            option("--out", "where report.md goes (default: the first DIR)", "DIR", Path),
        ))),
        "list": ("names of instances", (_list, (
            option("names", None, "FAMILY", default=["paper"], nargs="*"),
        ))),
    },
}  # fmt: skip
