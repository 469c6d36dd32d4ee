"""Zones that take so many robots at a time: which drives come in, go out, pass or go around.

A robot counts from the start of the drive that brings it in to the end of the one that takes it
out. A drive between places outside goes around the zone; where that is proven impossible, it passes
through and counts all the while. So a zone never holds more than it says, whatever the paths.
"""

from __future__ import annotations

import enum
from functools import cached_property
from pathlib import Path

from shapely.geometry import Polygon

from up_samp.fleet.loads import load_of, place_of, ridden, with_load
from up_samp.fleet.outlines import body_of, placed, still
from up_samp.fleet.records import Attached, FleetRecords
from up_samp.geometry import load_map
from up_samp.model import Placed
from up_samp.motion import MotionService


class Passing(enum.Enum):
    """What a drive has to do with a zone."""

    AROUND = "around"
    IN = "in"
    OUT = "out"
    WITHIN = "within"
    THROUGH = "through"


class Crowd:
    """One zone with ``max_robots``."""

    def __init__(self, records: FleetRecords, folder: Path, zone: str) -> None:
        self.zone = zone
        self._records = records
        self._folder = folder
        self._polygon = Polygon(records.zones[zone].polygon)
        self._known: dict[tuple[str, str, str], Passing] = {}

    def starts_inside(self, robot: str) -> bool:
        """Return whether a robot touches the zone where it starts."""
        mine = self._records.robots[robot]
        return self._inside(mine.type, mine.start)

    def passing(self, robot: str, origin: str, to: str) -> Passing:
        """Return what the drive of ``robot`` from ``origin`` to ``to`` has to do with the zone,
        with the load that rides with it.
        """
        kind = self._records.robots[robot].type
        key = (kind, origin, to)
        if key not in self._known:
            self._known[key] = self._passing(*key)
        return self._known[key]

    def _passing(self, kind: str, origin: str, to: str) -> Passing:
        order = ridden(self._records, origin, to)
        load = None if order is None else load_of(self._records, order)
        # the drives to and from the ride are made without the load: so the count is of robots alone
        leaves, comes = self._inside(kind, origin), self._inside(kind, to)
        if leaves or comes:
            return {(True, True): Passing.WITHIN, (False, True): Passing.IN}.get(
                (leaves, comes), Passing.OUT
            )
        if load is not None and any(self._inside(kind, p, load) for p in (origin, to)):
            return Passing.THROUGH
        poses = [self._records.places[place_of(p)].pose for p in (origin, to)]
        zone = self._records.zones[self.zone]
        area = Placed(self.zone, still(zone.polygon), (0.0, 0.0, 0.0))
        mine = self._records.robot_types[kind]
        body = body_of(mine) if load is None else with_load(mine, load)
        proof = self._service.certificate(body, poses, (area,))
        return Passing.AROUND if proof is None else Passing.THROUGH

    def _inside(self, kind: str, place: str, load: Attached | None = None) -> bool:
        mine, pose = self._records.robot_types[kind], self._records.places[place_of(place)].pose
        body = body_of(mine) if load is None else with_load(mine, load)
        return bool(self._polygon.intersects(Polygon(placed(body.footprint, pose))))

    @cached_property
    def _service(self) -> MotionService:
        grid = load_map(self._folder / self._records.map)
        return MotionService(grid, margin=self._records.margin)
