"""What is right about any run, and about one that has to end in a certain way."""

from __future__ import annotations

from pathlib import Path

from tests.faults.stage import Outcome

BEST = "11"
"""Makespan of the best plan of the problem ``rooms``."""
SLOWLY = {"without": ("bounds_first",), "optimal": True}
"""With these the best plan of ``rooms`` is the third candidate, and the second is a plan, too."""
LATE = 2.0


def sane(outcome: Outcome) -> list[str]:
    """Return what is wrong about any run: things left behind, invalid plans, false claims."""
    wrong = list(outcome.left)
    if "hung for" in outcome.err:
        wrong.append(outcome.err.splitlines()[-1])
    told = outcome.told or {}
    results = [told, told.get("kept"), *told.get("events", []), told.get("child")]
    for result in filter(None, results):
        if result.get("valid") is False:
            wrong.append(f"invalid plan: {result}")
    return wrong


def ended(outcome: Outcome, *statuses: str) -> list[str]:
    """Return what is wrong where the run should end in one of the statuses."""
    wrong = sane(outcome)
    told = outcome.told or {}
    if told.get("status") not in statuses:
        wrong.append(f"exit {outcome.code}, {told or outcome.err[-600:]}, not {statuses}")
    return wrong


def half_written(folder: Path) -> list[str]:
    if not folder.exists():
        return []
    return [f"half-written: {p.name}" for p in folder.iterdir() if p.name.startswith(".")]
