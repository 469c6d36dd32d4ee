"""Try other values of the tunables on short cases, and keep what each of them shows.

    python scripts/sweep.py                        # what is not in the kept file yet
    python scripts/sweep.py --only scheduling/cpsat exchanges    # rooms or tunables, anew
    python scripts/sweep.py --reads                # only which case reads which tunable
    python scripts/sweep.py --parts                # stages and ideas left out, one at a time

A tunable is tried at a quarter and at four times its default (a share nearer to nothing and to
all), in every case that reads it; all tunables of a room first, and each of them alone only where
the part changes anything. Each run is a process of its own, forked where all is imported and the
kernels are compiled. What is compared is what does not hang on the machine: plans found, their
ends, bounds, rounds; and CPU time with a wide margin. Results go to
``benchmarks/figures/sweep.json``, from which ``scripts/tuning.py`` writes docs/tuning.md.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import itertools
import json
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "benchmarks" / "figures" / "sweep.json"
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks" / "scheduling")]

from up_samp.tuning import Tuning, tuning_of  # noqa: E402

Table = dict[str, Any]
Values = dict[str, Any]
ENGINE = "samp-refine[cpsat]"
SLOWER = 1.3
"""CPU times that differ by less are called the same; so are those that differ by less than:"""
NOISE = 1.0
"""s of CPU."""
AT_MOST = 3
"""Cases in which a part or a tunable is tried: the quickest of each kind first."""
WORSE = 0.01
"""Share of a makespan, of a bound or of arrivals that counts as worse or better."""


# --- cases: each gets a tuning as a nested table, and returns what came of it


def told_of(problem: Any, result: Any) -> Values:
    """Return what a solve came to."""
    metrics = result.metrics or {}
    told: Values = {"found": int(result.plan is not None), "status": result.status.name}
    if "makespan" in metrics:
        told["makespan"] = float(metrics["makespan"])
    if "lower_bound" in metrics:
        told["bound"] = float(metrics["lower_bound"])
    for name in ("rounds", "motion_queries", "queries"):
        if name in metrics:
            told[name] = float(metrics[name])
    return told


def solved(problem: Any, tuning: Table, timeout: float = 60.0, **params: Any) -> Values:
    """Solve a problem by the meta-engine, by counted work."""
    from unified_planning.shortcuts import OneshotPlanner

    params = {"tuning": tuning, "reproducible": True, **params}
    with OneshotPlanner(name=ENGINE, params=params) as planner:
        return told_of(problem, planner.solve(problem, timeout=timeout))


def first_plan(name: str, tuning: Table) -> Values:
    """A first plan of an instance."""
    from up_samp.benchmarks.instances import instance

    return solved(instance(name).build("fluents", False), tuning, optimal=False)


def proof(name: str, tuning: Table) -> Values:
    """The optimum of an instance."""
    from up_samp.benchmarks.instances import instance

    return solved(instance(name).build("fluents", True), tuning, 120.0, optimal=True)


def store(size: str, tuning: Table) -> Values:
    """A first plan of a warehouse."""
    return solved(_warehouse(size), tuning, 300.0)


def _warehouse(size: str) -> Any:
    """Return the warehouse of a size such as "5x10": robots and orders."""
    from up_samp.benchmarks.instances import instance

    robots, orders = size.split("x")
    return instance(f"warehouse-compact-r{robots}-o{orders}").build()


def fleet(size: str, tuning: Table) -> Values:
    """A first plan of a small warehouse, solved as large ones are."""
    return solved(_warehouse(size), {**tuning, "large": 1}, optimal=False)


def better(size: str, tuning: Table) -> Values:
    """The plans of a warehouse in 40 s."""
    from unified_planning.shortcuts import AnytimePlanner

    problem, last = _warehouse(size), None
    with AnytimePlanner(name=ENGINE, params={"tuning": tuning, "reproducible": True}) as planner:
        for result in planner.get_solutions(problem, timeout=40.0):
            last = result if result.plan is not None else last
    return told_of(problem, last) if last is not None else {"found": 0}


def example(name: str, tuning: Table) -> Values:
    """A problem of examples/."""
    from up_samp.cli.problems import find_problem

    return solved(find_problem(str(ROOT / "examples" / name)), tuning)


def random_problem(seed: str, tuning: Table) -> Values:
    """A random problem: 2 s a unit, as the fuzzer has it; "engine seed" is another engine's."""
    from unified_planning.shortcuts import OneshotPlanner

    from tests.fuzz.problems import build, random_case
    from tests.fuzz.wide import wide_case

    *kind, number = seed.split()
    case = (wide_case if "wide" in kind else random_case)(int(number))
    engine = "aries" if "aries" in kind else "cpsat"
    params = {"seconds_per_unit": 2.0, "query_seconds": 1.0, "tuning": tuning}
    params["reproducible"] = engine == "cpsat"
    with tempfile.TemporaryDirectory() as folder:
        problem = build(case, Path(folder))
        with OneshotPlanner(name=f"samp-refine[{engine}]", params=params) as planner:
            return told_of(problem, planner.solve(problem, timeout=30.0))


