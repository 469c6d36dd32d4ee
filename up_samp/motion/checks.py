"""Is a motion from elsewhere (a file) what it says: from pose to pose, within limits, clear?"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from up_samp.geometry import Scene, sweeps
from up_samp.geometry.shapes import shape_of
from up_samp.model import Configuration, Kinematics, MotionModel, Trajectory
from up_samp.motion.curves.twists import twists
from up_samp.motion.protocol import LegQuery

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Allowance:
    """What is allowed. Limits may be exceeded by a ``share``: less than the validator allows;
    positions (m) and angles (rad) may be off by ``noise``, the ends by ``end`` only.
    """

    share: float = 0.005
    noise: float = 1e-6
    end: float = 1e-9


ALLOWED = Allowance()


def is_sound(scene: Scene, query: LegQuery, trajectory: Trajectory) -> bool:
    """Return whether a trajectory answers a query: its ends, its limits, swept clearance."""
    ends = trajectory.poses[0], trajectory.poses[-1]
    if trajectory.times[0] != 0.0 or len(ends[0]) != len(query.start):
        return False
    if not all(_same(a, b) for a, b in zip(ends, (query.start, query.goal), strict=True)):
        return False
    return keeps_limits(trajectory, query.body.kinematics) and _is_clear(scene, query, trajectory)


def _same(pose: FloatArray, wanted: Configuration) -> bool:
    off = pose - np.array(wanted)
    if len(pose) == 3:
        off[2] = math.remainder(float(off[2]), 2 * math.pi)
    return float(np.abs(off).max()) < ALLOWED.end


def _is_clear(scene: Scene, query: LegQuery, trajectory: Trajectory) -> bool:
    poses = trajectory.poses.copy()  # numba compiles anew for arrays that cannot be written
    if query.body.kinematics.model is MotionModel.SE3:
        from up_samp.motion.planners.flyer import FlyerWorld

        air = FlyerWorld(scene, query.body, (query.start, query.goal), query.obstacles)
        if not air.fit_margin() or any(air.swallowed(p) for p in (query.start, query.goal)):
            return False
        return all(air.edge_free(a, b) for a, b in itertools.pairwise(poses))
    world = scene.world(shape_of(query.body, 0.0), query.obstacles)
    return bool(sweeps.samples_free(world, poses, ALLOWED.noise) < 0)


def keeps_limits(trajectory: Trajectory, kinematics: Kinematics) -> bool:
    """Return whether a motion from rest to rest keeps the speeds and the acceleration of its model.

    By mean speeds between samples, which a motion within its limits never exceeds.
    """
    if len(trajectory.times) == 1:
        return True
    dt = np.diff(trajectory.times)
    d = np.diff(trajectory.poses, axis=0)
    if kinematics.model is MotionModel.REEDSSHEPP:
        speed, bends = _car_speeds(trajectory.poses, dt, kinematics)
    elif kinematics.model is MotionModel.PIVOT:
        speed, bends = _pivot_speeds(trajectory.poses, dt, kinematics)
    else:
        size = 2 if d.shape[1] == 3 else 3
        speed = d[:, :size] / dt[:, None]
        turn = np.abs(d[:, 2]) if size == 2 else _angles(trajectory.poses)
        bends = bool(np.any(turn > kinematics.omega_max * (1 + ALLOWED.share) * dt + ALLOWED.noise))
    if bends:
        return False
    size = np.linalg.norm(speed, axis=1)
    if np.any(size * dt > kinematics.v_max * (1 + ALLOWED.share) * dt + ALLOWED.noise):
        return False
    moving = np.where(size * dt > ALLOWED.noise, Trajectory.MAX_STEP, math.inf)
    if np.any(dt > 1.01 * moving):
        return False
    fuzz = 2 * ALLOWED.noise / dt
    half = dt / 2
    change = np.linalg.norm(np.diff(speed, axis=0), axis=1)
    allowed = kinematics.a_max * (1 + ALLOWED.share)
    inner = change <= allowed * (half[1:] + half[:-1]) + fuzz[1:] + fuzz[:-1]
    ends = size[[0, -1]] <= allowed * half[[0, -1]] + fuzz[[0, -1]]
    return bool(inner.all() and ends.all())


def _car_speeds(
    poses: FloatArray, dt: FloatArray, kinematics: Kinematics
) -> tuple[FloatArray, bool]:
    """Return a car's signed speeds (n - 1, 1), and whether it slips sideways or bends too much."""
    along, across, turn = twists(poses).T
    way = np.hypot(along, across)
    tight = np.abs(turn) > way / kinematics.turning_radius * (1 + ALLOWED.share) + ALLOWED.noise
    return np.copysign(way, along)[:, None] / dt[:, None], bool(
        np.any(tight) or np.any(np.abs(across) > 10 * ALLOWED.noise)
    )


def _pivot_speeds(
    poses: FloatArray, dt: FloatArray, kinematics: Kinematics
) -> tuple[FloatArray, bool]:
    """Return the signed speeds (n - 1, 1) of a body that drives or turns on the spot, and whether
    it slips sideways or turns too fast.
    """
    along, across, turn = twists(poses).T
    fast = np.abs(turn) > kinematics.omega_max * (1 + ALLOWED.share) * dt + ALLOWED.noise
    return along[:, None] / dt[:, None], bool(
        np.any(fast) or np.any(np.abs(across) > 10 * ALLOWED.noise)
    )


def _angles(poses: FloatArray) -> FloatArray:
    q = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    near = np.minimum(
        np.linalg.norm(q[1:] - q[:-1], axis=1), np.linalg.norm(q[1:] + q[:-1], axis=1)
    )
    return np.asarray(4 * np.arcsin(np.clip(near / 2, 0, 1)))
