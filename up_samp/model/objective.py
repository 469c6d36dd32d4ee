"""What a metric means that UP has no class for, to the scheduler and to the validator."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.metrics import MinimizeExpressionOnFinalState
from unified_planning.shortcuts import Int


@dataclass(frozen=True)
class MetricMeaning:
    """A class of UP metrics, said twice, as what plans and what judges share nothing.

    ``parts``: (metric, problem) -> the :class:`up_samp.upio.objective.ObjectivePart` whose weighted
    sum is minimised (``sign`` 1) or maximised (-1). ``judged``: (metric, timeline of a schedule) ->
    the metric's value. ``name`` is for people.
    """

    metric: type
    name: str
    sign: int
    parts: Callable[[Any, Any], Iterable[Any]]
    judged: Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Cost:
    """``weight`` times what ``node`` is worth in the end: a number, or 1 if it holds. With an
    ``activity`` (a name) it counts if that is present; ``positive``: as far as it is above 0. Costs
    of one ``term`` (tardiness, driving) are told as one sum. Of those with a ``share`` (who works),
    which are sums of their own, only the largest in the term counts.
    """

    term: str
    weight: int | Fraction
    node: FNode
    activity: str | None = None
    positive: bool = False
    share: str = ""

    def __post_init__(self) -> None:
        if (self.positive or self.share) and self.weight < 0:
            how = "counts above 0" if self.positive else "is a share"
            raise ValueError(f"a cost of '{self.term}' that {how} has a weight below 0")


class MinimizeCosts(MinimizeExpressionOnFinalState):  # type: ignore[misc]
    """A metric: the sum of ``costs`` is minimised. Costs may read times, and may be an activity's.

    UP, which knows no such metric, takes it for an expression on the final state: an engine that
    knows of these only is none for it, as ``supports`` says.
    """

    def __init__(self, costs: Iterable[Cost], environment: Any = None) -> None:
        super().__init__(Int(0), environment=environment)
        self.costs = tuple(costs)

    def __repr__(self) -> str:
        terms = dict.fromkeys(cost.term for cost in self.costs)
        return f"minimize {' + '.join(terms) or '0'}"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MinimizeCosts) and self.costs == other.costs

    def __hash__(self) -> int:
        return hash(self.costs)
