"""Doors of Open-RMF's building maps as doors that open as robots come."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from up_samp.fleet.importers.common import name_of, number_of
from up_samp.fleet.outlines import convex_hull, swept

XY = tuple[float, float]
LEAF, OPENS = 0.1, 3.0
"""Assumed: thickness of a leaf (m), and how long a door takes to open (s)."""

Traits = Mapping[str, Sequence[Any]]
"""What a building says of a door; RMF writes ``key: [type, value]``."""


def doors_of(
    level: Mapping[str, Any], points: Sequence[XY], taken: Collection[str]
) -> dict[str, Any]:
    """Return the automatic doors of a level: the doorway of each is all that its leaves sweep; what
    slides stays in the wall.
    """
    doors: dict[str, Any] = {}
    for first, second, traits in level.get("doors", ()):
        title = str(traits.get("name", [1, ""])[1]) or "door"
        corners = _leaves(points[first], points[second], traits)
        polygon = [[round(x, 4), round(y, 4)] for x, y in convex_hull(corners)]
        doors[name_of(title, {*taken, *doors}, "door")] = {"polygon": polygon, "opens_in": OPENS}
    return doors


def _leaves(start: XY, end: XY, traits: Traits) -> Iterator[XY]:
    """Yield the corners of where a door's leaves are, from closed to open."""

    def trait(key: str, default: Any) -> Any:
        return traits[key][1] if key in traits else default

    kind = trait("type", "hinged")
    middle = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    turn = math.copysign(1.0, trait("motion_direction", 1)) * ("hinged" in kind)
    turn *= math.radians(number_of(trait("motion_degrees", 90.0)))
    hinges = [(start, end, turn)]
    if trait("motion_axis", "start") == "end":
        hinges = [(end, start, turn)]
    if kind.startswith("double"):  # each turns to the same side
        hinges = [(start, middle, turn), (end, middle, -turn)]
    for hinge, tip, angle in hinges:
        length, heading = math.dist(hinge, tip), math.atan2(tip[1] - hinge[1], tip[0] - hinge[0])
        closed, opened = (_leaf(hinge, heading + a, length) for a in (0.0, angle))
        yield from swept((length, LEAF), closed, opened)


def _leaf(hinge: XY, heading: float, length: float) -> tuple[float, float, float]:
    """Return the pose of a leaf's middle."""
    x, y = (length / 2 * way(heading) for way in (math.cos, math.sin))
    return hinge[0] + x, hinge[1] + y, heading
