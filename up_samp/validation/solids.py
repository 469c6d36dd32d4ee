"""Solids in space, of triangles, and how far they are from each other."""

from __future__ import annotations

import importlib
import itertools
import math
import os
from dataclasses import dataclass, field

import numpy as np

from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.arrays import BoolArray, FloatArray

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
def matrices(quaternions: FloatArray) -> FloatArray:
    """Return the rotation matrices (k, 3, 3) of quaternions (k, 4), x y z w, of any length."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


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
    turn_a, turn_b = matrices(pose_a[None, 3:])[0], matrices(pose_b[None, 3:])[0]
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
    """Return whether the first of world ``points`` lies inside a closed mesh: a ray crosses the
    surface an odd number of times.
    """
    if not solid.closed:
        return False
    here = (points[0] - pose[:3]) @ matrices(pose[None, 3:])[0]
    far = here + _ASKEW * (4 * solid.radius + float(np.linalg.norm(here)))
    count = len(solid.triangles)
    start, end = np.tile(here, (count, 1)), np.tile(far, (count, 1))
    return bool(np.count_nonzero(pierced(start, end, solid.triangles)) % 2)


def swallowed(a: Solid, pose_a: FloatArray, b: Solid, pose_b: FloatArray) -> bool:
    """Return whether one of two bodies whose surfaces do not meet lies inside the other."""
    corner_a = a.triangles[0] @ matrices(pose_a[None, 3:])[0].T + pose_a[:3]
    corner_b = b.triangles[0] @ matrices(pose_b[None, 3:])[0].T + pose_b[:3]
    return inside(a, pose_a, corner_b) or inside(b, pose_b, corner_a)
