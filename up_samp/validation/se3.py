"""Bodies with meshes that move in space (SE3): own distances and sweeps, no collision library.

Two meshes are apart by the least distance of their triangles (C. Ericson, *Real-Time Collision
Detection*, 2005, sections 5.1.5, 5.1.9 and 5.3.6, for arrays). What has no height of its own, the
map's blocked part and most bodies that move in the plane, stands from the floor to the sky: there
the mesh counts as its shadow on the floor. A body of a height is a prism. Touching counts as
contact. Lengths in m, times in s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely

from up_samp.model import UnsupportedError
from up_samp.model.arrays import FloatArray
from up_samp.validation.collisions import JudgedShape, first_contact, hits_body, placed
from up_samp.validation.maps import BlockedMap
from up_samp.validation.solids import Solid, matrices, mesh_distance, swallowed
from up_samp.validation.tracks import Track


@dataclass(frozen=True)
class SpaceTrack(Track):
    """A body's pose in space over all time: straight between samples, the orientation by slerp
    (Shoemake 1985); at rest before the first and after the last sample. ``poses`` (n, 7).
    """

    _turns: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        q = self.poses[:, 3:] / np.linalg.norm(self.poses[:, 3:], axis=1, keepdims=True)
        # the same orientation has two quaternions: take those on one side
        flips = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0)
        q[1:] *= np.cumprod(flips)[:, None]
        object.__setattr__(self, "poses", np.hstack((self.poses[:, :3], q)))
        dots = np.clip(np.sum(q[1:] * q[:-1], axis=1), -1.0, 1.0)
        object.__setattr__(self, "_turns", np.append(np.arccos(dots), 0.0))
        steps = np.linalg.norm(np.diff(self.poses[:, :3], axis=0), axis=1)
        steps = steps + 2 * self.radius * self._turns[:-1]
        object.__setattr__(self, "_travel", np.concatenate(([0.0], np.cumsum(steps))))

    def poses_at(self, times: FloatArray) -> FloatArray:
        """Return the poses at ``times`` (k,), shape (k, 7)."""
        i, share = self._locate(times)
        a, b = self.poses[i], self.poses[np.minimum(i + 1, len(self.poses) - 1)]
        s = share[:, None]
        turn = self._turns[i][:, None]
        small = turn < 1e-6
        sine = np.where(small, 1.0, np.sin(turn))
        first = np.where(small, 1 - s, np.sin((1 - s) * turn) / sine)
        second = np.where(small, s, np.sin(s * turn) / sine)
        position = a[:, :3] + s * (b[:, :3] - a[:, :3])
        return np.hstack((position, first * a[:, 3:] + second * b[:, 3:]))


def track_of(times: FloatArray, poses: FloatArray, radius: float) -> Track:
    """Return the track of a trajectory, planar (n, 3) or in space (n, 7)."""
    kind = SpaceTrack if poses.shape[1] == 7 else Track
    return kind(times, poses, radius)


def shadows(solid: Solid, pose: FloatArray) -> Any:
    """Return the shapely geometries that a mesh's triangles cover on the floor."""
    corners = solid.triangles @ matrices(pose[None, 3:])[0].T + pose[:3]
    return shapely.convex_hull(shapely.multipoints(corners[..., :2]))


# ---------------------------------------------------------------------------------- sweeps
def hits_map_from_space(
    solid: Solid, track: Track, blocked: BlockedMap, low: float, high: float
) -> float | None:
    """Return a time in [low, high] at which a mesh's shadow meets the map's blocked part."""

    def gap(times: FloatArray) -> FloatArray:
        poses = track.poses_at(times)
        apart = blocked.distances_of(shapely.points(poses[:, :2])) - solid.radius
        for k in np.flatnonzero(apart <= 0.5 * solid.radius):
            apart[k] = blocked.distances_of(shadows(solid, poses[k])).min()
        return np.asarray(apart)

    return first_contact(low, high, gap, track.travel)


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
        if any(isinstance(one, SpaceTrack) for one in (track, other_track)):
            raise UnsupportedError("bodies without a mesh move in the plane")
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
    for level in (bottom, shape.height):
        for cap in caps:
            flat = shapely.get_coordinates(cap)[:3]
            triangles.append(np.column_stack((flat, np.full(3, level))))
    for a, b in zip(corners, after, strict=True):
        low_a, low_b, high_a, high_b = ((*p, z) for z in (bottom, shape.height) for p in (a, b))
        triangles += [np.array([low_a, low_b, high_b]), np.array([low_a, high_b, high_a])]
    return Solid(shape.name, np.array(triangles), True)


def _gap_at(
    solid: Solid, pose: FloatArray, other: JudgedShape | Solid, other_pose: FloatArray
) -> float:
    if isinstance(other, Solid):
        return mesh_distance(solid, pose, other, upright(other_pose))
    polygon = shapely.Polygon(placed(other.corners, other_pose[None])[0])
    return float(shapely.distance(shadows(solid, pose), polygon).min())
