"""The one protocol of all single-robot motion planners.

A planner moves a body from rest at one pose to rest at another among resting obstacles (a *leg*);
:class:`up_samp.motion.service.MotionService` strings legs together, caches them and proves "no".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from up_samp.model import Body, Configuration, Deadline, Placed, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.trajectories import reversed_trajectory


@dataclass(frozen=True)
class LegQuery:
    """Move ``body`` from rest at ``start`` to rest at ``goal`` while the ``obstacles`` rest.

    ``effort``: work after which to give up, counted as in ``Leg.effort`` (None: the planner's own
    budget). A planner that does not count may ignore it.
    """

    body: Body
    start: Configuration
    goal: Configuration
    obstacles: tuple[Placed, ...] = ()
    effort: int | None = None

    def remembered(self, *, reversible: bool) -> LegQuery:
        """Return the query in the direction in which its leg is remembered (itself, or another):
        one leg is for both where a planner is ``reversible`` and the body may drive either way.
        """
        if reversible and self.body.kinematics.both_ways and self.goal < self.start:
            return replace(self, start=self.goal, goal=self.start)
        return self


@dataclass(frozen=True)
class Leg:
    """A planner's answer: the motion (from time 0) or None with the ``reason``. None is no proof.

    ``effort`` counts what the planner expanded or sampled. ``complete``: the search ended by itself
    and not by a deadline or by ``LegQuery.effort``, so that asking again with more time gives the
    same; only then the motion counts as the planner's fastest. ``corners`` (n, 3): the corners of
    an omnidirectional body's way, which the trajectory blends; with them it can pass from one leg
    into the next without a stop.
    """

    trajectory: Trajectory | None
    reason: str = ""
    effort: int = 0
    complete: bool = False
    corners: FloatArray | None = None

    def turned(self, start: Configuration) -> Leg:
        """Return the leg driven from its end, which is at the pose ``start``, to its start. Its
        headings begin with that of ``start``, from which they may differ by whole turns.
        """
        if self.trajectory is None:
            return self
        back = reversed_trajectory(self.trajectory)
        shift = np.zeros_like(back.poses[0])
        # none in space, where the third number is a height
        shift[2] = 2 * math.pi * round((start[2] - float(back.poses[0, 2])) / (2 * math.pi))
        poses = back.poses + shift
        poses[0, :3] = start[:3]
        corners = None if self.corners is None else self.corners[::-1] + shift
        return replace(self, trajectory=Trajectory(back.times, poses), corners=corners)


class MotionPlanner(Protocol):
    """Plans legs. ``reversible``: driven backwards in time a leg is a leg, too, of a body that may
    drive backwards.
    """

    name: str
    reversible: bool

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a motion from rest to rest, exactly from the start to the goal."""
