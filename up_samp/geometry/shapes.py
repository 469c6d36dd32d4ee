"""Footprints as the compiled collision checks need them: convex parts, inflated, and discs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product, starmap

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.geometry.kernels import WIDER
from up_samp.geometry.records import RuleData, ShapeData
from up_samp.model import Body, ProblemError, TrafficZone, check_time
from up_samp.model.arrays import FloatArray

Point = tuple[float, float]

CORE = 2e-6
"""How much thinner (m) the core of a footprint is: twice what the validator takes for rounding."""
SLACK_MIN, SLACK_MAX = 1e-4, 0.2
"""Smallest and largest extra inflation (m) that the swept checks use in tight places."""

FINER = 0.1
"""Share of the least extra inflation that the finer checks use."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A footprint in the body frame (m), ready for the kernels.

    ``parts`` are convex polygons (counter-clockwise) whose union is the footprint.
    ``circumscribed`` is the radius of the smallest disc about the reference point that covers
    it, ``inscribed`` that of the largest disc about it inside (0 if the point is outside);
    ``inner`` = (x, y, r) is the largest disc inside it anywhere. ``margin`` is the clearance (m)
    that ``data`` asks for, ``grain`` the least extra inflation (m; 0: by the margin) that swept
    checks of it use. ``zones``: rules of ways that swept checks of its motions keep.
    """

    footprint: tuple[Point, ...]
    parts: tuple[tuple[Point, ...], ...]
    margin: float
    circumscribed: float
    inscribed: float
    inner: tuple[float, float, float]
    discs: FloatArray
    grain: float = 0.0
    zones: tuple[TrafficZone, ...] = ()

    @cached_property
    def turned(self) -> Shape:
        """The same footprint for a search from the goal: every rule the other way round."""
        if not self.zones:
            return self
        return replace(self, zones=tuple(zone.turned for zone in self.zones))

    @cached_property
    def finer(self) -> Shape:
        """The same footprint and margin, with checks that also pass gaps hardly wider than that.

        They take more time.
        """
        return replace(self, grain=max(FINER * float(self.data.slack[2]), SLACK_MIN))

    @cached_property
    def data(self) -> ShapeData:
        """The arrays that the kernels take (see :class:`ShapeData`)."""
        slack = np.array([0.0, 0.0, *_slacks(self.grain or self.margin, self.inner[2])])
        # level 0 is the bare footprint, level 1 has the margin, the others margin and slack
        wider = [0.0, *(self.margin + slack[1:])]
        pairs = product(wider, self.parts)
        verts, counts = padded([_inflate(part, by) for by, part in pairs])
        shape = (len(wider), len(self.parts))
        verts, counts = verts.reshape(*shape, -1, 2), counts.reshape(shape)
        discs, radius = np.ascontiguousarray(self.discs), float(self.circumscribed)
        ways = rules_of(self.zones, radius)
        return ShapeData(verts, counts, slack, discs, radius, float(self.margin), ways)


def padded(polygons: Sequence[npt.ArrayLike]) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return polygons as one array (n, most corners, 2), each filled up with its last corner, and
    how many corners each has.
    """
    rings = [np.asarray(polygon, dtype=np.float64) for polygon in polygons]
    counts = np.array([len(ring) for ring in rings], dtype=np.int64)
    verts = np.zeros((len(rings), int(counts.max(initial=3)), 2))
    for i, ring in enumerate(rings):
        verts[i, : len(ring)] = ring
        verts[i, len(ring) :] = ring[-1]
    return verts, counts


def _slacks(margin: float, inner: float) -> list[float]:
    """Return growing extra inflations (m): the first as small as the margin, the last useful ones
    below a third of the body's inner radius.
    """
    slacks = [min(max(margin, SLACK_MIN), 0.02)]
    while 4 * slacks[-1] <= min(SLACK_MAX, max(inner / 3, 4 * slacks[0])):
        slacks.append(4 * slacks[-1])
    return slacks


def shape_of(body: Body, margin: float = 0.0) -> Shape:
    """Return the (cached) shape of a planar body, asking for ``margin`` metres of clearance."""
    footprint = tuple((float(x), float(y)) for x, y in body.footprint)
    return _shape(footprint, float(margin), body.kinematics.ways)


