"""How plans of a large warehouse get better with time.

    python benchmarks/scale/better.py 20x60 300

One line for each plan of an anytime planner: seconds and CPU seconds since it was asked, makespan,
lower bound and of which kind that is. The last plan is judged by the validator.
"""

from __future__ import annotations

import argparse
import time

from unified_planning.shortcuts import AnytimePlanner, get_environment

from up_samp.benchmarks.warehouse import warehouse
from up_samp.validation import validate_plan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("size", help="robots x orders, such as 20x60")
    parser.add_argument("seconds", type=float)
    parser.add_argument("--encoding", choices=("compact", "moves"), default="compact")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    get_environment().credits_stream = None
    robots, orders = map(int, args.size.split("x"))
    problem = warehouse(robots, orders, encoding=args.encoding)
    began, cpu, plan = time.monotonic(), time.process_time(), None
    params = {"seed": args.seed}
    with AnytimePlanner(name="samp-refine[cpsat]", params=params) as planner:
        for result in planner.get_solutions(problem, timeout=args.seconds):
            plan, told = result.plan or plan, result.metrics or {}
            spent = time.monotonic() - began, time.process_time() - cpu
            row = [f"{seconds:.1f}" for seconds in spent]
            row += [str(told.get(k)) for k in ("makespan", "lower_bound", "bound_kind")]
            print(f"| {' | '.join(row)} |", flush=True)
    assert plan is not None, "no plan in that time"
    assert validate_plan(problem, plan).valid


if __name__ == "__main__":
    main()
