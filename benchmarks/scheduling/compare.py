"""cpsat beside aries-opt and cpse on classic, flexible and transport problems, in one run.

    python benchmarks/scheduling/compare.py --seconds 30 --out compare.json

The other engines get what they can read: aries-opt knows no optional activities, cpse no object
fluents; such pairs are marked "-" (the compilers of this package are not used here).
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from typing import Any

import unified_planning as up
from instances import SHOPS, flexible_shop, job_shop, transport
from unified_planning.shortcuts import OneshotPlanner

import up_samp  # noqa: F401  (registers the engines)

ENGINES = ("cpsat", "aries-opt", "cpse")


def problems(large: bool) -> list[tuple[Any, int | None, tuple[str, ...]]]:
    """Return (problem, known optimum, engines that can read it)."""
    names = ["ft06", "la02", *(["ft10", "ta01"] if large else [])]
    found: list[tuple[Any, int | None, tuple[str, ...]]] = [
        (job_shop(n, uses=False), SHOPS[n][1], ENGINES) for n in names
    ]
    sizes = [(4, 4, 3), (6, 5, 4), *([(10, 6, 5)] if large else [])]
    found += [(flexible_shop(*s, 0), None, ("cpsat", "cpse")) for s in sizes]
    fleets = [(1, 3), (2, 4), *([(3, 8)] if large else [])]
    found += [(transport(*f, 0), None, ("cpsat",)) for f in fleets]
    return found


def solve(engine: str, problem: Any, seconds: float) -> dict[str, Any]:
    """Solve with one engine; return status, makespan and seconds."""
    started = time.perf_counter()
    try:
        with OneshotPlanner(name=engine) as planner, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = planner.solve(problem, timeout=seconds)
    except Exception as error:  # a crash of another engine is a result here
        return {"status": f"crash: {type(error).__name__}", "seconds": 0.0, "makespan": None}
    taken = round(time.perf_counter() - started, 3)
    makespan = None
    if result.plan is not None:
        ends = [int(result.plan.get(a.end).constant_value()) for a in result.plan.activities]
        makespan = max(ends, default=0)
    return {"status": result.status.name, "seconds": taken, "makespan": makespan}


def main() -> None:
    """Run everything; write JSON and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--large", action="store_true", help="also ft10, ta01 and larger fleets")
    parser.add_argument("--out", type=Path, default=None)
    args = parser.parse_args()
    up.shortcuts.get_environment().credits_stream = None
    rows = []
    print("| problem | optimum | " + " | ".join(ENGINES) + " |")
    print("|---|---|" + "---|" * len(ENGINES))
    for problem, optimum, readers in problems(args.large):
        row: dict[str, Any] = {"problem": problem.name, "optimum": optimum}
        for engine in ENGINES:
            row[engine] = solve(engine, problem, args.seconds) if engine in readers else None
        rows.append(row)
        cells = [
            "-"
            if row[e] is None
            else f"{row[e]['makespan']} {row[e]['status']} {row[e]['seconds']} s"
            for e in ENGINES
        ]
        print(f"| {problem.name} | {optimum or ''} | " + " | ".join(cells) + " |", flush=True)
    if args.out is not None:
        args.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
