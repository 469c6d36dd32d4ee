"""What motion planners are asked and answer, the one protocol of all of them, their counted work,
and the memory of planned legs.

A planner moves a body from rest at one pose to rest at another among resting obstacles (a *leg*);
:class:`up_samp.motion.service.MotionService` strings legs together, caches them and proves "no".
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from up_samp.geometry.memory import Memory
from up_samp.model import Body, Configuration, Deadline, Placed, ProblemError, Trajectory
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
    same; only then the motion counts as the planner's fastest, and only where its way was not
    ``drawn`` at random: another draw may be faster. ``corners`` (n, 3): the corners of an
    omnidirectional body's way, which the trajectory blends; with them it can pass from one leg into
    the next without a stop.
    """

    trajectory: Trajectory | None
    reason: str = ""
    effort: int = 0
    complete: bool = False
    corners: FloatArray | None = None
    drawn: bool = False

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


# ------------------ How much a search may work: counted, so that it ends the same on every machine


@dataclass
class WorkBudget:
    """Counted work, and a deadline that only aborts.

    ``effort``: the work after which to give up (None: no such limit). ``used``: the work done.
    ``cut``: whether one of both has ended a search that was not finished.
    """

    deadline: Deadline
    effort: int | None = None
    used: int = 0
    cut: bool = False

    def spent(self) -> bool:
        """Return whether to stop; call it only where there is still something to do."""
        over = self.effort is not None and self.used >= self.effort
        self.cut = self.cut or over or self.deadline.expired()
        return self.cut


# ------------------ A memory of planned legs, of one search or of several


ObstacleKey = frozenset[tuple[object, ...]]
PairKey = tuple[object, ...]


def body_key(body: Body) -> tuple[object, ...]:
    """Return what motions depend on of a body, its control law (or None) last.

    A mesh counts by what its file holds. A control law counts as the function that it is: the key
    holds it, so that no other function can take its place.
    """
    kin = body.kinematics
    limits = (kin.turning_radius, kin.v_max, kin.a_max, kin.omega_max, kin.reverse)
    turns = (kin.lateral_a_max, kin.alpha_max, kin.reach)
    law = None if kin.control is None else (kin.control.function, kin.control.bounds)
    ways = tuple((zone.polygon, zone.one_way, zone.pivots) for zone in kin.ways)
    return (*shape_key(body), kin.model.name, *map(float, (*limits, *turns)), ways, law)


def obstacle_key(obstacles: Sequence[Placed]) -> ObstacleKey:
    """Return what motions depend on of resting objects: shapes and poses, not names."""
    return frozenset((*shape_key(p.body), tuple(map(float, p.pose))) for p in obstacles)


def shape_key(body: Body) -> tuple[object, ...]:
    """Return what a body is to others."""
    height = float(body.height) if math.isfinite(body.height) else None
    return (body.footprint, mesh_key(body.mesh), height)


def mesh_key(path: str | None) -> str | None:
    """Return a digest of what a mesh file holds."""
    if path is None:
        return None
    try:
        status = os.stat(path)
        return _digest(path, status.st_mtime_ns, status.st_size)
    except OSError as error:
        raise ProblemError(f"the geometric model '{path}' cannot be read: {error}") from error


@lru_cache(maxsize=256)
def _digest(path: str, _modified: int, _size: int) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


@dataclass(frozen=True)
class CachedLeg:
    """A ``leg`` that was planned among the ``among`` obstacles (and keeps clear of them); where it
    is not complete, its planner had ``limit`` seconds.
    """

    among: ObstacleKey
    leg: Leg
    limit: float = 0.0

    @property
    def trajectory(self) -> Trajectory:
        """The motion (there always is one)."""
        assert self.leg.trajectory is not None
        return self.leg.trajectory

    @property
    def rank(self) -> tuple[bool, float]:
        """Less is better: what a planner finished goes before what it did not."""
        return not self.leg.complete, self.trajectory.duration


class MotionCache:
    """Legs by (map, planner, margin, body, start, goal), each with the obstacles it was planned
    among; a leg and its reverse share an entry (for reversible planners). The pairs that were used
    longest ago are forgotten beyond 20,000.
    """

    def __init__(self) -> None:
        self._entries: Memory[list[CachedLeg]] = Memory(20_000)
        self.hits = 0

    def __len__(self) -> int:
        return sum(map(len, self._entries.values()))

    def get(self, key: PairKey) -> list[CachedLeg]:
        """Return all entries of a pair, those with fewest obstacles first."""
        return self._entries.get(key) or []

    def put(self, key: PairKey, entry: CachedLeg) -> None:
        """Remember an entry (the better one if there are two for the same obstacles)."""
        known = self.get(key)
        best = min([entry, *(e for e in known if e.among == entry.among)], key=lambda e: e.rank)
        kept = [*(e for e in known if e.among != entry.among), best]
        self._entries.put(key, sorted(kept, key=lambda e: (len(e.among), e.rank)))
