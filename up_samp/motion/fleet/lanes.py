"""Cheap detours: leave the path for a parallel lane where it meets something, and come back."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from up_samp.geometry import sweeps
from up_samp.geometry.scene import Scene
from up_samp.model import MotionModel
from up_samp.motion.curves.arcs import merged
from up_samp.motion.curves.reeds_shepp import fastest
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.fleet.paths import Path, path_of
from up_samp.motion.planners.car_shortcuts import settle

FloatArray = npt.NDArray[np.float64]

LONGEST = 25.0
"""Stretches longer than this (m) are not worth a lane of their own."""


def lane_offsets(path: Path, other: Path) -> list[float]:
    """Return the sideways offsets (m) worth a try to pass ``other``, small ones first."""
    width = path.hull.radius + other.hull.radius
    return [side * share * width for share in (0.5, 0.8, 1.15) for side in (-1.0, 1.0)]


def shifted_lane(scene: Scene, path: Path, first: float, last: float, offset: float) -> Path | None:
    """Return ``path`` moved sideways by ``offset`` m (left > 0) on [first, last] (m along it), if
    the map allows it. Only for cars on a path without waypoints.
    """
    kin = path.body.kinematics
    if kin.model is not MotionModel.REEDSSHEPP or last - first > LONGEST:
        return None
    # a lane change of two equal arcs takes about 2 sqrt(|d| (2 R - |d| / 2)), with some air
    reach = 2.0 * math.sqrt(abs(offset) * kin.turning_radius * 2.0) + kin.turning_radius
    begin, end = first - reach, last + reach
    if begin < 0.0 or end > path.length:
        begin, end = max(begin, 0.0), min(end, path.length)
    marks = np.array([begin, first, last, end])
    poses = path.poses_at(marks)
    for i in (1, 2):
        poses[i, 0] -= offset * math.sin(poses[i, 2])
        poses[i, 1] += offset * math.cos(poses[i, 2])
    arcs = [arcs_between(path, 0.0, begin)]
    for i in range(3):
        curve = fastest(tuple(poses[i]), tuple(poses[i + 1]), *limits_of(kin))[1]
        if np.abs(curve[:, 1]).sum() > 2.0 * (marks[i + 1] - marks[i]) + 6 * kin.turning_radius:
            return None
        arcs.append(curve)
    arcs.append(arcs_between(path, end, path.length))
    whole = merged(np.concatenate(arcs))
    start, goal = path.poses[0], path.poses[-1]
    shape = scene.shape(path.body).data
    if sweeps.path_free(scene.data, scene.polys(()), shape, start, whole) >= 0:
        return None
    if settle(start, goal, whole) > 1e-7:
        return None
    ends = (tuple(float(x) for x in start), tuple(float(x) for x in goal))
    return path_of(trajectory_of(ends, [whole], kin), path.body, ends)


def arcs_between(path: Path, first: float, last: float) -> FloatArray:
    """Return the arcs (curvature, signed length) of a car's path from ``first`` to ``last`` m."""
    kinks = path.s[path.kink]
    marks = np.concatenate([[first], kinks[(kinks > first) & (kinks < last)], [last]])
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-9])]
    if len(marks) < 2:
        return np.empty((0, 2))
    middle = 0.5 * (marks[1:] + marks[:-1])
    i = np.clip(np.searchsorted(path.s, middle, side="right") - 1, 0, len(path.s) - 2)
    d = path.poses[i + 1] - path.poses[i]
    heading = path.poses[i, 2] + 0.5 * d[:, 2]
    sign = np.sign(np.cos(heading) * d[:, 0] + np.sin(heading) * d[:, 1])
    lengths = np.diff(marks) * sign
    poses = path.poses_at(marks)
    return np.stack([np.diff(poses[:, 2]) / lengths, lengths], axis=1)
