"""One robot does one thing at a time: said by a resource of one unit, or pair by pair.

``python benchmarks/fleet/one_at_a_time.py [ORDERS ROBOTS SECONDS]`` writes one fleet problem in
both forms, gives its drives the least durations that distances tell, and lets ``cpsat`` solve what
remains without motions: constraints, CPU time of writing and of solving, makespan and bound.
"""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from unified_planning.shortcuts import LE, Or

from up_samp import Fleet
from up_samp.fleet import build
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio import read_problem, relax

MAP = Path(__file__).parents[2] / "examples" / "maps" / "two_rooms.yaml"
POINTS = ((7, 3), (7, 7), (7, 12), (12, 3), (12, 12), (25, 4), (25, 8), (25, 12))


def fleet_of(orders: int, robots: int) -> Fleet:
    """Return orders from shelf to shelf in two rooms."""
    fleet = Fleet(MAP)
    fleet.add_robot_type("agv", (1.2, 0.8), model="diff", v_max=2.0, a_max=0.5)
    for i in range(robots):
        fleet.add_place(f"home{i}", 2, 2 + 3 * i)
        fleet.add_robot(f"r{i}", "agv", f"home{i}", end=f"home{i}")
    for i, (x, y) in enumerate(POINTS):
        fleet.add_place(f"p{i}", x, y)
    for i in range(orders):
        fleet.add_order(f"o{i}", f"p{i % 8}", f"p{(i + 4) % 8}")
    return fleet


def pairs(writer: Any, _: str, activities: Sequence[Any]) -> None:
    """Keep activities apart pair by pair."""
    for a, b in itertools.combinations(activities, 2):
        scope = [x.present for x in (a, b) if x.optional]
        writer.problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)), scope)


def measure(name: str, orders: int, robots: int, seconds: float) -> None:
    """Write and solve one form, and print a row."""
    fleet = fleet_of(orders, robots)
    began = time.process_time()
    problem = fleet.problem
    written = time.process_time() - began
    for activity in problem.activities:
        for constraint in getattr(activity, "motion_constraints", ()):
            ends = (constraint.starting, constraint.waypoints[0])
            p, q = (tuple(end.object().configuration) for end in ends)
            activity.set_duration_bounds(math.ceil(math.dist(p[:2], q[:2]) / 2 + 2), 600)
    began = time.process_time()
    relaxation = relax(problem, read_problem(problem))
    session = CpsatSession(relaxation.problem, seed=0, workers=1)
    report = session.solve(Deadline.after(seconds), optimal=True)
    made = "-" if report.schedule is None else report.schedule.makespan
    count = len(problem._base._constraints)
    print(
        f"| {name} | {orders} | {robots} | {count} | {written:.2f} | "
        f"{time.process_time() - began:.1f} | {report.status.value} | {made} | {report.bound} |"
    )


if __name__ == "__main__":
    given = [float(v) for v in sys.argv[1:4]] or [4, 2, 60.0]
    print("| form | orders | robots | constraints | writing | solving | ended | makespan | bound |")
    print("|---|---|---|---|---|---|---|---|---|")
    measure("resource", int(given[0]), int(given[1]), given[2])
    build._Writer._one_at_a_time = pairs  # type: ignore[method-assign]
    measure("pairs", int(given[0]), int(given[1]), given[2])
