"""Motions of bodies that drive along their heading and turn on the spot.

They are sought as a car's that turns no tighter than such a body can at top speed, so that it never
rests but at cusps, and that may rest to turn on the spot, too (:mod:`.car`); then stretches are
replaced where a line is faster, with turns on the spot at its ends, or as it sets off and comes to
rest (:mod:`up_samp.motion.curves.rolling`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from up_samp.geometry import Scene, Shape
from up_samp.geometry.kernels import first_hit
from up_samp.model import Configuration, Deadline, Kinematics, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import DriveLimits, run_time
from up_samp.motion.curves.rolling import (
    moves_on,
    rolled,
    rolling_radius,
    rolling_time,
    rolls_of,
    rows_of,
    swerves,
)
from up_samp.motion.curves.trajectories import at_rest, with_ends
from up_samp.motion.curves.trapezoid import limits_of
from up_samp.motion.guides import TOUCHES, widest_shape
from up_samp.motion.moves import corners_of, steer
from up_samp.motion.planners.car import QUICK, CarPlanner, CarSettings
from up_samp.motion.protocol import Leg, LegQuery, WorkBudget


class PivotPlanner:
    """Plans legs of bodies that turn on the spot, in one scene. Deterministic for a seed."""

    name = "pivot"
    reversible = True

    def __init__(self, scene: Scene, seed: int = 0, settings: CarSettings = CarSettings()) -> None:
        self.scene = scene
        self._car = CarPlanner(scene, seed, settings)

    @classmethod
    def quick(cls, scene: Scene, seed: int = 0) -> PivotPlanner:
        """Return a planner that gives up after little work, for detours."""
        return cls(scene, seed, QUICK)

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a fast motion between two poses among resting obstacles."""
        body, ends = query.body, (query.start, query.goal)
        shape = widest_shape(self.scene, body, ends, query.obstacles)
        if shape is None:
            return Leg(None, TOUCHES, complete=True)
        budget = WorkBudget(deadline, query.effort)
        arcs, reason = self._car.path(query, budget, rolling_limits(body.kinematics))
        found = [*self._straight(shape, query, *ends)]
        if arcs is not None:
            rows = rows_of(np.array(query.start[:3], dtype=np.float64), arcs)
            found.append(self._shortened(shape, query, rows, deadline))
        complete = not budget.cut and not deadline.expired()
        if not found:
            return Leg(None, reason, budget.used, complete)
        rows = min(found, key=lambda rows: rolling_time(rows, body.kinematics))
        return Leg(_timed(query, rows), "", budget.used, complete)

    def _shortened(
        self, shape: Shape, query: LegQuery, rows: FloatArray, deadline: Deadline
    ) -> FloatArray:
        """Return poses (n, 3), driven straight between some of their rests where that is faster."""
        rests = _rests(rows := rows[moves_on(rows)], query.body.kinematics)
        i = 0
        while i < len(rests) - 1 and not deadline.expired():
            for k in range(len(rests) - 1, i, -1):
                a, b = rests[i], rests[k]
                p, q = (tuple(rows[at].tolist()) for at in (a, b))
                seconds = rolling_time(rows[a : b + 1], query.body.kinematics)
                better = next(self._straight(shape, query, p, q, seconds - 1e-6), None)
                if better is not None:
                    rows = _spliced(rows, a, b, better)
                    rests = _rests(rows, query.body.kinematics)
                    break
            i += 1
        return rows

    def _straight(
        self,
        shape: Shape,
        query: LegQuery,
        start: Configuration,
        goal: Configuration,
        most: float = math.inf,
    ) -> Iterator[FloatArray]:
        """Yield free ways along a line between two rests that take less than ``most`` s: turning
        on the spot at its ends, or as it sets off and comes to rest.
        """
        world, kin = self.scene.world(shape, query.obstacles), query.body.kinematics
        nearest = run_time(math.dist(start[:2], goal[:2]), kin.v_max, kin.a_max)
        turning = corners_of(steer(query.body, start, goal))
        line = turning[1:-1] if len(turning) == 4 else turning[:1]
        if nearest < most and first_hit(world, line) < 0:
            # with a limit to how fast a turn begins there are no such bends at a rest
            bent = swerves(start, goal, kin) if math.isinf(kin.alpha_max) else []
            quick = (rows for rows in (*bent, turning) if rolling_time(rows, kin) < most)
            yield from (rows for rows in quick if first_hit(world, rows) < 0)


def rolling_limits(kinematics: Kinematics) -> DriveLimits:
    """Return the limits of a car that turns no tighter than such a body does at top speed, and on
    the spot as it does.
    """
    limits = limits_of(kinematics)
    return limits._replace(radius=rolling_radius(kinematics), omega=float(kinematics.omega_max))


def _rests(rows: FloatArray, kinematics: Kinematics) -> list[int]:
    """Return at which of its poses (n, 3) a way rests."""
    kinds = rolls_of(rows, kinematics).kinds
    stops = np.flatnonzero((np.diff(kinds) != 0) | (np.abs(kinds[1:]) == 2)) + 1
    return [0, *map(int, stops), len(rows) - 1]


def _spliced(nodes: FloatArray, i: int, j: int, part: FloatArray) -> FloatArray:
    """Return ``nodes`` with those from i to j replaced by ``part``, theta continuous."""
    part, tail = part.copy(), nodes[j + 1 :].copy()
    part[:, 2] += nodes[i, 2] - part[0, 2]
    tail[:, 2] += part[-1, 2] - nodes[j, 2]
    return np.concatenate([nodes[:i], part, tail])


def _timed(query: LegQuery, rows: FloatArray) -> Trajectory:
    """Return the motion through ``rows``, exactly between the query's poses."""
    if len(rows) < 2:
        return at_rest(query.goal)
    return with_ends(rolled(rows, query.body.kinematics), query.start, query.goal)
