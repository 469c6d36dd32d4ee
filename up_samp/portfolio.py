"""Several searches for one problem at once: other seeds, engines or settings, behind one executor.

::

    with ProcessPoolExecutor(4) as executor:
        result = solve_portfolio(problem, seeds(4), executor=executor, timeout=60)

The members are independent. Whoever is back first has no say: the result is the shortest plan, the
first of them where several are as short. It is optimal if it meets its own member's bound, or any
absolute one: a relative bound speaks of the motions that its member's planner finds. A member whose
worker is lost is run here, if there is time.
"""

from __future__ import annotations

import logging
import os
import pickle
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from typing import Any

from unified_planning.engines import PlanGenerationResult
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.environment import get_environment
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.io.plan_dict import PlanDict, plan_to_dict
from up_samp.io.restore import plan_from_dict
from up_samp.model import Deadline, ProblemError, UnsupportedError
from up_samp.search.params import Parameters
from up_samp.system.workers import Workers, WorkItem
from up_samp.upio.plan import SampSchedule
from up_samp.validation import validate_plan

log = logging.getLogger(__name__)

SAME = ("seconds_per_unit", "margin")
"""What is part of the question: members that differ in it answer different ones."""


@dataclass(frozen=True)
class Member:
    """One search: an engine by its name, and its parameters (which have to be sent to a worker)."""

    engine: str = "samp-refine[cpsat]"
    params: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Said:
    """What came of a member. Bounds and makespans are in units."""

    status: str
    plan: PlanDict | None = None
    makespan: int | None = None
    lower_bound: int = 0
    bound_kind: str = ""
    message: str = ""


def seeds(count: int, engine: str = "samp-refine[cpsat]", **params: Any) -> list[Member]:
    """Return members that differ in their seed alone: 0, 1, ..."""
    return [Member(engine, {**params, "seed": seed}) for seed in range(count)]


