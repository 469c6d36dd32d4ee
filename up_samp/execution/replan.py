"""What is left of a plan planned anew, from where everybody stands."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import OneshotPlanner

from up_samp.execution.executor import Executor
from up_samp.execution.files import with_dependencies
from up_samp.execution.remaining import Remaining, Surprise
from up_samp.execution.simulate import Delays, floor_of
from up_samp.io.plan_dict import PlanDict, result_to_dict
from up_samp.model import ProblemError

ENGINE = "samp-refine[cpsat]"


def solve_remaining(
    left: Remaining, *, engine: str = ENGINE, seconds: float | None = None
) -> PlanDict:
    """Return a plan of what is left with its dependencies, sought from the rest of the old plan
    (``left.hint``) on, in its units and with its clearance (``left.params``).

    Raises :class:`ProblemError` where the engine finds none within ``seconds``.
    """
    with OneshotPlanner(name=engine, params=dict(left.params)) as planner:
        result = planner.solve(left.problem, timeout=seconds, warm_start_plan=left.hint)
    return with_dependencies(left.problem, result_to_dict(left.problem, result))


def remaining_at(
    problem: SchedulingProblem,
    plan: PlanDict,
    time: float,
    surprise: Surprise | None = None,
    broken_down: Collection[str] = (),
) -> Remaining:
    """Return what is left of a plan that was carried out without delays until ``time`` (s), when a
    ``surprise`` is told, and robots ``broken_down`` are out of order, wherever they stand.

    Raises :class:`ProblemError` where all was over by then.
    """
    executor = Executor(plan, problem)
    floor = floor_of(executor, Delays(), 0)
    while floor.goes_on and floor.now < time - 1e-9:
        floor.step()
    if not floor.goes_on:
        raise ProblemError(f"nothing is left at {time:g} s: the plan is over after {floor.now:g} s")
    return executor.remaining_problem(
        broken_where_they_stand(executor, surprise or Surprise(), broken_down)
    )


def broken_where_they_stand(
    executor: Executor, surprise: Surprise, names: Collection[str]
) -> Surprise:
    """Return a surprise with robots that break down where they come to a stand."""
    here = executor.remaining_problem().poses if names else {}
    broken = dict(surprise.broken)
    for name in names:
        if name not in here:
            known = ", ".join(sorted(here))
            raise ProblemError(f"'{name}' cannot break down: what stands on the floor is {known}")
        x, y, theta = here[name]
        broken[name] = (x, y, theta)
    return replace(surprise, broken=broken)
