"""Several maps as one: side by side in one plane, so far apart that nothing of two of them meets.

Each map is laid down along its own cells, however it is turned in the world: no cell is resampled,
but for finer ones where maps differ in resolution. Poses go with their maps, and trajectories come
back by ``Snapshot.to_world``. So everything that plans on one map plans on several.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
import shapely

from up_samp.geometry.maps import MOST_PIXELS, OccupancyGrid, load_map
from up_samp.model import Body, Configuration, TrafficZone, UnsupportedError
from up_samp.model.arrays import BoolArray
from up_samp.model.frames import Frame, PlacedMap
from up_samp.model.snapshot import Snapshot, TermKind

_BESIDE = 0.5
"""How far (m) beyond the reach of its body an object that rests outside its map may be."""

_DIGITS = 9
"""Poses in the plane are rounded to so many digits: equal ones stay equal when a map is moved."""

_SAME_HEIGHT = 1e-6
"""Heights (m) that differ by less are one."""

_FINEST = 1e-4
"""Smallest cells (m) that maps of different resolutions are cut into."""


def lay_out(snapshot: Snapshot) -> tuple[Snapshot, OccupancyGrid | None]:
    """Return a problem on one grid in one plane (``None``: it has no map).

    With one map that plane is the frame that the map's file states its origin in: wherever it lies
    in the world, the motions are the same. Raises :class:`UnsupportedError` where several maps
    cannot be told apart, :class:`~up_samp.model.ProblemError` where a map cannot be read.
    """
    if not snapshot.maps:
        return snapshot, None
    if len(snapshot.maps) == 1:
        (placed,) = snapshot.maps
        if placed.frame.is_identity or _in_space(snapshot):
            return snapshot, in_world(placed)
        moved = _moved(snapshot, (placed.frame,))
        return _with_zones(moved, lambda _, area: area), load_map(placed.file)
    grids = [in_world(placed) for placed in snapshot.maps]
    _check_apart(snapshot, grids)
    radius = max((_radius(o.body.footprint) for o in snapshot.objects.values()), default=0.0)
    reach = radius + _BESIDE
    grid, lefts = _side_by_side(snapshot.maps, grids, 2.0 * (reach + radius) + _BESIDE)
    to_world = [Frame(*g.origin).after(Frame(-left)) for g, left in zip(grids, lefts, strict=True)]
    # what stands far outside its map touches nothing there, and must not touch another one
    within = [
        (left - reach, left + g.size[0] + reach) for g, left in zip(grids, lefts, strict=True)
    ]
    moved = _moved(snapshot, tuple(to_world), within)
    grounds = [
        shapely.box(left, 0.0, left + g.size[0], g.size[1])
        for g, left in zip(grids, lefts, strict=True)
    ]
    return _with_zones(moved, lambda k, area: area & grounds[k]), grid


def _in_space(snapshot: Snapshot) -> bool:
    return any(o.body.flies for o in snapshot.objects.values())


def _moved(
    snapshot: Snapshot,
    to_world: tuple[Frame, ...],
    within: Sequence[tuple[float, float]] = ((-math.inf, math.inf),),
) -> Snapshot:
    """Return a problem with its poses in the plane that ``to_world`` leads back from; ``within``
    are the lowest and highest x there, by map.
    """
    back = [frame.inverse for frame in to_world]
    poses: dict[str, Configuration] = {}
    for name, pose in snapshot.configurations.items():
        k = snapshot.map_of[name]
        x, y, yaw = (round(v, _DIGITS) for v in back[k].of(pose))
        low, high = within[k]
        poses[name] = (min(max(x, low), high), y, yaw)
    return replace(snapshot, configurations=poses, to_world=to_world)


def _with_zones(
    snapshot: Snapshot, on: Callable[[int, shapely.Polygon], shapely.Geometry]
) -> Snapshot:
    """Return a problem with all zones where its maps were moved to: ``on`` map k, the part of each
    that lies there (bodies are on their map, and so is what they do in a zone).
    """
    back = [frame.inverse for frame in snapshot.to_world]

    def put(zone: TrafficZone) -> Iterator[TrafficZone]:
        for k, placed in enumerate(snapshot.maps):
            if abs(placed.height - zone.height) > _SAME_HEIGHT:
                continue
            part = on(k, shapely.Polygon(back[k].points(zone.polygon)))
            for area in shapely.get_parts(part):
                if area.geom_type == "Polygon" and area.area > 0.0:
                    corners = [(round(x, _DIGITS), round(y, _DIGITS)) for x, y in _ring(area)]
                    way = None if zone.one_way is None else zone.one_way + back[k].yaw
                    dock = None if zone.dock is None else back[k].of(zone.dock)
                    yield replace(zone, polygon=tuple(corners), one_way=way, dock=dock)

    def moved(body: Body) -> Body:
        kin = body.kinematics
        zones = tuple(part for zone in kin.zones for part in put(zone))
        return replace(body, kinematics=replace(kin, zones=zones)) if kin.zones else body

    objects = {n: replace(o, body=moved(o.body)) for n, o in snapshot.objects.items()}
    laden = {task: moved(body) for task, body in snapshot.laden.items()}
    return replace(snapshot, objects=objects, laden=laden)


def _ring(area: shapely.Polygon) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in area.exterior.coords[:-1]]


def in_world(placed: PlacedMap) -> OccupancyGrid:
    """Read a map and put it where its reference frame says."""
    grid = load_map(placed.file)
    if placed.frame.is_identity:
        return grid
    return replace(grid, origin=placed.frame.of(grid.origin))


def _radius(footprint: Sequence[tuple[float, float]]) -> float:
    return max(itertools.starmap(math.hypot, footprint), default=0.0)


def _side_by_side(
    maps: Sequence[PlacedMap], grids: Sequence[OccupancyGrid], gap: float
) -> tuple[OccupancyGrid, list[float]]:
    """Return one grid with all maps in a row, ``gap`` m apart, and where each begins (x, m): from
    the lowest on, however they are listed, as planners go by the cells that they see.
    """
    cell = _common_cell(maps, grids)
    times = [round(g.resolution / cell) for g in grids]
    apart = math.ceil(gap / cell)
    widths = [g.shape[1] * n for g, n in zip(grids, times, strict=True)]
    rows = max(g.shape[0] * n for g, n in zip(grids, times, strict=True))
    starts = [0] * len(grids)
    end = -apart
    for k in sorted(range(len(maps)), key=lambda k: (maps[k].height, str(maps[k]))):
        starts[k] = end + apart
        end = starts[k] + widths[k]
    shape = rows, end
    if shape[0] * shape[1] > MOST_PIXELS:
        raise UnsupportedError(
            f"the maps {', '.join(m.label for m in maps)} need {shape[0] * shape[1]} cells of "
            f"{cell:g} m together; {MOST_PIXELS} are the most"
        )
    occupied = np.zeros(shape, dtype=np.bool_)
    unknown = np.ones(shape, dtype=np.bool_)
    for grid, n, start in zip(grids, times, starts, strict=True):
        here = slice(0, grid.shape[0] * n), slice(start, start + grid.shape[1] * n)
        occupied[here] = _finer(grid.occupied, n)
        unknown[here] = _finer(grid.unknown, n)
    whole = OccupancyGrid(occupied, cell, unknown=unknown)
    return whole, [start * cell for start in starts]


def _finer(cells: BoolArray, n: int) -> BoolArray:
    return np.repeat(np.repeat(cells, n, axis=0), n, axis=1)


def _common_cell(maps: Sequence[PlacedMap], grids: Sequence[OccupancyGrid]) -> float:
    """Return the largest edge (m) of which every map's cells are a whole number."""
    if len({g.resolution for g in grids}) == 1:
        return grids[0].resolution
    sizes = [Fraction(g.resolution).limit_denominator(10**6) for g in grids]
    scale = math.lcm(*(s.denominator for s in sizes))
    cell = Fraction(math.gcd(*(int(s * scale) for s in sizes)), scale)
    near = all(abs(float(s) - g.resolution) <= 1e-12 for s, g in zip(sizes, grids, strict=True))
    if not near or cell < _FINEST:
        told = ", ".join(f"{m.label}: {g.resolution:g} m" for m, g in zip(maps, grids, strict=True))
        raise UnsupportedError(f"the resolutions of the maps do not fit together ({told})")
    return float(cell)


