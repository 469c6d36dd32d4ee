"""Edges of a layout: as zones, where they have one direction, a limit of speed, or no turning; as
lanes that robots prefer, where they are driven both ways.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from shapely import get_parts
from shapely.geometry import LineString, MultiLineString, Polygon
from shapely.ops import linemerge

from up_samp.fleet.importers.common import listed, name_of
from up_samp.fleet.limits import FILE_LIMITS


class LaneEdge(NamedTuple):
    """An edge from ``start`` to ``end`` (m): driven that way only (``one_way``), no faster than
    ``v_max`` (m/s; None: no limit), without turning on the spot (``still``).
    """

    name: str
    start: tuple[float, float]
    end: tuple[float, float]
    one_way: bool = False
    v_max: float | None = None
    still: bool = False


def lane_zones(edges: Sequence[LaneEdge]) -> tuple[dict[str, Any], list[str]]:
    """Return zones, by name, for the edges that say something, and what has to be told of them.
    Lanes are 1 m wide, as nothing tells that, and end half as far before the vertices that they
    join: there robots turn into others.

    Left out, and told: edges too short for a lane, and directions of lanes that overlap against
    each other, as nobody could drive there.
    """
    wide = 1.0
    zones: dict[str, Any] = {}
    areas: dict[str, tuple[Polygon, LaneEdge]] = {}
    short: list[str] = []
    for edge in edges:
        if not (edge.one_way or edge.still or edge.v_max is not None):
            continue
        length = math.dist(edge.start, edge.end)
        if length < 2.0 * wide:
            short.append(edge.name)
            continue
        line = LineString([edge.start, edge.end])
        ends = [line.interpolate(at) for at in (0.5 * wide, length - 0.5 * wide)]
        area = LineString(ends).buffer(0.5 * wide, cap_style="flat")
        areas[edge.name] = area, edge
    against = _against(areas)
    for name, (area, edge) in areas.items():
        zone: dict[str, Any] = {
            "polygon": [[round(x, 4), round(y, 4)] for x, y in area.exterior.coords[:-1]]
        }
        if edge.one_way and name not in against:
            dx, dy = edge.end[0] - edge.start[0], edge.end[1] - edge.start[1]
            zone["one_way"] = round(math.atan2(dy, dx), 6)
        if edge.v_max is not None:
            zone["v_max"] = edge.v_max
        if edge.still:
            zone["pivoting"] = "never"
        if len(zone) > 1:
            zones[name] = zone
    notes = {
        f"lanes with rules are zones {wide:g} m wide": zones,
        "too short for a lane, left out": short,
        "lanes that overlap against each other go both ways": against,
    }
    return zones, listed(notes)


def preferred_lanes(edges: Sequence[LaneEdge], taken: Collection[str]) -> dict[str, Any]:
    """Return lanes, by names that are not ``taken``, along the edges that are driven both ways: one
    from fork to fork.
    """
    ends = {tuple(sorted((e.start, e.end))) for e in edges if not e.one_way and e.start != e.end}
    lines = linemerge(MultiLineString(sorted(ends))) if ends else MultiLineString()
    lanes: dict[str, Any] = {}
    for line in sorted(get_parts(lines), key=lambda line: line.coords[0]):
        points = [[round(x, 4), round(y, 4)] for x, y in line.coords]
        for first in range(0, len(points) - 1, FILE_LIMITS.corners - 1):
            name = name_of(f"way{len(lanes) + 1}", {*lanes, *taken}, "way")
            lanes[name] = {"points": points[first : first + FILE_LIMITS.corners]}
    return lanes


def _against(areas: dict[str, tuple[Polygon, LaneEdge]]) -> list[str]:
    """Return the lanes with a direction that overlap others against it."""
    found: dict[str, None] = {}
    for (one, (a, first)), (other, (b, second)) in itertools.combinations(areas.items(), 2):
        if not (first.one_way and second.one_way and a.intersection(b).area > 0.0):
            continue
        ways = [(e.end[0] - e.start[0], e.end[1] - e.start[1]) for e in (first, second)]
        if ways[0][0] * ways[1][0] + ways[0][1] * ways[1][1] < 0.0:
            found |= {one: None, other: None}
    return list(found)
