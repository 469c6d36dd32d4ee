"""Layouts: VDMA's LIF (stations and nodes) and Open-RMF's building maps (vertices, walls)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from shapely import get_parts
from shapely.geometry import LineString, MultiLineString, MultiPoint, Polygon
from shapely.ops import linemerge, unary_union

from up_samp.fleet.fields import FILE_LIMITS
from up_samp.fleet.files import compose, text_of
from up_samp.fleet.importers.common import (
    Imported,
    Options,
    finish,
    json_of,
    listed,
    name_of,
    number_of,
    wrong,
)
from up_samp.fleet.importers.outlines import map_from_polygons
from up_samp.fleet.outlines import convex_hull, swept
from up_samp.geometry.maps import load_map, write_map
from up_samp.model import UnsupportedError

AGV = {"footprint": [1.0, 0.7], "model": "omni", "v_max": 1.0, "a_max": 0.5, "omega_max": 1.0}

XY = tuple[float, float]
Traits = Mapping[str, Sequence[Any]]
"""What a building of RMF says of a thing: ``key: [type, value]``."""

RMF_WALL, CHARGING = 0.1, 0.05
"""Assumed: thickness of RMF's walls (m, its own default), and what a charger gives a second: a
battery of 100 is full in half an hour.
"""


def import_lif(source: Path, folder: Path, options: Options) -> Imported:
    """Import a LIF layout: stations, and nodes that no station names, become places; edges with one
    direction, a limit of speed or no rotation become zones, those of two directions lanes.

    LIF has no walls: give a map, or the floor is what lies around the nodes.
    """
    layout, *others = json_of(source)["layouts"]
    nodes = {n["nodeId"]: n for n in layout["nodes"]}
    stations = layout.get("stations", [])
    at = {key: n["nodePosition"] for key, n in nodes.items()}
    points = {key: (number_of(p["x"]), number_of(p["y"])) for key, p in at.items()}
    if not points:
        raise wrong(source, None, "the layout has no nodes")
    places: dict[str, Any] = {}
    met: set[str] = set()
    for station in stations:
        for number, node in enumerate(station["interactionNodeIds"]):
            if node not in nodes:
                raise wrong(source, None, f"station '{station['stationId']}': no node '{node}'")
            base = station.get("stationName") or station["stationId"]
            name = name_of(base if number == 0 else f"{base}_{number + 1}", places, "station")
            places[name] = [*points[node], _theta(nodes[node])]
            met.add(node)
    for key, node in nodes.items():
        if key not in met:
            places[name_of(node.get("nodeName") or key, places, "node")] = [
                *points[key], _theta(node),
            ]  # fmt: skip
    edges = _lif_edges(source, layout, points, places)
    zones, notes = lane_zones(edges)
    notes += listed({"other layouts were left out": (str(o["layoutId"]) for o in others)})
    lanes = preferred_lanes(edges, {*places, *(e.name for e in edges)})
    if options.map is not None:
        grid = load_map(options.map)
        cells = grid.occupied, grid.resolution, grid.origin, grid.unknown
        map_file = write_map(folder, "map", *cells).name
    else:
        floor = MultiPoint(list(points.values())).envelope.buffer(3.0, join_style="mitre")
        map_file = map_from_polygons(floor, folder).name
        notes.append("LIF has no walls: the floor is free 3 m around the nodes (or give --map)")
    notes.append("robots' footprint and limits are assumed; add robots and orders")
    data = {"map": map_file, "robot_types": {"agv": AGV}, "places": places}
    return finish(folder, {**data, "zones": zones, "lanes": lanes}, notes)


def _lif_edges(
    source: Path,
    layout: Mapping[str, Any],
    points: Mapping[str, XY],
    places: Mapping[str, Any],
) -> list[LaneEdge]:
    """Return the edges of a LIF layout; vehicle types count together: the slowest one's speed."""
    edges = layout.get("edges", [])
    known = {(e["startNodeId"], e["endNodeId"]) for e in edges}
    found: list[LaneEdge] = []
    names = set(places)
    for edge in edges:
        a, b = edge["startNodeId"], edge["endNodeId"]
        for node in (a, b):
            if node not in points:
                raise wrong(source, None, f"edge '{edge['edgeId']}': no node '{node}'")
        kinds = edge.get("vehicleTypeEdgeProperties", ())
        speeds = [number_of(k["maxSpeed"]) for k in kinds if k.get("maxSpeed") is not None]
        speed = min((v for v in speeds if v > 0.0), default=None)
        still = bool(kinds) and not any(k.get("rotationAllowed", True) for k in kinds)
        name = name_of(edge["edgeId"], names, "edge")
        names.add(name)
        one_way = (b, a) not in known
        found.append(LaneEdge(name, points[a], points[b], one_way, speed, still))
    return found


