"""cpsat beside aries-opt and cpse on classic, flexible and transport problems.

Each opponent gets a problem as it is, where it can read that (aries-opt knows no optional
activities, cpse no object fluents), and as this package's compilers rewrite it for that engine. All
run in one process, each once before the clock starts; a time is the best of three where it is below
a second, and includes compiling. ``python scripts/figures.py --only schedulers`` runs it.
"""

from __future__ import annotations

import os
import time
import warnings
from typing import Any

import unified_planning as up
from instances import SHOPS, flexible_shop, job_shop, transport
from unified_planning.shortcuts import OneshotPlanner

import up_samp  # noqa: F401  (registers the engines)
from up_samp.model import CandidateSchedule, UnsupportedError
from up_samp.scheduling.compilers.translate import ProblemWriter, read_plain
from up_samp.scheduling.engine_scheduler import chain, compilers_for, restored
from up_samp.scheduling.quirks import quirks_of
from up_samp.scheduling.worker import slim_down
from up_samp.upio.plan import build_schedule, to_candidate
from up_samp.validation import validate_schedule

COLUMNS = ("cpsat", "aries-opt", "cpse", "aries-opt compiled", "cpse compiled")
READERS = {"job shop": COLUMNS[:3], "flexible": ("cpsat", "cpse"), "transport": ("cpsat",)}
"""Who reads a family as it is."""


def problem_of(name: str) -> tuple[str, Any, int | None]:
    """Return (family, problem, known optimum) of "ft06", "flexible-3x3x3-0", "transport-1-2-0"."""
    kind, _, size = name.partition("-")
    if not size:
        return "job shop", job_shop(name, uses=False), SHOPS[name][1]
    *numbers, seed = (int(n) for n in size.replace("x", "-").split("-"))
    build = {"flexible": flexible_shop, "transport": transport}[kind]
    return kind, build(*numbers, seed), None


def direct(planner: Any, problem: Any, seconds: float) -> tuple[str, CandidateSchedule | None]:
    """Solve a problem as it is."""
    result = planner.solve(problem, timeout=seconds)
    if result.plan is None:
        return result.status.name, None
    return result.status.name, to_candidate(result.plan)


def compiled(planner: Any, problem: Any, seconds: float) -> tuple[str, CandidateSchedule | None]:
    """Solve what the compilers make of a problem, and map the answer back."""
    started = time.perf_counter()
    quirks = quirks_of(type(planner))
    original = read_plain(problem)
    plan = chain(original, compilers_for(quirks))
    written = ProblemWriter(plan.problem)
    if quirks.message_limit is not None:
        slim_down(planner, written.up, quirks.message_limit)
    left = max(0.1, seconds - (time.perf_counter() - started))
    status, found = direct(planner, written.up, left)
    if found is None:
        return status, None
    return status, restored(original, plan, written.read_back(found))


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
    if validate_schedule(problem, build_schedule(problem, schedule)).violations:
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


def row_of(name: str, seconds: float) -> dict[str, Any]:
    """Return what each engine makes of a problem within so many seconds, for a table."""
    up.shortcuts.get_environment().credits_stream = None
    family, problem, optimum = problem_of(name)
    warm = job_shop("ft06", uses=False)
    for column in COLUMNS:
        assert solve(column, warm, 5.0)["makespan"], f"{column} finds no plan for ft06"
    row: dict[str, Any] = {}
    for column in COLUMNS:
        able = " " in column or column in READERS[family]
        row[column] = best_of(column, problem, seconds) if able else None
    mine = row["cpsat"]
    return {
        "optimum": optimum,
        "cpsat": mine["seconds"],
        "makespan": mine["makespan"],
        "engines": {column: show(row[column]) for column in COLUMNS},
        "ratio": ratio(row, seconds),
    }
