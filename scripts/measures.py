"""How each figure of ``scripts/figures.py`` is measured: one function each, run in a process of its
own as ``python scripts/measures.py FUNCTION CASE TREE``.

A function gets the name of a case and returns its values by name; they are printed as one line of
JSON. ``TREE`` is the checkout that is measured: its package is the one that is imported
(``PYTHONPATH`` says so), which need not be the checkout that this file lies in. So only what has
long been there is used: engines, ``up_samp.benchmarks``, ``coordinate``, ``MotionService``,
``up_samp.execution``, the command line. ``cpu`` is s of computing by this process and its
children, all else in the units that the list in ``figures.py`` gives.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import re
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

ENGINE = "samp-refine[cpsat]"
SMALLEST = "jobshop-r1-j1-m1"
DRAWS = 6
"""Draws of delays that each plan is executed with."""
SEED = 5000
"""The first of them."""
TREE = Path(sys.argv[3] if len(sys.argv) > 3 else Path(__file__).parents[1]).resolve()
Values = dict[str, Any]


def spent() -> float:
    """Return the CPU seconds of this process and of its children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def peak() -> float:
    """Return the most memory that this process has held (MiB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def resident() -> float:
    """Return the memory that this process holds now (MiB)."""
    with open("/proc/self/status", encoding="ascii") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def helper(folder: str, *modules: str) -> Any:
    """Import a module of the measured checkout outside of its package, by any of its names."""
    place = TREE / folder
    sys.path.insert(0, str(place))
    files = {name: place / f"{name.replace('.', '/')}.py" for name in modules}
    return importlib.import_module(next(name for name, file in files.items() if file.exists()))


def planner(kind: Any = None, **params: Any) -> Any:
    """Return the engine (a one-shot planner unless ``kind`` says otherwise)."""
    from unified_planning.shortcuts import OneshotPlanner, get_environment

    import up_samp  # noqa: F401  (registers the engines)

    get_environment().credits_stream = None
    return (kind or OneshotPlanner)(name=ENGINE, params=params)


def warm_up(case: str) -> Values:
    """Compile all kernels of this checkout, and keep them on disk."""
    from up_samp.model import MotionModel
    from up_samp.motion.compile import precompile

    precompile(MotionModel)
    tight_place("pocket, omni")
    return {}


# --- plans of the benchmark families


def run_of(case: str, engine: str = ENGINE, **spec: Any) -> Values:
    """Solve one instance as ``up-samp bench run`` does."""
    from up_samp.benchmarks.report import proven, solved

    run = helper(".", "up_samp.benchmarks.one_run", "up_samp.benchmarks.runner")
    record = run.perform(run.RunSpec(case, engine, **spec))
    if "error" in record:
        raise RuntimeError(record["error"])
    metrics = record["metrics"]
    told: Values = {"valid": int(solved(record)), "proven": int(proven(record))}
    told |= {"makespan": record.get("makespan"), "bound": metrics.get("lower_bound")}
    told |= {"cpu": record["seconds_cpu"], "seconds": record["seconds"]}
    told |= {"sequential": record.get("sequential"), "rounds": metrics.get("rounds")}
    layers = ("geometric", "temporal", "group")
    told["refinements"] = sum(int(metrics.get(f"refinements_{layer}", 0)) for layer in layers)
    return told


def first_plan(case: str) -> Values:
    """A first plan of a published instance, with fluents, within 60 s."""
    return run_of(case, optimal=False, timeout=60)


def aries_plan(case: str) -> Values:
    """The same by aries, the engine of the paper."""
    return run_of(case, "samp-refine[aries]", optimal=False, timeout=60)


def drawn_anew(case: str) -> Values:
    """The best plan within 60 s of an instance that is drawn from a seed, with its bound."""
    return run_of(case, optimal=True, timeout=60)


def proof(case: str) -> Values:
    """A plan that is proven optimal, of a published instance with fluents, within 300 s."""
    return run_of(case, optimal=True, timeout=300)


PRESET_INSTANCES = (
    "logistics-do-oc-r2-i3",
    "logistics-dc-oc-r2-i2",
    "logistics-do-all-r2-i3",
    "logistics-dc-all-r2-i3",
    "jobshop-r2-j2-m1",
    "jobshop-r2-j2-m2",
)
"""Small instances in which robots meet."""


def preset(case: str) -> Values:
    """First plans of six small instances (20 s each) by one preset."""
    runs = [run_of(name, preset=case, optimal=False, timeout=20) for name in PRESET_INSTANCES]
    good = [r for r in runs if r["valid"]]
    told: Values = {"runs": len(runs), "solved": len(good), "cpu": sum(r["cpu"] for r in runs)}
    told |= {key: sum(int(r[key] or 0) for r in good) for key in ("rounds", "refinements")}
    told["makespans"] = sum(r["makespan"] for r in good)
    return told


# --- large warehouses


def warehouse_of(case: str) -> Any:
    """Return the problem of a case such as "20x60" or "10x30, file"."""
    size, _, form = case.partition(", ")
    robots, orders = map(int, size.split("x"))
    if form == "file":
        names = "tests.search.fleet_bound.store_fleet", "tests.search.store_fleet"
        return helper(".", *names).fleet_of(robots, orders).problem
    from up_samp.benchmarks.instances import instance

    compact = "" if form == "moves" else "compact-"
    return instance(f"warehouse-{compact}r{robots}-o{orders}").build()


def warehouse_plan(case: str) -> Values:
    """A first plan of a large warehouse, seed 0."""
    problem, began = warehouse_of(case), spent()
    with planner(first_plan=True) as engine:
        result = engine.solve(problem, timeout=3000)
    told = result.metrics or {}
    values: Values = {"activities": len(problem.activities), "cpu": spent() - began}
    stages = ("reading", "building", "validating")
    values |= {f"cpu_{stage}": float(told.get(f"cpu_{stage}", 0.0)) for stage in stages}
    values |= {"bound": int(told["lower_bound"]), "peak": peak()}
    values["makespan"] = int(told["makespan"]) if result.plan is not None else None
    values["modules"] = sum(name.startswith("up_samp") for name in sys.modules)
    return values


def better_plans(case: str) -> Values:
    """The plans of an anytime planner in so many seconds of computing ("20x60, seed 0, 300 s")."""
    from unified_planning.shortcuts import AnytimePlanner, PlanValidator

    from up_samp.benchmarks.instances import instance
    from up_samp.model.deadline import computing_time

    size, seed, seconds = case.replace("seed ", "").removesuffix(" s").split(", ")
    robots, orders = map(int, size.split("x"))
    problem = instance(f"warehouse-compact-r{robots}-o{orders}-s{seed}").build()
    first, plan, told = dict[int, float](), None, {}
    with computing_time(), planner(AnytimePlanner, seed=0) as engine:
        began = spent()
        for result in engine.get_solutions(problem, timeout=float(seconds)):
            told = result.metrics or {}
            if result.plan is not None:
                plan = result.plan
                first.setdefault(int(told["makespan"]), round(spent() - began, 1))
    with PlanValidator(name="samp-validator") as judge:
        valid = judge.validate(problem, plan).status.name == "VALID"
    return {
        "valid": int(valid),
        "first": next(iter(first)),
        "makespan": min(first),
        **{k: int(told[k]) for k in ("without_traffic",) if k in told},
        "bound": int(told["lower_bound"]),
        "absolute": int(told.get("absolute_bound", told["lower_bound"])),
        "plans": [list(pair) for pair in first.items()],
    }


# --- traffic


def arrivals(traffic: Any, seconds: float) -> tuple[Any, float, Any]:
    """Coordinate a group, twice where that is quick (the first call loads kernels); return its
    report, the CPU seconds, and the sum of arrivals (s; None if not everybody gets through).
    """
    from up_samp.model import Deadline, Outcome
    from up_samp.motion.fleet import coordinate
    from up_samp.motion.service import MotionService

    for _ in range(2):
        service, began = MotionService(traffic.grid), spent()
        report = coordinate(service, traffic.query, Deadline.after(seconds))
        cpu = spent() - began
        if cpu > 5.0:
            break
    found = report.outcome is Outcome.FOUND
    return report, cpu, sum(t.end for t in report.trajectories.values()) if found else None


def alone(traffic: Any) -> float | None:
    """Return the sum of arrivals (s) if nobody met anybody, None where one has no way."""
    from dataclasses import replace

    total = 0.0
    for motion in traffic.query.motions:
        single = replace(traffic, query=replace(traffic.query, motions=(motion,)))
        mine = arrivals(single, 60.0)[2]
        if mine is None:
            return None
        total += mine
    return total


TIGHT = ("tests.motion.fleet.tight_places", "up_samp.benchmarks.tight_places")


def tight_place(case: str) -> Values:
    """A tight place of ``tests/motion/fleet/tight_places.py`` with one kind of body; who gets
    through is judged by the validator's own checks.
    """
    tight_places = helper(".", *TIGHT)

    name, _, body = case.rpartition(", ")
    traffic = tight_places.CASES[name].build(tight_places.BODIES[body]())
    report, cpu, total = arrivals(traffic, 60.0)
    told: Values = {"found": int(total is not None), "cpu": cpu, "ratio": None}
    if total is not None:
        judge = helper(".", "tests.motion.fleet.independent", "tests.spacetime.independent").judge
        with tempfile.TemporaryDirectory() as folder:
            judge(traffic, report, Path(folder))
        least = alone(traffic)
        told["ratio"] = total / least if least else None
    return told


def errands(case: str) -> Values:
    """Random errands of so many robots on one map, drawn by a seed ("pillars, omni, 10, 0"): the
    first plan, and what comes of it in a minute of computing, judged by the validator's own checks.
    """
    from up_samp.model import Deadline, Outcome
    from up_samp.model.deadline import computing_time
    from up_samp.motion.fleet import neighbourhoods
    from up_samp.motion.service import MotionService

    tight_places = helper(".", *TIGHT)
    name, body, robots, seed = case.split(", ")
    grid = {"pillars": tight_places.pillars, "aisles": tight_places.aisles}[name]()
    traffic = tight_places.errands(grid, tight_places.BODIES[body](), int(robots), int(seed))
    least = alone(traffic)
    told: Values = {"found": 0, "first": None, "ratio": None, "cpu": None}
    if least is None:
        return {**told, "failed": "somebody has no way even alone: no draw"}
    arrivals(tight_places.errands(grid, tight_places.BODIES[body](), 3, 0), 60.0)  # loads kernels
    first_runs, first = neighbourhoods.first_runs, dict[str, float]()

    def noted(group: Any) -> Any:
        runs = first_runs(group)
        if runs is not None and not first:
            total = sum(run.arrival for run in runs.values())
            first.update(first=total / least, cpu=spent() - began)
        return runs

    with computing_time():
        began = spent()
        service = MotionService(traffic.grid)
        with mock.patch("up_samp.motion.fleet.coordination.first_runs", noted):
            report = service.coordinate(traffic.query, Deadline.after(60.0), anytime=True)
    if report.outcome is Outcome.FOUND:
        with tempfile.TemporaryDirectory() as folder:
            helper(".", "tests.motion.fleet.independent").judge(traffic, report, Path(folder))
        total = sum(t.end for t in report.trajectories.values())
        told |= {"found": 1, "ratio": total / least}
    return told | first


def drives(case: str) -> Values:
    """Depot-to-item motions in the logistics hall by one planner ("car", "omnidirectional",
    "RRTConnect": OMPL's with our compiled checks, shortened and timed by us).
    """
    import numpy as np

    from up_samp.geometry import OccupancyGrid
    from up_samp.model import Body, Deadline, Kinematics, MotionModel, Outcome, PathQuery
    from up_samp.motion import MotionService

    cells = np.zeros((650, 1000), dtype=bool)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = True
    cells[350:400, 520:] = cells[200:250, 520:] = True
    kinematics = Kinematics(MotionModel.REEDSSHEPP, turning_radius=1.0, v_max=2.0, a_max=0.5)
    if case == "omnidirectional":
        kinematics = Kinematics(MotionModel.SE2, v_max=2.0, a_max=0.5, omega_max=1.0)
    body = Body(((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)), kinematics)
    names = {"omnidirectional": "planar"}
    service = MotionService(OccupancyGrid(cells, 0.1), planner=names.get(case, case))
    starts = [(x, 59.0, math.pi / 2) for x in (25.0, 15.0, 35.0)]
    items = [(float(x), float(y), 0.0) for y in (32, 27, 42, 17) for x in (59, 71, 83, 95)]
    service.plan(PathQuery(body, ((20.0, 59.0, 1.5), (59.0, 33.0, 0.0))), Deadline.after(120))
    times, ratios = [], []
    for start in starts:
        for goal in items:
            began = time.process_time()
            report = service.plan(PathQuery(body, (start, goal)), Deadline.after(30))
            times.append(1e3 * (time.process_time() - began))
            if report.outcome is Outcome.FOUND:
                least = service.lower_bound(body, (start, goal))
                ratios.append(report.trajectory.duration / least)
    told: Values = {"asked": len(times), "found": len(ratios)}
    told |= {"median": statistics.median(times), "most": max(times)}
    return told | {"ratio": statistics.median(ratios), "worst": max(ratios)}


# --- sites


def site(case: str) -> Values:
    """The best plan of an example's site within 60 s of computing, and the routing solver's."""
    found: Values = helper("benchmarks/fleet", "sites").measured(case, 60.0)
    return found


def others_floor(case: str) -> Values:
    """The best plan within 100 s of computing of a fleet on a map that others drew."""
    found: Values = helper("benchmarks/scale", "floors").measured(case, 100.0)
    return found


# --- days


def day(case: str) -> Values:
    """A day of ten robots in simulation ("rolling, 60 an hour, 8 h, seed 0"), or of others ("...,
    30 robots"), or on Nav2's map ("..., Nav2"): 2 cm of noise, 30 % delays, two breakdowns ("...,
    no breakdowns": none), orders due after 300 s ("..., due 120 s": sooner). Several of them
    ("seeds 20 to 29") are one row: sums, means by order, and the worst day's times.
    """
    first, last = re.search(r"seeds? (\d+)(?: to (\d+))?", case).groups()  # type: ignore[union-attr]
    found = [one_day(case, seed) for seed in range(int(first), int(last or first) + 1)]
    if len(found) == 1:
        return found[0]
    orders = sum(f["orders"] for f in found)
    means = ("per_hour", "tardiness", "flow", "waiting")
    worst = ("early", "held", "planning", "step", "peak")
    names = {name: None for f in found for name in f}
    values: Values = {}
    for name in names:
        if name in worst:
            values[name] = max(f[name] for f in found)
        elif name in means:
            values[name] = sum(f[name] * f["orders"] for f in found) / orders
        else:
            values[name] = sum(f.get(name, 0) for f in found)
    return values


def one_day(case: str, seed: int) -> Values:
    """Run one of them. Memory is looked at every tenth of an hour: ``held`` is what this process
    holds at the end of the second hour (of a shorter day: at half of it) and at the end.
    """
    from up_samp.operate.day import DayPlan, simulate_day

    days = helper("benchmarks/operate", "days")
    way, *rest = case.split(", ")
    told = {unit: float(n) for n, unit in re.findall(r"([0-9.]+) (an hour|h|robots|s)", case)}
    plan = DayPlan(
        told["h"], told["an hour"], due=told.get("s", 300.0), noise=0.02, delays=0.3,
        breakdowns=0 if "no breakdowns" in rest else 2, seed=seed,
    )  # fmt: skip
    floor = days.nav2_warehouse if "Nav2" in rest else days.warehouse
    held: list[float] = []

    way_of: Any = days.WAYS[way]

    class Watched(way_of):
        def step(self) -> None:
            super().step()
            if self.clock.now() >= 360.0 * len(held):
                held.append(resident())

    with tempfile.TemporaryDirectory() as folder:
        fleet, store = floor(Path(folder), int(told.get("robots", 10))), Path(folder) / "day.db"
        result = simulate_day(fleet, plan, store, operation=Watched)
    came, wrong = result.figures, result.verdict.wrong
    values: Values = {"orders": came.orders, "done": came.done, "wrong": sum(wrong.values())}
    values |= wrong
    values |= {k: getattr(came, k) for k in ("per_hour", "tardiness", "flow", "waiting")}
    values |= {"plans": came.plans, "dropped": came.plans - came.plans_taken}
    values |= {"early": held[min(20, len(held) // 2)], "held": held[-1]}
    values |= {"planning": came.planning[1], "step": came.steps[1], "peak": peak()}
    print(f"{way}, seed {seed}: {values}", file=sys.stderr)
    return values


# --- execution


def solved_plan(problem: Any, seconds: float = 120.0, hint: Any = None, **params: Any) -> Any:
    """Solve a problem; return UP's result, which has a plan."""
    params = params or {"first_plan": True}
    with planner(**params) as engine:
        result = engine.solve(problem, timeout=seconds, warm_start_plan=hint)
    if result.plan is None:
        raise RuntimeError(f"no plan: {result.status.name}")
    return result


def executable(name: str) -> tuple[Any, dict[str, Any]]:
    """Return an instance's problem, and its first plan with dependencies."""
    from up_samp.benchmarks import instance
    from up_samp.execution import with_dependencies
    from up_samp.io import result_to_dict

    problem = instance(name).build()
    return problem, with_dependencies(problem, result_to_dict(problem, solved_plan(problem)))


def floor(case: str) -> Values:
    """A first plan executed with delays ("NAME, 30 %") by each policy; all meet the same draws.
    Makespans are means of the realised over the planned.
    """
    from up_samp.execution import Delays, dependencies_from_plan, simulate

    name, share = case.removesuffix(" %").split(", ")
    _, plan = executable(name)
    fine = dependencies_from_plan(plan)
    delays, told, bad = Delays.of_share(float(share) / 100), {}, 0
    for policy in ("timed", "staircase", "reorder"):
        runs = [
            simulate(fine, plan, delays, seed, policy=policy) for seed in range(SEED, SEED + DRAWS)
        ]
        told[policy] = statistics.mean(r.makespan / r.planned for r in runs)
        collided = sum(r.collisions > 0 for r in runs)
        if policy == "timed":
            told["timed_collided"] = collided
        else:
            bad += sum(
                bool(r.collisions or r.deadlock or r.overruns or not r.finished) for r in runs
            )
        if policy == "reorder":
            told["waiting"] = statistics.mean(r.waiting for r in runs)
    return {**told, "draws": DRAWS, "unsafe": bad}


def clairvoyant(case: str) -> Values:
    """Makespans over that of a plan made in knowledge of how slow each robot will be."""
    from up_samp.benchmarks import instance
    from up_samp.execution import (
        Delays,
        dependencies_from_plan,
        dependencies_of,
        simulate,
    )
    from up_samp.execution.floor import draw
    from up_samp.io import result_to_dict

    _, plan = executable(case)
    fine, delays = dependencies_from_plan(plan), Delays(slow=0.3)
    over: dict[str, list[float]] = {"staircase": [], "reorder": []}
    for seed in range(SEED, SEED + DRAWS):
        luck = draw(delays, fine, seed)
        problem = instance(case).build()
        for item in problem.all_objects:
            if getattr(item, "name", "") in luck:
                item.motion_parameters["v_max"] *= luck[item.name].pace
        result = solved_plan(problem, 60, optimal=True)
        if result.status.name != "SOLVED_OPTIMALLY":
            continue
        known = result_to_dict(problem, result)
        best = simulate(dependencies_of(problem, known), known, Delays(), 0, judged=False)
        for policy, ratios in over.items():
            run = simulate(fine, plan, delays, seed, policy=policy, judged=False)
            ratios.append(run.makespan / best.makespan)
    means = {policy: statistics.mean(found) for policy, found in over.items()}
    return {**means, "worst": max(over["reorder"]), "draws": len(over["reorder"])}


def replan(case: str) -> Values:
    """What is left of a plan with delays of 30 %, solved from 20, 40, 60 and 80 % of it on."""
    from up_samp.execution import Delays, Executor, Surprise, dependencies_of
    from up_samp.execution.simulate import Floor

    problem, plan = executable(case)
    found = dependencies_of(problem, plan)
    executor = Executor(plan, problem, dependencies=found)
    driven, times, solved = Floor(executor, Delays.of_share(0.3), SEED), [], 0
    for share in (0.2, 0.4, 0.6, 0.8):
        while driven.now < share * plan["makespan"]:
            driven.step()
        began = spent()
        left = executor.remaining_problem(Surprise(same_choices=True))
        with planner() as engine:
            result = engine.solve(left.problem, timeout=60, warm_start_plan=left.hint)
        times.append(spent() - began)
        solved += result.plan is not None
    return {"asked": len(times), "solved": solved, "cpu": statistics.median(times)}


def executor_time(case: str) -> Values:
    """The executor's own time for a made-up plan ("50 robots, 1000 activities"): medians, ms."""
    from up_samp.execution import Executor

    made_up = helper("benchmarks/execution", "made_up")
    robots, activities = (int(word) for word in case.split() if word.isdigit())
    found = made_up.fleet(robots, activities)
    times = made_up.drive_all(Executor({}, dependencies=found), 60.0)
    return {what: 1e3 * statistics.median(each) for what, each in times.items()}


# --- start-up, memory, house


def python(code: str, folder: Path, **environment: str) -> tuple[float, float]:
    """Run code in a fresh process; return its seconds by the clock, and CPU seconds."""
    env = {**os.environ, **environment}
    env.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation keeps its bytecode
    cpu, began = spent(), time.perf_counter()
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{code}: {done.stderr[-2000:]}")
    return time.perf_counter() - began, spent() - cpu


COMMAND = "import sys; from up_samp.cli import main; sys.exit(main({!r}))"
STARTS = {
    "import unified_planning": (
        "import unified_planning.shortcuts as s; s.get_environment().factory"
    ),
    "import up_samp": "import up_samp",
    "up-samp --version": COMMAND.format(["--version"]),
    f"up-samp solve {SMALLEST}": COMMAND.format(["solve", SMALLEST, "--first"]),
    "up-samp demo": COMMAND.format(["demo", "--first", "--out", "out"]),
}


def start_up(case: str) -> Values:
    """A fresh process that does one thing: the median of five after one that does not count; or
    ("..., cold") once, of a copy of the package without bytecode and compiled kernels.
    """
    import up_samp

    what, _, cold = case.partition(", ")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if cold:
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(Path(up_samp.__file__).parent, folder / "up_samp", ignore=ignored)
            seconds, cpu = python(
                STARTS[what], folder, PYTHONPATH=name, HOME=name, UP_SAMP_CACHE_DIR=f"{name}/cache"
            )
        else:
            python(STARTS[what], folder)
            runs = [python(STARTS[what], folder) for _ in range(5)]
            seconds, cpu = (statistics.median(column) for column in zip(*runs, strict=True))
    return {"cpu": cpu, "seconds": seconds}


def memory(case: str) -> Values:
    """The memory of a process that solves one published instance, or many small ones in turn."""
    from up_samp.benchmarks import instance

    if case != "48 solves":
        solved_plan(instance(case).build())
        return {"peak": peak()}
    held = []
    for _ in range(8):
        for name in PRESET_INSTANCES:
            solved_plan(instance(name).build())
        held.append(resident())
    return {"peak": peak(), "after_6": held[0], "after_48": held[-1]}


def house(case: str) -> Values:
    """The structure of the package, by ``scripts/house.py`` beside this file."""
    from house import measure

    assert (TREE / "up_samp").is_dir(), "no package in this checkout"
    return measure(TREE).values()


# --- the scheduler alone


def scheduler(case: str) -> Values:
    """A scheduling problem by cpsat and by other engines, 12 s each."""
    compare = helper("benchmarks/scheduling", "compare")
    return compare.row_of(case, 12.0)


def relaxation(case: str) -> Values:
    """The scheduling problem inside a published instance, moves at 2 m/s: the lower bound without
    search, and a tour by list scheduling and annealing.
    """
    from up_samp.benchmarks import instance

    module = helper("benchmarks/scheduling", "relaxations")
    return module.bounds(instance(case).build("fluents", True))


def resolving(case: str) -> Values:
    """Twenty rounds of a growing problem: one session, and a new one each round."""
    from up_samp.benchmarks import instance

    module = helper("benchmarks/scheduling", "relaxations")
    return module.resolve(instance(case).build(), 20)


MEASURES: dict[str, Callable[[str], Values]] = {
    function.__name__: function
    for function in (
        *(warm_up, first_plan, aries_plan, drawn_anew, proof, preset),
        *(warehouse_plan, better_plans, site, others_floor),
        *(tight_place, errands, drives, floor, day, clairvoyant, replan),
        *(executor_time, start_up, memory, house, scheduler, relaxation, resolving),
    )
}


def rounded(value: Any) -> Any:
    """Return a value as it is kept: three digits after the point."""
    return round(value, 3) if isinstance(value, float) else value


def main(arguments: Sequence[str]) -> None:
    """Measure one case and print its values."""
    values = MEASURES[arguments[0]](arguments[1])
    print(json.dumps({key: rounded(value) for key, value in values.items()}))


if __name__ == "__main__":
    main(sys.argv[1:])
