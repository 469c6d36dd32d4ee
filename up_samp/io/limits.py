"""How large the numbers and names of a plan file may be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlanFileLimits:
    """What is beyond them is refused: it cannot be meant."""

    largest: float = 1e7
    """Largest time (s or schedule units) and coordinate (m) in a plan file: more is a slip of the
    pen, and nothing could be drawn or checked in bounded time.
    """
    name: int = 1000
    """Characters of a name."""
    turned: float = 1e4
    """Largest heading, rad, that a motion may come to by turning."""


LIMITS = PlanFileLimits()
