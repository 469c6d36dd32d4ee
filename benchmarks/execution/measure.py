"""Plans on a floor with delays: how long they take, and whether anybody collides.

python benchmarks/execution/measure.py plans  FOLDER [NAME ...]     solve the instances once
python benchmarks/execution/measure.py runs   FOLDER [--runs 100]   execute them: runs.csv
python benchmarks/execution/measure.py bound  FOLDER [--runs 10]    against the clairvoyant plan
python benchmarks/execution/measure.py replan FOLDER [--runs 5]     re-planning from mid-way
python benchmarks/execution/measure.py speed                        the executor's own time
python benchmarks/execution/measure.py table  FOLDER                the table of docs/execution.md
python benchmarks/execution/measure.py bound-table FOLDER           the clairvoyant's table
"""

from __future__ import annotations

import argparse
import csv
import statistics
import sys
import time
from pathlib import Path

from made_up import drive_all, fleet
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from up_samp.benchmarks import instance
from up_samp.execution import (
    Delays,
    Executor,
    Surprise,
    coarse,
    dependencies_from_plan,
    dependencies_of,
    simulate,
    with_dependencies,
)
from up_samp.execution.delays import draw
from up_samp.execution.simulate import Floor
from up_samp.io import read_plan, result_to_dict, write_plan

NAMES = (
    "logistics-dc-all-r2-i3",
    "logistics-do-oc-r3-i4",
    "logistics-dc-all-r3-i6",
    "jobshop-r2-j2-m2",
    "jobshop-r3-j3-m2",
    "jobshop-r3-j3-m4",
    "transport-dc-r2-j2-m2",
    "navigation-r3",
    "kitting-r2-k2-p2-d2",
    "doors-r2-d2",
    "warehouse-r3-o5",
    "logistics-dc-all-r5-i8",
    "navigation-r10",
    "logistics-dc-all-r10-i16",
)
SMALL = NAMES[:2] + NAMES[3:5]
SHARES = (0.3, 0.1, 0.5)
BLOCK = 2
"""Seeds after which the next instance has its turn."""

POLICIES = ("timed", "coarse", "reorder", "staircase")
BOUNDED = ("coarse", "staircase", "reorder")
"""What is compared with the clairvoyant, in this order."""

HEADER = ("instance", "delays", "policy", "seed", "planned", "makespan", "waiting", "collisions",
          "deadlock", "finished", "overruns", "reorders")  # fmt: skip


def solve(problem, seconds, hint=None, **params):
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        return planner.solve(problem, timeout=seconds, warm_start_plan=hint)


def plans(args):
    for name in args.names or NAMES:
        target = args.folder / f"{name}.json"
        if target.exists():
            continue
        problem = instance(name).build()
        result = solve(problem, args.seconds)
        if result.plan is None:
            print(name, result.status.name)
            continue
        plan = with_dependencies(problem, result_to_dict(problem, result))
        write_plan(target, plan)
        edges = plan["dependencies"]
        print(name, plan["makespan"], edges["edges_before_reduction"], len(edges["edges"]))


def files(args):
    names = args.names or NAMES
    return [(n, args.folder / f"{n}.json") for n in names if (args.folder / f"{n}.json").exists()]


def runs(args):
    """All instances, shares and policies in blocks of seeds: what is there is even at any time."""
    done = set()
    target = args.folder / "runs.csv"
    if target.exists():
        with target.open() as stream:
            done = {tuple(r[:4]) for r in csv.reader(stream)}
    made = {}
    with target.open("a", newline="") as stream:
        out = csv.writer(stream)
        if not done:
            out.writerow(HEADER)
        last = args.seed + args.runs
        for low in range(args.seed, last, BLOCK):
            for share in args.shares:
                for name, file in files(args):
                    block = [
                        s for s in range(low, min(low + BLOCK, last))
                        if any((name, str(share), p, str(s)) not in done for p in POLICIES)
                    ]  # fmt: skip
                    if not block:
                        continue
                    if name not in made:
                        plan = read_plan(file)
                        fine = dependencies_from_plan(plan)
                        made[name] = plan, fine, coarse(fine)
                    for seed in block:
                        out.writerows(one_draw(name, share, seed, *made[name]))
                        stream.flush()
                    print(name, share, low, f"{time.process_time():.0f} s", file=sys.stderr)


