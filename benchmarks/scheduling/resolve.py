"""Re-solve a problem while constraints are added, warm (one session) and cold (a new one each).

python benchmarks/scheduling/resolve.py --robots 2 --items 4 --rounds 20
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

from relaxations import relaxation

from up_samp.benchmarks.jobshop import job_shop
from up_samp.benchmarks.logistics import logistics
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession


def tighten(problem: Any, schedule: Any, number: int) -> None:
    """Do what a motion check does: a move of the schedule takes longer, or may not overlap."""
    moves = sorted(n for n in schedule.times if n.startswith("move"))
    name = moves[number % len(moves)]
    activity = problem.get_activity(name)
    start, end = schedule.times[name]
    high = int(activity.duration.upper.constant_value())
    activity.set_duration_bounds(min(end - start + 2, high), high)
    em = problem.environment.expression_manager
    other = problem.get_activity(moves[(number + 1) % len(moves)])
    if other is not activity:
        apart = em.Or(em.LT(activity.end, other.start), em.LT(other.end, activity.start))
        problem.add_constraint(apart, scope=[activity.present, other.present])


class Clock:
    """Adds up seconds by the wall's clock and of all threads' computing."""

    def __init__(self) -> None:
        self.wall = self.cpu = 0.0

    def __enter__(self) -> None:
        self._started = time.perf_counter(), time.process_time()

    def __exit__(self, *_: object) -> None:
        self.wall += time.perf_counter() - self._started[0]
        self.cpu += time.process_time() - self._started[1]


def run(problem: Any, rounds: int, seconds: float, workers: int) -> dict[str, Any]:
    """Return total times and whether warm and cold agree in every round."""
    session = CpsatSession(problem, workers=workers)
    report = session.solve(Deadline.after(seconds))
    warm, cold = Clock(), Clock()
    agree = True
    for number in range(rounds):
        tighten(problem, report.schedule, number)
        with warm:
            report = session.solve(Deadline.after(seconds))
        with cold:
            fresh = CpsatSession(problem, workers=workers).solve(Deadline.after(seconds))
        agree &= (report.status, report.bound) == (fresh.status, fresh.bound)
    return {
        "problem": problem.name,
        "rounds": rounds,
        "warm_seconds": round(warm.wall, 2),
        "cold_seconds": round(cold.wall, 2),
        "ratio": round(cold.wall / warm.wall, 2),
        "cpu_ratio": round(cold.cpu / warm.cpu, 2),
        "agree": agree,
        "rebuilds": session.rebuilds - 1,
        "last": [report.status.value, report.bound],
    }


def main() -> None:
    """Run one logistics and one job-shop problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--items", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    for samp in (logistics(args.robots, args.items), job_shop(2, 2, 2)):
        print(json.dumps(run(relaxation(samp), args.rounds, args.seconds, args.workers)))


if __name__ == "__main__":
    main()
