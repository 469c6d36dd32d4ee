"""What is minimised or maximised, told once: a metric as a weighted sum of parts.

Everything that asks for an objective reads it here: the encoding (``scheduling/cpsat/encode/
objective.py``) makes each part a linear expression, bounds and incumbents are costs of it, messages
say its name. A new metric is a row of ``METRICS``. (The validator has rules of its own, and says
what a plan is worth.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

from unified_planning.model import FNode, TimeInterval, metrics
from unified_planning.model.timing import GlobalEndTiming

from up_samp.extensions import parts as from_outside
from up_samp.model import UnsupportedError
from up_samp.model.objective import Cost, MinimizeCosts, check_weight
from up_samp.upio.expressions import QuantifierRemover

Number = int | Fraction


@dataclass(frozen=True)
class ObjectivePart:
    """``weight`` times what ``node`` is worth: a number in the end, or 1 if it holds then.

    With an ``interval`` it is 1 if it holds throughout; with an ``activity`` (a name) it counts if
    that is present, and may read its parameters and times. ``positive``: it counts as far as it is
    above 0. ``share`` (a term, a name): of the sums by name, only a term's largest counts, or 0.
    """

    weight: Number
    node: FNode
    interval: TimeInterval | None = None
    activity: str | None = None
    positive: bool = False
    share: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        check_weight(self.weight, f"'{self.node}'")


class Objective(metrics.PlanQualityMetric):  # type: ignore[misc]
    """A sum of parts to be minimised (``sign`` 1) or maximised (-1). A UP metric itself, so that a
    relaxation can carry it. Costs are ``sign`` times values: the less, the better. ``limits``:
    other sums, and what each of them costs at most.
    """

    def __init__(
        self,
        name: str,
        sign: int,
        parts: Iterable[ObjectivePart],
        environment: Any,
        limits: Iterable[tuple[Objective, Number]] = (),
    ) -> None:
        super().__init__(environment)
        self.name = name
        self.sign = sign
        self.parts = tuple(parts)
        self.limits = tuple(limits)

    def __repr__(self) -> str:
        return f"{'maximize' if self.sign < 0 else 'minimize'} {self.name}"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Objective) and (
            self.name,
            self.sign,
            self.parts,
            self.limits,
        ) == (other.name, other.sign, other.parts, other.limits)

    def __hash__(self) -> int:
        return hash((self.name, self.sign))

    @property
    def all_parts(self) -> tuple[ObjectivePart, ...]:
        """Its parts, and those of what is limited."""
        return (*self.parts, *(part for other, _ in self.limits for part in other.parts))

    def rewritten(self, rewrite: Callable[[FNode], FNode]) -> Objective:
        """Return it with each expression rewritten."""
        parts = (replace(p, node=rewrite(p.node)) for p in self.parts)
        limits = ((other.rewritten(rewrite), most) for other, most in self.limits)
        return Objective(self.name, self.sign, parts, self.environment, limits)

    def decided(self, fix: Callable[..., FNode], present: Container[str]) -> Objective:
        """Return it where presence is decided: without what absent activities cost. ``fix`` tells
        what is left of a condition; what an absent activity leaves open is no goal reached.
        """
        parts = []
        for part in self.parts:
            ends = () if part.interval is None else (part.interval.lower, part.interval.upper)
            named = [part.activity, *(getattr(t, "timepoint", t).container for t in ends)]
            if any(name is not None and name not in present for name in named):
                continue
            holds = part.node.type.is_bool_type()
            node = fix(part.node, positive=False) if holds else part.node
            parts.append(replace(part, node=node))
        limits = ((other.decided(fix, present), most) for other, most in self.limits)
        return Objective(self.name, self.sign, parts, self.environment, limits)


# ------------------ One row for each metric of UP


def _makespan(metric: Any, problem: Any) -> Iterator[ObjectivePart]:
    yield ObjectivePart(1, problem.environment.expression_manager.TimingExp(GlobalEndTiming()))


def _final(metric: Any, problem: Any) -> Iterator[ObjectivePart]:
    yield ObjectivePart(1, metric.expression)


def _goals(metric: Any, problem: Any) -> Iterator[ObjectivePart]:
    for goal, gain in metric.goals.items():
        interval, node = goal if isinstance(goal, tuple) else (None, goal)
        yield ObjectivePart(gain, node, interval)


def _costs(metric: Any, problem: Any) -> Iterator[ObjectivePart]:
    if metric.default is None:  # UP takes no activities for actions with costs of their own
        raise UnsupportedError(f"the metric '{metric}' says not what an activity costs: by default")
    for activity in problem.activities:
        yield ObjectivePart(1, metric.default, activity=activity.name)


def _sum(metric: Any, problem: Any) -> Iterator[ObjectivePart]:
    yield from _parts(metric.of_rank(len(metric.limits)))


def _parts(costs: Iterable[Cost]) -> Iterator[ObjectivePart]:
    for cost in costs:
        share = (cost.term, cost.share) if cost.share else None
        yield ObjectivePart(cost.weight, cost.node, None, cost.activity, cost.positive, share)


MAKESPAN = "makespan"
METRICS: Mapping[type, tuple[str, int, Callable[[Any, Any], Iterable[ObjectivePart]]]] = {
    metrics.MinimizeMakespan: (MAKESPAN, 1, _makespan),
    metrics.MinimizeExpressionOnFinalState: ("final value", 1, _final),
    metrics.MaximizeExpressionOnFinalState: ("final value", -1, _final),
    metrics.Oversubscription: ("gain", -1, _goals),
    metrics.TemporalOversubscription: ("gain", -1, _goals),
    metrics.MinimizeActionCosts: ("cost", 1, _costs),
    MinimizeCosts: ("cost", 1, _sum),
}
"""By class: what it is called, 1 to minimise or -1 to maximise, and how its parts are told."""


def objective_of(problem: Any) -> Objective | None:
    """Return what a problem asks for (None: just some plan), without quantifiers.

    :raises UnsupportedError: for a metric without a row, several of them, or what is said of all
        numbers.
    """
    told = list(problem.quality_metrics)
    if not told:
        return None
    if len(told) > 1:
        raise UnsupportedError("one quality metric at a time, not several: add them up in one")
    metric = told[0]
    if isinstance(metric, MinimizeCosts) and metric.in_order:
        raise UnsupportedError(f"'{metric}' in this order: samp-refine[cpsat] does one by one")
    others = {o.metric: (o.name, o.sign, o.parts) for o in from_outside("objectives").values()}
    row = {**METRICS, **others}.get(type(metric))
    if row is not None:
        name, sign, parts = row
        env, limits = problem.environment, _limits(metric, name, problem.environment)
        metric = Objective(name, sign, parts(metric, problem), env, limits)
    elif not isinstance(metric, Objective):
        raise UnsupportedError(f"the metric '{metric}' has no meaning for schedules")
    return metric.rewritten(QuantifierRemover(problem))


def _limits(metric: Any, name: str, env: Any) -> Iterator[tuple[Objective, Number]]:
    """Yield what a metric limits beside what it minimises."""
    if isinstance(metric, MinimizeCosts):
        for number, most in enumerate(metric.limits):
            yield Objective(name, 1, _parts(metric.of_rank(number)), env), most


def check_copied(problem: Any) -> None:
    """Refuse a problem that UP cannot copy.

    :raises UnsupportedError: by its metric's name.
    """
    for metric in problem.quality_metrics:
        if isinstance(metric, metrics.MinimizeActionCosts):
            raise UnsupportedError(
                f"UP cannot copy a schedule's problem with the metric '{metric}', which is needed "
                "for replanning, and where a parameter says what moves: say it as gains of "
                "Not(activity.present)"
            )


def is_makespan(costs: Iterable[Cost]) -> bool:
    """Return whether costs are the makespan, times a weight above 0."""
    told = [*costs]
    node = told[0].node if len(told) == 1 else None
    if node is None or not node.is_timing_exp() or node.timing() != GlobalEndTiming():
        return False
    return told[0].weight > 0 and told[0].activity is None


def only_makespan(problem: Any) -> bool:
    """Return whether nothing but the makespan is to be made smaller."""
    return all(m.is_minimize_makespan() for m in problem.quality_metrics)


def plain_number(number: Any) -> Number:
    """Return a number exactly, whole ones as such."""
    exact = Fraction(number)
    return int(exact) if exact.denominator == 1 else exact


def shown(number: Any) -> str:
    """Return a number as people write it: a whole one exactly, others to ten digits."""
    exact = plain_number(number)
    return str(exact) if isinstance(exact, int) else f"{float(exact):.10g}"


# ------------------ What plans cost, by a problem's objective


@dataclass(frozen=True)
class Measure:
    """How plans are compared: by ``cost`` of a schedule, the less the better. ``least``: what no
    plan costs less than, whatever the problem. ``name`` and ``sign`` tell it to people.
    """

    cost: Callable[[Any], Number]
    name: str = MAKESPAN
    sign: int = 1
    least: float = 0

    def told(self, cost: float | Fraction) -> str:
        """Return a cost as the value that a user knows."""
        return "-" if math.isinf(cost) else f"{plain_number(self.sign * cost)}"

    def metrics(self, bound: float | Fraction | None, cost: Number | None) -> dict[str, str]:
        """Return what a result tells of an objective that is not the makespan: its name, and a
        bound and a plan's value, if there are any.
        """
        known = {"value_bound": bound, "value": cost}
        told = {key: self.told(v) for key, v in known.items() if v is not None}
        return {"objective": self.name, **told}


def measure_of(problem: Any, worth: Callable[[Any], Number]) -> Measure:
    """Return how schedules of a problem are compared: by their makespan, or by what they are
    ``worth`` (the metric's value).
    """
    if only_makespan(problem):
        return Measure(lambda schedule: schedule.makespan)
    objective = objective_of(problem)
    assert objective is not None
    sign = objective.sign
    return Measure(lambda schedule: sign * worth(schedule), objective.name, sign, -math.inf)
