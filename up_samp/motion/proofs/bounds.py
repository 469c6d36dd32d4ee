"""Admissible lower bounds on the durations of motions.

A motion's path is at least as long as the shortest way of the footprint's inscribed disc (about
the reference point) among what surely blocks it, and a car's at least as long as the shortest
Reeds-Shepp curve (Dubins curve, if it drives ahead only); no speed profile from rest to rest beats
the trapezoid over that length, and a car rests at each cusp (:mod:`up_samp.motion.proofs.runs`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import shapely

from up_samp.geometry import Scene
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import along
from up_samp.geometry.shapes import core_of, shape_of
from up_samp.model import Body, Configuration, Mobility, Placed, TrafficZone
from up_samp.motion.curves.reeds_shepp import run_time, shortest
from up_samp.motion.curves.trapezoid import limits_of
from up_samp.motion.guides.visibility import Visibility
from up_samp.motion.proofs.certificates import Certifier
from up_samp.motion.proofs.runs import fastest_roll, fastest_runs
from up_samp.motion.proofs.slow_zones import SlowZone, fastest_with_slow, slow_zone


class DurationBounds:
    """Lower bounds (s) on motions in one scene, cached by body size and obstacles."""

    def __init__(self, scene: Scene, certifier: Certifier | None = None) -> None:
        self.scene = scene
        self.certifier = certifier or Certifier(scene)
        self._known: Memory[Visibility] = Memory(64)
        self._slow: Memory[SlowZone | None] = Memory(32)

    def through(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed] = ()
    ) -> float:
        """Return seconds that no motion through ``poses`` can beat; it rests at the first and at
        the last one, but need not stop at those between.

        0 for bodies with their own equations of motion (nothing is known about their speed).
        """
        kin = body.kinematics
        if kin.mobility.own_law:
            return 0.0
        legs = list(itertools.pairwise(poses))
        length = sum(self.way(body, a, b, obstacles) for a, b in legs)
        least = self._least(body, legs, length)
        slow = self._slow_parts(body, legs)
        if slow:
            length = max(length, sum(metres for metres, _ in slow))
            least = max(least, fastest_with_slow(length, slow, kin.v_max, kin.a_max))
        return least * (1 - 1e-9)

    @staticmethod
    def _least(
        body: Body, legs: Sequence[tuple[Configuration, Configuration]], length: float
    ) -> float:
        """Return seconds that no motion of so many m through some legs beats, whatever zones it
        leads through.
        """
        kin = body.kinematics
        if kin.mobility.steers and len(legs) == 1:
            return fastest_runs(*legs[0], limits_of(kin), length)
        least = max(
            run_time(length, kin.v_max, kin.a_max),
            sum(_turn(kin.mobility, a, b) for a, b in legs) / kin.omega_max,
        )
        if kin.mobility.rolls and len(legs) == 1:
            least = fastest_roll(*legs[0], kin, least)
        return least

    def _slow_parts(
        self, body: Body, legs: Sequence[tuple[Configuration, Configuration]]
    ) -> list[tuple[float, float]]:
        """Return how much (m) of any motion through some legs is in zones, and how fast (m/s) it
        may be there: of zones that overlap those that cost most.
        """
        kin = body.kinematics
        if kin.mobility.flies:
            return []
        told = []
        for zone in kin.zones:
            if not (zone.v_max < kin.v_max and zone.binds(legs[-1][1])):
                continue
            if zone.dock is not None:
                area: shapely.Geometry = shapely.Polygon(zone.polygon)
                metres = min(zone.long, math.dist(legs[0][0][:2], zone.dock[:2]))
            elif (known := self._slow_zone(body, zone)) is not None:
                area, metres = known.area, sum(self._slow_way(known, a, b) for a, b in legs)
            else:
                continue
            told.append((metres * (1.0 / zone.v_max - 1.0 / kin.v_max), metres, zone, area))
        told.sort(key=lambda one: -one[0])
        kept: list[tuple[float, float, shapely.Geometry]] = []
        for lost, metres, zone, area in told:
            if lost > 0.0 and not any(area.intersects(other) for *_, other in kept):
                kept.append((metres, zone.v_max, area))
        return [(metres, v_max) for metres, v_max, _ in kept]

    def _slow_zone(self, body: Body, zone: TrafficZone) -> SlowZone | None:
        """Return what is known of a zone for a body (None: nothing)."""
        grid, radius = self.scene.grid, shape_of(core_of(body)).inscribed
        if grid is None or radius <= 0.0:
            return None
        key = (round(radius, 9), zone.polygon)
        if key not in self._slow:
            blocked = self.certifier.blocked(radius, ())
            self._slow.put(key, slow_zone(zone, grid, blocked, radius))
        return self._slow.get(key)

    def _slow_way(self, zone: SlowZone, start: Configuration, goal: Configuration) -> float:
        """Return how much (m) of any way between two poses is slow."""
        cells = [(math.floor(y), math.floor(x)) for x, y in map(self._cells, (start, goal))]
        rows, cols = zone.kind.shape
        if not all(0 <= row < rows and 0 <= col < cols for row, col in cells):
            return 0.0
        return zone.least(cells[0], cells[1], math.dist(start[:2], goal[:2]))

    def way(
        self,
        body: Body,
        start: Configuration,
        goal: Configuration,
        obstacles: Sequence[Placed] = (),
    ) -> float:
        """Return metres that no way of a body's reference point between two poses can beat."""
        kin = body.kinematics
        if kin.mobility.flies:
            return math.dist(start[:3], goal[:3])
        length = self.length(body, start, goal, obstacles)
        if kin.mobility.steers:
            sense = limits_of(kin).sense
            length = max(length, shortest(start, goal, kin.turning_radius, sense)[0])
        return length

    def length(
        self,
        body: Body,
        start: Configuration,
        goal: Configuration,
        obstacles: Sequence[Placed] = (),
    ) -> float:
        """Return metres that no way of the reference point between two planar poses can beat."""
        straight = math.dist(start[:2], goal[:2])
        grid = self.scene.grid
        radius = shape_of(core_of(body)).inscribed
        if grid is None or radius <= 0.0:
            return straight
        a, b = self._cells(start), self._cells(goal)
        way = self._visibility(radius, obstacles).distance(a, b)
        return max(straight, way) if math.isfinite(way) else straight

    def _cells(self, pose: Configuration) -> tuple[float, float]:
        """Return a point in cells from the map's corner."""
        frame = self.scene.data.frame
        gx, gy = along(frame, pose[0], pose[1])
        return float(gx / frame.size), float(gy / frame.size)

    def _visibility(self, radius: float, obstacles: Sequence[Placed]) -> Visibility:
        key = (
            round(radius, 9),
            frozenset((p.body.footprint, tuple(p.pose)) for p in obstacles),
        )
        size = self.scene.data.frame.size
        return self._known.get_or(
            key, lambda: Visibility(self.certifier.blocked(radius, obstacles), size)
        )


def _turn(able: Mobility, start: Configuration, goal: Configuration) -> float:
    """Return radians that a body which may turn on the spot turns at least (a car's turns are in
    the length of its way).
    """
    if able.flies:
        dot = abs(sum(a * b for a, b in zip(start[3:], goal[3:], strict=True)))
        norm = math.hypot(*start[3:]) * math.hypot(*goal[3:])
        return 2 * math.acos(min(1.0, dot / norm))
    if able.pivots:
        return abs(math.remainder(goal[2] - start[2], 2 * math.pi))
    return 0.0
