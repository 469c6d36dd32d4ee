"""How coordination grows with the number of robots, on the logistics hall of the SAMP paper.

    python benchmarks/spacetime/growth.py [--out FILE.json] [--robots 1 2 3 ...] [--seeds N]

For each number of robots: groups that drive at the same time into and out of the corridor
(``coordinate``, first call with its paths known, and again), and a whole plan of many motions most
of which do not overlap in time. Fixed work; prints a Markdown table, writes JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import statistics
import time
from pathlib import Path

import numpy as np

from up_samp.geometry.maps import OccupancyGrid
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    Rest,
    TimedMotion,
)
from up_samp.motion.fleet import coordinate, workspace
from up_samp.motion.service import MotionService

CAR = Body(
    ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)),
    Kinematics(MotionModel.REEDSSHEPP, 1.0, 2.0, 0.5),
)
ITEMS = [(x, y, 0.0) for y in (32.0, 27.0) for x in (59.0, 71.0, 83.0, 95.0)]


def hall() -> OccupancyGrid:
    occupied = np.zeros((650, 1000), dtype=bool)
    occupied[:3] = occupied[-3:] = True
    occupied[:, :3] = occupied[:, -3:] = True
    occupied[350:400, 520:] = occupied[200:250, 520:] = True
    return OccupancyGrid(occupied, 0.1)


def depots(count: int) -> list[tuple[float, float, float]]:
    if count <= 5:
        xs = {1: [25], 2: [20, 30], 3: [15, 25, 35], 4: [10, 20, 30, 40], 5: [15, 20, 25, 30, 35]}
        return [(float(x), 59.0, math.pi / 2) for x in xs[count]]
    top = math.ceil(count / 2)
    rows = [(61.0, top), (57.0, count - top)]
    return [(10.0 + 6.0 * i, y, math.pi / 2) for y, n in rows for i in range(n)]


def duration(service: MotionService, start, goal) -> float:
    report = service.plan(PathQuery(CAR, (start, goal)), Deadline.never())
    return report.trajectory.duration


def group(service: MotionService, count: int, rng: random.Random, slack: float) -> GroupQuery:
    """Some robots drive in, others out, at the same time; windows are their best plus slack."""
    homes, items = depots(count), rng.sample(ITEMS, min(count, len(ITEMS)))
    motions = []
    for k in range(min(count, len(ITEMS))):
        start, goal = (homes[k], items[k]) if rng.random() < 0.5 else (items[k], homes[k])
        release = float(rng.randint(0, 8))
        due = release + math.ceil(duration(service, start, goal)) + slack
        motions.append(TimedMotion(f"m{k}", f"r{k}", CAR, (start, goal), release, due))
    rests = [Rest(f"r{k}", CAR, homes[k]) for k in range(len(motions), count)]
    return GroupQuery(tuple(motions), tuple(rests))


def plan(service: MotionService, count: int, trips: int, rng: random.Random) -> GroupQuery:
    """``trips`` drives to items and back: every robot goes round and round."""
    homes, motions = depots(count), []
    free = [0.0] * count
    for trip in range(trips):
        k = trip % count
        item = ITEMS[trip % len(ITEMS)]
        begin = max(free[k], 22.0 * trip)
        there = begin + math.ceil(duration(service, homes[k], item)) + 3
        back = there + 1 + math.ceil(duration(service, item, homes[k])) + 3
        motions.append(
            TimedMotion(f"go{trip}", f"r{k}", CAR, (homes[k], item), begin, there, free[k], there)
        )
        motions.append(
            TimedMotion(f"ret{trip}", f"r{k}", CAR, (item, homes[k]), there + 1, back, there, back)
        )
        free[k] = back
    rests = [Rest(f"r{k}", CAR, homes[k], free[k]) for k in range(count)]
    return GroupQuery(tuple(motions), tuple(rests))


def timed(service: MotionService, query: GroupQuery) -> dict[str, object]:
    """Coordinate three times, first with nothing but the numba cache; seconds are processor time,
    so that they can be read on a busy machine (everything runs in one thread).
    """
    workspace._workspaces.clear()
    seconds = []
    for _ in range(3):
        began = time.process_time()
        report = coordinate(service, query, Deadline.after(120))
        seconds.append(time.process_time() - began)
    late = [report.late[m.name] - m.due for m in query.motions if m.name in report.late]
    return {
        "motions": len(query.motions),
        "first": seconds[0],
        "again": min(seconds[1:]),
        "found": report.outcome is Outcome.FOUND,
        "late": len(late),
        "most_late": max(late, default=0.0),
    }


HEAD = (
    "| robots | group, first (ms) | group, again (ms) | found | with late "
    "| plan of | first (ms) | again (ms) | late |"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 2, 3, 4, 5, 6, 8])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--slack", type=float, default=2.0, help="seconds beyond the best duration")
    parser.add_argument("--trips", type=int, default=30)
    options = parser.parse_args()
    service = MotionService(hall())
    timed(service, group(service, 3, random.Random(99), 0.0))  # compile
    rows = []
    for count in options.robots:
        runs = []
        for seed in range(options.seeds):
            query = group(service, count, random.Random(seed), options.slack)
            runs.append(timed(service, query))
        whole = timed(service, plan(service, count, options.trips, random.Random(0)))
        rows.append({"robots": count, "groups": runs, "plan": whole})
        first = statistics.median(float(r["first"]) for r in runs)
        again = statistics.median(float(r["again"]) for r in runs)
        if len(rows) == 1:
            print(HEAD)
            print("|---" * 9 + "|")
        found, late = (sum(bool(r[key]) for r in runs) for key in ("found", "late"))
        print(
            f"| {count} | {first * 1e3:.0f} | {again * 1e3:.0f} | {found}/{len(runs)} | {late} "
            f"| {whole['motions']} | {float(whole['first']) * 1e3:.0f} "
            f"| {float(whole['again']) * 1e3:.0f} | {whole['late']} |",
            flush=True,
        )
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
