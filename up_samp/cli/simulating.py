"""``up-samp simulate``: a plan on a floor with delays, many times."""

from __future__ import annotations

import argparse
import csv
import itertools
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from up_samp.cli.options import PLAN, Command, encoding, option
from up_samp.cli.problems import problem_of_plan
from up_samp.cli.solving import table
from up_samp.io import PlanDict, read_plan, write_plan
from up_samp.model import ProblemError

if TYPE_CHECKING:
    from up_samp.execution import Simulation


def _simulate(args: argparse.Namespace) -> int:
    from up_samp.execution import Delays, dependencies_from_plan, simulate
    from up_samp.execution.files import check_motions
    from up_samp.execution.simulate import Policy

    if args.runs < 1:
        raise ProblemError(f"--runs must be at least 1, not {args.runs}")
    plan = read_plan(args.plan)
    check_motions(plan)
    delays = Delays.parse(args.delays)
    policies = tuple(dict.fromkeys(args.policy or get_args(Policy)))
    named = args.problem is not None
    problem = problem_of_plan(args.problem, args.encoding, plan) if named else None
    found = dependencies_from_plan(plan, problem)
    runs: list[Simulation] = []
    for policy, seed in itertools.product(policies, range(args.seed, args.seed + args.runs)):
        runs.append(simulate(found, plan, delays, seed, policy=policy))
    print(_table(runs))
    if args.out is not None:
        files = write_runs(plan, runs, args.out)
        print("\n".join(str(f) for f in files))
    bad = any(r.contacts or r.broken or not r.finished for r in runs if r.policy != "timed")
    return 1 if bad else 0


def _policies(runs: Sequence[Simulation]) -> list[str]:
    return list(dict.fromkeys(r.policy for r in runs))


def _table(runs: Sequence[Simulation]) -> str:
    """Return a row for each policy, and a line for each of the first broken rules."""
    rows = []
    for policy in _policies(runs):
        mine = [r for r in runs if r.policy == policy]
        ratios = sorted(r.ratio for r in mine if r.finished)
        rows.append(
            [
                policy,
                str(len(mine)),
                str(sum(not r.finished for r in mine)),
                f"{statistics.median(ratios):.3f}" if ratios else "-",
                f"{ratios[-1]:.3f}" if ratios else "-",
                f"{100 * statistics.mean(r.waiting for r in mine):.1f} %",
                str(sum(r.collisions for r in mine)),
                f"{sum(bool(r.contacts) for r in mine)}",
                f"{sum(bool(r.broken) for r in mine)}",
                str(sum(r.deadlock for r in mine)),
                str(sum(r.reorders for r in mine)),
            ]
        )
    header = (
        "policy", "runs", "unfinished", "median", "worst", "waiting", "collisions", "unsafe",
        "broken", "deadlocks", "reorders",
    )  # fmt: skip
    note = "median and worst: realised over planned makespan of the runs that were finished; "
    note += "unsafe: runs with a collision; broken: runs that break a rule of the problem "
    note += "(looked for with --problem)"
    reasons = [f"{r.policy}, seed {r.seed}: {r.broken[0]}" for r in runs if r.broken][:3]
    return "\n".join([table(header, rows, range(1, 11)), note, *reasons])


def write_runs(plan: PlanDict, runs: Sequence[Simulation], folder: Path) -> list[Path]:
    """Write ``runs.csv``, the median run's record and pictures; return the files."""
    from up_samp.plotting import plot_executed
    from up_samp.plotting.style import save_figure

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
        picture = plot_executed(plan, middle.record)
        files.append(save_figure(picture, folder / f"executed-{policy}.png"))
    return files


COMMANDS: dict[str, Command] = {
    "simulate": (_simulate, (
        PLAN,
        option("--delays", "a share such as 30%% (slow robots, stops, late tasks), or slow=0.3,"
               "stops=1,stop_seconds=5,long_stop=20,late=0.5 (default: %(default)s)", "HOW",
               default="30%"),
        option("--runs", None, "N", int, 20),
        option("--seed", "of the first run", "N", int, 0),
        option("--policy", "how to follow the plan; may be given again (default: timed, staircase, "
               "reorder)", choices=("timed", "staircase", "reorder"), action="append"),
        option("--problem", "the plan's problem, as for 'up-samp solve': where the plan file has "
               "no dependencies", "PROBLEM"),
        encoding(),
        option("--out", "folder for CSV, record and pictures", "DIR", Path),
    )),
}  # fmt: skip
