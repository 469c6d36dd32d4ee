"""The scheduling problems inside the SAMP families: moves at 2 m/s, doors opened before they are
passed, no motion planning. The paper's 132 instances, and logistics with 10 robots and 16 items.

    python benchmarks/scheduling/relaxations.py --seconds 60 --out out.jsonl
    python benchmarks/scheduling/relaxations.py --bounds --encodings fluents --match j3-m6
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import statistics
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from unified_planning.model import ClosedTimeInterval, Timing

from up_samp.benchmarks import instances as frozen_instances
from up_samp.benchmarks.builder import ENCODINGS
from up_samp.benchmarks.logistics import logistics
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work
from up_samp.scheduling.cpsat.routing.list_scheduling import improve
from up_samp.scheduling.cpsat.routing.sequels import steps_of
from up_samp.scheduling.cpsat.routing.workload import bound_by_work
from up_samp.upio import read_problem, relax
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule

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
        passed |= doors
    return passed & doors


def instances(family: str, encoding: str = "lean") -> Iterator[tuple[str, Any]]:
    """Yield (name, function that builds the SAMP problem) of a family in the paper's sizes."""
    for entry in frozen_instances(family):
        yield entry.name, partial(entry.build, encoding, True)
    if family == "logistics":
        yield (
            "logistics-dc-all-r10-i16",
            partial(logistics, 10, 16, door="closed", sides="all", encoding=encoding),
        )


def solve(name: str, problem: Any, seconds: float, workers: int, seed: int = 0) -> dict[str, Any]:
    """Schedule one relaxation; return what came of it. Times (s) include building the model."""
    plain = relaxation(problem)
    started, cpu = time.monotonic(), time.process_time()
    first: list[tuple[float, int]] = []

    def note(schedule: Any, bound: Any) -> None:
        if not first:
            first.append((time.monotonic() - started, schedule.makespan))

    session = CpsatSession(plain, workers=workers, seed=seed)
    report = session.solve(Deadline.after(seconds), on_solution=note)
    found = report.schedule
    wrong = found and validate_schedule(plain, build_schedule(plain, found)).violations
    return {
        "instance": name,
        "activities": len(plain.activities),
        "status": report.status.value,
        "valid": None if found is None else not wrong,
        "makespan": found.makespan if found else None,
        "bound": report.bound,
        "first_seconds": round(first[0][0], 2) if first else None,
        "first_makespan": first[0][1] if first else None,
        "seconds": round(time.monotonic() - started, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
    }


def bounds(name: str, problem: Any) -> dict[str, Any]:
    """Return the lower bound without search, and the makespan of the best quick tour."""
    plain = relaxation(problem)
    started = time.process_time()
    model = ScheduleModel(plain)
    routes = find_routes(model)
    built = time.process_time()
    work = find_work(model, routes)
    assert work is not None
    found = bound_by_work(model, work)
    bound = found.value
    bounded = time.process_time()
    some = found.sequences
    start = steps_of(work, some, some.found[0]) if some is not None and some.found else []
    tour = improve(work, 60 * len(work.tasks), 0, lambda: False, start=start, enough=bound)
    makespan = tour.schedule.makespan if tour is not None else None
    return {
        "instance": name,
        "bound": bound,
        "tour": makespan,
        "share": round(bound / makespan, 3) if makespan else None,
        "cpu_model": round(built - started, 2),
        "cpu_bound": round(bounded - built, 2),
    }


def summary(lines: list[dict[str, Any]]) -> str:
    """Return the figures of a sweep in words, family by family."""
    text = []
    for family in sorted({line["instance"].rsplit("-r", 1)[0] for line in lines}):
        some = [line for line in lines if line["instance"].rsplit("-r", 1)[0] == family]
        firsts = [line["first_seconds"] for line in some if line["first_seconds"] is not None]
        proven = sum(line["status"] == "optimal" for line in some)
        gaps = [1 - (line["bound"] or 0) / line["makespan"] for line in some if line["makespan"]]
        text.append(
            f"{family:20} {len(some):3} instances: {proven} proven optimal, "
            f"{len(firsts)} with a schedule ({sum(f <= 10 for f in firsts)} within 10 s, "
            f"the last after {max(firsts, default=0):.1f} s), "
            f"mean gap {100 * statistics.fmean(gaps or [0]):.1f} %, "
            f"{sum(line['valid'] is False for line in some)} invalid"
        )
    return "\n".join(text)


def main() -> None:
    """Run the families and write one JSON line per instance; what is there already is kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--family", choices=["all", "logistics", "jobshop"], default="all")
    parser.add_argument("--encodings", dest="encoding", default="lean", choices=ENCODINGS)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--match", default="", help="only instances with this in their name")
    parser.add_argument("--out", type=Path, default=None, help="JSON lines; resumed if it exists")
    parser.add_argument("--bounds", action="store_true", help="only bounds without search")
    args = parser.parse_args()
    if args.bounds:
        for family in ["logistics", "jobshop"] if args.family == "all" else [args.family]:
            for name, build in instances(family, args.encoding):
                if args.match in name:
                    print(json.dumps(bounds(name, build())), flush=True)
        return
    lines: list[dict[str, Any]] = []
    if args.out is not None and args.out.exists():
        lines = [json.loads(line) for line in args.out.read_text().splitlines()]
    done = {line["instance"] for line in lines}
    families = ["logistics", "jobshop"] if args.family == "all" else [args.family]
    for family in families:
        for name, build in instances(family, args.encoding):
            if args.match not in name or name in done:
                continue
            lines.append(solve(name, build(), args.seconds, args.workers))
            line = json.dumps(lines[-1])
            print(line, flush=True)
            if args.out is not None:
                with args.out.open("a") as stream:
                    stream.write(line + "\n")
    print(summary(lines))


if __name__ == "__main__":
    main()
