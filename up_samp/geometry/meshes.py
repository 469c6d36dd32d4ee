"""Solid bodies in space: triangle meshes, walls that rise from a map, their distances, and what
they are to bodies that drive below them.

Needs the optional extra ``meshes``: ``trimesh`` reads the files, ``coal`` (the successor of
hpp-fcl) measures. Lengths in m; poses are (x, y, z, qx, qy, qz, qw) in the world frame.
"""

from __future__ import annotations

import importlib
import itertools
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.geometry.maps import OccupancyGrid
from up_samp.geometry.scene import placed_polygons
from up_samp.model import (
    Body,
    Configuration,
    Kinematics,
    MotionModel,
    Placed,
    ProblemError,
    UnsupportedError,
)
from up_samp.model.arrays import FloatArray, IntArray


@cache
def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise UnsupportedError(
            f"bodies with meshes need the package '{name}': pip install trimesh coal"
        ) from error


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in its body's frame. ``vertices`` (n, 3), ``faces`` (m, 3).

    ``radius`` (m) is the distance of the farthest vertex from the body's reference point (the
    origin); ``closed`` tells whether the surface has an inside; ``solid`` is coal's model of it.
    """

    vertices: FloatArray
    faces: IntArray
    radius: float
    closed: bool
    solid: Any

    @cached_property
    def crossings(self) -> tuple[FloatArray, FloatArray]:
        """How far along a ray from a point p (body frame), and where in a triangle, the ray meets
        the plane of each triangle that it is not parallel to: ``m @ p + c`` for these m (3, k, 3)
        and c (3, k) (Moller & Trumbore 1997: all three are linear in p).
        """
        ray = np.array([0.5773, 0.2113, 0.7887])  # askew, to miss edges
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        one, two = b - a, c - a
        across = np.cross(ray, two)
        det = np.sum(one * across, axis=1)
        usable = np.abs(det) > 1e-14
        found = np.array([across, np.cross(one, ray), np.cross(one, two)])[:, usable]
        found /= det[usable, None]
        return found, -np.sum(found * a[usable], axis=2)


def make_mesh(vertices: npt.ArrayLike, faces: npt.ArrayLike, closed: bool = True) -> Mesh:
    """Return a mesh from its arrays."""
    coal = _library("coal")
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    corners = np.ascontiguousarray(faces, dtype=np.int64)
    model = coal.BVHModelOBBRSS()
    positions, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in points:
        positions.append(point)
    for a, b, c in corners.tolist():
        triangles.append(coal.Triangle(a, b, c))
    model.beginModel(len(corners), len(points))
    model.addSubModel(positions, triangles)
    model.endModel()
    return Mesh(points, corners, float(np.linalg.norm(points, axis=1).max()), closed, model)


def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read a mesh file (STL, OBJ, PLY, OFF, GLB ...; cached). Its numbers are taken as metres.

    Raises ``ProblemError`` naming the file if it is missing, unreadable, or holds no triangles.
    """
    name = os.fspath(path)
    if not os.path.isfile(name):
        raise ProblemError(f"the geometric model '{name}' is not a file")
    status = os.stat(name)
    return _load(name, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=64)
def _load(name: str, _modified: int, _size: int) -> Mesh:
    trimesh = _library("trimesh")
    try:
        mesh = trimesh.load(name, force="mesh")
        vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    except Exception as error:  # each of trimesh's readers has errors of its own
        raise ProblemError(f"the geometric model '{name}' cannot be read: {error}") from error
    if faces.ndim != 2 or len(faces) == 0 or faces.shape[1] != 3:
        raise ProblemError(f"the geometric model '{name}' holds no triangles")
    if not np.isfinite(vertices).all():
        raise ProblemError(f"the geometric model '{name}' has corners that are not finite")
    return make_mesh(vertices, faces, bool(mesh.is_watertight))


def prism(polygons: Sequence[FloatArray], low: float, high: float) -> Mesh:
    """Return the upright prisms over convex polygons (n, 2), counter-clockwise, world frame."""
    vertices: list[FloatArray] = []
    faces: list[tuple[int, int, int]] = []
    base = 0
    for ring in polygons:
        n = len(ring)
        vertices.extend(np.column_stack((ring, np.full(n, height))) for height in (low, high))
        for i in range(n):
            j = (i + 1) % n
            faces += [(base + i, base + j, base + n + j), (base + i, base + n + j, base + n + i)]
        for i in range(1, n - 1):
            faces += [(base, base + i + 1, base + i), (base + n, base + n + i, base + n + i + 1)]
        base += 2 * n
    return make_mesh(np.concatenate(vertices), np.array(faces))


