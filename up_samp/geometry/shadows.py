"""What bodies in space are to bodies that drive below them: their shadows on the floor.

A flyer is no obstacle to a driver where all of it is above the driver. Where some of it is not, the
driver has to keep clear of the shadow of that part, and of nothing more: the part of a mesh below a
plane projects to the same area as what a driver of that height would touch.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import numpy as np
import shapely

from up_samp.geometry.meshes import load_mesh, rotation
from up_samp.model import Body, Kinematics, MotionModel, Placed, ProblemError
from up_samp.model.arrays import FloatArray

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
