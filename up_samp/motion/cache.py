"""A memory of planned legs, of one search or of several."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from up_samp.geometry.memory import Memory
from up_samp.model import Body, Placed, ProblemError, Trajectory
from up_samp.motion.protocol import Leg

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
