"""Replay a solver's models with the allocator's checks: does CP-SAT write beyond its memory?

    python benchmarks/reliability/memory.py [--rounds 10] [--runs 5] [--workers 2]

A fleet without chargers is solved once in a process of its own, and every model that CP-SAT was
given is replayed there again and again, with the searches that are left out
(``IGNORED``, up_samp/scheduling/cpsat/solve/runner.py) and without them. glibc's malloc checks
each block as it is freed and ends the process where one was written beyond. Run it before a
newer OR-Tools is let use them again. Linux with glibc only (``libc_malloc_debug.so.0``).
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from pathlib import Path
from unittest import mock

from ortools.sat.python import cp_model

from up_samp.fleet import Fleet
from up_samp.scheduling.cpsat.solve.runner import IGNORED

MAP = Path(__file__).parents[2] / "examples" / "maps" / "two_rooms.yaml"
CHECKS = {"LD_PRELOAD": "libc_malloc_debug.so.0", "MALLOC_CHECK_": "3"}
Run = tuple[cp_model.CpModel, str]
"""A model, and the parameters that it was solved with."""


def fleet() -> Fleet:
    """Return a fleet that has no plan: its robot's battery is too small, and nothing charges it."""
    made = Fleet(MAP)
    made.add_robot_type(
        "agv", (1.2, 0.8), model="diff", v_max=2.0, a_max=1.0, omega_max=2.0,
        battery={"capacity": 60, "per_metre": 1.0, "reserve": 2},
    )  # fmt: skip
    for name, x, y in (("home", 2, 3), ("plug", 2, 12.5), ("a", 7, 3), ("b", 12, 12), ("c", 25, 4)):
        made.add_place(name, x, y)
    made.add_robot("r", "agv", "home", end="home")
    made.add_order("o1", "a", "b")
    made.add_order("o2", "c", "b")
    return made


def recorded(problem: Fleet, workers: int) -> list[Run]:
    """Return what CP-SAT is asked with several workers while a problem is solved."""
    runs: dict[tuple[str, str], Run] = {}
    solve = cp_model.CpSolver.solve

    def note(self, model, *rest):
        parameters = str(self.parameters)
        if f"num_workers: {workers}" in parameters:
            runs.setdefault(
                (str(model), parameters.split("max_det")[0]), (model.clone(), parameters)
            )
        return solve(self, model, *rest)

    with mock.patch.object(cp_model.CpSolver, "solve", note):
        problem.solve(timeout=None, workers=workers)
    return list(runs.values())


def replay(runs: list[Run], rounds: int, ignored: tuple[str, ...]) -> None:
    """Solve all models ``rounds`` times; print a line after each."""
    for number in range(rounds):
        for model, parameters in runs:
            solver = cp_model.CpSolver()
            lines = [line for line in parameters.splitlines() if "ignore_subsolvers" not in line]
            solver.parameters.parse_text_format("\n".join(lines))
            solver.parameters.ignore_subsolvers.extend(ignored)
            solver.solve(model)
        print(f"round {number + 1} of {len(runs)} models", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--runs", type=int, default=5, help="processes")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--ignored", default=None, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.ignored is not None:
        ignored = tuple(args.ignored.split(",")) if args.ignored else ()
        replay(recorded(fleet(), args.workers), args.rounds, ignored)
        return 0
    print("| left out | process | rounds | end |\n|---|---|---|---|")
    for ignored in (",".join(IGNORED), ""):
        for run in range(args.runs):
            command = [sys.executable, __file__, "--rounds", str(args.rounds)]
            command += ["--workers", str(args.workers), "--ignored", ignored]
            done = subprocess.run(
                command, env={**os.environ, **CHECKS}, capture_output=True, text=True, check=False
            )
            if done.returncode > 0:
                raise RuntimeError(done.stderr)
            said = [
                line for line in done.stderr.splitlines() if "free()" in line or "malloc" in line
            ]
            end = (
                " ".join([signal.Signals(-done.returncode).name, *said[:1]])
                if done.returncode
                else "well"
            )
            count = done.stdout.count("round ")
            print(f"| {ignored or 'nothing'} | {run} | {count} | {end} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