@lru_cache(maxsize=1024)
def _shape(footprint: tuple[Point, ...], margin: float, zones: tuple[TrafficZone, ...]) -> Shape:
    ring = _checked(footprint)
    parts = tuple(convex_parts(ring))
    polygon = shapely.Polygon(ring)
    line = shapely.maximum_inscribed_circle(polygon, tolerance=1e-4)
    cx, cy = map(float, line.coords[0])
    boundary = polygon.exterior
    inside = polygon.covers(shapely.Point(0.0, 0.0))
    inscribed = float(boundary.distance(shapely.Point(0.0, 0.0))) if inside else 0.0
    inner = (cx, cy, float(boundary.distance(shapely.Point(cx, cy))))
    if inscribed >= inner[2] - 1e-3:  # prefer the reference point where it is as good
        inner = (0.0, 0.0, inscribed)
    return Shape(
        footprint=tuple(ring),
        parts=parts,
        margin=margin,
        circumscribed=max(starmap(math.hypot, ring)),
        inscribed=inscribed,
        inner=inner,
        discs=np.concatenate([_covering_discs(part) for part in parts]),
        zones=zones,
    )


@lru_cache(maxsize=1024)
def core_of(body: Body) -> Body:
    """Return the body with its footprint thinner by ``CORE`` m all round.

    What its core meets, the body meets by more than any judge takes for rounding: proofs that
    something is in the way are made for it. A footprint too thin for that has no such proofs.
    """
    polygon = shapely.Polygon(_checked(body.footprint))
    thin = polygon.buffer(-CORE, join_style="mitre", mitre_limit=1e3)
    if thin.is_empty or thin.geom_type != "Polygon":
        raise ProblemError(
            f"the footprint {body.footprint} is thinner than {2 * CORE:g} m somewhere"
        )
    ring = tuple((float(x), float(y)) for x, y in thin.exterior.coords[:-1])
    return replace(body, footprint=ring)


def _checked(footprint: tuple[Point, ...]) -> list[Point]:
    """Return the ring counter-clockwise without repeated and collinear points, or complain."""
    ring = [p for i, p in enumerate(footprint) if math.dist(p, footprint[i - 1]) > 1e-9]
    if not all(math.isfinite(v) for p in footprint for v in p):
        raise ProblemError(f"the footprint {footprint} has coordinates that are not finite")
    if len(ring) < 3:
        raise ProblemError(f"the footprint {footprint} needs at least three different corners")
    polygon = shapely.Polygon(ring)
    if not polygon.is_valid:
        reason = shapely.is_valid_reason(polygon)
        raise ProblemError(f"the footprint {footprint} is not a simple polygon: {reason}")
    if polygon.area < 1e-8:
        raise ProblemError(f"the footprint {footprint} has no area")
    if not polygon.exterior.is_ccw:
        ring.reverse()
    keep = [
        p
        for i, p in enumerate(ring)
        if abs(_cross(ring[i - 1], p, ring[(i + 1) % len(ring)])) > 1e-12
    ]
    return keep


