"""Doors of Open-RMF's building maps as doors of fleets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from up_samp.fleet.importers.common import name_of, number_of

XY = tuple[float, float]
LEAF, BEFORE_DOOR = 0.1, 1.2
"""Assumed: thickness of a leaf, and how far before a door robots open it if no lane tells (m)."""


Ends = tuple[XY, XY]
"""Where a doorway begins and ends, m."""
Traits = Mapping[str, Sequence[Any]]
"""What a building says of a door; RMF writes ``key: [type, value]``."""


def _middle(ends: Ends) -> XY:
    (x, y), (u, v) = ends
    return (x + u) / 2, (y + v) / 2


def _heading(ends: Ends) -> float:
    """Return the direction from the first end to the other, rad."""
    (x, y), (u, v) = ends
    return math.atan2(v - y, u - x)


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
        name, ends = name_of(title, taken, "door"), (points[first], points[second])
        before = _before(ends, level, points, free)
        if not before:
            left.append(title)
            continue
        names = [_place(name, ends, pose, i, places) for i, pose in enumerate(before, 1)]
        doors[name] = {
            "leaf": [round(math.dist(*ends), 4), LEAF],
            "closed": _rounded(*_middle(ends), _heading(ends)),
            "open": _rounded(*_opened(ends, traits)),
            "opened_from": names,
        }
    return doors, left


def _opened(ends: Ends, traits: Traits) -> tuple[float, float, float]:
    """Return where the leaf is when the door is open: turned about its hinge, or slid aside by its
    own length (doors of two leaves are taken as one that slides).
    """

    def trait(key: str, default: Any) -> Any:
        return traits[key][1] if key in traits else default

    sign = 1.0 if trait("motion_direction", 1) >= 0 else -1.0
    length, heading, (x, y) = math.dist(*ends), _heading(ends), _middle(ends)
    shift = sign * length
    if trait("type", "hinged") == "hinged":
        at_end = trait("motion_axis", "start") == "end"
        x, y = ends[1] if at_end else ends[0]
        heading += sign * math.radians(number_of(trait("motion_degrees", 90.0)))
        shift = -length / 2 if at_end else length / 2
    return x + shift * math.cos(heading), y + shift * math.sin(heading), heading


def _before(
    ends: Ends, level: Mapping[str, Any], points: Sequence[XY], free: BaseGeometry
) -> list[XY]:
    leaf = LineString(ends)
    lanes = [(points[a], points[b]) for a, b, *_ in level.get("lanes", ())]
    found = [p for lane in lanes if LineString(lane).intersects(leaf) for p in lane]
    if not found:
        (x, y), across = _middle(ends), _heading(ends) + math.pi / 2
        found.extend(
            (x + side * math.cos(across), y + side * math.sin(across))
            for side in (BEFORE_DOOR, -BEFORE_DOOR)
        )
    return [p for p in dict.fromkeys(found) if free.contains(Point(p)) and leaf.distance(Point(p))]


def _place(door: str, ends: Ends, point: XY, number: int, places: dict[str, Any]) -> str:
    """Return the place at a point, a new one where there is none: it looks to the door."""
    for name, place in places.items():
        pose = place["pose"] if isinstance(place, dict) else place
        if math.dist(pose[:2], point) < 1e-3:
            return name
    name = name_of(f"{door}_side{number}", places, "door")
    x, y = _middle(ends)
    places[name] = _rounded(*point, math.atan2(y - point[1], x - point[0]))
    return name


def _rounded(*values: float) -> list[float]:
    return [round(v, 4) for v in values]
