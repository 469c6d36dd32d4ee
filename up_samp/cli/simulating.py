"""``up-samp simulate``: a plan on a floor with delays, many times."""

from __future__ import annotations

import argparse
import csv
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from up_samp.benchmarks.builder import ENCODINGS
from up_samp.cli.problems import find_problem
from up_samp.cli.table import table
from up_samp.io import PlanDict, read_plan, write_plan
from up_samp.model import ProblemError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from up_samp.execution import Dependencies, Simulation

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

POLICIES = ("timed", "coarse", "staircase", "reorder")


def add_simulate(commands: Subparsers) -> None:
    """Add ``simulate``."""
    parser = commands.add_parser(
        "simulate", help="execute a plan on a floor with delays: how long, who waits, who collides"
    )
    parser.add_argument("plan", type=Path, metavar="PLAN.json")
    parser.add_argument(
        "--delays",
        default="30%",
        metavar="HOW",
        help="a share such as 30%% (slow robots, stops, late tasks), or slow=0.3,stops=1,"
        "stop_seconds=5,long_stop=20,late=0.5 (default: %(default)s)",
    )
    parser.add_argument("--runs", type=int, default=20, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the first run")
    parser.add_argument(
        "--policy",
        action="append",
        choices=POLICIES,
        help="how to follow the plan; may be given again (default: timed, staircase, reorder)",
    )
    parser.add_argument(
        "--problem",
        default=None,
        metavar="PROBLEM",
        help="where the plan file has no dependencies: its problem, as for 'up-samp solve'",
    )
    parser.add_argument("--encoding", choices=ENCODINGS, default="lean")
    parser.add_argument(
        "--out", type=Path, default=None, metavar="DIR", help="folder for CSV, record and pictures"
    )
    parser.set_defaults(run=_simulate)


def _simulate(args: argparse.Namespace) -> int:
    from up_samp.execution import Delays, coarse, simulate

    if args.runs < 1:
        raise ProblemError(f"--runs must be at least 1, not {args.runs}")
    plan = read_plan(args.plan)
    delays = Delays.parse(args.delays)
    found = _dependencies(args, plan)
    runs: list[Simulation] = []
    for policy in args.policy or ("timed", "staircase", "reorder"):
        graph = coarse(found) if policy == "coarse" else found
        for seed in range(args.seed, args.seed + args.runs):
            runs.append(simulate(graph, plan, delays, seed, policy=policy))
    print(_table(runs))
    if args.out is not None:
        files = write_runs(plan, runs, args.out)
        print("\n".join(str(f) for f in files))
    bad = any(r.contacts or not r.finished for r in runs if r.policy != "timed")
    return 1 if bad else 0


def _dependencies(args: argparse.Namespace, plan: PlanDict) -> Dependencies:
    from up_samp.execution import dependencies_from_plan, dependencies_of

    if args.problem is not None:
        return dependencies_of(find_problem(args.problem, args.encoding), plan)
    return dependencies_from_plan(plan)


def _policies(runs: Sequence[Simulation]) -> list[str]:
    return list(dict.fromkeys(r.policy for r in runs))


def _table(runs: Sequence[Simulation]) -> str:
    rows = []
    for policy in _policies(runs):
        mine = [r for r in runs if r.policy == policy]
        ratios = sorted(r.ratio for r in mine)
        rows.append(
            [
                policy,
                str(len(mine)),
                f"{statistics.median(ratios):.3f}",
                f"{ratios[-1]:.3f}",
                f"{100 * statistics.mean(r.waiting for r in mine):.1f} %",
                str(sum(r.collisions for r in mine)),
                f"{sum(bool(r.contacts) for r in mine)}",
                str(sum(r.deadlock for r in mine)),
                str(sum(r.reorders for r in mine)),
            ]
        )
    header = (
        "policy", "runs", "median", "worst", "waiting", "collisions", "unsafe", "deadlocks",
        "reorders",
    )  # fmt: skip
    note = "median and worst: realised over planned makespan; unsafe: runs with a collision"
    return f"{table(header, rows, range(1, 9))}\n{note}"


def write_runs(plan: PlanDict, runs: Sequence[Simulation], folder: Path) -> list[Path]:
    """Write ``runs.csv``, the median run's record and pictures; return the files."""
    from up_samp.plotting import plot_executed, plot_makespans

    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / "runs.csv"]
    with files[0].open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(
            ["policy", "seed", "planned_s", "makespan_s", "ratio", "waiting", "collisions",
             "deadlock", "finished", "reorders"]
        )  # fmt: skip
        for r in runs:
            writer.writerow(
                [r.policy, r.seed, f"{r.planned:g}", f"{r.makespan:.3f}", f"{r.ratio:.4f}",
                 f"{r.waiting:.4f}", r.collisions, r.deadlock, r.finished, r.reorders]
            )  # fmt: skip
    for policy in _policies(runs):
        mine = sorted((r for r in runs if r.policy == policy), key=lambda r: r.makespan)
        middle = mine[len(mine) // 2]
        files.append(write_plan(folder / f"executed-{policy}.json", middle.record))
        files.append(folder / f"executed-{policy}.png")
        _save(plot_executed(plan, middle.record), files[-1])
    files.append(folder / "makespans.png")
    spans = {p: [r.makespan for r in runs if r.policy == p] for p in _policies(runs)}
    _save(plot_makespans(spans, runs[0].planned), files[-1])
    return files


def _save(ax: Axes, path: Path) -> None:
    figure = ax.get_figure(root=True)
    assert figure is not None
    figure.savefig(path)
