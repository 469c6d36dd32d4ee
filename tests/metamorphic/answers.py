"""Solve what is said in several ways, and tell where the answers contradict each other."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from tests.metamorphic.motions import MotionStyle, write
from tests.metamorphic.sites import MotionSite
from tests.shuffled import Shuffled
from up_samp.validation import validate_plan


@dataclass(frozen=True)
class Answer:
    """What came of a problem. ``refused``: what the validator has against the plan.

    ``first`` and ``seconds``: what the first plan and the whole took, in s of computing by all
    threads, which other work on the machine hardly changes.
    """

    style: MotionStyle | str
    status: Status
    makespan: int | None
    bound: int
    refused: str
    first: float | None
    seconds: float
    why: str = ""


def answer(
    site: MotionSite, style: MotionStyle, folder: Path, *, timeout: float = 60.0, **params
) -> Answer:
    """Solve a site in a style, to optimality where time allows."""
    problem = write(site, style, folder)
    return answer_to(problem, style, partial(validate_plan, problem), timeout=timeout, **params)


def answer_in(told: Shuffled, listing: str, *, timeout: float, **params) -> Answer:
    """Solve a problem in another listing; its plan is judged by the original."""
    unit = params.get("seconds_per_unit", 1.0)

    def judge(plan):
        return validate_plan(told.original, told.back(plan), seconds_per_unit=unit)

    return answer_to(told.problem, listing, judge, timeout=timeout, **params)


def answer_to(problem, style: MotionStyle | str, judge, *, timeout: float, **params) -> Answer:
    """Solve a problem, whose plans the validator judges by ``judge``."""
    began, first = time.process_time(), []

    def watch(event) -> None:
        if event.phase == "plan":
            first.append(time.process_time() - began)

    # what is compared are the planner's own motions
    params = {"optimal": True, "relative": True, "progress": watch, **params}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=timeout)
    seconds = time.process_time() - began
    metrics = result.metrics or {}
    refused = ""
    if result.plan is not None:
        verdict = judge(result.plan)
        refused = "" if verdict.valid else str(verdict)
    return Answer(
        style,
        result.status,
        int(metrics["makespan"]) if result.plan is not None else None,
        int(metrics.get("lower_bound", 0)),
        refused,
        first[0] if first else None,
        seconds,
        "; ".join(m.message for m in result.log_messages or []),
    )


def contradictions(answers: Iterable[Answer]) -> list[str]:
    """Return what cannot be true of problems that mean the same, as texts.

    Styles of equal ``units`` mean the same: no lower bound of one may be above a plan's makespan of
    another, and what is unsolvable in one has no plan in another.
    """
    by_meaning = {}
    for a in answers:
        by_meaning.setdefault(a.style.units, []).append(a)
    return [text for some in by_meaning.values() for text in in_one_meaning(some)]


def in_one_meaning(answers: Sequence[Answer]) -> list[str]:
    """Return what cannot be true of answers to one problem, as texts."""
    found = [f"{a.style}: {a.refused}" for a in answers if a.refused]
    failed = (Status.INTERNAL_ERROR, Status.UNSUPPORTED_PROBLEM)
    found += [f"{a.style}: {a.status.name}: {a.why}" for a in answers if a.status in failed]
    plans = [a for a in answers if a.makespan is not None]
    if not plans:
        return found
    best = min(plans, key=lambda a: a.makespan)
    found += [
        f"{a.style}: {a.bound} is the least, but in style {best.style} there is {best.makespan}"
        for a in answers
        if a.bound > best.makespan
    ]
    found += [
        f"{a.style}: {a.status.name} ({a.why}), but in style {best.style} there is a plan"
        for a in answers
        if a.status is Status.UNSOLVABLE_PROVEN
    ]
    optimal = {a.makespan for a in answers if a.status is Status.SOLVED_OPTIMALLY}
    if len(optimal) > 1:
        found.append(f"optimal are {sorted(optimal)}")
    return found
