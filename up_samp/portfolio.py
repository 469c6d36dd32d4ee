"""Several searches for one problem at once: other seeds, engines or settings, behind one executor.

::

    with ProcessPoolExecutor(4) as executor:
        result = solve_portfolio(problem, seeds(4), executor=executor, timeout=60)

Whoever is back first has no say: the result is the shortest plan, the first of them where several
are as short. It is optimal if it meets its own member's bound, or any absolute one: a relative
bound speaks of the motions that its member's planner finds. A member whose worker is lost has no
say: the log says so, and ``lost`` of the metrics how often that was.

In several rounds, all members begin each one from the best plan so far, from other random numbers:
large-neighbourhood searches that share their incumbent. A round is a task for each member, whoever
is there to do it.
"""

from __future__ import annotations

import logging
import math
import os
import pickle
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from contextlib import ExitStack
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Any

from unified_planning.engines import PlanGenerationResult
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.environment import get_environment
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.io.plan_dict import PlanDict, plan_to_dict
from up_samp.io.restore import plan_from_dict
from up_samp.model import Deadline, ProblemError, SampError, UnsupportedError
from up_samp.model.refinement import ABSOLUTE
from up_samp.search.params import Parameters
from up_samp.upio.plan import SampSchedule, figures_told, words_told
from up_samp.validation import validate_plan

log = logging.getLogger(__name__)

SAME = ("seconds_per_unit", "margin")
"""What is part of the question: members that differ in it answer different ones."""

PROVEN = Status.SOLVED_OPTIMALLY.name, Status.UNSOLVABLE_PROVEN.name
"""The statuses of members after which no other round is of use."""
LOST = "LOST"
"""The status of a member whose worker did not come back."""
LEAVE = 0.05
"""Seconds that an answer is waited for at least."""


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
    rounds: int = 1,
) -> PlanGenerationResult:
    """Return the best that ``members`` find.

    :param executor: who runs them; it should have as many workers as there are members, for who
        is not back in time has no say. ``None``: processes of this machine, one for each core.
    :param timeout: s, for all together.
    :param rounds: in which members search; each begins from the best plan of those before, and ends
        after its share of the time, or each member's ``runtime``.

    Raises :class:`ProblemError` where there are no members, one cannot be sent, or nothing ends a
    round.
    """
    if not members or rounds < 1:
        raise ProblemError("a portfolio needs at least one member, and one round")
    runtime = max(member.params.get("runtime", math.inf) for member in members)
    if rounds > 1 and timeout is None and runtime == math.inf:
        raise ProblemError("rounds of a portfolio need a time limit, or a 'runtime' of each member")
    data, deadline = _sent(problem, members), Deadline.after(timeout)
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
        said: list[Said] = []
        for left in range(rounds, 0, -1):
            soon = deadline.within(deadline.remaining() / left)
            # what a worker found has to come back, too
            each = 0.95 * soon.remaining() / turns
            ends = math.inf if turns > 1 else time.time() + each
            begin = min(said, key=_makespan, default=Said("")).plan
            asked = [
                _submit(executor, data, number, each, ends, begin)
                for number in range(len(said), len(said) + len(members))
            ]
            said += [_answer(future, soon.remaining()) for future in asked]
            if any(s.status in PROVEN for s in said):
                break
    return _result(problem, said, len(members))


def _sent(problem: SchedulingMotionProblem, members: Sequence[Member]) -> bytes:
    """Return what workers are sent, if members answer one question."""
    for name in SAME:
        usual = getattr(Parameters(), name)
        if len({m.params.get(name, usual) for m in members}) > 1:
            raise ProblemError(f"the members of a portfolio need the same {name!r}")
    try:
        return pickle.dumps((problem, tuple(members)))
    except Exception as error:
        raise ProblemError(f"the problem or a member cannot be sent to workers: {error}") from error


