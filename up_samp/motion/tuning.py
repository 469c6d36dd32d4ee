"""The tunables of motion planning: how long is tried."""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, tunable


@dataclass(frozen=True)
class FleetTuning(Tunables):
    """Several robots together (``motion/fleet/coordination.py``, ``motion/fleet/deadlocks.py``)."""

    first: int = tunable(
        20, "motions", "planned for each one of a group, with who is in the way ejected", least=0
    )
    again: int = tunable(
        30,
        "motions",
        "planned again for each one where somebody is late, or all much later than alone",
        least=0,
    )
    enough: float = tunable(
        1.15, "factor", "of the arrivals alone with which a group on time is content", least=1
    )
    knots: tuple[int, ...] = tunable(
        (40_000, 150_000),
        "moves",
        "looked at in one search for joint moves, on all roadmaps in turn",
        least=1,
    )


@dataclass(frozen=True)
class MotionTuning(Tunables):
    """All of motion planning."""

    fleet: FleetTuning = field(default_factory=FleetTuning)
