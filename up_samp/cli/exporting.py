"""``up-samp export``: a plan file in other people's formats."""

from __future__ import annotations

import argparse
from pathlib import Path

from up_samp.export import FORMATS, export_plan
from up_samp.io import read_plan


def add_export(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``export``."""
    parser.add_argument("plan", type=Path, metavar="PLAN.json")
    parser.add_argument("--to", choices=tuple(FORMATS), required=True)
    parser.add_argument("--out", type=Path, default=Path("."), metavar="DIR")
    parser.set_defaults(run=_export)


def _export(args: argparse.Namespace) -> int:
    files = export_plan(read_plan(args.plan), args.to, args.out)
    print("\n".join(str(f) for f in files))
    return 0
