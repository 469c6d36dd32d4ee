"""Pure traffic, no tasks: who gets everybody from start to goal, how fast, and how well.

The same maps, bodies, starts and goals for all, in one run:
- ladder: ours, the whole of ``up_samp.motion.fleet.coordinate``;
- prioritised: one robot after the other, each on its best path, its lanes and detours with the best
  timing among those before it (safe intervals along paths), in one order;
- st-rrt*: one robot after the other by ST-RRT* (cars only), as in the paper;
- lacam: our LaCAM alone, everybody in step from rest to rest on the lattice: the lower reference.

    python benchmarks/traffic/compare.py [--robots 2 5 10] [--seeds 2] [--seconds 60]
"""

from __future__ import annotations

import argparse
import math
import statistics
import time

from up_samp.benchmarks import tight_places as tight
from up_samp.model import Deadline, GroupReport, Outcome
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.lacam import Agent, Joint
from up_samp.motion.fleet.one_robot import plan_one
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.priority_search import Group, window_of
from up_samp.motion.fleet.roadmap import Roadmap, cells_of
from up_samp.motion.fleet.workspace import workspace_of
from up_samp.motion.service import MotionService
from up_samp.motion.tuning import RoadmapTuning

MAPS = {"pillars": tight.pillars, "aisles": tight.aisles}
SEARCHES = 4
WORK = 300_000


def by_ladder(traffic, service, deadline):
    return arrivals(coordinate(service, traffic.query, deadline))


def by_samples(traffic, service, deadline):
    return arrivals(coordinate(service, traffic.query, deadline, method="st-rrt*"))


def arrivals(report: GroupReport) -> float | None:
    if report.outcome is not Outcome.FOUND:
        return None
    return sum(t.end for t in report.trajectories.values())


def by_priority(traffic, service, deadline):
    motions = {m.name: m for m in traffic.query.motions}
    group = Group(workspace_of(service), motions, [], deadline)
    runs = {}
    for name in group.order:
        attempt = plan_one(
            group.workspace, motions[name], window_of(group, name, runs), list(runs.values()),
            deadline, effort=1,
        )  # fmt: skip
        if attempt.run is None:
            return None
        runs[name] = attempt.run
    # who goes first does not heed those that still stand at their starts
    pairs = [(a, b) for a in runs.values() for b in runs.values() if a.name < b.name]
    if any(group.workspace.meeting(a, b)[0] < math.inf for a, b in pairs):
        return None
    return sum(run.arrival for run in runs.values())


def in_step(traffic, service, deadline):
    motions = traffic.query.motions
    body, heeds = motions[0].body, [[a is not b for b in motions] for a in motions]
    ends = [pose for m in motions for pose in m.poses]
    for cell in dict.fromkeys(cells_of(body, RoadmapTuning())[:2]):
        roadmap = Roadmap(service.scene, body, ends, (), (), cell, RoadmapTuning())
        goals = [roadmap.place(m.poses[-1]) for m in motions]
        agents = [
            Agent(roadmap, roadmap.place(m.poses[0]), goal, roadmap.to_go(goal))
            for m, goal in zip(motions, goals, strict=True)
        ]
        for seed in range(SEARCHES):
            steps = Joint(agents, heeds, service.scene.margin, seed).search(WORK, deadline)
            if steps is not None:
                return _in_step_arrivals(steps)
    return None


def _in_step_arrivals(steps) -> float:
    now, last = 0.0, [0.0] * len(steps[0])
    for step in steps:
        now += max(edge.move.seconds for edge in step)
        for i, edge in enumerate(step):
            if edge.source != edge.target:
                last[i] = now
    return sum(last)


METHODS = {
    "ladder": by_ladder,
    "prioritised": by_priority,
    "st-rrt*": by_samples,
    "lacam": in_step,
}


def measured(traffic, method, seconds):
    service = MotionService(traffic.grid)
    began = time.process_time()
    total = method(traffic, service, Deadline.after(seconds))
    return total, time.process_time() - began


def alone(traffic) -> float | None:
    """Sum of arrivals if nobody met anybody: no plan is better, but for the planner's own gap. None
    where somebody finds no path even alone: such a draw is left out.
    """
    workspace = workspace_of(MotionService(traffic.grid))
    paths = [workspace.path(m.body, m.poses, (), Deadline.after(60)) for m in traffic.query.motions]
    if not all(isinstance(path, Path) for path in paths):
        return None
    return sum(path.natural.duration for path in paths)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="*", default=[2, 5, 10, 20])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--bodies", nargs="*", default=list(tight.BODIES))
    parser.add_argument("--maps", nargs="*", default=list(MAPS))
    args = parser.parse_args()
    print("| map | body | robots | method | found | CPU s | arrivals / alone |")
    print("|---|---|---|---|---|---|---|")
    for map_name in args.maps:
        for kind in args.bodies:
            for robots in args.robots:
                rows = {name: [] for name in METHODS if kind == "car" or name != "st-rrt*"}
                for seed in range(args.seeds):
                    traffic = tight.errands(MAPS[map_name](), tight.BODIES[kind](), robots, seed)
                    least = alone(traffic)
                    if least is None:
                        continue
                    for name, found in rows.items():
                        total, cpu = measured(traffic, METHODS[name], args.seconds)
                        found.append((None if total is None else total / least, cpu))
                for name, found in rows.items():
                    if not found:
                        continue
                    ratios = [ratio for ratio, _ in found if ratio is not None]
                    ratio = f"{statistics.mean(ratios):.2f}" if ratios else "-"
                    cpu = statistics.median(seconds for _, seconds in found)
                    count = f"{len(ratios)}/{len(found)}"
                    print(
                        f"| {map_name} | {kind} | {robots} | {name} | {count} | {cpu:.2f} "
                        f"| {ratio} |",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
