"""How large the numbers of a problem may be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProblemLimits:
    """What is beyond them is refused by name: results would be wrong, or never come."""

    farthest: float = 1e7
    """Largest coordinate, of a configuration or a map's frame, m: further out, floating-point
    numbers do not tell 1 cm from 0."""
    turned: float = 1e4
    """Largest heading, rad."""
    movers: int = 200
    """Most choices of objects that one activity may move."""
    footprint: float = 1e5
    """Largest coordinate of a footprint, m."""


LIMITS = ProblemLimits()