def _theta(node: Mapping[str, Any]) -> float:
    """Return the first heading that a vehicle type has at a node, rad."""
    kinds = node.get("vehicleTypeNodeProperties", ())
    return next((number_of(k["theta"]) for k in kinds if k.get("theta") is not None), 0.0)


def import_rmf(source: Path, folder: Path, options: Options) -> Imported:
    """Import the first level of an Open-RMF building map: floor, walls, holes, named vertices.

    Pixels become m by the level's measurements (coordinates may be m already); y points up.
    Chargers and parking spots are places to park, holding points are places, too; a robot stands
    where one is spawned. Doors open as robots come; lanes with one direction or a limit of speed
    become zones, those of two directions are preferred.
    """
    root = compose(source, text_of(source))
    building = yaml.SafeLoader("").construct_document(root)
    levels = building["levels"]
    if not levels:
        raise wrong(source, None, "it has no level")
    name, level = next(iter(levels.items()))
    vertices = level["vertices"]
    points, scale = _metres(source, building, level)
    floors, holes = (
        [Polygon([points[i] for i in f["vertices"]]) for f in level.get(key, ())]
        for key in ("floors", "holes")
    )
    if not floors:
        raise wrong(source, None, f"level '{name}' has no floor")
    walls = [LineString([points[w[0]], points[w[1]]]) for w in level.get("walls", ())]
    solid = unary_union(walls).buffer(RMF_WALL / 2, cap_style="square")
    free = unary_union(floors).difference(unary_union([solid, *holes]))
    low = free.bounds[:2]
    places, chargers, robots = _rmf_places(vertices, points)
    edges = _rmf_lanes(level, points, places)
    zones, of_lanes = lane_zones(edges)
    notes = [f"level '{name}': {scale:g} m a pixel; its lower left corner is at {_show(low)}"]
    doors = doors_of(level, points, places)
    told = {
        f"doors open as robots come, in {OPENS:g} s: say opens_in": list(doors),
        f"chargers give {CHARGING:g} a second, once robots have a battery": chargers,
        "other levels were left out": list(levels)[1:],
        "lifts were left out": building.get("lifts") or (),
    }
    notes += listed(told)
    notes.append("headings are 0; robots' footprint and limits are assumed; add robots and orders")
    map_file = map_from_polygons(free, folder).name
    data = {"map": map_file, "robot_types": {"agv": AGV}, "places": places}
    lanes = preferred_lanes(edges, {*places, *robots, *doors, *(e.name for e in edges)})
    data |= {"robots": robots, "automatic_doors": doors, "zones": zones, "lanes": lanes}
    return finish(folder, data, [*notes, *of_lanes])


def _rmf_places(
    vertices: Sequence[Any], points: Sequence[XY]
) -> tuple[dict[str, Any], list[str], dict[str, Any]]:
    """Return the vertices with a name as places, those of them that are chargers, and the robots
    that are spawned at some.
    """
    places: dict[str, Any] = {}
    chargers: list[str] = []
    robots: dict[str, Any] = {}
    for vertex, (x, y) in zip(vertices, points, strict=True):
        title = next(iter(vertex[3:]), "")
        traits: Mapping[str, Any] = next(iter(vertex[4:]), {})
        if title:
            park = any(_trait(traits, key) for key in ("is_charger", "is_parking_spot"))
            pose = [round(x, 4), round(y, 4), 0.0]
            place = name_of(title, places, "v")
            places[place] = {"pose": pose, "park": 1} if park else pose
            if _trait(traits, "is_charger"):
                places[place]["charger"] = {"per_second": CHARGING}
                chargers.append(place)
            for spawned in traits.get("spawn_robot_name", ())[1:]:
                name = name_of(str(spawned), {*robots, *places}, "robot")
                robots[name] = {"type": "agv", "start": place}
    return places, chargers, robots


