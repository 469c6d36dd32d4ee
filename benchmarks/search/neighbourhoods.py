"""Neighbourhoods side by side with the search of the whole, from the same first plan.

    python benchmarks/search/neighbourhoods.py logistics-dc-all-r8-i12 --seconds 20

Both ways begin from one process's first plan and what it had learned by then (the process forks),
and have the same CPU seconds, on a busy machine, too: all limits go by the CPU time of the process,
and CP-SAT has one thread. Prints when each way had which makespan.
"""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from ortools.sat.python import cp_model

from up_samp.benchmarks.instances import instance
from up_samp.model import Deadline, Refusal
from up_samp.model import deadline as clocks
from up_samp.scheduling.cpsat.solve import runner
from up_samp.search.attempt import try_candidate
from up_samp.search.conclusion import conclude_without_schedule
from up_samp.search.loop import get_schedule, improve, is_better, state_what_is_known
from up_samp.search.neighbourhoods import Descent, DescentSettings
from up_samp.search.params import Parameters
from up_samp.search.search import Search
from up_samp.search.session import Wrapped, open_search
from up_samp.upio import SampSchedule
from up_samp.validation import validate_plan

WAITS = 50.0
"""Wall clock that a CPU second may take at most."""


class CpuSolver(cp_model.CpSolver):
    """CP-SAT whose time limit counts CPU time."""

    def solve(self, model: Any, callback: Any = None) -> Any:
        """Solve until the process has used so much CPU time."""
        limit, done = self.parameters.max_time_in_seconds, threading.Event()
        until = time.process_time() + limit
        self.parameters.max_time_in_seconds = WAITS * limit

        def watch() -> None:
            while not done.wait(0.05):
                if time.process_time() > until:
                    self.stop_search()

        threading.Thread(target=watch, daemon=True).start()
        try:
            return super().solve(model, callback)
        finally:
            done.set()


def count_cpu_time() -> None:
    """Let all limits of this process go by its CPU time."""
    cpu = SimpleNamespace(monotonic=time.process_time)
    clocks.time = runner.time = cpu  # type: ignore[attr-defined]
    names = {n: getattr(cp_model, n) for n in dir(cp_model)}
    runner.cp_model = SimpleNamespace(**{**names, "CpSolver": CpuSolver})  # type: ignore[assignment]


def first_plan(name: str, encoding: Any, seed: int) -> Search:
    """Return a search that has its first plan, and has learned what comes before that."""
    problem = instance(name).build(encoding, True)

    def judge(plan: SampSchedule) -> list[Refusal]:
        verdict = validate_plan(problem, plan)
        if not verdict.valid:
            raise RuntimeError(str(verdict.violations[:3]))
        return []

    wrapped = Wrapped("cpsat", {"workers": 1}, lambda *_: [], judge, native=True)
    search = open_search(problem, wrapped, Parameters(seed=seed), Deadline.after(300.0))
    state_what_is_known(search)
    while search.bounds.incumbent is None:
        report = get_schedule(search, optimal=False)
        if report.schedule is None:
            raise RuntimeError(f"no schedule of {name} in time")
        try_candidate(search, report)
    return search


def go_on(search: Search, note: Callable[[], None]) -> None:
    """Search on for a shorter plan, as the loop does."""
    deadline = search.budget.deadline
    while not deadline.expired() and not search.bounds.met:
        for _ in improve(search, stuck=False):
            note()
        if deadline.expired():
            return
        report = get_schedule(search, optimal=True)
        if report.schedule is None or not is_better(search, report.schedule):
            if conclude_without_schedule(search, report) is not None:
                return
            for _ in improve(search, stuck=True):
                note()
        elif try_candidate(search, report).better is not None:
            note()


def way(search: Search, seconds: float, name: str, improvers: tuple[Descent, ...]) -> None:
    """Go one way in a process of its own."""
    process = os.fork()
    if process:
        os.waitpid(process, 0)
        return
    began, trail = time.process_time(), []
    search.budget.deadline = Deadline.after(seconds)
    search.components = replace(search.components, improvers=improvers)
    go_on(search, lambda: trail.append((time.process_time() - began, search.bounds.upper)))
    told = ", ".join(f"{makespan} at {at:.0f} s" for at, makespan in trail) or "nothing better"
    lower, upper = search.bounds.lower, search.bounds.upper
    print(f"  {name}: {told}; in the end {upper}, bound {lower}", flush=True)
    os._exit(0)


def main() -> None:
    """Go both ways for each instance."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("instances", nargs="+")
    parser.add_argument("--encoding", default="fluents")
    parser.add_argument("--seconds", type=float, default=20.0, help="of CPU time, for each way")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    count_cpu_time()
    for name in options.instances:
        search = first_plan(name, options.encoding, options.seed)
        count = len(search.knowledge.relaxation.problem.activities)
        print(f"{name}, seed {options.seed}, {count} activities: first plan {search.bounds.upper}")
        first = Descent(DescentSettings(activities=0))
        way(search, options.seconds, "neighbourhoods", (first,))
        way(search, options.seconds, "the whole", ())


if __name__ == "__main__":
    main()
