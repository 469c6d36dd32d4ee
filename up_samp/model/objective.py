"""What a metric from outside the package means, to the scheduler and to the validator."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any


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
