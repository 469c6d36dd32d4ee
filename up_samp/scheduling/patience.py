"""How long engines in processes of their own are waited for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Patience:
    """Times (s) that the system and known engines set, not ours to tune."""

    grace: float = 0.5
    """Seconds that an engine gets beyond its deadline to hand over what it has."""
    one_wait: float = 1e6
    """Longest time (s) of one wait: the system counts milliseconds, in 32 bits."""
    engine_limit: float = 2.0e6
    """Longest time limit (s) for an engine: aries counts milliseconds in 32 bits."""


PATIENCE = Patience()