def solve_portfolio(
    problem: SchedulingMotionProblem,
    members: Sequence[Member],
    *,
    executor: Executor | None = None,
    timeout: float | None = None,
) -> PlanGenerationResult:
    """Return the best that ``members`` find.

    :param executor: who runs them; it should have as many workers as there are members, for who
        is not back in time has no say. ``None``: processes of this machine, one for each core.
    :param timeout: s, for all together.

    Raises :class:`ProblemError` where there are no members, or one cannot be sent.
    """
    if not members:
        raise ProblemError("a portfolio needs at least one member")
    for name in SAME:
        usual = getattr(Parameters(), name)
        if len({m.params.get(name, usual) for m in members}) > 1:
            raise ProblemError(f"the members of a portfolio need the same {name!r}")
    try:
        data = pickle.dumps((problem, tuple(members)))
    except Exception as error:
        raise ProblemError(f"the problem or a member cannot be sent to workers: {error}") from error
    deadline = Deadline.after(timeout)
    environment = get_environment()
    with ExitStack() as stack:
        # members are silent, those that are run in this process, too
        stack.callback(setattr, environment, "credits_stream", environment.credits_stream)
        turns = 1
        if executor is None:
            count = min(len(members), os.cpu_count() or 1)
            turns = -(-len(members) // count)
            pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"))
            executor = stack.enter_context(pool)
        workers = Workers(executor)
        # what a worker found has to come back, too
        each = None if timeout is None else 0.95 * timeout / turns
        ends = None if each is None or turns > 1 else time.time() + each
        tasks: list[WorkItem[Said]] = [
            WorkItem(
                run_member,
                (data, number, each, ends),
                partial(_run_here, problem, member, each),
                deadline.remaining,
            )
            for number, member in enumerate(members)
        ]
        answers = workers.answers(tasks, deadline.remaining)
    said = [Said(Status.TIMEOUT.name) if a is None else a for a in answers]
    return _result(problem, said, workers.lost)


def run_member(
    data: bytes, number: int, each: float | None, ends: float | None, seconds: float
) -> Said:
    """Run a member of a portfolio that was sent: a worker's task. Until ``ends`` (of ``time.time``:
    a cluster's clocks are in step), where it is given.
    """
    problem, members = pickle.loads(data)
    left = seconds if each is None else min(seconds, each)
    left = left if ends is None else min(left, max(0.0, ends - time.time()))
    return _run(problem, members[number], left)


def _run_here(
    problem: SchedulingMotionProblem, member: Member, each: float | None, seconds: float
) -> Said:
    return _run(problem, member, seconds if each is None else min(seconds, each))


def _run(problem: SchedulingMotionProblem, member: Member, seconds: float) -> Said:
    from unified_planning.shortcuts import OneshotPlanner

    import up_samp  # noqa: F401  (registers the engines)

    get_environment().credits_stream = None
    with OneshotPlanner(name=member.engine, params=dict(member.params)) as planner:
        result = planner.solve(problem, timeout=None if seconds == float("inf") else seconds)
    told = " ".join(m.message for m in result.log_messages or ())
    metrics = result.metrics or {}
    bound, kind = int(metrics.get("lower_bound", 0)), str(metrics.get("bound_kind", ""))
    if result.plan is None:
        return Said(result.status.name, None, None, bound, kind, told)
    if "value" in metrics:
        raise UnsupportedError("a portfolio compares makespans, and the problem has another metric")
    unit = float(metrics.get("seconds_per_unit", 1.0))
    plan = plan_to_dict(problem, result.plan, seconds_per_unit=unit)
    makespan = max((a["end"] for a in plan["activities"]), default=0)
    return Said(result.status.name, plan, makespan, bound, kind, told)


def _result(
    problem: SchedulingMotionProblem, said: Sequence[Said], lost: int
) -> PlanGenerationResult:
    """Return the best plan that stands before the validator, with the best bound."""
    metrics = {"members": str(len(said)), "lost": str(lost)}
    metrics["statuses"] = ", ".join(s.status for s in said)
    ranked = [(s.makespan, number) for number, s in enumerate(said) if s.makespan is not None]
    for makespan, number in sorted(ranked):
        plan = _judged(problem, said[number])
        if plan is None:
            log.error("the plan of member %d is not valid here", number)
            continue
        bound = _bound(said, said[number])
        metrics |= {"lower_bound": str(bound.lower_bound), "bound_kind": bound.bound_kind}
        metrics |= {"makespan": str(makespan), "member": str(number)}
        met = bool(problem.quality_metrics) and 0 < bound.lower_bound == makespan
        optimal = met or said[number].status == Status.SOLVED_OPTIMALLY.name
        status = Status.SOLVED_OPTIMALLY if optimal else Status.SOLVED_SATISFICING
        return PlanGenerationResult(status, plan, "portfolio", metrics)
    proven = Status.UNSOLVABLE_PROVEN.name
    first = next((s for s in said if s.status == proven), said[0])
    bound = _bound(said, first)
    metrics |= {"lower_bound": str(bound.lower_bound), "bound_kind": bound.bound_kind}
    metrics["why"] = "no member's plan is valid here" if ranked else first.message
    status = Status.INTERNAL_ERROR if ranked else Status[first.status]
    return PlanGenerationResult(status, None, "portfolio", metrics)


def _bound(said: Sequence[Said], own: Said) -> Said:
    """Return who tells the greatest bound that holds for what ``own`` found."""
    told = [own, *(s for s in said if s.bound_kind == "absolute")]
    return max(told, key=lambda s: s.lower_bound)


def _judged(problem: SchedulingMotionProblem, said: Said) -> SampSchedule | None:
    """Return a member's plan as one of ``problem``, if it is valid."""
    assert said.plan is not None
    plan = plan_from_dict(problem, said.plan)
    unit = said.plan["seconds_per_unit"]
    return plan if validate_plan(problem, plan, seconds_per_unit=unit).valid else None
