"""The one protocol of all single-robot motion planners.

A planner moves a body from rest at one pose to rest at another among resting obstacles (a *leg*);
:class:`up_samp.motion.service.MotionService` strings legs together, caches them and proves "no".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from up_samp.model import Body, Configuration, Deadline, Placed, Trajectory


@dataclass(frozen=True)
class LegQuery:
    """Move ``body`` from rest at ``start`` to rest at ``goal`` while the ``obstacles`` rest."""

    body: Body
    start: Configuration
    goal: Configuration
    obstacles: tuple[Placed, ...] = ()


@dataclass(frozen=True)
class Leg:
    """A planner's answer: the motion (from time 0) or None with the ``reason``. None is no proof.

    ``effort`` counts what the planner expanded or sampled.
    """

    trajectory: Trajectory | None
    reason: str = ""
    effort: int = 0


class MotionPlanner(Protocol):
    """Plans legs. ``reversible``: driven backwards in time a leg is a leg, too."""

    name: str
    reversible: bool

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a motion from rest to rest, exactly from the start to the goal."""