def wall_rectangles(grid: OccupancyGrid) -> list[FloatArray]:
    """Return the blocked cells of a map, and a ring of cells around it, as few rectangles (4, 2),
    counter-clockwise in the world frame: runs along rows, joined where the next row has the same.
    """
    blocked = np.pad(grid.blocked, 1, constant_values=True)
    done: list[tuple[int, int, int, int]] = []
    growing: dict[tuple[int, int], int] = {}
    for row in range(blocked.shape[0] + 1):
        runs: set[tuple[int, int]] = set()
        if row < blocked.shape[0]:
            edges = np.flatnonzero(
                np.diff(np.concatenate(([0], blocked[row].astype(np.int8), [0])))
            )
            runs = {(int(a), int(b)) for a, b in edges.reshape(-1, 2)}
        done.extend((growing.pop(run), row, *run) for run in [r for r in growing if r not in runs])
        for run in runs:
            growing.setdefault(run, row)
    found = []
    for r0, r1, c0, c1 in sorted(done):
        corners = ((r0, c0), (r0, c1), (r1, c1), (r1, c0))
        # point_of gives centres of cells, and the ring of padding is cell -1
        found.append(np.array([grid.point_of(r - 1.5, c - 1.5) for r, c in corners]))
    return found


def mesh_of(body: Body, pose: Configuration, low: float, high: float) -> tuple[Mesh, Configuration]:
    """Return a resting body's mesh and its pose in space.

    A body that moves in the plane stands as a prism from ``low`` to ``high``, or up to its own
    height where it has one.
    """
    if not body.flies:
        rest = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        top = min(high, body.height)
        return prism(placed_polygons(body, pose), min(low, top - 1.0), top), rest
    if body.mesh is None:
        raise ProblemError("a body that moves in space (SE3) needs a geometric model (a mesh file)")
    return load_mesh(body.mesh), pose


def transform(pose: Sequence[float]) -> Any:
    """Return coal's transform for a pose (its quaternion need not be of length 1)."""
    coal = _library("coal")
    result = coal.Transform3s()
    result.setRotation(rotation(pose[3:]))
    result.setTranslation(np.array(pose[:3], dtype=np.float64))
    return result