def _rmf_lanes(
    level: Mapping[str, Any], points: Sequence[XY], places: Mapping[str, Any]
) -> list[LaneEdge]:
    """Return the lanes of a level: of those that are not ``bidirectional``, one goes one way."""
    lanes = [(a, b, *rest) for a, b, *rest in level.get("lanes", ())]
    known = {(a, b) for a, b, *_ in lanes}
    found: list[LaneEdge] = []
    names = set(places)
    for number, (a, b, *rest) in enumerate(lanes):
        traits: Mapping[str, Any] = next(iter(rest), {})
        speed = number_of(_trait(traits, "speed_limit", 0.0))
        both = bool(_trait(traits, "bidirectional")) or (b, a) in known
        name = name_of(f"lane{number + 1}", names, "lane")
        names.add(name)
        limit = speed if speed > 0.0 else None
        found.append(LaneEdge(name, points[a], points[b], not both, limit))
    return found


def _metres(
    source: Path, building: Mapping[str, Any], level: Mapping[str, Any]
) -> tuple[list[XY], float]:
    """Return a level's vertices in m, y up, and how many m a unit of the file is."""
    match building.get("coordinate_system", "reference_image"):
        case "reference_image":
            scale, up = _scale(source, level), -1.0
        case "cartesian_meters":
            scale, up = 1.0, 1.0
        case other:
            raise UnsupportedError(f"{source}: coordinates of '{other}': only pixels, or metres")
    vertices = level["vertices"]
    return [(number_of(scale * v[0]), number_of(up * scale * v[1])) for v in vertices], scale


def _scale(source: Path, level: Mapping[str, Any]) -> float:
    """Return m per pixel: the mean over the measurements."""
    vertices = level["vertices"]
    found = []
    for a, b, traits in level.get("measurements", []):
        pixels = math.dist(vertices[a][:2], vertices[b][:2])
        found.append(number_of(traits["distance"][1]) / pixels)
    if not found:
        raise wrong(source, None, "no measurement says how long a pixel is")
    return sum(found) / len(found)


def _trait(traits: Traits, key: str, default: Any = None) -> Any:
    """Return what a building says of a thing."""
    return traits[key][1] if key in traits else default


def _show(point: Sequence[float]) -> str:
    return "(" + ", ".join(f"{v:.2f}" for v in point) + ")"


# ------------------ Doors of Open-RMF's building maps, as doors that open as robots come


LEAF, OPENS = 0.1, 3.0
"""Assumed: thickness of a leaf (m), and how long a door takes to open (s)."""


def doors_of(
    level: Mapping[str, Any], points: Sequence[XY], taken: Collection[str]
) -> dict[str, Any]:
    """Return the automatic doors of a level: the doorway of each is all that its leaves sweep; what
    slides stays in the wall.
    """
    doors: dict[str, Any] = {}
    for first, second, traits in level.get("doors", ()):
        title = str(_trait(traits, "name", "")) or "door"
        corners = _leaves(points[first], points[second], traits)
        polygon = [[round(x, 4), round(y, 4)] for x, y in convex_hull(corners)]
        doors[name_of(title, {*taken, *doors}, "door")] = {"polygon": polygon, "opens_in": OPENS}
    return doors


def _leaves(start: XY, end: XY, traits: Traits) -> Iterator[XY]:
    """Yield the corners of where a door's leaves are, from closed to open."""
    kind = _trait(traits, "type", "hinged")
    middle = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    turn = math.copysign(1.0, _trait(traits, "motion_direction", 1)) * ("hinged" in kind)
    turn *= math.radians(number_of(_trait(traits, "motion_degrees", 90.0)))
    hinges = [(start, end, turn)]
    if _trait(traits, "motion_axis", "start") == "end":
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


# ------------------ Edges of a layout
# They are zones, where they have one direction, a limit of speed, or no turning; lanes that robots
# prefer, where they are driven both ways.


class LaneEdge(NamedTuple):
    """An edge from ``start`` to ``end`` (m): driven that way only (``one_way``), no faster than
    ``v_max`` (m/s; None: no limit), without turning on the spot (``still``).
    """

    name: str
    start: XY
    end: XY
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
