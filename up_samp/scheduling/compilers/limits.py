"""How large a problem may become when it is told in other words."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CompilerLimits:
    """What needs more is said in another way, or refused by name."""

    values: int = 100
    """Largest domain whose values become objects."""
    forbidden_sets: int = 5000
    """Most sets of activities that are forbidden one by one, per resource."""
    factor: int = 100
    """Largest constant in a product that becomes a sum."""
    span: int = 10**6
    """Upper bound for the length of a span whose owner's is not a constant."""


LIMITS = CompilerLimits()