def shop(name: str, tuning: Table) -> Values:
    """A scheduling problem without motions."""
    from compare import problem_of
    from unified_planning.shortcuts import OneshotPlanner

    problem = problem_of(name)[1]
    params = {"tuning": tuning, "workers": 1}
    with OneshotPlanner(name="cpsat", params=params) as planner:
        result = planner.solve(problem, timeout=30.0)
    told = told_of(problem, result)
    if result.plan is not None:
        ends = [int(str(result.plan.get(a.end))) for a in result.plan.activities]
        told["makespan"] = max(ends)
    return told


def arrivals(traffic: Any, tuning: Table) -> Values:
    """Motions of a group."""
    from up_samp.model import Deadline, Outcome
    from up_samp.motion.fleet import coordinate
    from up_samp.motion.service import MotionService

    service = MotionService(traffic.grid, tuning=tuning_of(tuning))
    report = coordinate(service, traffic.query, Deadline.after(60.0))
    found = report.outcome is Outcome.FOUND
    ends = {"arrivals": sum(t.end for t in report.trajectories.values())} if found else {}
    return {"found": int(found), **ends}


def tight(name: str, tuning: Table) -> Values:
    """A tight place."""
    from tests.motion.fleet import tight_places

    case, _, body = name.rpartition(", ")
    return arrivals(tight_places.CASES[case].build(tight_places.BODIES[body]()), tuning)


def errands(name: str, tuning: Table) -> Values:
    """Random errands on a map."""
    from tests.motion.fleet import tight_places

    place, body, robots, seed = name.split(", ")
    grid = {"pillars": tight_places.pillars, "aisles": tight_places.aisles}[place]()
    kind = tight_places.BODIES[body]()
    return arrivals(tight_places.errands(grid, kind, int(robots), int(seed)), tuning)


CASES: dict[str, tuple[Callable[[str, Table], Values], tuple[str, ...]]] = {
    "tight": (tight, (
        "pocket, omni", "pocket, car", "pocket, differential", "lay-by, car",
        "full ring, three speeds, omni", "square of ten, omni", "square of ten, car",
        "room of nine, four, omni", "corner, omni",
    )),
    "errands": (errands, (
        "pillars, car, 5, 1", "pillars, omni, 10, 0",
    )),
    "shop": (shop, ("transport-1-3-0", "transport-2-4-0", "ft06", "flexible-4x4x3-0")),
    "example": (example, ("passing_place.py", "unsolvable.yaml", "charging.py", "drones.py")),
    "random": (random_problem, ("1", "4", "7", "wide 3")),
    "fleet": (fleet, ("2x3",)),
    "warehouse": (store, ("2x3", "5x10")),
    "first plan": (first_plan, (
        "navigation-r3", "jobshop-r2-j2-m1", "kitting-r2-k2-p2-d2", "doors-r2-d2",
    )),
    "optimum": (proof, ("jobshop-r2-j2-m1", "jobshop-r2-j1-m4")),
    "better": (better, ("5x10",)),
}  # fmt: skip