def _check_apart(snapshot: Snapshot, grids: Sequence[OccupancyGrid]) -> None:
    """Raise where two maps of one height share ground: whose walls would count there?"""
    grounds = [shapely.Polygon(grid.corners) for grid in grids]
    reach = _resting_reach(snapshot)
    for i, j in itertools.combinations(range(len(grids)), 2):
        one, other = snapshot.maps[i], snapshot.maps[j]
        if abs(one.height - other.height) > _SAME_HEIGHT:
            continue
        if shapely.area(shapely.intersection(grounds[i], grounds[j])) > grids[i].resolution ** 2:
            raise UnsupportedError(
                f"the maps {one.label} and {other.label} lie over each other at one height: give "
                "the frame of one of them a height (an SE3 with z) if they are floors, or use one "
                "map for both"
            )
        pairs = itertools.product(((i, j), (j, i)), reach.items())
        for (a, b), (name, (owner, radius)) in pairs:
            spot = shapely.Point(snapshot.configurations[name][:2])
            if snapshot.map_of[name] == a and spot.distance(grounds[b]) <= radius:
                raise UnsupportedError(
                    f"object '{owner}' at '{name}', a configuration on map "
                    f"{snapshot.maps[a].label}, may reach onto map {snapshot.maps[b].label} "
                    "beside it: state both as one map"
                )


def _resting_reach(snapshot: Snapshot) -> Mapping[str, tuple[str, float]]:
    """Configuration -> the largest object that may rest there without having driven there (who
    drives stays on the free cells of its map), and its radius (m).
    """
    drivers = {t.object for t in snapshot.tasks}
    uses = [(o, place) for o, place in snapshot.initial.items() if o not in drivers]
    for change in snapshot.changes:
        term = change.term
        known = term.kind is TermKind.CONSTANT
        places = [term.name] if known else list(snapshot.configurations)
        uses += [(change.object, place) for place in places if change.object not in drivers]
    found: dict[str, tuple[str, float]] = {}
    for owner, place in uses:
        radius = _radius(snapshot.objects[owner].body.footprint)
        if radius > found.get(place, ("", -1.0))[1]:
            found[place] = owner, radius
    return found
