"""cpsat beside aries-opt and cpse on classic, flexible and transport problems, in one run.

    python benchmarks/scheduling/compare.py --seconds 30 --out compare.json

Each opponent gets a problem as it is, where it can read that (aries-opt knows no optional
activities, cpse no object fluents), and as this package's compilers rewrite it for that engine.
All run in this process, each once before the clock starts; a time is the best of three where it is
below a second, and includes compiling. ``ratio`` is the best opponent's time by that of cpsat.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import unified_planning as up
from instances import SHOPS, flexible_shop, job_shop, transport
from unified_planning.shortcuts import OneshotPlanner

import up_samp  # noqa: F401  (registers the engines)
from up_samp.model import CandidateSchedule, UnsupportedError
from up_samp.scheduling.compilers.pipeline import chain, compilers_for
from up_samp.scheduling.compilers.read import read_problem
from up_samp.scheduling.compilers.write import plain_schedule, write_problem
from up_samp.scheduling.messages import slim_down
from up_samp.scheduling.quirks import quirks_of
from up_samp.scheduling.schedules import complete, to_up_schedule
from up_samp.validation import validate_schedule

COLUMNS = ("cpsat", "aries-opt", "cpse", "aries-opt compiled", "cpse compiled")
READERS = {"job shop": COLUMNS[:3], "flexible": ("cpsat", "cpse"), "transport": ("cpsat",)}
"""Who reads a family as it is."""


def problems(match: str) -> list[tuple[str, Any, int | None]]:
    """Return (family, problem, known optimum)."""
    found: list[tuple[str, Any, int | None]] = [
        ("job shop", job_shop(name, uses=False), optimum) for name, (_, optimum) in SHOPS.items()
    ]
    sizes = [(3, 3, 3), (4, 4, 3), (5, 4, 4), (6, 5, 4), (10, 6, 5)]
    found += [("flexible", flexible_shop(*size, 0), None) for size in sizes]
    fleets = [(1, 2), (1, 3), (2, 3), (2, 4), (3, 8)]
    found += [("transport", transport(*fleet, 0), None) for fleet in fleets]
    return [f for f in found if match in f[1].name or match == f[0]]


def direct(planner: Any, problem: Any, seconds: float) -> tuple[str, CandidateSchedule | None]:
    """Solve a problem as it is."""
    result = planner.solve(problem, timeout=seconds)
    if result.plan is None:
        return result.status.name, None
    return result.status.name, CandidateSchedule(*plain_schedule(result.plan))


def compiled(planner: Any, problem: Any, seconds: float) -> tuple[str, CandidateSchedule | None]:
    """Solve what the compilers make of a problem, and map the answer back."""
    started = time.perf_counter()
    quirks = quirks_of(type(planner))
    plan = chain(read_problem(problem), compilers_for(quirks))
    rewritten = write_problem(plan.problem)
    if quirks.message_limit is not None:
        slim_down(planner, rewritten, quirks.message_limit)
    left = max(0.1, seconds - (time.perf_counter() - started))
    status, schedule = direct(planner, rewritten, left)
    return status, None if schedule is None else complete(problem, plan.map_back(schedule))


def solve(column: str, problem: Any, seconds: float) -> dict[str, Any]:
    """Solve in one way; return status, makespan (None: no valid plan) and seconds."""
    name, _, way = column.partition(" ")
    with OneshotPlanner(name=name) as planner, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        planner.skip_checks = True
        environment = dict(quirks_of(type(planner)).environment) if way else {}
        os.environ.update(environment)
        started = time.perf_counter()
        try:
            status, schedule = (compiled if way else direct)(planner, problem, seconds)
        except UnsupportedError as error:
            return {"status": f"refused: {error}", "seconds": None, "makespan": None}
        except Exception as error:  # a crash of another engine is a result here
            return {"status": f"crash: {type(error).__name__}", "seconds": None, "makespan": None}
        finally:
            for key in environment:
                del os.environ[key]
        taken = round(time.perf_counter() - started, 3)
    if schedule is None:
        return {"status": status, "seconds": taken, "makespan": None}
    if validate_schedule(problem, to_up_schedule(problem, schedule)).violations:
        return {"status": f"invalid: {status}", "seconds": taken, "makespan": None}
    return {"status": status, "seconds": taken, "makespan": schedule.makespan}


def best_of(column: str, problem: Any, seconds: float) -> dict[str, Any]:
    """Solve once, or three times where that is quick; return the quickest."""
    first = solve(column, problem, seconds)
    if first["seconds"] is None or first["seconds"] > 1:
        return first
    more = [solve(column, problem, seconds) for _ in range(2)]
    return min((first, *more), key=lambda cell: cell["seconds"] or seconds)


def ratio(row: dict[str, Any], limit: float) -> str:
    """Return how many times sooner cpsat has proven the optimum than the best opponent."""
    mine = row["cpsat"]
    if mine["status"] != "SOLVED_OPTIMALLY":
        return ""
    others = [
        row[c]["seconds"]
        for c in COLUMNS[1:]
        if row[c] is not None
        and row[c]["status"] == "SOLVED_OPTIMALLY"
        and row[c]["makespan"] == mine["makespan"]
    ]
    if not others:
        return f"> {limit / mine['seconds']:.0f}"
    return f"{min(others) / mine['seconds']:.1f}"


def show(cell: dict[str, Any] | None) -> str:
    """Return a cell of the table; what is not proven optimal says what it is."""
    if cell is None:
        return "-"
    proven = cell["status"] == "SOLVED_OPTIMALLY"
    time_taken = "" if cell["seconds"] is None else f"{cell['seconds']:.2f} s"
    return f"{cell['makespan'] or ''} {'' if proven else cell['status']} {time_taken}".strip()


def main() -> None:
    """Run everything; write JSON and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--match", default="", help="a family, or a part of problems' names")
    parser.add_argument("--out", type=Path, default=None)
    args = parser.parse_args()
    up.shortcuts.get_environment().credits_stream = None
    for warm in map(partial(solve, problem=job_shop("ft06", uses=False), seconds=5), COLUMNS):
        assert warm["makespan"]
    rows = []
    print("| problem | optimum | " + " | ".join(COLUMNS) + " | ratio |")
    print("|---|---|" + "---|" * (len(COLUMNS) + 1))
    for family, problem, optimum in problems(args.match):
        row: dict[str, Any] = {"problem": problem.name, "optimum": optimum}
        for column in COLUMNS:
            able = " " in column or column in READERS[family]
            row[column] = best_of(column, problem, args.seconds) if able else None
        row["ratio"] = ratio(row, args.seconds)
        rows.append(row)
        cells = [show(row[c]) for c in COLUMNS]
        known = optimum if optimum is not None else ""
        print(f"| {problem.name} | {known} | " + " | ".join([*cells, row["ratio"]]) + " |")
        if args.out is not None:
            args.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