WARMERS = (
    *("first plan: jobshop-r1-j1-m1", "shop: flexible-3x3x3-0", "warehouse: 1x1"),
    *(
        "tight: ring of three, omni",
        "tight: ring of three, car",
        "tight: ring of three, differential",
    ),
)
"""Cases that load what others then have: kernels, libraries."""


def cases() -> Iterator[str]:
    """Yield the names of all cases."""
    for kind, (_, names) in CASES.items():
        yield from (f"{kind}: {name}" for name in names)


# --- runs


def _watch_reads(seen: set[str]) -> None:
    """Note which tunables are read from now on."""
    names = frozenset(tunables())

    def read(self: Tuning, name: str) -> Any:
        if name in names:
            seen.add(name)
        return object.__getattribute__(self, name)

    Tuning.__post_init__ = lambda self: None  # type: ignore[method-assign]
    Tuning.__getattribute__ = read  # type: ignore[method-assign, assignment]


def _count_cpu_time() -> None:
    """Let the limits of this process go by its CPU time: others may keep the machine busy."""
    from types import SimpleNamespace

    from up_samp.model import deadline as clocks
    from up_samp.scheduling.cpsat.solve import runner

    cpu = SimpleNamespace(monotonic=time.process_time)
    clocks.time = runner.time = cpu  # type: ignore[attr-defined]


def parts() -> list[str]:
    """Return what can be left out: stages of a solve, and ideas of a search."""
    from up_samp.scheduling.cpsat.solve.strategy import STAGES
    from up_samp.search.params import IDEAS

    stages = [f"stage: {stage.name}" for stage in STAGES]
    return stages + [f"idea: {name}" for name in IDEAS if name != "refine"]


def _leave_out(part: str) -> None:
    """Leave a part out of all that this process solves."""
    from up_samp.engines import samp
    from up_samp.scheduling.cpsat.solve import strategy
    from up_samp.search.params import split_parameters as split

    kind, _, name = part.partition(": ")
    if kind == "stage":
        strategy.STAGES = tuple(s for s in strategy.STAGES if s.name != name)
    else:

        def without(given: Any) -> Any:
            found, rest = split(given)
            return dataclasses.replace(found, without=(*found.without, name)), rest

        vars(samp)["split_parameters"] = without


def _child(case: str, tuning: Table, reads: bool, part: str, pipe: Any) -> None:
    """Run one case and tell what came of it."""
    os.setpgrp()
    _count_cpu_time()
    if part:
        _leave_out(part)
    seen = set[str]()
    if reads:
        _watch_reads(seen)
    kind, _, name = case.partition(": ")
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    try:
        values = CASES[kind][0](name, tuning)
    except Exception as error:
        values = {"found": 0, "error": f"{type(error).__name__}: {error}"[:300]}
    used = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    values["cpu"] = round(sum(u.ru_utime + u.ru_stime for u in used), 2)
    if reads:
        values["reads"] = sorted(seen)
    pipe.send(values)
    pipe.close()
    os._exit(0)


def run(case: str, tuning: Table, seconds: float, reads: bool = False, part: str = "") -> Values:
    """Return what a case comes to, in a forked process of at most so many seconds of CPU (and
    twenty times as many by the clock).
    """
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_child, args=(case, tuning, reads, part, theirs))
    child.start()
    theirs.close()
    try:
        if ours.poll(20 * seconds):
            return dict(ours.recv())
        return {"found": 0, "error": f"over {20 * seconds:.0f} s"}
    except EOFError:
        return {"found": 0, "error": "died"}
    finally:
        if child.pid is not None and child.is_alive():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
        child.join()


