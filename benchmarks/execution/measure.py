"""Plans on a floor with delays: how long they take, and whether anybody collides.

python benchmarks/execution/measure.py plans  FOLDER [NAME ...]     solve the instances once
python benchmarks/execution/measure.py runs   FOLDER [--runs 100]   execute them: runs.csv
python benchmarks/execution/measure.py bound  FOLDER [--runs 10]    against the clairvoyant plan
python benchmarks/execution/measure.py replan FOLDER [--runs 5]     re-planning from mid-way
python benchmarks/execution/measure.py speed                        the executor's own time
python benchmarks/execution/measure.py table  FOLDER                the tables of docs/execution.md
"""

from __future__ import annotations

import argparse
import csv
import statistics
import sys
import time
from pathlib import Path

from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from up_samp.benchmarks import instance
from up_samp.execution import (
    Delays,
    coarse,
    dependencies_from_plan,
    dependencies_of,
    simulate,
    with_dependencies,
)
from up_samp.io import read_plan, result_to_dict, write_plan

NAMES = (
    "logistics-dc-all-r2-i3",
    "logistics-do-oc-r3-i4",
    "logistics-dc-all-r3-i6",
    "jobshop-r2-j2-m2",
    "jobshop-r3-j3-m2",
    "jobshop-r3-j3-m4",
    "transport-dc-r2-j2-m2",
    "logistics-dc-all-r5-i8",
    "logistics-dc-all-r10-i16",
)
SMALL = NAMES[:2] + NAMES[3:5]
SHARES = (0.1, 0.3, 0.5)
POLICIES = ("timed", "coarse", "staircase", "reorder")
HEADER = ("instance", "delays", "policy", "seed", "planned", "makespan", "waiting", "collisions",
          "deadlock", "finished", "overruns", "reorders")  # fmt: skip


def solve(problem, seconds, **params):
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        return planner.solve(problem, timeout=seconds)


def plans(args):
    for name in args.names or NAMES:
        target = args.folder / f"{name}.json"
        if target.exists():
            continue
        problem = instance(name).build()
        result = solve(problem, 120)
        plan = with_dependencies(problem, result_to_dict(problem, result))
        write_plan(target, plan)
        edges = plan["dependencies"]
        print(name, plan["makespan"], edges["edges_before_reduction"], len(edges["edges"]))


def files(args):
    names = args.names or NAMES
    return [(n, args.folder / f"{n}.json") for n in names if (args.folder / f"{n}.json").exists()]


def runs(args):
    done = set()
    target = args.folder / "runs.csv"
    if target.exists():
        with target.open() as stream:
            done = {tuple(r[:4]) for r in csv.reader(stream)}
    with target.open("a", newline="") as stream:
        out = csv.writer(stream)
        if not done:
            out.writerow(HEADER)
        for name, file in files(args):
            plan = read_plan(file)
            fine = dependencies_from_plan(plan)
            whole = coarse(fine)
            for share in args.shares:
                for policy in POLICIES:
                    for seed in range(args.runs):
                        if (name, str(share), policy, str(seed)) in done:
                            continue
                        graph = whole if policy == "coarse" else fine
                        r = simulate(graph, plan, Delays.of_share(share), seed, policy=policy)
                        out.writerow(
                            [name, share, policy, seed, r.planned, round(r.makespan, 3),
                             round(r.waiting, 4), r.collisions, int(r.deadlock), int(r.finished),
                             r.overruns, r.reorders]
                        )  # fmt: skip
                    stream.flush()
                print(name, share, f"{time.process_time():.0f} s", file=sys.stderr)


def slowed(name, pace):
    """The instance with robots that are known to be slow."""
    problem = instance(name).build()
    for item in problem.all_objects:
        if getattr(item, "name", "") in pace:
            item.motion_parameters["v_max"] *= pace[item.name]
    return problem


def bound(args):
    """Slow robots only: known from the start, the problem can be solved for them."""
    from up_samp.execution.delays import draw

    delays = Delays(slow=0.3)
    with (args.folder / "bound.csv").open("a", newline="") as stream:
        out = csv.writer(stream)
        for name, file in ((n, f) for n, f in files(args) if n in SMALL):
            plan = read_plan(file)
            fine = dependencies_from_plan(plan)
            robots = [life.object for life in fine.lives.values() if life.drives]
            for seed in range(args.runs):
                luck = draw(delays, robots, (), plan["makespan"], seed)
                problem = slowed(name, luck.pace)
                result = solve(problem, 60, optimal=True)
                if result.plan is None:
                    print(name, seed, result.status.name, file=sys.stderr)
                    continue
                known = result_to_dict(problem, result)
                best = simulate(dependencies_of(problem, known), known, Delays(), 0, judged=False)
                row = [name, seed, result.status.name, known["makespan"], round(best.makespan, 3)]
                for policy in ("staircase", "reorder"):
                    r = simulate(fine, plan, delays, seed, policy=policy, judged=False)
                    row.append(round(r.makespan, 3))
                out.writerow(row)
                stream.flush()
                print(*row, file=sys.stderr)


def table(args):
    with (args.folder / "runs.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    cells = {}
    for r in rows:
        cells.setdefault((r["instance"], r["delays"], r["policy"]), []).append(r)
    print("| instance | delays | runs | (a) time-stamped: runs with collisions "
          "| (b) coarse | (c) staircase | (d) re-ordered | (d) to (b) | waiting (d) |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|")
    for name, share in dict.fromkeys((k[0], k[1]) for k in cells):

        def ratio(policy, name=name, share=share):
            found = cells.get((name, share, policy), [])
            return [float(r["makespan"]) / float(r["planned"]) for r in found]

        def mean(values):
            return f"{statistics.mean(values):.3f}" if values else ""

        timed = cells.get((name, share, "timed"), [])
        unsafe = sum(int(r["collisions"]) > 0 for r in timed)
        b, c, d = ratio("coarse"), ratio("staircase"), ratio("reorder")
        gain = f"{statistics.mean(d) / statistics.mean(b) - 1:+.0%}" if b and d else ""
        wait = [float(r["waiting"]) for r in cells.get((name, share, "reorder"), [])]
        waits = f"{statistics.mean(wait):.1%}" if wait else ""
        print(f"| {name} | {float(share):.0%} | {len(c)} | {mean(ratio('timed'))}: {unsafe} of "
              f"{len(timed)} | {mean(b)} | {mean(c)} | {mean(d)} | {gain} | {waits} |")  # fmt: skip
    safe = [r for r in rows if r["policy"] != "timed"]
    print(f"\n{len(safe)} runs of (b), (c) and (d): {sum(int(r['collisions']) for r in safe)} "
          f"collisions, {sum(int(r['deadlock']) for r in safe)} deadlocks, "
          f"{sum(r['finished'] == '0' for r in safe)} not finished, "
          f"{sum(int(r['overruns']) for r in safe)} overruns")  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("plans", "runs", "bound", "table"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--shares", type=float, nargs="+", default=SHARES)
    args = parser.parse_args()
    get_environment().credits_stream = None
    args.folder.mkdir(parents=True, exist_ok=True)
    {"plans": plans, "runs": runs, "bound": bound, "table": table}[args.what](args)


if __name__ == "__main__":
    main()
