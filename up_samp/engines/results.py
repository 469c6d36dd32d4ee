"""What ``samp-refine`` tells of a search in UP's words: statuses, metrics, messages."""

from __future__ import annotations

import traceback
from dataclasses import replace
from typing import IO, TYPE_CHECKING

from unified_planning.engines import (
    LogLevel,
    LogMessage,
    PlanGenerationResult,
    PlanGenerationResultStatus,
)
from unified_planning.plans import Plan

from up_samp.model import Deadline, ScheduleStatus
from up_samp.model.errors import in_words, short
from up_samp.model.refinement import ABSOLUTE, RELATIVE, Layer
from up_samp.search.params import Parameters
from up_samp.upio.objective import MAKESPAN

if TYPE_CHECKING:
    from up_samp.search.conclusion import Conclusion
    from up_samp.search.knowledge import History, ProgressEvent
    from up_samp.search.search import Search


STATUSES = {
    ScheduleStatus.OPTIMAL: PlanGenerationResultStatus.SOLVED_OPTIMALLY,
    ScheduleStatus.FOUND: PlanGenerationResultStatus.SOLVED_SATISFICING,
    ScheduleStatus.INFEASIBLE: PlanGenerationResultStatus.UNSOLVABLE_PROVEN,
    ScheduleStatus.NOT_FOUND: PlanGenerationResultStatus.UNSOLVABLE_INCOMPLETELY,
    ScheduleStatus.OUT_OF_TIME: PlanGenerationResultStatus.TIMEOUT,
    ScheduleStatus.ERROR: PlanGenerationResultStatus.INTERNAL_ERROR,
}

_STATUSES = {
    "OPTIMAL": PlanGenerationResultStatus.SOLVED_OPTIMALLY,
    "SOLVED": PlanGenerationResultStatus.SOLVED_SATISFICING,
    "UNSOLVABLE": PlanGenerationResultStatus.UNSOLVABLE_PROVEN,
    "EXHAUSTED": PlanGenerationResultStatus.UNSOLVABLE_INCOMPLETELY,
    "OUT_OF_TIME": PlanGenerationResultStatus.TIMEOUT,
    "STOPPED": PlanGenerationResultStatus.TIMEOUT,
    "FAILED": PlanGenerationResultStatus.INTERNAL_ERROR,
}
"""UP's status for each :class:`up_samp.search.conclusion.Conclusion`, by its name."""


class SampResult(PlanGenerationResult):  # type: ignore[misc]
    """A UP result that carries the search's history (rounds, refinements, times, bounds)."""

    history: History


def status_of(conclusion: Conclusion) -> PlanGenerationResultStatus:
    """Return UP's status for how a search ended."""
    return _STATUSES[conclusion.name]


def result_of(
    name: str,
    params: Parameters,
    search: Search,
    status: PlanGenerationResultStatus,
    plan: Plan | None,
    why: str,
) -> SampResult:
    """Return the result of the engine ``name``: a plan or none, and ``why`` (or "")."""
    failed = status is PlanGenerationResultStatus.INTERNAL_ERROR
    messages = [LogMessage(LogLevel.ERROR if failed else LogLevel.INFO, why)] if why else []
    metrics = metrics_of(params, search)
    for key, told in (
        ("handed_over", f"{name} was handed over "),
        ("may_be_shorter", "motions may be shorter than the planner's by "),
    ):
        if key in metrics:
            messages.append(LogMessage(LogLevel.INFO, told + metrics[key]))
    messages += [LogMessage(LogLevel.ERROR, told) for told in search.history.refuted]
    messages = [replace(told, message=in_words(told.message)) for told in messages]
    result = SampResult(status, plan, name, metrics, messages)
    result.history = search.history
    return result


