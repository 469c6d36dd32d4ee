"""Motions of bodies that drive along their heading and turn on the spot: the fastest of two ways.

One is found by A* over a lattice of positions and headings (:mod:`up_samp.motion.fleet.roadmap`),
coarse to fine, guided by the distance around what is fixed; then corners are left out where
turning, driving and turning again is faster. The other one is a car's that turns no tighter than
such a body can at top speed: it never rests but at cusps. Where neither is found, a car's that may
rest to turn on the spot, too, is sought as finely as the way is thin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from up_samp.geometry import Scene, Shape, sweeps
from up_samp.model import Body, Deadline, Kinematics, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.budget import WorkBudget
from up_samp.motion.curves.rolling import (
    moves_on,
    rolled,
    rolling_radius,
    rolling_time,
    rolls_of,
    rows_of,
)
from up_samp.motion.curves.trajectories import at_rest
from up_samp.motion.curves.trapezoid import limits_of
from up_samp.motion.fleet.roadmap import Roadmap, cells_of
from up_samp.motion.guides.cost_to_go import Fields, field_value
from up_samp.motion.guides.search_space import TOUCHES, search_box, widest_shape
from up_samp.motion.moves import ShortMove, corners_of, steer
from up_samp.motion.planners.car import CarPlanner
from up_samp.motion.protocol import Leg, LegQuery


@dataclass(frozen=True)
class PivotSettings:
    """How hard the path of a body that turns on the spot is sought: A* looks at so many ``places``
    of the lattice of each grain, with a ``weight`` on what is left to drive, and as far around all
    that is known as ``reach`` (radii of the body) where there is no map; a way along ``arcs``, as a
    car drives, has so many expansions. ``thin``: where none is found, ways as thin as the body are
    sought to the end.
    """

    places: tuple[int, ...] = (10_000, 20_000, 40_000, 60_000)
    weight: float = 1.2
    reach: float = 16.0
    arcs: int = 8_000
    thin: bool = True


class PivotPlanner:
    """Plans legs of bodies that turn on the spot, in one scene. Deterministic."""

    name = "pivot-lattice"
    reversible = True

    def __init__(
        self, scene: Scene, seed: int = 0, settings: PivotSettings = PivotSettings()
    ) -> None:
        self.scene = scene
        self.settings = settings
        self.fields = Fields(scene)
        # there are other ways, with stops
        self._car = CarPlanner.quick(scene, seed)
        self._thread = CarPlanner(scene, seed)

    @classmethod
    def quick(cls, scene: Scene, seed: int = 0) -> PivotPlanner:
        """Return a planner that gives up after little work, for detours."""
        return cls(scene, seed, PivotSettings(places=(400, 1, 1, 1), thin=False))

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a fast motion between two poses among resting obstacles."""
        body, ends = query.body, (query.start, query.goal)
        shape = widest_shape(self.scene, body, ends, query.obstacles)
        if shape is None:
            return Leg(None, TOUCHES, complete=True)
        moves: Sequence[ShortMove] | None = steer(body, *ends)
        effort, cut = 0, False
        if not self._is_free(shape, query, moves or ()):
            moves, effort, cut = self._search(shape, query, deadline)
        found: list[FloatArray] = []
        if moves is not None:
            found.append(corners_of(moves))
        arcs, thin = WorkBudget(deadline, self.settings.arcs), WorkBudget(deadline)
        if self.settings.arcs > 0:
            found += self._along_arcs(self._car, query, arcs, 0.0)
        if self.settings.thin and query.effort is None and not found:
            found += self._along_arcs(self._thread, query, thin, body.kinematics.omega_max)
        effort += arcs.used + thin.used
        whole = not cut and not deadline.expired()
        if not found:
            reason = "no path at the finest resolution" if whole else "out of time"
            return Leg(None, reason, effort, complete=whole)
        found = [self._shortened(shape, query, rows, deadline) for rows in found]
        rows = min(found, key=lambda rows: rolling_time(rows, body.kinematics))
        return Leg(_timed(body, query, rows), "", effort, complete=whole)

    def _along_arcs(
        self, planner: CarPlanner, query: LegQuery, budget: WorkBudget, omega: float
    ) -> list[FloatArray]:
        """Return the poses of a way as a car drives it that turns no tighter than such a body can
        at top speed, and with ``omega`` (rad/s) on the spot; none if none is found.
        """
        kin = query.body.kinematics
        car = limits_of(kin)._replace(radius=rolling_radius(kin), omega=float(omega))
        arcs, _ = planner.path(query, budget, car)
        start = np.array(query.start[:3], dtype=np.float64)
        return [] if arcs is None else [rows_of(start, arcs)]

    def _search(
        self, shape: Shape, query: LegQuery, deadline: Deadline
    ) -> tuple[list[ShortMove] | None, int, bool]:
        """Return moves along a lattice, the places looked at, and whether time or work ended it."""
        body, ends = query.body, (query.start, query.goal)
        field = self.fields.toward(shape, query.goal, query.obstacles)
        low, high = search_box(
            self.scene, ends, query.obstacles, self.settings.reach * shape.circumscribed
        )
        box = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        effort, speed = 0, body.kinematics.v_max / self.settings.weight
        for cell, most in zip(cells_of(body), self.settings.places, strict=True):
            left = most if query.effort is None else min(most, query.effort - effort)
            if deadline.expired() or left <= 0:
                return None, effort, True
            roadmap = Roadmap(self.scene, body, ends, query.obstacles, cell, box)
            start, goal = (roadmap.place(pose) for pose in ends)

            def estimate(node: int, roadmap: Roadmap = roadmap) -> float:
                x, y, _ = roadmap.poses[node]
                away = math.dist((x, y), query.goal[:2])
                return max(away, float(field_value(field, x, y))) / speed

            way, looked = roadmap.route((start, goal), estimate, most=left)
            effort += looked
            if way is not None:
                return [edge.move for edge in way], effort, False
        return None, effort, False

    def _shortened(
        self, shape: Shape, query: LegQuery, rows: FloatArray, deadline: Deadline
    ) -> FloatArray:
        """Return poses (n, 3), driven straight between some of their rests where that is faster."""
        kin, rows = query.body.kinematics, rows[moves_on(rows)]
        rests, i = _rests(rows, kin), 0
        while i < len(rests) - 1 and not deadline.expired():
            for k in range(len(rests) - 1, i, -1):
                a, b = rests[i], rests[k]
                p, q = (tuple(float(v) for v in rows[at]) for at in (a, b))
                moves = steer(query.body, p, q)
                seconds = rolling_time(rows[a : b + 1], kin)
                sooner = sum(m.seconds for m in moves) <= seconds - 1e-6
                if sooner and self._is_free(shape, query, moves):
                    rows = _spliced(rows, a, b, corners_of(moves))
                    rests = _rests(rows, kin)
                    break
            i += 1
        return rows

    def _is_free(self, shape: Shape, query: LegQuery, moves: Sequence[ShortMove]) -> bool:
        return all(self._sweeps_free(shape, query, m.rows) for m in moves)

    def _sweeps_free(self, shape: Shape, query: LegQuery, rows: FloatArray) -> bool:
        world = self.scene.world(shape, query.obstacles)
        least = 1e-3 * float(shape.data.slack[2])
        return bool(sweeps.samples_free(world, rows, least) < 0)


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


def _timed(body: Body, query: LegQuery, rows: FloatArray) -> Trajectory:
    """Return the motion through ``rows``, exactly between the query's poses."""
    if len(rows) < 2:
        return at_rest(query.goal)
    motion = rolled(rows, body.kinematics)
    poses = motion.poses.copy()
    for k, pose in ((0, query.start), (-1, query.goal)):
        turns = 2 * math.pi * round((float(poses[k, 2]) - pose[2]) / (2 * math.pi))
        poses[k] = (pose[0], pose[1], pose[2] + turns)
    return Trajectory(motion.times.copy(), poses)
