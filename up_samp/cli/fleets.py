"""The commands for problem files: ``new`` and ``check``."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_new(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``new``."""
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.set_defaults(run=_new)


def _new(args: argparse.Namespace) -> int:
    from up_samp.fleet.starter import write_starter

    files = write_starter(args.folder)
    print("\n".join(str(f) for f in files))
    print(f"next: up-samp check {files[0]}")
    return 0


def add_check(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``check``."""
    parser.add_argument("problem", type=Path, metavar="PROBLEM.yaml")
    parser.add_argument(
        "--out", type=Path, default=None, metavar="FILE.png",
        help="the picture (default: beside the problem file)",
    )  # fmt: skip
    parser.set_defaults(run=_check)


def _check(args: argparse.Namespace) -> int:
    """Return 0 where nothing is wrong, 1 where something is."""
    from up_samp.fleet import read_problem_file
    from up_samp.fleet.checks import Level, check_fleet
    from up_samp.fleet.picture import draw_fleet

    records, folder = read_problem_file(args.problem), args.problem.parent
    findings = check_fleet(records, folder)
    for finding in findings:
        print(finding)
    figure = draw_fleet(records, folder, findings).get_figure(root=True)
    assert figure is not None
    picture = args.out or args.problem.with_suffix(".check.png")
    figure.savefig(picture)
    errors = sum(f.level is Level.ERROR for f in findings)
    warnings = sum(f.level is Level.WARNING for f in findings)
    what = f"{len(records.robots)} robots, {len(records.orders)} orders, {len(records.tasks)} tasks"
    print(f"{what}: {errors} errors, {warnings} warnings; see {picture}")
    return 1 if errors else 0


def tell_findings(file: str) -> None:
    """Print what a look at a problem file finds, where solving found no plan."""
    from up_samp.fleet import Fleet

    for finding in Fleet.from_file(file).check():
        print(f"  {finding}")


def add_import(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``import``."""
    parser.add_argument("source", type=Path, metavar="FILE")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--kind", default=None, help="what it is, where its name does not tell")
    parser.add_argument("--cell", type=float, default=1.0, metavar="M", help="a cell or unit, in m")
    parser.add_argument("--map", type=Path, default=None, metavar="MAP.yaml", help="for LIF")
    parser.add_argument("--robots", type=int, default=2, metavar="N", help="take so many at most")
    parser.add_argument("--jobs", type=int, default=4, metavar="N", help="take so many at most")
    parser.set_defaults(run=_import)


def _import(args: argparse.Namespace) -> int:
    from up_samp.fleet.importers import Options, import_file

    options = Options(args.cell, args.map, args.robots, args.jobs)
    found = import_file(args.source, args.out, args.kind, options)
    for note in found.notes:
        print(note)
    print(f"written: {found.problem}\nnext: up-samp check {found.problem}")
    return 0