# --- settings


def other(field: dataclasses.Field[Any], value: Any, factor: float) -> Any:
    """Return a value ``factor`` times as large (a share: nearer to 0 or 1), or None if none such
    makes sense.
    """
    if isinstance(value, tuple):
        found = tuple(other(field, v, factor) for v in value)
        kept = tuple(v if new is None else new for v, new in zip(value, found, strict=True))
        return None if kept == value else kept
    told = field.metadata
    if told["most"] == 1.0 and factor > 1:
        new: Any = 1 - (1 - value) / factor
    else:
        new = value * factor
    if isinstance(value, int):
        new = round(new) if round(new) != value else value + (1 if factor > 1 else -1)
    new = min(max(new, told["least"]), told["most"])
    new = type(value)(new)
    return None if new == value else new


def tunables() -> dict[str, dataclasses.Field[Any]]:
    """Return every tunable by its name."""
    return {field.name: field for field in dataclasses.fields(Tuning)}


def setting(names: Iterable[str], factor: float) -> Table:
    """Return the table in which these tunables have other values."""
    known = tunables()
    found = {name: other(known[name], known[name].default, factor) for name in names}
    return {name: new for name, new in found.items() if new is not None}


def differences(base: Values, now: Values) -> list[str]:
    """Return what differs, in words that end with "worse", "better" or "other"."""
    told = []
    if base["found"] != now["found"]:
        told.append("found worse" if now["found"] < base["found"] else "found better")
        return told
    for name, sign in (("makespan", 1), ("arrivals", 1), ("bound", -1)):
        a, b = base.get(name), now.get(name)
        if a is None or b is None or a == b:
            if (a is None) != (b is None):
                told.append(f"{name} {'worse' if b is None else 'better'}")
            continue
        share = sign * (b - a) / max(abs(a), 1e-9)
        how = "other" if abs(share) < WORSE else "worse" if share > 0 else "better"
        told.append(f"{name} {a:g} -> {b:g} {how}")
    if base.get("status") != now.get("status"):
        told.append(f"{base.get('status')} -> {now.get('status')} other")
    for name in ("rounds", "queries", "motion_queries"):
        if base.get(name) != now.get(name):
            told.append(f"{name} {base.get(name)} -> {now.get(name)} other")
    a, b = base["cpu"], now.get("cpu", base["cpu"])
    if abs(a - b) > NOISE and max(a, b) > SLOWER * min(a, b):
        told.append(f"cpu {a:g} -> {b:g} {'worse' if b > a else 'better'}")
    return told


