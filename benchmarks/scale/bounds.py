"""Lower bounds of large warehouses, from their jobs alone: a table.

    python benchmarks/scale/bounds.py 5x10 10x30 20x60
    python benchmarks/scale/bounds.py 10x30 --encoding file

Columns: absolute bound, CPU seconds; bound relative to the planner's own drives, how many of them
were asked for, CPU seconds. ``file``: the same orders as a fleet's problem file, without latest
ends, with cars and robots that move in any direction in turn.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from unified_planning.model.motion import SchedulingMotionProblem

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.search.store_fleet import fleet_of
from up_samp.benchmarks.warehouse import warehouse
from up_samp.geometry import lay_out
from up_samp.model import Deadline
from up_samp.search.drives import Drives
from up_samp.search.facts import Facts
from up_samp.search.jobs import find_jobs
from up_samp.search.jobs_bound import JobsBound
from up_samp.search.params import Parameters
from up_samp.search.session import open_service
from up_samp.upio import read_problem
from up_samp.upio.relaxing import relax


def row(problem: SchedulingMotionProblem, most: int, seconds: float) -> str:
    """Return one row of the table."""
    snapshot, grid = lay_out(read_problem(problem))
    relaxation = relax(problem, snapshot)
    facts = Facts(relaxation.snapshot, relaxation.choices)
    service = open_service(snapshot, grid, Parameters())
    jobs = find_jobs(problem, snapshot)
    assert jobs is not None, "no jobs are found in the problem"
    began = time.process_time()
    bound = JobsBound(problem, facts, service, jobs)
    absolute = bound.absolute(Deadline.after(seconds))
    quick, began = time.process_time() - began, time.process_time()
    drives = Drives(service)
    *_, relative = bound.relative(drives, most, Deadline.after(seconds))
    slow = time.process_time() - began
    return f"{absolute} | {quick:.1f} | {relative} | {drives.asked} | {slow:.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sizes", nargs="+", help="robots x orders, such as 5x10")
    parser.add_argument("--encoding", choices=("compact", "moves", "file"), default="compact")
    parser.add_argument("--drives", type=int, default=3000, help="asked for, at most")
    parser.add_argument("--seconds", type=float, default=600.0, help="for each bound, at most")
    args = parser.parse_args()
    for size in args.sizes:
        robots, orders = map(int, size.split("x"))
        if args.encoding == "file":
            problem = fleet_of(robots, orders).problem
        else:
            problem = warehouse(robots, orders, encoding=args.encoding)
        print(f"| {size} {args.encoding} | {row(problem, args.drives, args.seconds)} |", flush=True)


if __name__ == "__main__":
    main()
