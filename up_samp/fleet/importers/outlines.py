"""Maps from polygons: shapely's own, or outlines in DXF and SVG files (extra ``[drawings]``)."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
import shapely
from shapely.geometry import LinearRing, LineString, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import polygonize, unary_union

from up_samp.fleet.fields import FILE_LIMITS
from up_samp.fleet.files import check_size
from up_samp.fleet.importers.common import (
    Imported,
    Options,
    finish,
    listed,
    name_of,
    number_of,
    wrong,
)
from up_samp.geometry.maps import write_map
from up_samp.model import ProblemError
from up_samp.system.imports import extra

CELL, DRAWN_WALL = 0.05, 0.05
"""Assumed: size of a cell of a map that is drawn from outlines, thickness of a wall that is drawn
as a line (m).
"""


def map_from_polygons(
    free: BaseGeometry, folder: str | Path, name: str = "map", cell: float = CELL
) -> Path:
    """Write a ROS map on which only ``free`` (m, world frame) can be driven; return its YAML.

    A cell is free where all of it lies in ``free``: nothing becomes drivable by rounding. Around
    it is a border of one cell.
    """
    if free.is_empty or not free.is_valid or free.area <= 0:
        raise ProblemError("a map needs a valid polygon with an area; try shapely's make_valid")
    left, low, right, top = free.bounds
    origin = (left - cell, low - cell)
    cols, rows = math.ceil((right - left) / cell) + 2, math.ceil((top - low) / cell) + 2
    if cols * rows > FILE_LIMITS.cells:
        raise ProblemError(f"{cols} x {rows} cells of {cell:g} m are too many; take a larger cell")
    shapely.prepare(free)
    xs = origin[0] + cell * np.arange(cols)
    occupied = np.ones((rows, cols), dtype=np.bool_)
    for row in range(rows):
        y = origin[1] + cell * row
        # the tolerance forgives rounding of the cells' own corners only
        boxes = shapely.box(xs + 1e-9, y + 1e-9, xs + cell - 1e-9, y + cell - 1e-9)
        occupied[row] = ~shapely.covers(free, boxes)
    return write_map(folder, name, occupied, cell, (origin[0], origin[1], 0.0))


@dataclass
class _Drawn:
    """What a drawing shows (m): closed outlines, lines, and by name what is there to be known;
    ``thick``: what lines cover that have a width; ``thin``: of which that is not known.
    """

    rings: list[list[tuple[float, float]]] = field(default_factory=list)
    lines: list[list[tuple[float, float]]] = field(default_factory=list)
    zones: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    places: dict[str, list[float]] = field(default_factory=dict)
    thick: list[BaseGeometry] = field(default_factory=list)
    thin: dict[str, None] = field(default_factory=dict)

    def add(
        self,
        layer: str,
        points: list[tuple[float, float]],
        closed: bool,
        name: str = "",
        thick: BaseGeometry | None = None,
    ) -> None:
        """Add what is drawn on a layer, and what its line covers; a zone, which is within its line,
        has its own ``name``, or else its layer's.
        """
        if not layer.lower().startswith(_ZONE):
            (self.rings if closed else self.lines).append(points)
            self.thick += filter(None, [thick])
        elif closed:
            self.zones[name_of(name or layer[len(_ZONE) :], self.zones, _ZONE)] = points
        else:
            raise ProblemError(f"layer '{layer}': zones are closed outlines; close the line there")


def import_dxf(source: Path, folder: Path, options: Options) -> Imported:
    """Import a DXF drawing: the largest outline is the floor, closed or made of lines that meet;
    what else is closed is in the way, lines are walls, blocks are what they consist of. Blocks on
    layers ``place...`` are places named after the block, closed outlines on layers ``zone...``
    zones named after the layer. Its unit comes from the drawing.
    """
    with extra("DXF", "drawings", "ezdxf"):
        import ezdxf
        from ezdxf.path import make_path
        from ezdxf.units import conversion_factor
    try:
        drawing = ezdxf.readfile(check_size(source))
    except (OSError, ezdxf.DXFError) as error:
        raise wrong(source, None, f"not readable as DXF: {error}") from error
    scale, notes = 1.0, []
    if drawing.units:
        scale = float(conversion_factor(drawing.units, 6))  # 6: metres
    else:
        notes.append("the drawing has no unit: taken as m")
    found, made, left = _Drawn(thin=_stretched(drawing)), 0, set[str]()
    for entity in _entities(drawing.modelspace()):
        layer, points = str(entity.dxf.layer), list[tuple[float, float]]()
        if entity.dxftype() == "INSERT":
            x, y, _ = entity.dxf.insert
            pose = [number_of(scale * x), number_of(scale * y), math.radians(entity.dxf.rotation)]
            found.places[name_of(entity.dxf.name, found.places)] = pose
        elif entity.dxftype() in _SHAPES:
            path = make_path(entity)
            for v in (path.start, *path.control_vertices()):
                number_of(scale * v.x), number_of(scale * v.y)  # before many points are made
            points = [(scale * v.x, scale * v.y) for v in path.flattening(0.01 / scale)]
            found.add(layer, points, path.is_closed, thick=_traced(entity, scale))
        else:
            left.add(entity.dxftype())
        made += 1 + len(points)
        if made > FILE_LIMITS.pieces:
            raise wrong(source, None, f"its lines have more than {FILE_LIMITS.pieces} points")
    notes += listed({"what was left out, by kind": sorted(left)})
    return _finish(source, folder, found, notes)


def _has_width(entity: Any) -> bool:
    """Return whether an entity of DXF is a polyline with a width, constant or by vertex."""
    return getattr(entity, "has_width", False)


def _stretched(drawing: Any) -> dict[str, None]:
    """Return which blocks are stretched to one side, where any of a drawing has bends with a width:
    such bends become ellipses, which have none.
    """
    parts = [part for block in drawing.blocks for part in block]
    blocks = [e for e in parts if e.dxftype() == "INSERT" and not e.has_uniform_scaling]
    bends = any(_has_width(e) and e.has_arc for e in parts)
    return {f"in block '{e.dxf.name}'": None for e in blocks if bends}


def _traced(entity: Any, scale: float) -> BaseGeometry | None:
    """Return what a polyline with a width covers (m): ``scale`` m are a unit of the drawing."""
    from ezdxf.render.trace import TraceBuilder

    if not _has_width(entity) or not len(entity):
        return None
    faces = TraceBuilder.from_polyline(entity).faces_wcs(entity.ocs(), 0.0)
    corners = ([(number_of(scale * v.x), number_of(scale * v.y)) for v in face] for face in faces)
    return unary_union([shapely.MultiPoint(face).convex_hull for face in corners])


_SHAPES = ("LWPOLYLINE", "POLYLINE", "LINE", "CIRCLE", "ARC", "SPLINE", "ELLIPSE")
_ZONE, _PLACE = "zone", "place"
"""How layers begin whose outlines are zones, and whose blocks (in SVG: shapes) are places."""


def _entities(space: Iterable[Any]) -> Iterator[Any]:
    """Yield what a drawing consists of, and blocks, each followed by what it consists of, however
    deep, but where they mark a place.
    """
    for entity in space:
        if entity.dxftype() != "INSERT" or entity.dxf.layer.lower().startswith(_PLACE):
            yield entity
        else:
            yield from _entities(entity.virtual_entities())


def import_svg(source: Path, folder: Path, options: Options) -> Imported:
    """Import an SVG drawing, read like DXF: one unit of its ``viewBox`` is ``Options.cell`` m, y
    points up. Layers are Inkscape's, by their labels. Shapes on layers ``place...`` are places: a
    line is a pose that looks along it, of others the middle counts. Places and zones are named by
    the shape's own label, else by the layer's.
    """
    with extra("SVG", "drawings", "svgelements"):
        import svgelements
    try:
        root = ElementTree.parse(check_size(source)).getroot()
        _check_pieces(source, root)
        _prepare(root)
        text = io.BytesIO(ElementTree.tostring(root))
        drawing = svgelements.SVG.parse(text, ppi=96, reify=False)
    except (OSError, SyntaxError) as error:
        raise wrong(source, None, f"not readable as SVG: {error}") from error
    found = _Drawn()
    for shape in drawing.elements(lambda e: isinstance(e, svgelements.Shape)):
        layer, name = (str(shape.values.get(key, "")) for key in (_ON_LAYER, _NAMED))
        width = options.cell * _stroke(shape)
        if math.isnan(width):
            found.thin[f"'{name or shape.id or layer}'"] = None
        whole = svgelements.Path(shape).reify()  # what is turned, too, where it is drawn
        for part in whole.as_subpaths():
            path = svgelements.Path(part)
            points = _flat(path, options.cell)
            if layer.lower().startswith(_PLACE) and points:
                place = name_of(name or layer[len(_PLACE) :], found.places, _PLACE)
                found.places[place] = _pose_of(points)
                continue
            closed = len(points) > 3 and math.dist(points[0], points[-1]) < 1e-6
            found.add(layer, points, closed, name, _stroked(shape, points, closed, width))
    return _finish(source, folder, found, [f"a unit of the drawing is {options.cell:g} m"])


def _stroke(shape: Any) -> float:
    """Return how wide (units of the drawing) a shape's line is where it is widest: 0 where none is
    drawn, NaN where that cannot be read.
    """
    if str(shape.values.get("stroke")).strip().lower() in ("none", ""):
        return 0.0
    scales = "non-scaling" not in str(shape.values.get("vector-effect"))
    width = shape.stroke_width
    if not (scales and isinstance(width, int | float) and width >= 0):
        return math.nan
    t = shape.transform
    stretched = float(np.linalg.norm([[t.a, t.c], [t.b, t.d]], 2))
    return number_of(stretched * width)


def _stroked(
    shape: Any, points: list[tuple[float, float]], closed: bool, width: float
) -> BaseGeometry | None:
    """Return what a line covers that is so wide (m), up to its ends as these are drawn."""
    if not width > 0.0 or len(points) < 2:
        return None
    line = LinearRing(points) if closed else LineString(points)
    cap = _CAPS.get(str(shape.values.get("stroke-linecap")), "flat")
    return line.buffer(width / 2, cap_style=cap, join_style="mitre", mitre_limit=4.0)


_CAPS: Mapping[str, Literal["round", "square"]] = {"round": "round", "square": "square"}
_INKSCAPE = "{http://www.inkscape.org/namespaces/inkscape}"
_ON_LAYER, _NAMED = "up-samp-layer", "up-samp-name"
"""Attributes that say to the reader, which passes them on, where an element is."""


def _prepare(root: ElementTree.Element) -> None:
    """Say of each element which layer it is on, and its own label; have a unit of the ``viewBox``
    be one of the drawing, whatever size it has on paper.
    """
    box = re.split(r"[\s,]+", (root.get("viewBox") or "").strip())
    if len(box) == 4:
        root.attrib |= {"width": box[2], "height": box[3]}

    def mark(element: ElementTree.Element, layer: str) -> None:
        label = element.get(f"{_INKSCAPE}label", "")
        if element.get(f"{_INKSCAPE}groupmode") == "layer":
            layer, label = label, ""
        element.attrib |= {_ON_LAYER: layer, _NAMED: label}
        for part in element:
            mark(part, layer)

    mark(root, "")


def _pose_of(points: list[tuple[float, float]]) -> list[float]:
    """Return the pose at a line's start that looks to its end, or in the middle of what is none."""
    if len(points) == 2:
        (x, y), (to_x, to_y) = points
        return [x, y, math.atan2(to_y - y, to_x - x)]
    left, low, right, top = LineString(points).bounds if len(points) > 1 else points[0] * 2
    return [(left + right) / 2, (low + top) / 2, 0.0]