class Sweep:
    """The kept results, and how more of them are got."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.kept: Table = {"base": {}, "reads": {}, "tried": {}, "without": {}}
        if file.exists():
            self.kept |= json.loads(file.read_text(encoding="utf-8"))

    def save(self) -> None:
        """Write the results."""
        commit = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True
        ).stdout.strip()
        self.kept["commit"] = commit
        text = json.dumps(self.kept, indent=1, sort_keys=True)
        self.file.write_text(text + "\n", encoding="utf-8")

    def bases(self, wanted: list[str]) -> None:
        """Run every case with the defaults: what it reads, and what it comes to."""
        for case in wanted:
            if case in self.kept["base"]:
                continue
            values = run(case, {}, 120.0, reads=True)
            self.kept["reads"][case] = values.pop("reads", [])
            print(case, values, f"{len(self.kept['reads'][case])} tunables read", flush=True)
            self.kept["base"][case] = values
            self.save()

    def readers(self, names: Iterable[str]) -> list[str]:
        """Return the cases that read any of these tunables: the ``AT_MOST`` cheapest, of several
        kinds if there are.
        """
        wanted = set(names)
        found = [c for c, read in self.kept["reads"].items() if wanted & set(read)]
        found.sort(key=lambda c: self.kept["base"][c]["cpu"])
        kinds: dict[str, int] = {}
        turns = []
        for case in found:
            kind = case.partition(": ")[0]
            kinds[kind] = kinds.get(kind, 0) + 1
            turns.append((kinds[kind], case))
        return [case for _, case in sorted(turns, key=lambda t: t[0])][:AT_MOST]

    def attempt(self, label: str, names: list[str]) -> bool:
        """Return whether anything is worse or better if these tunables have other values; what is
        shown first is enough.
        """
        shown: dict[str, list[str]] = {}
        readers, runs, matters = self.readers(names), 0, False
        for case, factor in itertools.product(readers, (0.25, 4.0)):
            table = setting(names, factor)
            if not table:
                continue
            base = self.kept["base"][case]
            now, runs = run(case, table, 4 * base["cpu"] + 10), runs + 1
            if found := differences(base, now):
                shown[f"x{factor:g} {case}"] = found
                if matters := any(f.endswith(("worse", "better")) for f in found):
                    break
        told = {"cases": readers, "runs": runs, "shown": shown, "matters": matters}
        self.kept["tried"][label] = told
        self.save()
        print(label, runs, "runs", "MATTERS" if matters else "", json.dumps(shown), flush=True)
        return matters

    def leave_out(self, part: str) -> None:
        """Run every case without a part."""
        shown = {}
        for case in [c for c in self.kept["base"] if not c.startswith(("tight", "errands"))]:
            base = self.kept["base"][case]
            if found := differences(base, run(case, {}, 4 * base["cpu"] + 10, part=part)):
                shown[case] = found
        self.kept["without"][part] = shown
        self.save()
        print(part, json.dumps(shown), flush=True)

    def screen(self, path: str, names: list[str]) -> None:
        """Try all tunables of a room at once, and each alone if that shows anything."""
        tried = self.kept["tried"]
        read = [n for n in names if self.readers([n])]
        for name in set(names) - set(read):
            tried[name] = {"cases": [], "runs": 0, "shown": {}, "matters": False}
        if read and path not in tried:
            self.attempt(path, read)
        for name in read:
            if name in tried:
                continue
            if tried[path]["matters"] and len(read) > 1:
                self.attempt(name, [name])
            else:  # all of them together change nothing, or there is no other
                tried[name] = tried[path]
        self.save()


def main() -> None:
    """Sweep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", default=[], help="rooms or tunables, tried anew")
    parser.add_argument("--reads", action="store_true", help="only the defaults")
    parser.add_argument("--parts", action="store_true", help="leave parts out")
    parser.add_argument("--cases", nargs="+", default=None, help="kinds of cases")
    parser.add_argument("--out", type=Path, default=KEPT)
    args = parser.parse_args()
    import unified_planning.shortcuts as shortcuts

    import up_samp  # noqa: F401
    from up_samp.model import MotionModel
    from up_samp.motion.compile import precompile

    shortcuts.get_environment().credits_stream = None
    precompile(MotionModel)
    for case in WARMERS:
        kind, _, name = case.partition(": ")
        CASES[kind][0](name, {})
    began, sweep = time.monotonic(), Sweep(args.out)
    sweep.bases([c for c in cases() if args.cases is None or c.partition(": ")[0] in args.cases])
    for part in parts() if args.parts else ():
        if part not in sweep.kept["without"]:
            sweep.leave_out(part)
    if args.reads or args.parts:
        return
    groups: dict[str, list[str]] = {}
    for name, field in tunables().items():
        groups.setdefault(field.metadata["room"], []).append(name)
    for room, names in groups.items():
        for name in (room, *names):
            if name in args.only or room in args.only:
                sweep.kept["tried"].pop(name, None)
    for path, names in groups.items():
        if args.only and path not in args.only:
            for name in [n for n in names if n in args.only]:
                sweep.attempt(name, [name])
        elif not all(n in sweep.kept["tried"] for n in (path, *names)):
            sweep.screen(path, names)
    print(f"{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
