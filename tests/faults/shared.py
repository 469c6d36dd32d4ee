"""Threads, forks, and standard streams that are closed."""

from __future__ import annotations

import random
import shutil
import sys
from pathlib import Path

from tests.faults.expected import BEST, SLOWLY, ended, half_written, sane
from tests.faults.stage import run


def two_threads(folder: Path, rng: random.Random) -> list[str]:
    engine = rng.choice(("cpsat", "aries-opt"))
    outcome = run(folder, {"api": "threads", "engine": engine, "params": SLOWLY})
    wrong = sane(outcome)
    events = (outcome.told or {}).get("events", [])
    good = [e for e in events if e.get("status") == "SOLVED_OPTIMALLY" and e["makespan"] == BEST]
    return wrong if len(good) == 2 else [*wrong, f"{engine}: {events} {outcome.err[-600:]}"]


def forks(*, warm: bool):
    def make(folder: Path, rng: random.Random) -> list[str]:
        for note in folder.glob("told.json.*"):
            note.unlink()
        engine = rng.choice(("cpsat", "aries-opt"))
        outcome = run(folder, {"api": "forked", "warm": warm, "engine": engine})
        told = outcome.told or {}
        wrong = ended(outcome, "SOLVED_OPTIMALLY")
        if (told.get("child") or {}).get("status") != "SOLVED_OPTIMALLY":
            wrong.append(f"the child: {told} {outcome.err[-600:]}")
        return wrong

    return make


def streams(how: str):
    """Standard streams that are closed, or read no further."""

    def make(folder: Path, _rng: random.Random) -> list[str]:
        out = folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        inner = [sys.executable, "-m", "up_samp", "solve", "jobshop-r1-j1-m1", "--out", str(out)]
        shells = {
            "stdin": '"$@" <&-',
            "stdout": '"$@" >&-',
            "stderr": '"$@" 2>&-',
            "all": '"$@" <&- >&- 2>&-',
            "head": '"$@" | head -c 1',
            "full": '"$@" >/dev/full',
        }
        outcome = run(folder, command=["sh", "-c", shells[how], "sh", *inner])
        wrong = [*outcome.left, *half_written(out)]
        if not (out / "plan.json").exists():
            wrong.append(f"no plan: exit {outcome.code}, {outcome.err[-600:]}")
        if "Traceback" in outcome.err:
            wrong.append(f"traceback: {outcome.err[-600:]}")
        if how in ("stdin", "stdout", "stderr", "all") and outcome.code != 0:
            wrong.append(f"exit {outcome.code}: {outcome.err[-600:]}")
        return wrong

    return make
