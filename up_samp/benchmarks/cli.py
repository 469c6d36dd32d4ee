"""``up-samp bench``: run sweeps over the benchmark families and report on them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from up_samp.benchmarks.instances import ENCODINGS, families
from up_samp.model import ProblemError
from up_samp.tuning import read_tuning


def add_bench(bench: argparse.ArgumentParser) -> None:
    """Add the commands of ``bench``: ``run``, ``report`` and ``list``."""
    commands = bench.add_subparsers(required=True)
    _add_run(commands)
    show = commands.add_parser("report", help="tables and plots of finished sweeps, as Markdown")
    show.add_argument("folders", nargs="+", type=Path, metavar="DIR")
    show.add_argument(
        "--out", type=Path, metavar="DIR", help="where report.md goes (default: the first DIR)"
    )
    names = commands.add_parser("list", help="names of instances")
    names.add_argument("names", nargs="*", default=["paper"], metavar="FAMILY")
    show.set_defaults(run=_report)
    names.set_defaults(run=_list)


def _add_run(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    known = ", ".join(("paper", *families()))
    sweeper = commands.add_parser("run", help="run a sweep (resumes where it was stopped)")
    sweeper.add_argument(
        "names",
        nargs="+",
        metavar="FAMILY",
        help=f"{known}; or an instance's name or a pattern such as 'logistics-oc-*-r1-*'",
    )
    sweeper.add_argument("--engines", nargs="+", default=["samp-refine[cpsat]"], metavar="ENGINE")
    sweeper.add_argument("--preset", nargs="+", default=["default"], metavar="NAME")
    sweeper.add_argument(
        "--tuning",
        nargs="+",
        default=[],
        type=Path,
        metavar="FILE.toml",
        help="tunables to sweep over: each file is one more setting beside the defaults",
    )
    sweeper.add_argument("--encodings", nargs="+", default=["fluents"], choices=ENCODINGS)
    sweeper.add_argument(
        "--first-plan",
        action="store_true",
        help="no metric: stop at the first plan (default: minimise the makespan, with proof)",
    )
    sweeper.add_argument("--timeout", type=float, default=60.0, metavar="S", help="s per run")
    sweeper.add_argument("--memory", type=int, default=20_000, metavar="MB", help="MB per run")
    sweeper.add_argument("--runs", type=int, default=1, metavar="N", help="repetitions (seeds)")
    sweeper.add_argument(
        "--seeds",
        nargs="+",
        type=int,
        default=[0],
        metavar="N",
        help="draw the instances anew from these seeds, all but their sizes (0: as they are)",
    )
    sweeper.add_argument("--jobs", type=int, default=1, metavar="J", help="runs at a time")
    sweeper.add_argument("--out", type=Path, required=True, metavar="DIR")
    sweeper.set_defaults(run=_run)


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
