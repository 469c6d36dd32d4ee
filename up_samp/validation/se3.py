"""Bodies with meshes that move in space (SE3): own distances and sweeps, no collision library.

Two meshes are apart by the least distance of their triangles (C. Ericson, *Real-Time Collision
Detection*, 2005, sections 5.1.5, 5.1.9 and 5.3.6, for arrays). What has no height of its own, the
map's blocked part and most bodies that move in the plane, stands from the floor to the sky: there
the mesh counts as its shadow on the floor. A body of a height is a prism. Touching counts as
contact. Lengths in m, times in s.
"""

from __future__ import annotations

import importlib
import itertools
import math
import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely

from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.validation.collisions import (
    BlockedMap,
    JudgedShape,
    Track,
    first_contact,
    hits_body,
    hits_map,
    placed,
    rotations,
)

_EDGES = ((0, 1), (1, 2), (2, 0))


_PAIRS = 200_000
"""Pairs of triangles that are looked at in one go."""


_ASKEW = np.array([0.6127, 0.3391, 0.7139])
"""Direction of the ray that tells inside from outside; askew, to miss edges."""


@dataclass(frozen=True)
class Solid:
    """A mesh: ``triangles`` (k, 3, 3) in the body frame; ``closed`` if it has an inside."""

    name: str
    triangles: FloatArray
    closed: bool
    radius: float = field(init=False)
    centres: FloatArray = field(init=False)
    reaches: FloatArray = field(init=False)
    """Radii of the spheres around ``centres`` that hold the triangles."""

    def __post_init__(self) -> None:
        centres = self.triangles.mean(axis=1)
        reaches = np.linalg.norm(self.triangles - centres[:, None], axis=2).max(axis=1)
        object.__setattr__(self, "radius", float(np.linalg.norm(self.triangles, axis=2).max()))
        object.__setattr__(self, "centres", centres)
        object.__setattr__(self, "reaches", reaches)


def load_solid(name: str, file: str | None) -> Solid:
    """Read an object's mesh file; its numbers are metres."""
    if file is None:
        raise UnsupportedError(f"object {name}: an SE3 body without a geometric model")
    if not os.path.isfile(file):
        raise ProblemError(f"object {name}: the geometric model {file} is not a file")
    try:
        trimesh = importlib.import_module("trimesh")
    except ImportError:
        raise UnsupportedError(
            f"object {name}: meshes need trimesh (pip install trimesh coal)"
        ) from None
    try:
        mesh = trimesh.load(file, force="mesh")
        triangles = np.array(mesh.triangles, dtype=np.float64)
    except Exception as error:  # each of trimesh's readers has errors of its own
        text = f"object {name}: the geometric model {file} cannot be read: {error}"
        raise ProblemError(text) from error
    if triangles.ndim != 3 or len(triangles) == 0 or not np.isfinite(triangles).all():
        raise ProblemError(f"object {name}: the geometric model {file} holds no finite triangles")
    return Solid(name, triangles, bool(mesh.is_watertight))


# --------------------------------------------------------------------------------- motion
def matrix(pose: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a pose (7,)."""
    return np.asarray(rotations(pose[3:]).as_matrix())


# ------------------------------------------------------------------------------- distances
def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.einsum("...i,...i->...", a, b)


def _edge_distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return distances of segments (n, 2, 3) to segments (n, 2, 3) (Ericson, 5.1.9)."""
    d1, d2, r = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0], a[:, 0] - b[:, 0]
    aa, ee, f = _dot(d1, d1), _dot(d2, d2), _dot(d2, r)
    c, bb = _dot(d1, r), _dot(d1, d2)
    tiny = 1e-30
    denominator = aa * ee - bb * bb
    # (nearly) parallel: any point of the first will do to begin with
    skew = denominator > 1e-12 * aa * ee
    s = np.where(skew, (bb * f - c * ee) / np.where(skew, denominator, 1.0), 0.0).clip(0, 1)
    t = (bb * s + f) / np.maximum(ee, tiny)
    s = np.where(t < 0, -c, np.where(t > 1, bb - c, s * aa)) / np.maximum(aa, tiny)
    s, t = s.clip(0, 1), t.clip(0, 1)
    between = r + s[:, None] * d1 - t[:, None] * d2
    return np.asarray(np.sqrt(_dot(between, between)))


def _above(points: FloatArray, tri: FloatArray) -> FloatArray:
    """Return the distances of points (n, 3) to the triangles (n, 3, 3) that they lie straight above
    or below of; infinite for others (an edge is nearest to them).
    """
    u, v, w = tri[:, 1] - tri[:, 0], tri[:, 2] - tri[:, 0], points - tri[:, 0]
    normal = np.cross(u, v)
    square = _dot(normal, normal)
    safe = np.where(square > 0, square, 1.0)
    beta = _dot(np.cross(w, v), normal) / safe
    gamma = _dot(np.cross(u, w), normal) / safe
    inside = (square > 0) & (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1)
    return np.where(inside, np.abs(_dot(w, normal)) / np.sqrt(safe), np.inf)