def _cross(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def convex_parts(ring: list[Point]) -> list[tuple[Point, ...]]:
    """Return convex polygons whose union is the simple counter-clockwise ``ring``.

    Triangles, merged across diagonals while convex (Hertel & Mehlhorn 1983).
    """
    if _is_convex(ring):
        return [tuple(ring)]
    faces = shapely.constrained_delaunay_triangles(shapely.Polygon(ring))
    triangles = shapely.get_coordinates(shapely.orient_polygons(shapely.get_parts(faces)))
    corners = triangles.reshape(-1, 4, 2)[:, :3].tolist()
    return [tuple(piece) for piece in _merged([[(x, y) for x, y in t] for t in corners])]


def _merged(pieces: list[list[Point]]) -> list[list[Point]]:
    """Join polygons that share an edge while the union is convex: always the first pair, in the
    order of the list, that can be joined.
    """
    owner = {edge: i for i, piece in enumerate(pieces) for edge in _edges(piece)}
    gone: set[int] = set()
    i = 0
    while i < len(pieces):
        beside = set() if i in gone else _beside(pieces[i], owner)
        for j in sorted(k for k in beside if k > i):
            joined = _join(pieces[i], pieces[j])
            if joined is None:
                continue
            check_time()
            for edge in (*_edges(pieces[i]), *_edges(pieces[j])):
                owner.pop(edge, None)
            pieces[i] = joined
            gone.add(j)
            owner.update((edge, i) for edge in _edges(joined))
            # pairs before this one could not be joined, but for those with what is new
            i = min([i, *_beside(joined, owner)])
            break
        else:
            i += 1
    return [piece for k, piece in enumerate(pieces) if k not in gone]


def _edges(piece: list[Point]) -> list[tuple[Point, Point]]:
    return [(a, piece[(i + 1) % len(piece)]) for i, a in enumerate(piece)]


def _beside(piece: list[Point], owner: Mapping[tuple[Point, Point], int]) -> set[int]:
    """Return the polygons that share an edge with one (they run along it the other way)."""
    return {owner[b, a] for a, b in _edges(piece) if (b, a) in owner}


def _is_convex(ring: list[Point]) -> bool:
    n = len(ring)
    return all(_cross(ring[i - 1], ring[i], ring[(i + 1) % n]) >= -1e-12 for i in range(n))


def _join(first: list[Point], second: list[Point]) -> list[Point] | None:
    """Return the union of two polygons that share an edge if it is convex."""
    back = {(b, a): j for j, (a, b) in enumerate(_edges(second))}
    i, j = next((i, back[edge]) for i, edge in enumerate(_edges(first)) if edge in back)
    tail = (second + second)[j + 2 : j + len(second)]
    joined = first[: i + 1] + tail + first[i + 1 :]
    return joined if _is_convex(joined) else None


def _inflate(part: tuple[Point, ...], by: float) -> FloatArray:
    """Return a convex polygon that contains every point within ``by`` of the convex ``part``.

    Edges move outwards by ``by``; at each corner the rounded offset is replaced by tangents no more
    than 45 degrees apart, so the polygon exceeds the exact offset by at most 8 % of ``by``.
    """
    if by == 0.0:
        return np.array(part)
    n = len(part)
    normals = []
    for i in range(n):
        (x0, y0), (x1, y1) = part[i], part[(i + 1) % n]
        normals.append(math.atan2(-(x1 - x0), y1 - y0))
    corners = []
    for i in range(n):
        before, after = normals[i - 1], normals[i]
        turn = (after - before) % (2 * math.pi)
        pieces = max(1, math.ceil(turn / (math.pi / 4) - 1e-9))
        reach = by / math.cos(turn / pieces / 2)
        for k in range(pieces):
            angle = before + turn * (k + 0.5) / pieces
            corners.append(
                (part[i][0] + reach * math.cos(angle), part[i][1] + reach * math.sin(angle))
            )
    return np.array(corners)


def _covering_discs(part: tuple[Point, ...]) -> FloatArray:
    """Return discs (x, y, r) of shape (k, 3) that cover a convex polygon (via its tightest box)."""
    points = np.array(part)
    best: tuple[float, float, FloatArray, FloatArray] | None = None
    for i in range(len(points)):
        edge = points[(i + 1) % len(points)] - points[i]
        axis = math.atan2(edge[1], edge[0])
        frame = np.array([[math.cos(axis), math.sin(axis)], [-math.sin(axis), math.cos(axis)]])
        local = points @ frame.T
        low, high = local.min(axis=0), local.max(axis=0)
        area = float(np.prod(high - low))
        if best is None or area < best[0]:
            best = (area, axis, low, high)
    assert best is not None
    _, axis, low, high = best
    size = high - low
    along = int(np.argmax(size))
    count = int(min(8, max(1, math.ceil(2.0 * size[along] / max(size[1 - along], 1e-6)))))
    share = (np.arange(count) + 0.5) / count
    local = np.empty((count, 2))
    local[:, along] = low[along] + share * size[along]
    local[:, 1 - along] = 0.5 * (low + high)[1 - along]
    radius = 0.5 * math.hypot(size[along] / count, size[1 - along]) + 1e-12
    back = np.array([[math.cos(axis), -math.sin(axis)], [math.sin(axis), math.cos(axis)]])
    return np.column_stack([local @ back.T, np.full(count, radius)])


def rules_of(zones: Sequence[TrafficZone], radius: float) -> RuleData:
    """Return zones as the kernels take them, for a body of ``radius`` m: convex parts of where the
    reference point is bound by each rule.
    """
    parts: list[tuple[tuple[float, float], ...]] = []
    rules: list[tuple[float, float, float]] = []
    for zone in zones:
        area = shapely.Polygon(zone.polygon)
        bound: list[tuple[shapely.Geometry, tuple[float, float, float]]] = []
        if zone.one_way is not None:
            way = (math.cos(zone.one_way), math.sin(zone.one_way), 0.0)
            bound.append((area.buffer(WIDER, join_style="mitre"), way))
        if not zone.pivots:
            # a little wider: a buffer's corners are rounded by chords
            bound.append((area.buffer(1.02 * radius), (0.0, 0.0, 1.0)))
        for where, rule in bound:
            ring = _checked(tuple((float(x), float(y)) for x, y in where.exterior.coords[:-1]))
            for part in convex_parts(ring):
                parts.append(part)
                rules.append(rule)
    return RuleData(*padded(parts), np.array(rules, dtype=np.float64).reshape(-1, 3))