def one_draw(name, share, seed, plan, fine, whole):
    """Return the rows of one draw: every policy meets the same delays."""
    rows, r = [], None
    for policy in POLICIES:
        if policy != "staircase" or r is None or r.reorders:
            graph = whole if policy == "coarse" else fine
            r = simulate(graph, plan, Delays.of_share(share), seed, policy=policy)
        # where no order was changed, the staircases alone do the same
        rows.append([name, share, policy, seed, r.planned, round(r.makespan, 3),
                     round(r.waiting, 4), r.collisions, int(r.deadlock), int(r.finished),
                     r.overruns, r.reorders])  # fmt: skip
    return rows


def slowed(name, pace):
    """The instance with robots that are known to be slow."""
    problem = instance(name).build()
    for item in problem.all_objects:
        if getattr(item, "name", "") in pace:
            item.motion_parameters["v_max"] *= pace[item.name]
    return problem


def bound(args):
    """Slow robots only: known from the start, the problem can be solved for them."""
    delays = Delays(slow=0.3)
    with (args.folder / "bound.csv").open("a", newline="") as stream:
        out = csv.writer(stream)
        for name, file in ((n, f) for n, f in files(args) if n in SMALL):
            plan = read_plan(file)
            fine = dependencies_from_plan(plan)
            whole = coarse(fine)
            robots = [life.object for life in fine.lives.values() if life.drives]
            for seed in range(args.seed, args.seed + args.runs):
                luck = draw(delays, robots, (), plan["makespan"], seed)
                problem = slowed(name, luck.pace)
                result = solve(problem, 60, optimal=True)
                if result.plan is None:
                    print(name, seed, result.status.name, file=sys.stderr)
                    continue
                known = result_to_dict(problem, result)
                best = simulate(dependencies_of(problem, known), known, Delays(), 0, judged=False)
                row = [name, seed, result.status.name, known["makespan"], round(best.makespan, 3)]
                for policy in BOUNDED:
                    graph = whole if policy == "coarse" else fine
                    r = simulate(graph, plan, delays, seed, policy=policy, judged=False)
                    row.append(round(r.makespan, 3))
                out.writerow(row)
                stream.flush()
                print(*row, file=sys.stderr)


def speed(args):
    for robots, tasks in ((10, 200), (50, 1000)):
        found = fleet(robots, tasks)
        executor = Executor({}, dependencies=found)
        spent = drive_all(executor, 120.0)
        graph = found.graph
        print(f"{robots} robots, {tasks} activities, {len(graph.events)} events, "
              f"{len(graph.edges)} edges")  # fmt: skip
        for what, times in spent.items():
            most = sorted(times)[int(0.99 * len(times))]
            print(f"  {what}: median {1e3 * statistics.median(times):.3f} ms, "
                  f"99 % under {1e3 * most:.3f} ms, "
                  f"worst {1e3 * max(times):.3f} ms of CPU in {len(times)} calls")  # fmt: skip


def replan(args):
    """Plan anew from 20, 40, 60 and 80 % of each run on; the machine's other work not counted."""
    rows = []
    for name, file in files(args):
        plan = read_plan(file)
        problem = instance(name).build()
        found = dependencies_of(problem, plan)
        robots = [life.object for life in found.lives.values() if life.drives]
        if len(robots) != 3:
            continue
        for seed in range(args.seed, args.seed + args.runs):
            luck = draw(Delays.of_share(0.3), robots, found.graph.tasks, plan["makespan"], seed)
            executor = Executor(plan, problem, dependencies=found)
            floor = Floor(executor, found, luck)
            for share in (0.2, 0.4, 0.6, 0.8):
                while floor.now < share * plan["makespan"]:
                    floor.step()
                for same in (True, False) if args.all else (True,):
                    began, cpu = time.perf_counter(), time.process_time()
                    left = executor.remaining_problem(Surprise(same_choices=same))
                    result = solve(left.problem, 60, left.hint)
                    took, cpu = time.perf_counter() - began, time.process_time() - cpu
                    rows.append((name, seed, share, same, result.plan is not None, took, cpu))
                    print(*rows[-1], file=sys.stderr)
    for same in (True, False):
        mine = [r for r in rows if r[3] is same]
        if mine:
            print(f"same choices: {same}: {sum(r[4] for r in mine)} of {len(mine)} solved, median "
                  f"{statistics.median(r[5] for r in mine):.2f} s, "
                  f"{statistics.median(r[6] for r in mine):.2f} s of CPU")  # fmt: skip