def _check_pieces(source: Path, root: ElementTree.Element) -> None:
    """Refuse a drawing that is too large, or nested too deeply, once each ``<use>`` stands for what
    it copies: its reader unfolds it without a limit.
    """
    named = {e.get("id"): e for e in root.iter() if e.get("id") is not None}
    known: dict[ElementTree.Element, tuple[int, int]] = {}

    def measured(element: ElementTree.Element, depth: int) -> tuple[int, int]:
        """Return how many pieces an element stands for, and how deeply they are nested."""
        if element not in known and depth <= FILE_LIMITS.depth:
            parts = list(element)
            if element.tag.rpartition("}")[2] == "use":
                href = (element.get("href") or element.get(_XLINK) or "")[1:]
                parts += [named[href]] if href in named else []
            inner = [measured(part, depth + 1) for part in parts]
            outline = (element.get("d") or "") + (element.get("points") or "")
            figures = islice(_FIGURE.finditer(outline), 2 * FILE_LIMITS.pieces + 2)
            own = 1 + sum(1 for _ in figures) // 2
            height = 1 + max((h for _, h in inner), default=0)
            known[element] = own + sum(n for n, _ in inner), height
        if depth + known.get(element, (0, 1))[1] > FILE_LIMITS.depth + 1:
            text = f"nested more than {FILE_LIMITS.depth} deep, or <use> copies what it is part of"
            raise wrong(source, None, text)
        return known[element]

    if measured(root, 0)[0] > FILE_LIMITS.pieces:
        text = f"more than {FILE_LIMITS.pieces} elements and points, with what <use> copies"
        raise wrong(source, None, text)


