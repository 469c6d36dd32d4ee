"""The scheduling problems inside the SAMP families: moves at 2 m/s, doors opened before they are
passed, no motion planning.

    python benchmarks/scheduling/relaxations.py --family logistics --seconds 60 --out out.jsonl
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import time
from pathlib import Path
from typing import Any

from unified_planning.model import ClosedTimeInterval, Timing

from up_samp.benchmarks.jobshop import job_shop
from up_samp.benchmarks.logistics import logistics
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio import read_problem, relax

SPEED = 2.0
"""m/s: the speed at which unobstructed moves are driven."""


def relaxation(problem: Any) -> Any:
    """Return the plain problem with realistic durations and door conditions stated."""
    snapshot = read_problem(problem)
    result = relax(problem, snapshot)
    plain = result.problem
    em = plain.environment.expression_manager
    for task in snapshot.tasks:
        activity = result.activities[task.activity]
        names = [t.name for t in task.terms]
        poses = [snapshot.configurations[n] for n in names]
        length = sum(math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(poses))
        low = max(int(activity.duration.lower.constant_value()), math.ceil(length / SPEED))
        high = max(low, int(activity.duration.upper.constant_value()))
        activity.set_duration_bounds(low, high)
        for door in _doors(names, snapshot):
            closed = em.ObjectExp(plain.object(snapshot.initial[door]))
            is_closed = em.Equals(result.state[door], closed)
            span = ClosedTimeInterval(Timing(1, activity.start), Timing(0, activity.end))
            activity.add_condition(span, em.Not(is_closed))
    return plain


def _doors(names: list[str], snapshot: Any) -> set[str]:
    """Return the doors that a move between these places passes."""
    doors = {d for d in snapshot.initial if d.startswith("door")}
    rooms = [n.removeprefix("machine") for n in names if n.startswith("machine")]
    passed = {f"door{r}" for r in rooms}
    if any(n.endswith("in") and n.startswith("item") for n in names):
        passed |= {d for d in doors if d == "door"}
    return passed & doors


def instances(family: str, encoding: str = "fluents", metric: bool = True) -> Any:
    """Yield (name, SAMP problem) of a family's instances in the paper's sizes."""
    if family == "logistics":
        for door in ("open", "closed"):
            for sides in ("corridor", "all"):
                for robots in (1, 2, 3):
                    for items in range(1, 9):
                        yield logistics(
                            robots,
                            items,
                            door=door,
                            sides=sides,
                            encoding=encoding,
                            metric=metric,
                        )
    else:
        for robots in (1, 2, 3):
            for jobs in (1, 2, 3):
                for machines in (1, 2, 4, 6):
                    yield job_shop(robots, jobs, machines, encoding=encoding, metric=metric)


def solve(problem: Any, seconds: float, workers: int, seed: int = 0) -> dict[str, Any]:
    """Schedule one relaxation; return what came of it."""
    plain = relaxation(problem)
    started = time.monotonic()
    first: list[tuple[float, int]] = []

    def note(schedule: Any, bound: Any) -> None:
        if not first:
            first.append((time.monotonic() - started, schedule.makespan))

    session = CpsatSession(plain, workers=workers, seed=seed)
    report = session.solve(Deadline.after(seconds), on_solution=note)
    return {
        "instance": problem.name,
        "activities": len(plain.activities),
        "status": report.status.value,
        "makespan": report.schedule.makespan if report.schedule else None,
        "bound": report.bound,
        "first_seconds": round(first[0][0], 2) if first else None,
        "first_makespan": first[0][1] if first else None,
        "seconds": round(time.monotonic() - started, 2),
    }


def main() -> None:
    """Run the families and write one JSON line per instance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--family", choices=["logistics", "jobshop"], required=True)
    parser.add_argument("--encoding", default="fluents", choices=["fluents", "no-fluents"])
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--match", default="", help="only instances with this in their name")
    parser.add_argument("--out", type=Path, default=None)
    args = parser.parse_args()
    for problem in instances(args.family, args.encoding):
        if args.match not in problem.name:
            continue
        line = json.dumps(solve(problem, args.seconds, args.workers))
        print(line, flush=True)
        if args.out is not None:
            with args.out.open("a") as stream:
                stream.write(line + "\n")


if __name__ == "__main__":
    main()
