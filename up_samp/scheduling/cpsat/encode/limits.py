"""How large the numbers and parts of the CP-SAT model may be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelLimits:
    """Bounds of what has none, and sizes from which parts are stated in another way."""

    magnitude: int = 10**9
    """Largest magnitude of an integer variable that the problem does not bound."""
    longest: int = 2**50
    """Largest number that a problem may name; sums of many have to fit into 63 bits."""
    latest: int = 2**58
    """Latest time of a schedule; a few such numbers are summed."""
    never: int = 10**9
    """Gap between activities that are never both there."""
    placeholder: int = 10**7
    """Latest time of variables until the horizon is known."""
    circuit_arcs: int = 60_000
    """Arcs of a circuit of one state variable's changes; beyond that only pairs are ordered."""
    domain: int = 2000
    """Values of an integer fluent, if they are to be listed one by one."""


LIMITS = ModelLimits()