def rotation(q: Sequence[float]) -> FloatArray:
    """Return the matrix (3, 3) of a quaternion (x, y, z, w)."""
    size = math.sqrt(sum(v * v for v in q))
    if size < 1e-9:
        raise ProblemError("a quaternion of length 0 is no orientation")
    x, y, z, w = (float(v) / size for v in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def surface_distance(a: Mesh, place_a: Any, b: Mesh, place_b: Any) -> float:
    """Return the distance (m) of two surfaces at their transforms; 0 where they cross."""
    coal = _library("coal")
    result = coal.DistanceResult()
    found = coal.distance(a.solid, place_a, b.solid, place_b, coal.DistanceRequest(), result)
    return max(0.0, float(found))


def contains(mesh: Mesh, point: npt.ArrayLike) -> bool:
    """Return whether a point (body frame) lies inside a closed mesh: a ray from it crosses the
    surface an odd number of times. An open mesh has no inside.
    """
    if not mesh.closed:
        return False
    directions, offsets = mesh.crossings
    u, v, far = directions @ np.asarray(point, dtype=np.float64) + offsets
    crossed = (u >= 0) & (v >= 0) & (u + v <= 1) & (far > 0)
    return bool(np.count_nonzero(crossed) % 2)


def nested(a: Mesh, pose_a: Sequence[float], b: Mesh, pose_b: Sequence[float]) -> bool:
    """Return whether one of two bodies whose surfaces do not meet lies inside the other."""
    for one, here, other, there in ((a, pose_a, b, pose_b), (b, pose_b, a, pose_a)):
        corner = rotation(here[3:]) @ one.vertices[0] + np.array(here[:3])
        if contains(other, rotation(there[3:]).T @ (corner - np.array(there[:3]))):
            return True
    return False


def bodies_meet(body_a: Body, pose_a: Configuration, body_b: Body, pose_b: Configuration) -> bool:
    """Return whether two resting bodies, one of them in space at least, touch, or lie one inside
    the other.
    """
    heights = [p[2] for p in (pose_a, pose_b) if len(p) == 7]
    low, high = _tall((body_a, body_b), heights)
    (a, at_a), (b, at_b) = mesh_of(body_a, pose_a, low, high), mesh_of(body_b, pose_b, low, high)
    return _meet(a, at_a, b, at_b)


def _meet(a: Mesh, pose_a: Configuration, b: Mesh, pose_b: Configuration) -> bool:
    """Return whether two meshes touch (rounding counts), or lie one inside the other."""
    gap = surface_distance(a, transform(pose_a), b, transform(pose_b))
    return gap < 1e-7 or nested(a, pose_a, b, pose_b)


def meets_walls(grid: OccupancyGrid, body: Body, pose: Configuration) -> bool:
    """Return whether a body in space touches a map's blocked cells (which rise to the sky) or lies
    in one or outside the map.
    """
    low, high = _tall((body,), [pose[2]])
    walls = prism(wall_rectangles(grid), low, high)
    mesh, at = mesh_of(body, pose, low, high)
    row, col = grid.cells_of([pose[:2]])[0]
    rows, cols = grid.shape
    inside = 0 <= row < rows and 0 <= col < cols
    return not inside or _meet(mesh, at, walls, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


def _tall(bodies: Sequence[Body], heights: Sequence[float]) -> tuple[float, float]:
    """Return a floor and a sky (m) below and above all bodies with meshes at these heights."""
    meshes = [b.mesh for b in bodies if b.flies]
    reach = 2 * max((load_mesh(m).radius for m in meshes if m is not None), default=1.0) + 1.0
    return min(heights) - reach, max(heights) + reach


# ------------------ Shadows on the floor
# A flyer is no obstacle to a driver where all of it is above the driver. Where some of it is not,
# the driver has to keep clear of the shadow of that part, and of nothing more: the part of a mesh
# below a plane projects to the same area as what a driver of that height would touch.


THIN = 1e-7
"""Half the width (m) of the shadow of a sheet that stands upright, which covers no area by itself;
what is no further from another shadow is covered by that.
"""
LEAST = 1e-8
"""Least area (m^2) of a piece of a shadow."""
_STILL = Kinematics(MotionModel.SE2)


def met_by(body: Body, placed: Iterable[Placed]) -> tuple[Placed, ...]:
    """Return obstacles as a body meets them: to drivers, those in space are their shadows on the
    floor (polygons of the same name), none where all of it is above.
    """
    if body.flies:
        return tuple(placed)
    parts = (_shadows(one, body.height) if one.body.flies else (one,) for one in placed)
    return tuple(itertools.chain.from_iterable(parts))


def surely_met(body: Body, placed: Iterable[Placed]) -> tuple[Placed, ...]:
    """Return obstacles as whatever part of a body meets them: what is above the lowest one may be
    above that one alone.
    """
    return met_by(replace(body, height=min(body.low, body.height)), placed)


@lru_cache(maxsize=1024)
def _shadows(placed: Placed, height: float) -> tuple[Placed, ...]:
    """Return the shadow on the floor of the part of a body in space that is below ``height`` (m),
    as polygons without holes.
    """
    if placed.body.mesh is None:
        raise ProblemError(f"'{placed.name}' moves in space (SE3) and needs a mesh file")
    mesh = load_mesh(placed.body.mesh)
    corners = mesh.vertices @ rotation(placed.pose[3:]).T + np.array(placed.pose[:3])
    pieces = covered(corners[mesh.faces], height)
    return tuple(_resting(placed.name, piece) for piece in pieces)


def covered(triangles: FloatArray, height: float) -> list[Any]:
    """Return simple polygons whose union is where triangles (n, 3, 3), m, are below ``height``."""
    low = triangles[triangles[..., 2].min(axis=1) <= height]
    if len(low) == 0:
        return []
    points = [_clipped(t, height) if t[:, 2].max() > height else t[:, :2] for t in low]
    hulls = [shapely.convex_hull(shapely.MultiPoint(p)) for p in points]
    faces = shapely.union_all([h for h in hulls if h.geom_type == "Polygon"])
    around = shapely.buffer(faces, THIN)
    sheets = [h for h in hulls if h.geom_type != "Polygon" and not shapely.covers(around, h)]
    whole = shapely.union_all([faces, *shapely.buffer(sheets, THIN, quad_segs=1)])
    return [piece for polygon in _polygons(whole) for piece in _without_holes(polygon)]


def _clipped(triangle: FloatArray, height: float) -> FloatArray:
    """Return the corners, seen from above, of the part of a triangle at or below ``height``."""
    kept = [corner[:2] for corner in triangle if corner[2] <= height]
    for a, b in ((0, 1), (1, 2), (2, 0)):
        above, below = sorted((triangle[a], triangle[b]), key=lambda c: -c[2])
        if below[2] <= height < above[2]:
            share = (height - below[2]) / (above[2] - below[2])
            kept.append((below + share * (above - below))[:2])
    return np.array(kept)


def _polygons(shape: Any) -> list[Any]:
    return [p for p in shapely.get_parts(shape) if p.geom_type == "Polygon" and p.area > LEAST]


def _without_holes(polygon: Any) -> list[Any]:
    if not polygon.interiors:
        return [polygon]
    return _polygons(shapely.constrained_delaunay_triangles(polygon))


def _resting(name: str, polygon: Any) -> Placed:
    """Return an obstacle of the shape of a polygon (world frame), about its own middle."""
    x, y = polygon.centroid.x, polygon.centroid.y
    ring = shapely.get_coordinates(polygon.exterior)[:-1] - (x, y)
    return Placed(name, Body(tuple(map(tuple, ring.tolist())), _STILL), (x, y, 0.0))
