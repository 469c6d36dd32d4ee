"""Lower bounds of large warehouses, from their jobs alone: a table.

    python benchmarks/scale/bounds.py 5x10 10x30 20x60
    python benchmarks/scale/bounds.py 10x30 --encoding file

Columns: absolute bound, CPU seconds; bound relative to the planner's own drives, how many of them
were asked for, CPU seconds. ``file``: the same orders as a fleet's problem file, without latest
ends, with cars and robots that move in any direction in turn.
"""

from __future__ import annotations

import argparse
import time

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp import Fleet
from up_samp.benchmarks.maps import drawn_map
from up_samp.benchmarks.warehouse import A_MAX, OMEGA_MAX, V_MAX, draw_orders, store, warehouse
from up_samp.geometry import lay_out
from up_samp.model import Deadline
from up_samp.search.drives import Drives
from up_samp.search.facts import Facts
from up_samp.search.jobs import find_jobs
from up_samp.search.jobs_bound import JobsBound
from up_samp.search.params import Parameters
from up_samp.search.session import open_service
from up_samp.upio import read_problem
from up_samp.upio.relaxation import relax


def problem_file(robots: int, orders: int) -> SchedulingMotionProblem:
    """Return a warehouse as its problem file would say it."""
    plan = store(robots)
    fleet = Fleet(str(drawn_map(f"warehouse-{robots}", plan.size, plan.walls)))
    limits = {"v_max": V_MAX, "a_max": A_MAX}
    fleet.add_robot_type("car", (1.2, 0.8), model="car", turning_radius=1.0, **limits)
    fleet.add_robot_type("omni", (1.2, 0.8), model="omni", omega_max=OMEGA_MAX, **limits)
    drawn = draw_orders(plan, orders, 0)
    places = {f"dock{i}": pose for i, pose in enumerate(plan.docks)}
    places |= {f"station{i}": pose for i, pose in enumerate(plan.stations)}
    places |= {f"slot{o.slot}": plan.slots[o.slot] for o in drawn}
    for name, pose in places.items():
        fleet.add_place(name, *pose)
    for r in range(robots):
        fleet.add_robot(f"r{r}", ("car", "omni")[r % 2], start=f"dock{r}", end=f"dock{r}")
    for k, o in enumerate(drawn):
        pickup = {"at": f"slot{o.slot}", "service": o.service[0]}
        fleet.add_order(f"o{k}", pickup, {"at": f"station{o.station}", "service": o.service[1]})
    return fleet.problem


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
            problem = problem_file(robots, orders)
        else:
            problem = warehouse(robots, orders, encoding=args.encoding)
        print(f"| {size} {args.encoding} | {row(problem, args.drives, args.seconds)} |", flush=True)


if __name__ == "__main__":
    main()
