"""The process that something is done to: it solves a problem and writes down what came of it.

    python -m tests.faults.subject '{"folder": ..., "note": ..., "engine": "aries", ...}'

Keys: ``problem`` (see :data:`PROBLEMS`), ``engine`` (a name, or a class of
:mod:`tests.faults.engines`), ``params``, ``timeout``, ``api`` (see :data:`APIS`), ``sabotage`` (see
:mod:`tests.faults.sabotage`), ``ready`` (a file that appears when the solve begins).
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.shortcuts import AnytimePlanner, OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from tests.faults import engines, sabotage
from tests.fuzz.cases import Case, Robot, Style
from tests.fuzz.floors import Floor, block, walled
from tests.fuzz.problems import SECONDS, build
from tests.oracles.clocks import Watch
from up_samp.model import SampError


def rooms(folder: Path):
    """Two cars that change rooms through a door, one of them with a choice."""
    cells = walled(11, 6)
    block(cells, 5.4, 0, 5.6, 2.2)
    block(cells, 5.4, 3.8, 5.6, 6)
    spots = [(1.5, 1.2), (1.5, 4.8), (3.2, 3.0), (9.5, 1.2), (9.5, 4.8), (7.8, 3.0)]
    places = {f"p{k}": (x, y, 0.0) for k, (x, y) in enumerate(spots)}
    floor = Floor("rooms", cells, places, ((5.5, 3.0, 0.0), (5.5, 4.9, 0.0), 1.6))
    robots = (
        Robot("r0", True, "box", "p0", (("p3", "p4"),), 2),
        Robot("r1", False, "square", "p5", (("p1",), ("p2",)), 0),
    )
    style = Style("list", "fluents", 0, "optional", "pairs")
    return build(Case(0, floor, robots, style, "once", 1), folder)


def instance(name: str):
    def make(_folder: Path):
        from up_samp.benchmarks import instance as find

        return find(name).build()

    return make


PROBLEMS = {
    "rooms": rooms,
    "law-0": lambda _folder: sabotage.a_robot_with_a_law(1),
    "law-50": lambda _folder: sabotage.a_robot_with_a_law(50, "ZeroDivisionError"),
    "law-5000": lambda _folder: sabotage.a_robot_with_a_law(5000, "KeyError"),
    "shop": instance("jobshop-r1-j2-m2"),
    "long": instance("logistics-dc-oc-r2-i2"),
}


class Note:
    """What came of the run so far, as a file that is whole at any time."""

    def __init__(self, path: str) -> None:
        self.path, self.lines = path, {"events": []}

    def put(self, **values: Any) -> None:
        self.lines |= values
        with open(self.path + ".new", "w", encoding="utf-8") as stream:
            json.dump(self.lines, stream)
        os.replace(self.path + ".new", self.path)


def describe(problem, result) -> dict[str, Any]:
    """Return what there is to know about a result; the validator judges its plan."""
    from up_samp.validation import validate_plan

    metrics = result.metrics or {}
    told = {
        "status": result.status.name,
        "messages": [m.message for m in result.log_messages or []],
        "makespan": metrics.get("makespan"),
        "valid": None,
    }
    if result.plan is not None:
        spu = float(metrics.get("seconds_per_unit", 1.0))
        told["valid"] = validate_plan(problem, result.plan, seconds_per_unit=spu).valid
    return told


def planner_of(spec: dict[str, Any], mode=OneshotPlanner, **guarantee: Any):
    name = spec.get("engine", "cpsat")
    if hasattr(engines, name):
        module, factory = engines.__name__, get_environment().factory
        factory.add_engine(name, module, name)
    settings = {"query_seconds": 1.0, "seconds_per_unit": SECONDS} | spec.get("params", {})
    return mode(name=f"samp-refine[{name}]", params=settings, **guarantee)


def oneshot(spec, problem, note) -> None:
    proves = spec.get("engine", "cpsat") in ("cpsat", "aries-opt")
    guarantee = {"optimality_guarantee": OptimalityGuarantee.SOLVED_OPTIMALLY} if proves else {}
    with planner_of(spec, **guarantee) as planner:
        began = time.monotonic()
        result = planner.solve(problem, timeout=spec.get("timeout", 30.0))
        note.put(**describe(problem, result), seconds=time.monotonic() - began)


def anytime(spec, problem, note) -> None:
    with planner_of(spec, AnytimePlanner) as planner:
        for result in planner.get_solutions(problem, timeout=spec.get("timeout", 30.0)):
            told = describe(problem, result)
            note.put(**told, events=[*note.lines["events"], told])


def threads(spec, problem, note) -> None:
    """Solve in two threads at once."""
    found: list[dict] = []

    def work() -> None:
        try:
            with planner_of(spec) as planner:
                result = planner.solve(problem, timeout=spec.get("timeout", 30.0))
                found.append(describe(problem, result))
        except BaseException as error:
            found.append({"exception": f"{type(error).__name__}: {error}"})

    both = [threading.Thread(target=work) for _ in range(2)]
    for one in both:
        one.start()
    for one in both:
        one.join()
    note.put(events=found)


def forked(spec, problem, note) -> None:
    """Solve in a child made by fork, and in the parent beside it."""
    if spec.get("warm"):
        oneshot(spec, problem, Note(note.path + ".warm"))
    child = os.fork()
    if child == 0:
        code = 1
        try:
            oneshot(spec, problem, Note(note.path + ".child"))
            code = 0
        finally:
            os._exit(code)
    oneshot(spec, problem, note)
    _, status = os.waitpid(child, 0)
    path = Path(note.path + ".child")
    note.put(child=json.loads(path.read_text()) if path.exists() else None, code=status)


def batch(spec, problem, note) -> None:
    """Solve once for each of the ``engines`` (none of them may harm the next one's run)."""
    with planner_of(spec | {"engine": "cpsat"}) as planner:
        planner.solve(problem, timeout=30.0)  # what is imported and loaded once, is now
    for name in spec["engines"]:
        told: dict[str, Any] = {"engine": name}
        watch = Watch()
        try:
            with planner_of(spec | {"engine": name}) as planner:
                result = planner.solve(problem, timeout=spec["timeout"])
                told |= {"seconds": watch.own}
                told |= describe(problem, result)
        except BaseException as error:
            told["exception"] = f"{type(error).__name__}: {error}"
        note.put(events=[*note.lines["events"], told])


APIS = {
    "oneshot": oneshot,
    "anytime": anytime,
    "threads": threads,
    "forked": forked,
    "batch": batch,
}


def limit(spec: dict[str, Any]) -> None:
    """Set limits on memory (MB beyond what is in use) and on the size of files (bytes)."""
    if "memory" in spec:
        with open("/proc/self/statm", encoding="utf-8") as stream:
            used = int(stream.read().split()[0]) * resource.getpagesize()
        most = used + int(spec["memory"]) * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    if "largest_file" in spec:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        most = int(spec["largest_file"])
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def main() -> None:
    spec = json.loads(sys.argv[1])
    signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs ignore it
    get_environment().credits_stream = None
    note = Note(spec["note"])
    folder = Path(spec["folder"])
    problem = PROBLEMS[spec.get("problem", "rooms")](folder)
    for name, given in spec.get("sabotage", {}).items():
        getattr(sabotage, name)(problem, given)
    if "imports" in spec:
        for name in spec["imports"]:
            importlib.import_module(name)
    limit(spec)
    if "ready" in spec:
        Path(spec["ready"]).touch()
    try:
        APIS[spec.get("api", "oneshot")](spec, problem, note)
    except (Exception, KeyboardInterrupt) as error:
        from up_samp.model.errors import short

        note.put(exception=type(error).__name__, said=short(str(error))[:300])
        note.put(ours=isinstance(error, SampError))
        best = getattr(error, "result", None)
        if best is not None:
            note.put(kept=describe(problem, best))
        sys.exit(3)


if __name__ == "__main__":
    main()
