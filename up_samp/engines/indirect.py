"""Problems solved by way of others: lexicographic objectives, moved objects that are parameters."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

from unified_planning.engines import LogLevel, LogMessage, PlanGenerationResultStatus
from unified_planning.model.metrics import MinimizeMakespan

from up_samp.engines.faces import Call
from up_samp.model import UnsupportedError
from up_samp.model.deadline import Deadline
from up_samp.model.errors import InterruptedSearch
from up_samp.model.objective import MinimizeCosts, terms_in
from up_samp.model.refinement import RELATIVE
from up_samp.upio.movers import Settled
from up_samp.upio.objective import is_makespan, shown
from up_samp.upio.plan import figures_told

Results = Callable[[Call], Iterator[Any]]
OPTIMAL = PlanGenerationResultStatus.SOLVED_OPTIMALLY


def costs_in_order(problem: Any) -> MinimizeCosts | None:
    """Return a problem's metric, if that is one of several ranks."""
    costs = (m for m in problem.quality_metrics if isinstance(m, MinimizeCosts) and m.in_order)
    return next(costs, None)


class InOrder:
    """Solves a problem whose costs have several ranks, rank by rank, by ``results`` of problems of
    one rank each. ``counted``: their time is counted work, and shared evenly beforehand.
    """

    def __init__(self, metric: MinimizeCosts, call: Call, results: Results, counted: bool) -> None:
        self._metric, self._call, self._results = metric, call, results
        self._counted = counted
        self._deadline = Deadline.after(call.timeout)
        self._limits: list[int | Fraction] = []
        self._told: list[LogMessage] = []
        self._said: set[str] = set()
        """What ranks have told, in their own words."""
        self._best: Any = call.warm_start_plan
        self._proven = True
        self._relative = False
        """Whether the bound of a rank rests on the motion planner's durations."""

    def solve(self, *, first: bool) -> Iterator[Any]:
        """Yield each better plan as INTERMEDIATE, and last the final result (``first``: any plan
        will do, and the first rank alone is asked for).
        """
        last = None
        for number, _ in enumerate(self._metric.ranks):
            try:
                for result in self._results(self._stage(number)):
                    if result.status is PlanGenerationResultStatus.INTERMEDIATE:
                        yield result
                    else:
                        last = self._ended(number, result)
            except InterruptedSearch as stop:
                raise InterruptedSearch(self._final(self._ended(number, stop.result))) from stop
            if last is None or last.plan is None or first:
                break
        assert last is not None
        yield last if last.plan is None else self._final(last)

    def _stage(self, number: int) -> Call:
        """Return the problem of a rank: those before it cost no more than in the best plan."""
        problem = copy.copy(self._call.problem)
        costs = self._metric.of_rank(number)
        metric: Any = self._metric.limited(self._limits)
        if not number and is_makespan(costs):
            metric = MinimizeMakespan(problem.environment)
        problem.clear_quality_metrics()  # a list of its own: the problem keeps its metric
        problem.add_quality_metric(metric)
        left, seconds = len(self._metric.ranks) - number, self._call.timeout
        if seconds is not None and self._counted:
            seconds /= len(self._metric.ranks)
        elif seconds is not None:
            seconds = max(0.0, self._deadline.remaining()) / left
        start = self._best
        return replace(self._call, problem=problem, timeout=seconds, warm_start_plan=start)

    def _ended(self, number: int, result: Any) -> Any:
        """Return the result of a rank, with the best plan so far; its costs are limits from now."""
        if number and not self._as_good(result.plan, number):
            result.plan = self._best  # all before keeps its worth
        self._best = result.plan
        optimal = result.status is OPTIMAL
        self._proven &= optimal
        self._relative |= figures_told(result).get("bound_kind") == RELATIVE
        if result.plan is None:
            return result
        worth = self._worth(result.plan)[number]
        self._limits.append(worth)
        name = " + ".join(terms_in(self._metric.of_rank(number)))
        bound = self._bound(number, figures_told(result))
        proven = "proven" if optimal else f"proven bound {bound}"
        self._told.append(LogMessage(LogLevel.INFO, f"{name} {shown(worth)} ({proven})"))
        self._told += self._reasons(name, result)
        return result

    def _reasons(self, name: str, result: Any) -> list[LogMessage]:
        """Return what a rank's result tells that none before did, by its name: each rank may have
        ended for another reason. What went wrong is told as it is.
        """
        new = [m for m in result.log_messages or () if m.message not in self._said]
        self._said |= {m.message for m in new}
        wrong = LogLevel.ERROR
        return [m if m.level is wrong else replace(m, message=f"{name}: {m.message}") for m in new]

    def _as_good(self, plan: Any, number: int) -> bool:
        """Return whether a plan costs no more than the best one, rank by rank."""
        return plan is not None and (
            self._worth(plan)[: number + 1] <= self._worth(self._best)[: number + 1]
        )

    def _worth(self, plan: Any) -> list[Any]:
        from up_samp.validation import ranked

        return ranked(self._call.problem, plan)

    def _bound(self, number: int, metrics: dict[str, str]) -> str:
        """Return what is known that no plan costs less than, in words."""
        least = metrics.get("value_bound", "-")
        if "lower_bound" in metrics:  # in units of the makespan
            (cost,) = self._metric.of_rank(number)
            least = str(Fraction(metrics["lower_bound"]) * Fraction(cost.weight))
        return "none" if least == "-" else shown(least)

    def _final(self, result: Any) -> Any:
        """Return the last result as that of the whole: optimal only if each rank was proven."""
        if result.plan is not None:
            solved = PlanGenerationResultStatus.SOLVED_SATISFICING
            done = len(self._limits) == len(self._metric.ranks)
            result.status = OPTIMAL if self._proven and done else solved
            result.log_messages = list(self._told)
        if self._relative:  # what one rank rests on, those after it do, too
            result.metrics["bound_kind"] = RELATIVE
        return result


# ------------------ Moved objects that are parameters: solved with named ones, told as they were


def solve_settled(
    settled: Settled, call: Call, results: Results, seconds_per_unit: float
) -> Iterator[Any]:
    """Yield the results of the settled problem, with plans of the original one, judged anew.

    :raises UnsupportedError: with a plan to begin from.
    """
    if call.warm_start_plan is not None:
        raise UnsupportedError(
            "a plan to begin from, where which object moves is a parameter: leave it out, or "
            "write one activity for each object"
        )
    try:
        for result in results(replace(call, problem=settled.problem)):
            yield _brought_back(settled, result, seconds_per_unit)
    except InterruptedSearch as stop:
        best = _brought_back(settled, stop.result, seconds_per_unit)
        raise InterruptedSearch(best) from stop


def _brought_back(settled: Settled, result: Any, seconds_per_unit: float) -> Any:
    from up_samp.validation import validate_plan

    if result.plan is None:
        return result
    result.plan = settled.back(result.plan)
    verdict = validate_plan(settled.original, result.plan, seconds_per_unit=seconds_per_unit)
    if verdict.violations:
        result.plan, result.status = None, PlanGenerationResultStatus.INTERNAL_ERROR
        why = f"the plan with named objects is none of the problem: {verdict.violations[0]}"
        result.log_messages.append(LogMessage(LogLevel.ERROR, why))
    return result
