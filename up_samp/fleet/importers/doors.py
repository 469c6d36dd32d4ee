"""Doors of Open-RMF's building maps as doors of fleets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from up_samp.fleet.importers.common import name_of, number_of

XY = tuple[float, float]
LEAF, BEFORE_DOOR = 0.1, 1.2
"""Assumed: thickness of a leaf, and how far before a door robots open it if no lane tells (m)."""


@dataclass(frozen=True)
class Doorway:
    """Where a door is: its ends (m), and what the building says of it."""

    name: str
    ends: tuple[XY, XY]
    traits: Mapping[str, Sequence[Any]]

    @property
    def middle(self) -> XY:
        """Its middle, m."""
        (x, y), (u, v) = self.ends
        return (x + u) / 2, (y + v) / 2

    @property
    def heading(self) -> float:
        """The direction from its first end to the other, rad."""
        (x, y), (u, v) = self.ends
        return math.atan2(v - y, u - x)

    def trait(self, key: str, default: Any) -> Any:
        """Return what the building says; RMF writes ``key: [type, value]``."""
        return self.traits[key][1] if key in self.traits else default


def doors_of(
    level: Mapping[str, Any], points: Sequence[XY], places: dict[str, Any], free: BaseGeometry
) -> tuple[dict[str, Any], list[str]]:
    """Return the doors of a level that robots can open, and the names of those that stay open.

    A door is opened at the vertices whose lane leads through it, or a bit before it on either side
    where no lane does; such poses join ``places``.
    """
    doors: dict[str, Any] = {}
    left = []
    for first, second, traits in level.get("doors", ()):
        title = str(traits.get("name", [1, ""])[1]) or "door"
        taken = {*places, *doors}
        doorway = Doorway(name_of(title, taken, "door"), (points[first], points[second]), traits)
        before = _before(doorway, level, points, free)
        if not before:
            left.append(title)
            continue
        names = [_place(doorway, pose, i, places) for i, pose in enumerate(before, 1)]
        x, y = doorway.middle
        doors[doorway.name] = {
            "leaf": [round(math.dist(*doorway.ends), 4), LEAF],
            "closed": _rounded(x, y, doorway.heading),
            "open": _rounded(*_opened(doorway)),
            "opened_from": names,
        }
    return doors, left


def _opened(doorway: Doorway) -> tuple[float, float, float]:
    """Return where the leaf is when the door is open: turned about its hinge, or slid aside by its
    own length (doors of two leaves are taken as one that slides).
    """
    sign = 1.0 if doorway.trait("motion_direction", 1) >= 0 else -1.0
    length = math.dist(*doorway.ends)
    if doorway.trait("type", "hinged") == "hinged":
        at_end = doorway.trait("motion_axis", "start") == "end"
        hinge = doorway.ends[1] if at_end else doorway.ends[0]
        turn = sign * math.radians(number_of(doorway.trait("motion_degrees", 90.0)))
        heading = doorway.heading + turn
        reach = -length / 2 if at_end else length / 2
        return (
            hinge[0] + reach * math.cos(heading),
            hinge[1] + reach * math.sin(heading),
            heading,
        )
    x, y = doorway.middle
    shift = sign * length
    heading = doorway.heading
    return x + shift * math.cos(heading), y + shift * math.sin(heading), heading


def _before(
    doorway: Doorway, level: Mapping[str, Any], points: Sequence[XY], free: BaseGeometry
) -> list[XY]:
    leaf = LineString(doorway.ends)
    lanes = [(points[a], points[b]) for a, b, *_ in level.get("lanes", ())]
    found = [p for lane in lanes if LineString(lane).intersects(leaf) for p in lane]
    if not found:
        (x, y), across = doorway.middle, doorway.heading + math.pi / 2
        for side in (BEFORE_DOOR, -BEFORE_DOOR):
            found.append((x + side * math.cos(across), y + side * math.sin(across)))
    return [p for p in dict.fromkeys(found) if free.contains(Point(p)) and leaf.distance(Point(p))]


def _place(doorway: Doorway, point: XY, number: int, places: dict[str, Any]) -> str:
    """Return the place at a point, a new one where there is none: it looks to the door."""
    for name, place in places.items():
        pose = place["pose"] if isinstance(place, dict) else place
        if math.dist(pose[:2], point) < 1e-3:
            return name
    name = name_of(f"{doorway.name}_side{number}", places, "door")
    x, y = doorway.middle
    places[name] = _rounded(*point, math.atan2(y - point[1], x - point[0]))
    return name


def _rounded(*values: float) -> list[float]:
    return [round(v, 4) for v in values]
