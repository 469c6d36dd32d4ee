"""``up-samp export``: a plan file in other people's formats."""

from __future__ import annotations

import argparse
from pathlib import Path

from up_samp.benchmarks.builder import ENCODINGS
from up_samp.cli.problems import problem_of_plan
from up_samp.execution import dependency_faults
from up_samp.execution.check import refuse
from up_samp.export import FORMATS, export_plan
from up_samp.io import read_plan


def add_export(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``export``."""
    parser.add_argument("plan", type=Path, metavar="PLAN.json")
    parser.add_argument("--to", choices=tuple(FORMATS), required=True)
    parser.add_argument("--out", type=Path, default=Path("."), metavar="DIR")
    parser.add_argument(
        "--problem",
        default=None,
        metavar="PROBLEM",
        help="the plan's problem, as for 'up-samp solve': the plan's graph is checked against it",
    )
    parser.add_argument("--encoding", choices=ENCODINGS, default="lean")
    parser.set_defaults(run=_export)


def _export(args: argparse.Namespace) -> int:
    plan = read_plan(args.plan)
    if args.problem is not None:
        refuse(dependency_faults(problem_of_plan(args.problem, args.encoding, plan), plan), plan)
    files = export_plan(plan, args.to, args.out)
    print("\n".join(str(f) for f in files))
    return 0
