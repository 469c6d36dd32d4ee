"""Cheap detours: leave the path for a parallel lane where it meets something, and come back."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np

from up_samp.geometry.kernels import first_hit
from up_samp.geometry.scene import Scene
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.blending import glide, pieces
from up_samp.motion.curves.reeds_shepp import DriveLimits, fastest
from up_samp.motion.curves.rolling import rolled, rolling_radius, rows_of, thinned
from up_samp.motion.curves.trapezoid import limits_of
from up_samp.motion.fleet.paths import Path, path_of

EXACT = 1e-7
"""Metres, or rad, by which a lane may miss the path that it comes back to."""


def lane_offsets(path: Path, other: Path) -> list[float]:
    """Return the sideways offsets (m) worth a try to pass ``other``, small ones first."""
    width = path.radius + other.radius
    return [side * share * width for share in (0.5, 0.8, 1.15) for side in (-1.0, 1.0)]


def shifted_lane(scene: Scene, path: Path, first: float, last: float, offset: float) -> Path | None:
    """Return ``path`` moved sideways by ``offset`` m (left > 0) on [first, last] (m along it), if
    the map allows it. For a path without waypoints.
    """
    able = path.body.mobility
    if able.own_law:
        return None
    if able.sideways:
        return _beside(scene, path, first, last, offset)
    return _swerved(scene, path, first, last, offset)


def _beside(scene: Scene, path: Path, first: float, last: float, offset: float) -> Path | None:
    """Return the lane of a body that moves sideways: out of the path, along it and back."""
    reach = abs(offset) + path.hull.radius
    begin, end = max(first - reach, 0.0), min(last + reach, path.length)
    if not begin < first < last < end:
        return None
    near = 0.1 * path.hull.radius
    marks = np.linspace(first, last, max(2, math.ceil((last - first) / reach) + 1))
    middle = path.poses_at(marks)
    ahead = path.poses_at(np.minimum(marks + near, path.length))
    behind = path.poses_at(np.maximum(marks - near, 0.0))
    way = ahead[:, :2] - behind[:, :2]
    sizes = np.hypot(*way.T)
    if sizes.min() < 0.5 * near:  # it turns there, or rests
        return None
    middle[:, 0] -= offset * way[:, 1] / sizes
    middle[:, 1] += offset * way[:, 0] / sizes
    before = path.poses_at(np.append(path.s[path.s < begin], begin))
    after = path.poses_at(np.append(end, path.s[path.s > end]))
    nodes = np.concatenate([_thinned(before), _thinned(middle), _thinned(after)])
    world = scene.world(scene.shape(path.body))
    found = glide(world, path.body.kinematics, pieces(nodes), path.ends[1])
    return None if found is None else path_of(found[0], path.body, path.ends)


def _thinned(rows: FloatArray, off_line: float = 0.01) -> FloatArray:
    """Return the poses (n, 3) without those within ``off_line`` m of the line between others
    (Ramer 1972, Douglas & Peucker 1973; a radian counts as a metre).
    """
    if len(rows) < 3:
        return rows
    line = rows[-1] - rows[0]
    size = float(np.linalg.norm(line))
    share = (rows - rows[0]) @ line / max(size * size, 1e-12)
    off = np.linalg.norm(rows - rows[0] - np.clip(share, 0.0, 1.0)[:, None] * line, axis=1)
    worst = int(np.argmax(off))
    if off[worst] < off_line:
        return rows[[0, -1]]
    return np.concatenate([_thinned(rows[: worst + 1]), _thinned(rows[worst:])[1:]])


def _swerved(scene: Scene, path: Path, first: float, last: float, offset: float) -> Path | None:
    """Return the lane of a body that drives along its heading: arcs, between the places where it
    rests.
    """
    kin, stops = path.body.kinematics, path.s[path.stop]
    car = limits_of(kin)
    if path.body.mobility.pivots:
        car = car._replace(radius=rolling_radius(kin))
    # two equal arcs take about 2 sqrt(|d| (2 R - |d| / 2)), with some air
    reach = 2.0 * math.sqrt(abs(offset) * car.radius * 2.0) + car.radius
    begin = max(first - reach, float(stops[stops <= first + 1e-9][-1]))
    end = min(last + reach, float(stops[stops >= last - 1e-9][0]))
    if not begin < first < last < end or np.any((stops > first) & (stops < last)):
        return None
    marks = np.array([begin, first, last, end])
    poses = _aside(path, marks, offset)
    curves = curves_through(poses, np.diff(marks), car)
    if curves is None:
        return None
    parts = [np.concatenate([path.poses[path.s < begin - EXACT], poses[:1]])]
    for curve, target in zip(curves, poses[1:], strict=True):
        rows = rows_of(np.ascontiguousarray(parts[-1][-1]), curve)
        if np.abs(_off(rows[-1], target)).max() > EXACT:
            return None
        parts.append(rows[1:])
    after = path.poses[path.s > end + EXACT].copy()
    after[:, 2] += parts[-1][-1, 2] - poses[-1, 2] - _off(parts[-1][-1], poses[-1])[2]
    rows = thinned(np.concatenate([*parts, after]), kin)
    if first_hit(scene.world(scene.shape(path.body)), rows) >= 0:
        return None
    return path_of(rolled(rows, kin), path.body, path.ends)


def _aside(path: Path, marks: FloatArray, offset: float) -> FloatArray:
    """Return the poses at four ``marks`` (m), the inner two ``offset`` m to the left."""
    poses = path.poses_at(marks)
    for i in (1, 2):
        poses[i, 0] -= offset * math.sin(poses[i, 2])
        poses[i, 1] += offset * math.cos(poses[i, 2])
    return poses


def curves_through(
    poses: Iterable[Iterable[float]], ways: Iterable[float], car: DriveLimits
) -> list[FloatArray] | None:
    """Return the arcs from pose to pose, if none is much longer than its part (m) of the path."""
    found = []
    for (a, b), way in zip(itertools.pairwise(poses), ways, strict=True):
        curve = fastest(tuple(a), tuple(b), car)[1]
        if np.abs(curve[:, 1]).sum() > 2.0 * way + 6 * car.radius:
            return None
        found.append(curve)
    return found


def _off(pose: FloatArray, target: FloatArray) -> FloatArray:
    """Return how far a pose is off another one, whole turns not counted."""
    off = pose - target
    off[2] = math.remainder(float(off[2]), 2 * math.pi)
    return np.asarray(off)
