"""Wrapped engines that die, raise, lie or hang, and parts of the search that raise."""

from __future__ import annotations

import random
import subprocess
import time
from pathlib import Path

from tests.faults.engines import FAULTS, GOOD
from tests.faults.expected import BEST, LATE, SLOWLY, ended, sane
from tests.faults.stage import run, with_token


def bad_engines(names: list[str], *, later: bool, timeout: float = 8.0):
    def make(folder: Path, _rng: random.Random) -> list[str]:
        spec = {
            "api": "batch",
            "engines": [n + "Later" * later for n in names],
            "timeout": timeout,
            "params": SLOWLY,
        }
        outcome = run(folder, spec, timeout=60 + 40 * len(names))
        wrong = sane(outcome)
        events = (outcome.told or {}).get("events", [])
        if len(events) != len(names):
            wrong.append(f"only {len(events)} of {len(names)} ran: {outcome.err[-600:]}")
        for name, event in zip(names, events, strict=False):
            wrong += _after_kept(event, name) if later else _after_nothing(event, name)
            if event.get("seconds", 0) > timeout + LATE:
                wrong.append(f"{name} took {event['seconds']:.1f} s")
        return wrong

    return make


def _after_nothing(event: dict, name: str) -> list[str]:
    if event.get("status") not in FAULTS[name].ends:
        return [f"{event}, not {FAULTS[name].ends}"]
    bad = FAULTS[name].ends != GOOD
    return [f"no reason: {event}"] if bad and not any(event["messages"]) else []


def _after_kept(event: dict, name: str) -> list[str]:
    """The plan of the second candidate is there, and called no better than it is."""
    status, best = event.get("status"), event.get("makespan") == BEST
    if not event.get("valid"):
        return [f"the plan is lost: {event}"]
    if status == "SOLVED_OPTIMALLY" and not best:
        return [f"called optimal: {event}"]
    return [] if FAULTS[name].ends != GOOD or best else [f"{event}"]


def killed_server(folder: Path, rng: random.Random) -> list[str]:
    """One of the processes that the solve has started is killed at a random instant."""

    def act(process: subprocess.Popen, token: str) -> None:
        until, wait = time.monotonic() + 30, rng.uniform(0.0, 2.0)
        while process.poll() is None and time.monotonic() < until:
            others = [p for p in with_token(token) if p.pid != process.pid]
            if others:
                time.sleep(wait)
                others = [p for p in with_token(token) if p.pid != process.pid]
                if others:
                    rng.choice(sorted(others, key=lambda p: p.pid)).kill()
                return
            time.sleep(0.02)

    engine = rng.choice(("aries", "aries-opt"))
    outcome = run(folder, {"engine": engine, "params": SLOWLY, "timeout": 20}, during=act)
    good = ("SOLVED_OPTIMALLY", "SOLVED_SATISFICING", "INTERNAL_ERROR", "TIMEOUT")
    return ended(outcome, *good)


def broken(where: str, at: int, error: str = "RuntimeError"):
    """A part of the search raises from its ``at``-th call on."""

    def make(folder: Path, _rng: random.Random) -> list[str]:
        sabotage = {"raising": {"where": where, "at": at, "error": error}}
        outcome = run(folder, {"sabotage": sabotage, "params": SLOWLY})
        wrong = ended(outcome, "INTERNAL_ERROR", "SOLVED_SATISFICING", "SOLVED_OPTIMALLY")
        told = outcome.told or {}
        failed = told.get("status") == "INTERNAL_ERROR" or any(told.get("messages", []))
        if failed and not any(error in m and "a wheel came off" in m for m in told["messages"]):
            wrong.append(f"the reason is not told: {told}")
        if at == 1 and not failed:
            wrong.append(f"nothing was injected: {told}")
        return wrong

    return make


def kept_after_a_plan(folder: Path, _rng: random.Random) -> list[str]:
    """The last pass over the best plan raises: the plan is there all the same."""
    sabotage = {"raising": {"where": "tidy", "at": 1}}
    outcome = run(folder, {"sabotage": sabotage, "params": SLOWLY})
    wrong = ended(outcome, "SOLVED_SATISFICING")
    return wrong if (outcome.told or {}).get("makespan") == BEST else [*wrong, "plan lost"]


def raising_law(problem: str, error: str):
    def make(folder: Path, _rng: random.Random) -> list[str]:
        outcome = run(folder, {"problem": problem, "timeout": 30})
        told = outcome.told or {}
        wrong = sane(outcome)
        said = told.get("said", "")
        if told.get("exception") != "ProblemError" or "r7" not in said or error not in said:
            wrong.append(f"not named: {told or outcome.err[-400:]}")
        return wrong

    return make
