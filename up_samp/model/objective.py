"""What a metric from outside the package means, to the scheduler and to the validator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Objective:
    """A class of UP metrics, said twice, as scheduler and validator share nothing.

    ``scheduled``: (metric, terms of the CP-SAT model) -> the linear expression to minimise.
    ``judged``: (metric, timeline of a schedule) -> the metric's value.
    """

    metric: type
    scheduled: Callable[[Any, Any], Any]
    judged: Callable[[Any, Any], Any]