def too_late(name: str, params: Parameters, deadline: Deadline) -> SampResult:
    """Say that the time was over before the problem was even read."""
    from up_samp.search.knowledge import History

    why = "the time was over before the search began: the problem or its map is large"
    metrics = {
        "preset": params.preset,
        "lower_bound": "0",
        "bound_kind": ABSOLUTE,
        "seconds_total": f"{deadline.elapsed():.3f}",
        "seconds_per_unit": repr(params.seconds_per_unit),
    }
    messages = [LogMessage(LogLevel.INFO, why)]
    result = SampResult(PlanGenerationResultStatus.TIMEOUT, None, name, metrics, messages)
    result.history = History()
    return result


def metrics_of(params: Parameters, search: Search) -> dict[str, str]:
    """Return the figures of a search, by name."""
    history, bounds = search.history, search.bounds
    bound = {"lower_bound": str(bounds.lower)}
    if bounds.measure.name != MAKESPAN:
        bound = bounds.measure.metrics(bounds.lower, bounds.upper)
    metrics = {
        "preset": params.preset,
        **bound,
        "bound_kind": RELATIVE if bounds.relative else ABSOLUTE,
        "rounds": str(len(history.rounds)),
        "restarts": str(history.restarts),
        "refinements_bound": str(history.count(Layer.BOUND)),
        "refinements_geometric": str(history.count(Layer.GEOMETRIC)),
        "refinements_temporal": str(history.count(Layer.TEMPORAL)),
        "refinements_group": str(history.count(Layer.GROUP)),
        "seconds_scheduler": f"{history.seconds_scheduler:.3f}",
        "seconds_motion": f"{history.seconds_motion:.3f}",
        "seconds_total": f"{search.budget.deadline.elapsed():.3f}",
        "seconds_per_unit": repr(params.seconds_per_unit),
        **history.stages.metrics(),
    }
    if bounds.relative and bounds.absolute > bounds.measure.least:
        metrics["absolute_bound"] = bounds.measure.told(bounds.absolute)
    if history.without_traffic is not None:
        # in any plan robots heed each other at places
        plans = [] if bounds.incumbent is None else [bounds.incumbent.schedule.makespan]
        metrics["without_traffic"] = str(min([history.without_traffic, *plans]))
    if history.recognised or history.left_over:
        metrics["recognised"] = "; ".join(history.recognised)
        metrics["left_over"] = "; ".join(history.left_over)
    told = {
        "may_be_shorter": _most_shorter(history),
        "handed_over": "; ".join(history.handed_over),
        "refuted": "; ".join(history.refuted),
        "refused": str(len(history.refused) or ""),
    }
    metrics |= {name: text for name, text in told.items() if text}
    if bounds.incumbent is not None:
        makespan = bounds.incumbent.schedule.makespan
        metrics["makespan"] = str(makespan)
        if bounds.measure.name == MAKESPAN:
            metrics["gap"] = f"{1 - bounds.lower / makespan if makespan else 0:.4f}"
    return metrics


def _most_shorter(history: History) -> str:
    """Return by how much the three motions in doubt most may be shorter, in words."""
    most = list(history.may_be_shorter.items())[:3]
    return "; ".join(f"{100 * share:.1f} % {name}" for name, share in most)


def with_progress(params: Parameters, stream: IO[str]) -> Parameters:
    """Return parameters that write each step to ``stream``."""

    def write(event: ProgressEvent) -> None:
        bounds = f"[{event.lower_bound}, {event.upper_bound}]"
        stream.write(
            f"{event.elapsed:8.2f} s  round {event.round}  {bounds}  {event.phase}: "
            f"{event.message}\n"
        )

    return replace(params, progress=write)


def was_asked_for(error: BaseException) -> bool:
    """Return whether an observer raised it: that is how one ends a search."""
    from up_samp.search import events

    frames = traceback.walk_tb(error.__traceback__)
    return any(frame.f_globals is vars(events) for frame, _ in frames)


def broke_down(error: BaseException) -> str:
    """Return what was raised and where, for a message."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    said = short(str(error), 500) or "no further word"
    return f"{type(error).__name__}: {said} ({place.filename}, line {place.lineno})"