def pierced(start: FloatArray, end: FloatArray, tri: FloatArray) -> BoolArray:
    """Return which segments (n, 3) to (n, 3) cross their triangles (n, 3, 3) (Ericson, 5.3.6)."""
    u, v = tri[:, 1] - tri[:, 0], tri[:, 2] - tri[:, 0]
    way, w = start - end, start - tri[:, 0]
    normal = np.cross(u, v)
    d = _dot(way, normal)
    usable = np.abs(d) > 1e-300
    safe = np.where(usable, d, 1.0)
    t = _dot(w, normal) / safe
    e = np.cross(way, w)
    beta, gamma = _dot(v, e) / safe, -_dot(u, e) / safe
    on = (t >= 0) & (t <= 1) & (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1)
    return np.asarray(usable & on)


def triangle_distances(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the distances of triangles (n, 3, 3) to triangles (n, 3, 3), 0 where they meet."""
    best = np.full(len(p), np.inf)
    for (a, b), (c, d) in itertools.product(_EDGES, _EDGES):
        best = np.minimum(best, _edge_distances(p[:, [a, b]], q[:, [c, d]]))
    for one, other in ((p, q), (q, p)):
        for k in range(3):
            best = np.minimum(best, _above(one[:, k], other))
        for a, b in _EDGES:
            best[pierced(one[:, a], one[:, b], other)] = 0.0
    return best


def mesh_distance(a: Solid, pose_a: FloatArray, b: Solid, pose_b: FloatArray) -> float:
    """Return the distance of two meshes' surfaces at poses (7,), 0 where they meet."""
    turn_a, turn_b = matrix(pose_a), matrix(pose_b)
    # everything in the frame of b
    turn, shift = turn_b.T @ turn_a, turn_b.T @ (pose_a[:3] - pose_b[:3])
    mine, centres = a.triangles @ turn.T + shift, a.centres @ turn.T + shift
    low = np.linalg.norm(centres[:, None] - b.centres[None], axis=2)
    low -= a.reaches[:, None] + b.reaches[None]
    order = np.argsort(low, axis=None)
    best, at, size = math.inf, 0, 16
    while at < len(order) and low.flat[order[at]] < best:
        i, j = np.unravel_index(order[at : at + size], low.shape)
        best = min(best, float(triangle_distances(mine[i], b.triangles[j]).min()))
        at, size = at + size, min(8 * size, _PAIRS)
        if best <= 0:
            break
    return best


def inside(solid: Solid, pose: FloatArray, points: FloatArray) -> bool:
    """Return whether the first of ``points`` is in a closed mesh: rays leave it oddly often."""
    if not solid.closed:
        return False
    here = (points[0] - pose[:3]) @ matrix(pose)
    far = here + _ASKEW * (4 * solid.radius + float(np.linalg.norm(here)))
    count = len(solid.triangles)
    start, end = np.tile(here, (count, 1)), np.tile(far, (count, 1))
    return bool(np.count_nonzero(pierced(start, end, solid.triangles)) % 2)


def swallowed(a: Solid, pose_a: FloatArray, b: Solid, pose_b: FloatArray) -> bool:
    """Return whether one of two bodies whose surfaces do not meet lies inside the other."""
    corner_a = a.triangles[0] @ matrix(pose_a).T + pose_a[:3]
    corner_b = b.triangles[0] @ matrix(pose_b).T + pose_b[:3]
    return inside(a, pose_a, corner_b) or inside(b, pose_b, corner_a)


@dataclass(frozen=True)
class SpaceTrack(Track):
    """A body's pose in space over all time: straight between samples, the orientation by slerp
    (Shoemake 1985); at rest before the first and after the last sample. ``poses`` (n, 7).
    """

    _turns: FloatArray = field(init=False, repr=False)
    """From each sample to the next, as rotation vectors (n, 3); none after the last."""

    def __post_init__(self) -> None:
        after = self.poses[[*range(1, len(self.poses)), -1]]
        turns = (rotations(self.poses[:, 3:]).inv() * rotations(after[:, 3:])).as_rotvec()
        object.__setattr__(self, "_turns", turns)
        steps = np.linalg.norm(after[:, :3] - self.poses[:, :3], axis=1)
        steps = steps + self.radius * np.linalg.norm(turns, axis=1)
        object.__setattr__(self, "_travel", np.concatenate(([0.0], np.cumsum(steps[:-1]))))

    def poses_at(self, times: FloatArray) -> FloatArray:
        """Return the poses at ``times`` (k,), shape (k, 7)."""
        i, share = self._locate(times)
        s, here = share[:, None], rotations(self.poses[i, 3:])
        step = self.poses[np.minimum(i + 1, len(self.poses) - 1), :3] - self.poses[i, :3]
        turned = here * type(here).from_rotvec(s * self._turns[i])
        return np.hstack((self.poses[i, :3] + s * step, turned.as_quat()))


def track_of(times: FloatArray, poses: FloatArray, radius: float) -> Track:
    """Return the track of a trajectory, planar (n, 3) or in space (n, 7)."""
    kind = SpaceTrack if poses.shape[1] == 7 else Track
    return kind(times, poses, radius)


def shadows(solid: Solid, pose: FloatArray) -> Any:
    """Return the shapely geometries that a mesh's triangles cover on the floor."""
    corners = solid.triangles @ matrix(pose).T + pose[:3]
    return shapely.convex_hull(shapely.multipoints(corners[..., :2]))


# ---------------------------------------------------------------------------------- sweeps
def meets_map(
    shape: JudgedShape | Solid, track: Track, blocked: BlockedMap, low: float, high: float
) -> float | None:
    """Return a time in [low, high] at which a moving body, or its shadow, meets the map."""
    if isinstance(shape, JudgedShape):
        _check_planar(track)
        return hits_map(shape, track, blocked, low, high)

    def gap(times: FloatArray) -> FloatArray:
        poses = track.poses_at(times)
        apart = blocked.distances_of(shapely.points(poses[:, :2])) - shape.radius
        for k in np.flatnonzero(apart <= 0.5 * shape.radius):
            apart[k] = blocked.distances_of(shadows(shape, poses[k])).min()
        return np.asarray(apart)

    return first_contact(low, high, gap, track.travel)


def _check_planar(*tracks: Track) -> None:
    if any(isinstance(one, SpaceTrack) for one in tracks):
        raise UnsupportedError("bodies without a mesh move in the plane")


def hits(
    shape: JudgedShape | Solid,
    track: Track,
    other: JudgedShape | Solid,
    other_track: Track,
    low: float,
    high: float,
) -> float | None:
    """Return a time in [low, high] at which two bodies meet, in the plane or in space."""
    if isinstance(shape, JudgedShape) and isinstance(other, JudgedShape):
        _check_planar(track, other_track)
        return hits_body(shape, track, other, other_track, low, high)
    if not isinstance(shape, Solid):
        return hits(other, other_track, shape, track, low, high)
    radii = shape.radius + other.radius
    flat = 2 if isinstance(other, JudgedShape) else 3
    body = other
    if isinstance(other, JudgedShape) and math.isfinite(other.height):
        lowest = min(0.0, float(track.poses[:, 2].min()))  # of its origin, the floor at most
        body = prism(other, lowest - 2 * shape.radius - 1.0)

    def gap(times: FloatArray) -> FloatArray:
        mine, theirs = track.poses_at(times), other_track.poses_at(times)
        apart = np.linalg.norm(mine[:, :flat] - theirs[:, :flat], axis=1) - radii
        for k in np.flatnonzero(apart <= 0.5 * radii):
            apart[k] = _gap_at(shape, mine[k], body, theirs[k])
        return np.asarray(apart)

    if isinstance(body, Solid):
        # surfaces that never meet cannot swallow each other on the way: look once
        begin = np.array([low])
        ends = track.poses_at(begin)[0], upright(other_track.poses_at(begin)[0])
        if swallowed(shape, ends[0], body, ends[1]):
            return low

    def travel(a: FloatArray, b: FloatArray) -> FloatArray:
        return track.travel(a, b) + other_track.travel(a, b)

    return first_contact(low, high, gap, travel)


def upright(pose: FloatArray) -> FloatArray:
    """Return a pose (7,): a pose in the plane (3,) stands upright on the floor."""
    if len(pose) == 7:
        return pose
    x, y, heading = pose
    return np.array([x, y, 0.0, 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)])


def prism(shape: JudgedShape, bottom: float) -> Solid:
    """Return a body of a height that moves in the plane, from far below to its height (m)."""
    corners, after = shape.corners, np.roll(shape.corners, -1, axis=0)
    caps = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(corners)))
    triangles = []
    for level, cap in itertools.product((bottom, shape.height), caps):
        flat = shapely.get_coordinates(cap)[:3]
        triangles.append(np.column_stack((flat, np.full(3, level))))
    for a, b in zip(corners, after, strict=True):
        low_a, low_b, high_a, high_b = (
            (*p, z) for z, p in itertools.product((bottom, shape.height), (a, b))
        )
        triangles += [np.array([low_a, low_b, high_b]), np.array([low_a, high_b, high_a])]
    return Solid(shape.name, np.array(triangles), True)


def _gap_at(
    solid: Solid, pose: FloatArray, other: JudgedShape | Solid, other_pose: FloatArray
) -> float:
    if isinstance(other, Solid):
        return mesh_distance(solid, pose, other, upright(other_pose))
    polygon = shapely.Polygon(placed(other.corners, other_pose[None])[0])
    return float(shapely.distance(shadows(solid, pose), polygon).min())
