"""One thing that a problem asks of the order of activities."""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.scheduling.partial_order.differences import (
    Difference,
)


@dataclass(frozen=True)
class OrderConstraint:
    """A difference with its reason: ``kind`` is a stable word, ``why`` is for people. ``instead``
    would do what is asked as well.
    """

    difference: Difference
    kind: str
    why: str
    instead: Difference | None = None
