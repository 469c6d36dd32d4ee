"""The objective of a schedule."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unified_planning.model import metrics as up

from up_samp.model import UnsupportedError
from up_samp.scheduling.cpsat.encode.forms import TRUE, Lin, constant
from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.terms import Terms, indicator, times


def objective_of(problem: Any, states: States, exact: Callable[[], None]) -> Lin | None:
    """Return what to minimise (``None``: the makespan or nothing).

    :param exact: makes the makespan variable exact, where something else is minimised.
    """
    metrics = list(problem.quality_metrics)
    if not metrics:
        return None
    if len(metrics) > 1:
        raise UnsupportedError("cpsat takes one quality metric, not several")
    metric = metrics[0]
    if isinstance(metric, up.MinimizeMakespan):
        return None
    terms = Terms(states.world, states.reader(None, TRUE, states.far, states.far))
    if isinstance(metric, up.MinimizeExpressionOnFinalState):
        return terms.linear(metric.expression)
    if isinstance(metric, up.MaximizeExpressionOnFinalState):
        return times(terms.linear(metric.expression), -1)
    if isinstance(metric, up.Oversubscription):
        return _oversubscription(metric, terms)
    raise UnsupportedError(f"cpsat does not support the metric '{metric}'")


def _oversubscription(metric: up.Oversubscription, terms: Terms) -> Lin:
    total = constant(0)
    for goal, gain in metric.goals.items():
        literal = terms.world.store.equivalent(terms.form(goal), terms.form(goal, False))
        if not isinstance(gain, int):
            raise UnsupportedError(f"cpsat takes integer gains only, not {gain}")
        total = total.plus(indicator(literal), -gain)
    return total
