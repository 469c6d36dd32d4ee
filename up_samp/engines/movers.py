"""Problems whose moved objects are parameters: solved with named ones, and told as they were."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from unified_planning.engines import LogLevel, LogMessage, PlanGenerationResultStatus

from up_samp.engines.direct import Call
from up_samp.model import UnsupportedError
from up_samp.model.errors import InterruptedSearch
from up_samp.upio.movers import Settled

Results = Callable[[Call], Iterator[Any]]


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
