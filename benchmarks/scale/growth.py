"""How time and memory of a first plan grow with the fleet: a table, and a picture of it.

    python benchmarks/scale/growth.py 5x10 10x30 20x60 --out growth.png

Each size (robots x orders) is solved in a process of its own. Seconds are CPU seconds of that
process, so that they say something on a machine that others use as well. Exponents are slopes of
straight lines through the logarithms (least squares).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time

import numpy as np

STAGES = ("reading", "building", "validating")


def one(robots: int, orders: int, encoding: str, timeout: float) -> dict[str, float]:
    """Return what a first plan of one size takes."""
    from unified_planning.shortcuts import OneshotPlanner, get_environment

    from up_samp.benchmarks.warehouse import warehouse

    get_environment().credits_stream = None
    problem = warehouse(robots, orders, encoding=encoding)
    began = time.process_time()
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(problem, timeout=timeout)
    told = result.metrics or {}
    found = {"activities": float(len(problem.activities)), "total": time.process_time() - began}
    found |= {stage: float(told.get(f"cpu_{stage}", 0.0)) for stage in STAGES}
    found["mib"] = max(float(v) for k, v in told.items() if k.startswith("mib_"))
    found["bound"] = float(told["lower_bound"])
    found["makespan"] = float(told["makespan"]) if result.plan is not None else float("nan")
    return found


def exponent(x: list[float], y: list[float]) -> float:
    """Return k of y ~ x ** k."""
    return float(np.polyfit(np.log(x), np.log(np.maximum(y, 1e-3)), 1)[0])


def draw(rows: dict[str, dict[str, float]], file: str) -> None:
    """Draw seconds and memory over activities."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    x = [row["activities"] for row in rows.values()]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), constrained_layout=True)
    for stage in ("total", *STAGES):
        y = [row[stage] for row in rows.values()]
        left.loglog(x, y, marker="o", label=f"{stage} (exponent {exponent(x, y):.2f})")
    y = [row["mib"] for row in rows.values()]
    right.loglog(x, y, marker="o", label=f"peak (exponent {exponent(x, y):.2f})")
    for axes, what in ((left, "CPU seconds"), (right, "MiB")):
        axes.set_xlabel("optional activities")
        axes.set_ylabel(what)
        axes.grid(which="both", alpha=0.3)
        axes.legend()
    figure.savefig(file, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sizes", nargs="+", help="robots x orders, such as 5x10")
    parser.add_argument("--encoding", default="compact")
    parser.add_argument("--timeout", type=float, default=900.0, help="wall clock of one size (s)")
    parser.add_argument("--out", help="a picture")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        robots, orders = map(int, args.sizes[0].split("x"))
        print(json.dumps(one(robots, orders, args.encoding, args.timeout)))
        return
    rows: dict[str, dict[str, float]] = {}
    for size in args.sizes:
        command = [sys.executable, __file__, size, "--one", "--encoding", args.encoding]
        done = subprocess.run(
            [*command, "--timeout", str(args.timeout)], capture_output=True, text=True, check=True
        )
        row = json.loads(done.stdout.splitlines()[-1])
        cells = " | ".join(f"{value:.1f}" for value in row.values())
        if row["building"] > 0.0 and row["makespan"] > 0.0:
            rows[size] = row  # others are too small for this way, or have no plan: another story
        print(f"| {size} | {cells} |", flush=True)
    if len(rows) > 1:
        x = [row["activities"] for row in rows.values()]
        for key in ("total", *STAGES, "mib"):
            print(f"{key}: exponent {exponent(x, [row[key] for row in rows.values()]):.2f}")
    if args.out and len(rows) > 1:
        draw(rows, args.out)


if __name__ == "__main__":
    main()
