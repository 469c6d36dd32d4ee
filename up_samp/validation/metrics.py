"""Values of UP's quality metrics for a schedule."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from unified_planning.model import metrics

from up_samp.extensions import parts
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.objective import Cost, MinimizeCosts
from up_samp.validation.schedule import holds_throughout, read_decisions
from up_samp.validation.timeline import (
    Reader,
    Reading,
    StateTimeline,
    Value,
    build_timeline,
    plain,
    reader_at,
)


def evaluate_metric(metric: Any, timeline: StateTimeline) -> Value:
    """Return the value of ``metric``: the makespan is the latest end of a present activity; values
    of fluents and goals are those after all effects.
    """
    for objective in parts("objectives").values():
        if type(metric) is objective.metric:
            return objective.judged(metric, timeline)
    for kind, value in _VALUES.items():
        if isinstance(metric, kind):
            return value(metric, timeline)
    raise UnsupportedError(f"the metric '{metric}' has no meaning for schedules")


def _final(timeline: StateTimeline, owner: str | None = None) -> Reader:
    """Return what reads expressions after all effects."""
    return reader_at(timeline, timeline.horizon + 1, Reading.LATER, owner)


def _of_costs(metric: MinimizeCosts, timeline: StateTimeline) -> Value:
    """Return what is minimised of costs: infinite, where one of those that are limited costs more
    than it may.
    """
    told = [_sum(costs, timeline) for costs in map(metric.of_rank, range(len(metric.limits) + 1))]
    over = any(value > most for value, most in zip(told, metric.limits, strict=False))
    return math.inf if over else told[-1]


def _sum(costs: Iterable[Cost], timeline: StateTimeline) -> Value:
    return plain(sum(value for _, value in _terms(costs, timeline)))


def _terms(costs: Iterable[Cost], timeline: StateTimeline) -> Iterator[tuple[str, Value]]:
    """Yield each cost that counts, by its term: weighted values after all effects, and the largest
    of those sums that are shares.
    """
    shares: dict[str, dict[str, Value]] = {}
    for cost in costs:
        if cost.activity is None or cost.activity in timeline.decisions.times:
            value = _final(timeline, cost.activity).value(cost.node)
            if cost.node.type.is_bool_type():  # what an absent activity leaves open does not hold
                value = int(value is True)
            worth = cost.weight * (max(0, value) if cost.positive else value)
            if cost.share:
                sums = shares.setdefault(cost.term, {})
                sums[cost.share] = sums.get(cost.share, 0) + worth
            else:
                yield cost.term, plain(worth)
    yield from ((term, plain(max(0, *sums.values()))) for term, sums in shares.items())


def _costs(metric: Any, timeline: StateTimeline) -> Iterator[Value]:
    """Yield what each present activity costs, by fluents as they were at first."""
    if metric.default is None:
        raise UnsupportedError(f"the metric '{metric}' says not what an activity costs: by default")
    for name in timeline.decisions.times:
        yield Reader(timeline.decisions, timeline.initial, name).value(metric.default)


def _goals(metric: Any, timeline: StateTimeline) -> Value:
    """Return what the goals that are reached in the end are worth."""
    final = _final(timeline)
    return plain(sum(gain for goal, gain in metric.goals.items() if final.value(goal) is True))


def _timed_goals(metric: Any, timeline: StateTimeline) -> Value:
    """Return what the goals are worth that hold all through their times."""
    reached = (
        gain
        for (interval, goal), gain in metric.goals.items()
        if holds_throughout(interval, goal, timeline, Reading.LATER)
    )
    return plain(sum(reached))


def _at_end(metric: Any, timeline: StateTimeline) -> Value:
    return _final(timeline).value(metric.expression)


_VALUES: Mapping[Any, Callable[[Any, StateTimeline], Value]] = {
    metrics.MinimizeMakespan: lambda _, timeline: timeline.decisions.makespan,
    MinimizeCosts: _of_costs,
    metrics.MinimizeExpressionOnFinalState: _at_end,
    metrics.MaximizeExpressionOnFinalState: _at_end,
    metrics.Oversubscription: _goals,
    metrics.TemporalOversubscription: _timed_goals,
    metrics.MinimizeActionCosts: lambda metric, timeline: plain(sum(_costs(metric, timeline))),
}
"""Values by the kind of metric."""


def terms_of(problem: Any, plan: Any) -> dict[str, Value]:
    """Return what a schedule costs by term, where the problem's metric is a sum of costs."""
    metric = problem.quality_metrics[0]
    found = dict.fromkeys((cost.term for cost in metric.costs), 0)
    timeline = _timeline_of(problem, plan)
    # shares of a term are compared within a rank: one sum at a time
    for costs in map(metric.of_rank, range(len(metric.ranks))):
        for term, value in _terms(costs, timeline):
            found[term] = plain(found[term] + value)
    return found


def ranked(problem: Any, plan: Any) -> list[Value]:
    """Return what a schedule costs by rank, where the problem's metric is a sum of costs."""
    metric, timeline = problem.quality_metrics[0], _timeline_of(problem, plan)
    return [_sum(metric.of_rank(number), timeline) for number, _ in enumerate(metric.ranks)]


def value_of(problem: Any, plan: Any) -> Value:
    """Return the value of the problem's (only) metric for a schedule."""
    return evaluate_metric(problem.quality_metrics[0], _timeline_of(problem, plan))


def _timeline_of(problem: Any, plan: Any) -> StateTimeline:
    decisions, wrong = read_decisions(problem, plan)
    if decisions is None:
        raise ProblemError(f"this is no schedule of the problem: {wrong[0]}")
    return build_timeline(problem, decisions)
