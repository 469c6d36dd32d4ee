"""Signals at random instants."""

from __future__ import annotations

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.faults.expected import SLOWLY, half_written, sane
from tests.faults.stage import Act, Outcome, after, run, when


def signalled(number: signal.Signals, api: str):
    """A signal at a random instant of a solve, from its start to its end."""

    def make(folder: Path, rng: random.Random) -> list[str]:
        ready = folder / "ready"
        spec = {"api": api, "params": SLOWLY, "ready": str(ready)}
        spec["engine"] = rng.choice(("cpsat", "cpsat", "aries-opt"))
        ready.unlink(missing_ok=True)
        outcome = run(folder, spec, during=when(ready, after(rng.uniform(0.0, 4.0), number)))
        return sane(outcome) + _ending_of(outcome, number)

    return make


def _ending_of(outcome: Outcome, number: signal.Signals) -> list[str]:
    told = outcome.told or {}
    if outcome.code == 0:
        return []  # it was done before
    if number is signal.SIGTERM:
        return [] if outcome.code == -signal.SIGTERM else [f"exit {outcome.code}"]
    if outcome.code == -signal.SIGINT:
        return []  # in the interpreter's first or last moments
    wrong = []
    if told.get("exception") not in ("KeyboardInterrupt", "InterruptedSearch"):
        wrong.append(f"Ctrl-C ended in {told or outcome.err[-600:]}")
    if told.get("exception") == "InterruptedSearch" and not (told.get("kept") or {}).get("valid"):
        wrong.append(f"the plan is lost: {told}")
    return wrong


def signalled_command(number: signal.Signals, *, late: bool):
    """The same for ``up-samp solve --out``; ``late``: once there is a plan."""

    def make(folder: Path, rng: random.Random) -> list[str]:
        out = folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        found = folder / "stderr"
        wait = rng.uniform(0.0, 2.0) if late else rng.uniform(0.0, 9.0)
        command = [sys.executable, "-c", _COMMAND, "solve", "jobshop-r1-j2-m2", "--optimal"]
        with found.open("w") as stream:
            outcome = run(
                folder,
                command=[*command, "--out", str(out)],
                during=_once_said(found, "plan with makespan", wait, number, late=late),
                stderr=stream,
            )
        said = found.read_text()
        wrong = [*outcome.left, *half_written(out)]
        plan = out / "plan.json"
        had_plan = "plan with makespan" in said
        codes = {0, 128 + number, -number} if number is signal.SIGTERM else {0, 130, -number}
        if outcome.code not in codes:
            wrong.append(f"exit {outcome.code}: {said[-600:]}")
        if "Traceback" in said and outcome.code not in (-number,):
            wrong.append(f"traceback: {said[-900:]}")
        if late and had_plan and not plan.exists():
            wrong.append(f"the plan is lost (exit {outcome.code}): {said[-600:]}")
        if plan.exists():
            json.loads(plan.read_text())
        return wrong

    return make


_COMMAND = (
    "import signal, sys\n"
    "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "from up_samp.cli import main\n"
    "sys.exit(main())\n"
)


def _once_said(file: Path, text: str, wait: float, number: signal.Signals, *, late: bool) -> Act:
    def act(process: subprocess.Popen, token: str) -> None:
        until = time.monotonic() + 120
        while late and process.poll() is None and time.monotonic() < until:
            if text in file.read_text():
                break
            time.sleep(0.02)
        after(wait, number)(process, token)

    return act