def run_member(
    data: bytes, number: int, each: float, ends: float, begin: PlanDict | None = None
) -> Said:
    """Run a member of a portfolio that was sent: a worker's task, for ``each`` s at most, until
    ``ends`` (of ``time.time``: a cluster's clocks are in step). Numbers go on from round to round;
    ``begin`` is the best plan until then.
    """
    from unified_planning.shortcuts import OneshotPlanner

    import up_samp  # noqa: F401  (registers the engines)

    problem, members = pickle.loads(data)
    member, seconds = members[number % len(members)], min(each, max(0.0, ends - time.time()))
    params, start = dict(member.params), None
    params["seed"] = params.get("seed", 0) + number - number % len(members)
    if begin is not None:
        start = plan_from_dict(problem, begin)
        params |= {"optimal": True, "first_plan": False}
    get_environment().credits_stream = None
    with OneshotPlanner(name=member.engine, params=params) as planner:
        limit = None if math.isinf(seconds) else seconds
        result = planner.solve(problem, timeout=limit, warm_start_plan=start)
    told, metrics = " ".join(words_told(result)), figures_told(result)
    bound, kind = int(metrics.get("lower_bound", 0)), str(metrics.get("bound_kind", ""))
    if result.plan is None:
        return Said(result.status.name, None, None, bound, kind, told)
    if "value" in metrics:
        raise UnsupportedError("a portfolio compares makespans, and the problem has another metric")
    unit = float(metrics.get("seconds_per_unit", 1.0))
    plan = plan_to_dict(problem, result.plan, seconds_per_unit=unit)
    makespan = max((a["end"] for a in plan["activities"]), default=0)
    return Said(result.status.name, plan, makespan, bound, kind, told)


def _submit(executor: Executor, *given: Any) -> Future[Said]:
    try:
        return executor.submit(run_member, *given)
    except Exception as error:  # a broken pool refuses tasks
        future: Future[Said] = Future()
        future.set_exception(error)
        return future


def _answer(future: Future[Said], seconds: float) -> Said:
    """Return what a member says within some seconds; one that is there already is taken anyhow."""
    try:
        return future.result(None if math.isinf(seconds) else max(LEAVE, seconds))
    except SampError:
        raise  # it is the problem, or a parameter
    except NotYet:
        future.cancel()
        return Said(Status.TIMEOUT.name)
    except (Exception, CancelledError) as error:
        log.warning("a worker is lost: %r", error)
        return Said(LOST, message=f"a worker is lost: {error!r}")


def _makespan(said: Said) -> float:
    """Return how long a member's plan takes (inf: there is none)."""
    return math.inf if said.makespan is None else said.makespan


def _result(
    problem: SchedulingMotionProblem, said: Sequence[Said], members: int
) -> PlanGenerationResult:
    """Return the best plan that stands before the validator, with the best bound."""
    lost = sum(s.status == LOST for s in said)
    metrics = {"members": str(members), "lost": str(lost)}
    metrics["statuses"] = ", ".join(s.status for s in said)
    ranked = [(s.makespan, number) for number, s in enumerate(said) if s.makespan is not None]
    for makespan, number in sorted(ranked):
        plan = _judged(problem, said[number])
        if plan is None:
            log.error("the plan of member %d is not valid here", number)
            continue
        bound = _bound(said, said[number])
        metrics |= {"lower_bound": str(bound.lower_bound), "bound_kind": bound.bound_kind}
        metrics |= {"makespan": str(makespan), "member": str(number % members)}
        # whether a relative bound is enough is its own member's to say
        met = bool(problem.quality_metrics) and 0 < bound.lower_bound == makespan
        met &= bound.bound_kind == ABSOLUTE
        optimal = met or said[number].status == Status.SOLVED_OPTIMALLY.name
        status = Status.SOLVED_OPTIMALLY if optimal else Status.SOLVED_SATISFICING
        return PlanGenerationResult(status, plan, "portfolio", metrics)
    proven = Status.UNSOLVABLE_PROVEN.name
    first = next((s for s in said if s.status == proven), said[0])
    bound = _bound(said, first)
    metrics |= {"lower_bound": str(bound.lower_bound), "bound_kind": bound.bound_kind}
    metrics["why"] = "no member's plan is valid here" if ranked else first.message
    broken = ranked or first.status == LOST
    status = Status.INTERNAL_ERROR if broken else Status[first.status]
    return PlanGenerationResult(status, None, "portfolio", metrics)


def _bound(said: Sequence[Said], own: Said) -> Said:
    """Return who tells the greatest bound that holds for what ``own`` found."""
    told = [own, *(s for s in said if s.bound_kind == ABSOLUTE)]
    return max(told, key=lambda s: s.lower_bound)


def _judged(problem: SchedulingMotionProblem, said: Said) -> SampSchedule | None:
    """Return a member's plan as one of ``problem``, if it is valid."""
    assert said.plan is not None
    plan = plan_from_dict(problem, said.plan)
    unit = said.plan["seconds_per_unit"]
    return plan if validate_plan(problem, plan, seconds_per_unit=unit).valid else None
