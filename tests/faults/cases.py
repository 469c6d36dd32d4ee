"""The faults, one after the other: how each is made, and what has to come of it.

Each case is a function of a folder and random numbers that returns what is wrong, a line each;
``benchmarks/reliability/faults.py`` runs them all and makes the table of docs/reliability.md.
"""

from __future__ import annotations

import os
import random
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.faults.dying import bad_engines, broken, kept_after_a_plan, killed_server, raising_law
from tests.faults.engines import FAULTS
from tests.faults.harmed import cold_cache, harmed_kernels
from tests.faults.scarce import full_disk, little_memory, read_only_cache, small_files
from tests.faults.shared import forks, streams, two_threads
from tests.faults.signalled import signalled, signalled_command


@dataclass(frozen=True)
class Fault:
    """``make`` returns what is wrong (nothing, where all is well)."""

    name: str
    expected: str
    make: Callable[[Path, random.Random], list[str]]
    runs: int = 1
    quick: bool = False


ENDING = [n for n, f in FAULTS.items() if "TIMEOUT" in f.ends]
DYING = ["DiesAtOnce", "LeavesQuietly", "KilledByItself", "Aborts", "LeavesBySystemExit",
         "Interrupts", "ShutsDescriptors"]  # fmt: skip
RAISING = ["RaisesAtOnce", "OutOfMemory", "Recursion"]
LYING = [n for n in FAULTS if n not in (*ENDING, *DYING, *RAISING)]
INT, TERM = signal.SIGINT, signal.SIGTERM


def table() -> list[Fault]:
    """Return all faults."""
    kept = "; the plan found before is returned"
    found = []
    for names, what, expected in (
        (DYING, "engine's process ends", "`INTERNAL_ERROR` with its last words"),
        (RAISING, "engine raises", "`INTERNAL_ERROR`, the error named"),
        (LYING, "engine lies or is odd", "`INTERNAL_ERROR`, or no proof"),
        (ENDING, "engine hangs, starts processes", "`TIMEOUT`, all of them ended"),
    ):
        limit = 8.0 if names is ENDING else 24.0  # what hangs takes all of it
        found += [
            Fault(
                f"{what} ({len(names)} kinds)",
                expected,
                bad_engines(names, later=False, timeout=limit),
            ),
            Fault(
                f"{what}, third call ({len(names)} kinds)",
                expected + kept,
                bad_engines(names, later=True, timeout=limit),
            ),
        ]
    found.append(
        Fault(
            "engine's server killed at a random instant", "any ending but a lie", killed_server, 10
        )
    )
    for where in ("car", "planar", "leg", "coordinate", "certificate", "repair"):
        found.append(
            Fault(
                f"motion planning raises: {where}", "`INTERNAL_ERROR`, or the plan until then",
                lambda folder, rng, where=where: [
                    w
                    for at in (1, rng.randint(2, 6))
                    for w in broken(where, at, rng.choice(("RuntimeError", "MemoryError")))(
                        folder, rng
                    )
                ],
                2,
            )
        )  # fmt: skip
    found += [
        Fault("the last pass over a plan raises", "the plan", kept_after_a_plan, 1, quick=True),
        Fault(
            "control model raises", "`ProblemError`, object named",
            lambda folder, rng: [
                w
                for n, e in (("law-0", "RuntimeError"), ("law-50", "ZeroDivisionError"),
                             ("law-5000", "KeyError"))
                for w in raising_law(n, e)(folder, rng)
            ],
        ),
    ]  # fmt: skip
    interrupted = "`KeyboardInterrupt`; the best plan in its `result`, once there is one"
    for number, expected in ((INT, interrupted), (TERM, "the process ends")):
        for api in ("oneshot", "anytime"):
            name = f"{number.name} at a random instant, {api}"
            found.append(Fault(name, expected, signalled(number, api), 15))
        name = f"{number.name} at a random instant, `up-samp solve`"
        exit_code = f"exit code {130 if number is INT else 143}"
        found += [
            Fault(name, exit_code, signalled_command(number, late=False), 10),
            Fault(
                f"{number.name} once there is a plan, `up-samp solve --out`",
                f"{exit_code}, plan.json written",
                signalled_command(number, late=True),
                10,
            ),
        ]
    found += [
        Fault("memory limit", "a plan, `INTERNAL_ERROR` or `MemoryError`", little_memory, 12),
        Fault("full disk", "a plan, or the error told", full_disk, 8),
        Fault("files of limited size", "a plan, or the error told", small_files, 5),
        Fault("read-only cache", "a plan", read_only_cache, 1),
        Fault("harmed kernel cache", "a plan, compiled anew", harmed_kernels, 6),
        Fault("two processes on a cold cache", "two plans", cold_cache, 1),
        Fault("two threads", "two plans", two_threads, 4),
        Fault("fork after import", "two plans", forks(warm=False), 3),
        Fault("fork after a solve", "two plans", forks(warm=True), 3),
    ]
    for how in ("stdin", "stdout", "stderr", "all"):
        found.append(Fault(f"closed: {how}", "plan.json written, exit code 0", streams(how)))
    found += [
        Fault("output read no further (`| head`)", "plan.json written", streams("head")),
        Fault("output to a full device", "plan.json written", streams("full")),
    ]
    return found


FAULT_TABLE = table()
assert os.name == "posix"