_XLINK = "{http://www.w3.org/1999/xlink}href"
_FIGURE = re.compile(r"[0-9.]+")


def _flat(path: Any, unit: float) -> list[tuple[float, float]]:
    """Return points along a path of SVG, y up."""
    import svgelements

    points: list[tuple[float, float]] = []
    for segment in path:
        if segment.start is None:
            continue
        straight = isinstance(segment, svgelements.Line | svgelements.Close | svgelements.Move)
        for i in range(2 if straight else 17):
            p = segment.point(i if straight else i / 16)
            point = (number_of(unit * p.x), number_of(-unit * p.y))
            if not points or math.dist(points[-1], point) > 1e-9:
                points.append(point)
    return points


def _finish(source: Path, folder: Path, drawn: _Drawn, notes: list[str]) -> Imported:
    shapes = [shapely.make_valid(Polygon(r)) for r in drawn.rings if len(r) >= 3]
    lines = [LineString(points) for points in drawn.lines if len(points) > 1]
    # walls that meet enclose a floor, too
    around = unary_union(list(polygonize(unary_union(lines))))
    shapes += [Polygon(part.exterior) for part in getattr(around, "geoms", [around])]
    shapes = [s for s in shapes if s.area > 0]
    if not shapes:
        raise wrong(source, None, "no closed outline: one has to be the floor")
    floor = max(shapes, key=lambda s: s.area)
    inside = [s for s in shapes if s is not floor]
    walls = [line.buffer(DRAWN_WALL / 2) for line in lines]
    free = floor.difference(unary_union([*inside, *walls, *drawn.thick]))
    map_from_polygons(free, folder)
    kind = {"footprint": [1.0, 0.7], "model": "omni"}
    notes.append(f"the floor is the largest outline; {len(inside)} others are in the way")
    notes.append("robots' footprint and limits are assumed; add places, robots and orders")
    notes += listed({"zones say nothing yet, being as quick as robots are": drawn.zones})
    notes += listed({f"widths not read, taken as {DRAWN_WALL:g} m": drawn.thin})
    data: dict[str, Any] = {"map": "map.yaml", "robot_types": {"agv": kind}}
    data["places"] = drawn.places
    data["zones"] = {n: {"polygon": points, "v_max": 1.0} for n, points in drawn.zones.items()}
    return finish(folder, data, notes)
