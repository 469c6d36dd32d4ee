"""How time and memory of a first plan grow with the fleet: tables, and a picture of them.

    python benchmarks/scale/growth.py 5x10,10x30,20x60 10x15,10x30,10x60 5x30,10x30,20x30 \\
        --out growth.png

Each argument is a series of sizes (robots x orders): both grow, or the orders of a fleet, or the
robots for the same orders. Each size is solved once, in a process of its own. Seconds are CPU
seconds of that process, so that they say something on a machine that others use as well. Exponents
are slopes of straight lines through the logarithms (least squares).
"""

from __future__ import annotations

import argparse
import json
import pathlib
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
    if encoding == "file":
        sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))
        from tests.search.store_fleet import fleet_of

        problem = fleet_of(robots, orders).problem
    else:
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


def axis_of(sizes: list[str]) -> str:
    """Return what grows along a series."""
    robots, orders = zip(*(size.split("x") for size in sizes), strict=True)
    if len(set(robots)) == 1:
        return f"orders ({robots[0]} robots)"
    if len(set(orders)) == 1:
        return f"robots ({orders[0]} orders)"
    return "optional activities"


def along(sizes: list[str], rows: dict[str, dict[str, float]]) -> list[float]:
    """Return the numbers that grow along a series."""
    which = {"r": 0, "o": 1}.get(axis_of(sizes)[0]) if "(" in axis_of(sizes) else None
    if which is None:
        return [rows[size]["activities"] for size in sizes]
    return [float(size.split("x")[which]) for size in sizes]


def draw(series: list[list[str]], rows: dict[str, dict[str, float]], file: str) -> None:
    """Draw seconds and memory along each series."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        2, len(series), figsize=(3.6 * len(series), 6.0), constrained_layout=True, squeeze=False
    )
    for column, sizes in enumerate(series):
        x = along(sizes, rows)
        for row, (stages, what) in enumerate(
            ((("total", *STAGES), "CPU seconds"), (("mib",), "peak MiB"))
        ):
            plot = axes[row][column]
            for stage in stages:
                y = [rows[size][stage] for size in sizes]
                plot.loglog(x, y, marker="o", label=f"{stage}: {exponent(x, y):.2f}")
            plot.set_xticks(x, [f"{value:g}" for value in x])
            if row == 1:
                held = [rows[size]["mib"] for size in sizes]
                plot.set_yticks(held, [f"{value:.0f}" for value in held])
            low, high = plot.get_ylim()
            plot.set_ylim(low, high * (high / low) ** 0.75)  # room for the legend
            plot.minorticks_off()
            plot.set_xlabel(axis_of(sizes))
            plot.set_ylabel(what)
            plot.grid(which="both", alpha=0.3)
            plot.legend(
                title="exponents", loc="upper left", fontsize="x-small", title_fontsize="x-small"
            )
    figure.savefig(file, dpi=70)


def measured(size: str, encoding: str, timeout: float) -> dict[str, float]:
    """Return what a first plan of one size takes, in a process of its own."""
    command = [sys.executable, __file__, size, "--one", "--encoding", encoding]
    done = subprocess.run(
        [*command, "--timeout", str(timeout)], capture_output=True, text=True, check=True
    )
    row: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("series", nargs="+", help="robots x orders, such as 5x10,10x30,20x60")
    parser.add_argument(
        "--encoding",
        choices=("compact", "moves", "file"),
        default="compact",
        help="file: the same orders as a fleet's problem file, without latest ends",
    )
    parser.add_argument("--timeout", type=float, default=900.0, help="wall clock of one size (s)")
    parser.add_argument("--out", help="a picture")
    parser.add_argument("--rows", help="where rows are kept, and looked up: a JSON file")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        robots, orders = map(int, args.series[0].split("x"))
        print(json.dumps(one(robots, orders, args.encoding, args.timeout)))
        return
    kept = pathlib.Path(args.rows) if args.rows else None
    rows = json.loads(kept.read_text()) if kept is not None and kept.exists() else {}
    series = [text.split(",") for text in args.series]
    for size in dict.fromkeys(size for sizes in series for size in sizes):
        if size not in rows:
            rows[size] = measured(size, args.encoding, args.timeout)
        if kept is not None:
            kept.write_text(json.dumps(rows))
        print(
            f"| {size} | " + " | ".join(f"{v:.1f}" for v in rows[size].values()) + " |", flush=True
        )
    # others are too small for this way, or have no plan: another story
    good = {size for size, row in rows.items() if row["building"] > 0 and row["makespan"] > 0}
    series = [[size for size in sizes if size in good] for sizes in series]
    series = [sizes for sizes in series if len(sizes) > 1]
    for sizes in series:
        x = along(sizes, rows)
        for key in ("total", *STAGES, "mib"):
            y = [rows[size][key] for size in sizes]
            print(f"{axis_of(sizes)}, {key}: exponent {exponent(x, y):.2f}")
    if args.out and series:
        draw(series, rows, args.out)


if __name__ == "__main__":
    main()
