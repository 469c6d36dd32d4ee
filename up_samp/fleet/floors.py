"""Floors and lifts: which map a place is on, how robots get from one floor to another.

The problem's own map is the floor ``ground``. A lift stands at one pose of each floor that it stops
at: each of these is a place (``LIFT.FLOOR``), from which a ride takes a robot to the other one.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

from up_samp.fleet.fields import Pose
from up_samp.fleet.loads import place_of
from up_samp.fleet.outlines import front_of
from up_samp.fleet.records import GROUND, FleetRecords, Lift
from up_samp.fleet.spelled_out import stop_of
from up_samp.geometry import load_map
from up_samp.geometry.maps import OccupancyGrid
from up_samp.motion import MotionService


def floor_of(records: FleetRecords, name: str) -> str:
    """Return the floor of a place, or of a pose at a place (a stand)."""
    return records.places[place_of(name)].floor


def map_of(records: FleetRecords, floor: str) -> str:
    """Return the map file of a floor, as the records name it."""
    return records.map if floor == GROUND else records.floors[floor].map


def height_of(records: FleetRecords, floor: str) -> float:
    """Return how high a floor is above the ground (m)."""
    return 0.0 if floor == GROUND else records.floors[floor].height


def legs_between(
    records: FleetRecords, origin: str, to: str
) -> Iterator[tuple[tuple[str, str], ...]]:
    """Yield the ways from one pose to another: one drive, or, between floors, a drive to a lift, a
    ride, and a drive from there on, for each spot of each lift that stops at both.
    """
    here, there = floor_of(records, origin), floor_of(records, to)
    if here == there:
        yield ((origin, to),)
        return
    for name, lift in records.lifts.items():
        if here in lift.stops and there in lift.stops:
            for spot in range(spots_of(lift)):
                enter, leave = stop_of(name, here, spot), stop_of(name, there, spot)
                legs = ((origin, enter), (enter, leave), (leave, to))
                yield tuple((p, q) for p, q in legs if p != q)


def way_between(records: FleetRecords, origin: str, to: str) -> tuple[Pose, ...]:
    """Return the poses that a drive from one place or stand to another leads through."""
    start, goal = (records.places[place_of(name)] for name in (origin, to))
    front = front_of(goal) if start is not goal else None
    return (start.pose, goal.pose) if front is None else (start.pose, front, goal.pose)


def lift_between(records: FleetRecords, origin: str, to: str) -> str | None:
    """Return the lift that a leg from one pose to another is a ride with; None for drives."""
    here, there = floor_of(records, origin), floor_of(records, to)
    if here == there:
        return None
    spots = ((n, s) for n, lift in records.lifts.items() for s in range(spots_of(lift)))
    return next(name for name, spot in spots if origin == stop_of(name, here, spot))


def spots_of(lift: Lift) -> int:
    """Return how many robots a lift takes at a time."""
    return min(map(len, lift.stops.values()))


def ride_seconds(records: FleetRecords, name: str, here: str, there: str) -> float:
    """Return how long a lift rides from one floor to another."""
    lift, heights = records.lifts[name], [height_of(records, f) for f in (here, there)]
    every = (height_of(records, floor) for floor in (GROUND, *records.floors))
    passed = sum(min(heights) < height <= max(heights) for height in every)
    return lift.seconds + lift.per_floor * passed


class FloorMaps:
    """The maps of a fleet's floors (relative to ``folder``), and who plans motions on each."""

    def __init__(self, records: FleetRecords, folder: Path) -> None:
        self._records = records
        self._folder = folder
        self.service = cache(self._service)

    def grid(self, floor: str) -> OccupancyGrid:
        """Return the map of a floor."""
        return load_map(self._folder / map_of(self._records, floor))

    def at(self, name: str) -> MotionService:
        """Return who plans motions on the floor of a pose."""
        return self.service(floor_of(self._records, name))

    def _service(self, floor: str) -> MotionService:
        return MotionService(self.grid(floor), margin=self._records.margin)
