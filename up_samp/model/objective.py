"""Metrics beside those of UP: weighted sums of costs, and what metrics from outside mean to the
scheduler and to the validator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.metrics import MinimizeExpressionOnFinalState
from unified_planning.shortcuts import Int

from up_samp.model.errors import ProblemError


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
    which are sums of their own, only the largest in the term counts. Costs of a lower ``rank`` come
    first: those of a higher one decide only among plans that cost the same in all before.
    """

    term: str
    weight: int | Fraction
    node: FNode
    activity: str | None = None
    positive: bool = False
    share: str = ""
    rank: int = 0

    def __post_init__(self) -> None:
        check_weight(self.weight, f"a cost of '{self.term}'")
        if (self.positive or self.share) and self.weight < 0:
            how = "counts above 0" if self.positive else "is a share"
            raise ValueError(f"a cost of '{self.term}' that {how} has a weight below 0")


def check_weight(weight: object, whose: str) -> None:
    """Refuse what no sum can be told by, UP's expressions among it.

    :raises ProblemError: that says whose weight it is.
    """
    if not isinstance(weight, Real) or weight - weight != 0:  # nor what is infinite
        raise ProblemError(
            f"{whose} has the weight '{weight}': it has to be a number; an expression can be part "
            "of what is counted"
        )


class MinimizeCosts(MinimizeExpressionOnFinalState):  # type: ignore[misc]
    """A metric: the sum of ``costs`` is minimised. Costs may read times, and may be an activity's.

    Of costs of several ranks (0, 1, ...) those of the first are minimised, then the next ones.
    With ``limits`` that is under way: the costs of each rank before are at most so much, and those
    of the next rank are minimised.

    UP, which knows no such metric, takes it for an expression on the final state: an engine that
    knows of these only is none for it, as ``supports`` says.
    """

    def __init__(
        self, costs: Iterable[Cost], environment: Any = None, limits: Iterable[int | Fraction] = ()
    ) -> None:
        super().__init__(Int(0), environment=environment)
        self.costs = tuple(costs)
        self.limits = tuple(limits)

    @property
    def ranks(self) -> list[int]:
        """The ranks of its costs, the first ones first."""
        return sorted({cost.rank for cost in self.costs})

    @property
    def in_order(self) -> bool:
        """Whether there is something to be minimised after something else."""
        return len(self.ranks) - len(self.limits) > 1

    def of_rank(self, number: int) -> tuple[Cost, ...]:
        """Return the costs of the ``number``-th rank from 0 on; of none, where there is none."""
        ranks = self.ranks[number : number + 1]
        return tuple(cost for cost in self.costs if cost.rank in ranks)

    def limited(self, limits: Iterable[int | Fraction]) -> MinimizeCosts:
        """Return what is minimised next, where the first ranks cost at most ``limits``."""
        limits = tuple(limits)
        told = [cost for n in range(len(limits) + 1) for cost in self.of_rank(n)]
        return MinimizeCosts(told, self.environment, limits)

    def __repr__(self) -> str:
        ranks = [" + ".join(terms_in(self.of_rank(n))) for n, _ in enumerate(self.ranks)]
        return f"minimize {', then '.join(ranks) or '0'}"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MinimizeCosts) and (self.costs, self.limits) == (
            other.costs,
            other.limits,
        )

    def __hash__(self) -> int:
        return hash((self.costs, self.limits))


def terms_in(costs: Iterable[Cost]) -> list[str]:
    """Return the terms of costs, each once."""
    return list(dict.fromkeys(cost.term for cost in costs))