def table(args):
    with (args.folder / "runs.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    groups = {}
    for r in rows:
        groups.setdefault((r["instance"], r["delays"], r["policy"]), set()).add(r["seed"])
    everywhere = set.intersection(*groups.values())  # equal numbers of draws in all rows
    rows = [r for r in rows if r["seed"] in everywhere]
    cells = {}
    for r in rows:
        cells.setdefault((r["instance"], r["delays"], r["policy"]), []).append(r)
    print("| instance | delays | runs | (a) time-stamped: runs with collisions "
          "| (b) coarse | (c) staircase | (d) re-ordered | (d) to (b) | waiting (d) |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|")
    order = sorted(dict.fromkeys((k[0], k[1]) for k in cells),
                   key=lambda k: (NAMES.index(k[0]), float(k[1])))  # fmt: skip
    for name, share in order:

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
    for share in sorted({k[1] for k in cells}, key=float):
        each = {p: [statistics.mean(float(r["makespan"]) / float(r["planned"]) for r in found)
                    for (_, s, policy), found in cells.items() if (s, policy) == (share, p)]
                for p in POLICIES}  # fmt: skip
        means = {p: statistics.mean(values) for p, values in each.items()}
        print(f"\nmean of all instances at {float(share):.0%}: "
              + ", ".join(f"{p} {m:.3f}" for p, m in means.items())
              + f"; (d) to (b) {means['reorder'] / means['coarse'] - 1:+.0%}")  # fmt: skip
    safe = [r for r in rows if r["policy"] != "timed"]
    print(f"\n{len(safe)} runs of (b), (c) and (d): {sum(int(r['collisions']) for r in safe)} "
          f"collisions, {sum(int(r['deadlock']) for r in safe)} deadlocks, "
          f"{sum(r['finished'] == '0' for r in safe)} not finished, "
          f"{sum(int(r['overruns']) for r in safe)} overruns")  # fmt: skip


def bound_table(args):
    """Print how much longer than the clairvoyant's plan each policy took."""
    with (args.folder / "bound.csv").open() as stream:
        rows = [r for r in csv.reader(stream) if r[2] == "SOLVED_OPTIMALLY"]
    print("| instance | draws | (b) over the clairvoyant: mean, worst | (c) | (d) |")
    print("|---|---|---|---|---|")
    for name in dict.fromkeys(r[0] for r in rows):
        mine = [r for r in rows if r[0] == name]
        cells = []
        for k in range(len(BOUNDED)):
            over = [float(r[5 + k]) / float(r[4]) for r in mine]
            cells.append(f"{statistics.mean(over):.3f}, {max(over):.3f}")
        print(f"| {name} | {len(mine)} | {' | '.join(cells)} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    steps = {
        "plans": plans, "runs": runs, "bound": bound, "replan": replan, "speed": speed,
        "table": table, "bound-table": bound_table,
    }  # fmt: skip
    parser.add_argument("what", choices=steps)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("execution-runs"))
    parser.add_argument("names", nargs="*")
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1000, help="the first of the draws")
    parser.add_argument("--all", action="store_true", help="replan: with other choices, too")
    parser.add_argument("--seconds", type=float, default=120, help="plans: time for each")
    parser.add_argument("--shares", type=float, nargs="+", default=SHARES)
    args = parser.parse_args()
    get_environment().credits_stream = None
    args.folder.mkdir(parents=True, exist_ok=True)
    steps[args.what](args)


if __name__ == "__main__":
    main()
