"""Sampled motions: joined, turned round, where they begin and end, and what lies between samples.

Between samples of planar poses the twist is constant: an arc through both, turned evenly. Here for
whole arrays; :func:`up_samp.model.interpolate` does one pose, and
:func:`up_samp.geometry.kernels.between` is the compiled form (Lynch & Park, *Modern Robotics*,
ch. 3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from up_samp.model import Configuration, Trajectory
from up_samp.model.arrays import FloatArray


def reversed_trajectory(trajectory: Trajectory) -> Trajectory:
    """Return the motion driven from its end to its start, from time 0."""
    times = trajectory.times[-1] - trajectory.times[::-1]
    return Trajectory(times, trajectory.poses[::-1].copy())


def joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Return planar or spatial motions one after the other, from time 0, theta continuous."""
    now, last = 0.0, parts[0].poses[0]
    times, poses = [np.zeros(1)], [last[None]]
    for part in parts:
        rows = unwound(part.poses, last) if len(last) == 3 else part.poses
        times.append(now + (part.times[1:] - part.times[0]))
        poses.append(rows[1:])
        now, last = now + part.duration, rows[-1]
    return Trajectory(np.concatenate(times), np.concatenate(poses))


def unwound(rows: FloatArray, near: FloatArray) -> FloatArray:
    """Return planar poses (n, 3) with whole turns added, so that the first is nearest to a pose."""
    found = rows.copy()
    found[:, 2] += 2 * math.pi * round((near[2] - found[0, 2]) / (2 * math.pi))
    return found


def with_ends(motion: Trajectory, start: Configuration, goal: Configuration) -> Trajectory:
    """Return a planar motion with its ends exactly at two poses, off which it is by rounding."""
    poses = motion.poses.copy()
    for k, pose in ((0, start), (-1, goal)):
        poses[k] = unwound(np.array([pose[:3]], dtype=np.float64), poses[k])[0]
    return Trajectory(motion.times.copy(), poses)


def at_rest(pose: Configuration) -> Trajectory:
    """Return the motion that stays where it is."""
    return Trajectory(np.zeros(1), np.array([pose], dtype=np.float64))


# ------------------ Constant twists between samples


FLAT = 1e-9
"""Half a turn (rad) below which an arc is its chord."""


def twists(poses: FloatArray) -> FloatArray:
    """Return the body-frame displacements (dx, dy, dtheta), shape (n - 1, 3), between samples: the
    length of the arc, in its direction at the start.
    """
    d = np.diff(poses, axis=0)
    half = 0.5 * d[:, 2]
    # the arc is longer than its chord by half / sin(half), and the chord points half the turn ahead
    flat = np.abs(half) < FLAT
    safe = np.where(flat, 1.0, half)
    grow = np.where(flat, 1.0, safe / np.sin(safe))
    heading = poses[:-1, 2] + half
    c, sn = np.cos(heading), np.sin(heading)
    dx = grow * (c * d[:, 0] + sn * d[:, 1])
    dy = grow * (-sn * d[:, 0] + c * d[:, 1])
    return np.stack([dx, dy, d[:, 2]], axis=1)


def travels(poses: FloatArray, radius: float) -> FloatArray:
    """Return how far (m) any point of a body of this ``radius`` (m) moves at most between samples,
    along arcs, shape (n - 1,).
    """
    moves = twists(poses)
    return np.asarray(np.hypot(moves[:, 0], moves[:, 1]) + radius * np.abs(moves[:, 2]))


def partway(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Return the poses (k, 3) that are ``share`` (k,) of the way from ``a`` to ``b`` (k, 3)."""
    d = b - a
    half = 0.5 * d[:, 2]
    # the chord up to `share` is sin(share half) / sin(half) long, turned half of what is left
    flat = np.abs(half) < FLAT
    safe = np.where(flat, 1.0, half)
    scale = np.where(flat, share, np.sin(share * safe) / np.sin(safe))
    angle = np.where(flat, 0.0, (share - 1.0) * half)
    c, sn = np.cos(angle), np.sin(angle)
    x = a[:, 0] + scale * (c * d[:, 0] - sn * d[:, 1])
    y = a[:, 1] + scale * (sn * d[:, 0] + c * d[:, 1])
    return np.stack([x, y, a[:, 2] + share * d[:, 2]], axis=1)


def rotations(poses: FloatArray) -> FloatArray:
    """Return the rotation vectors (n - 1, 3) (rad) from each quaternion (x, y, z, w) to the next,
    in the world's frame.
    """
    q = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    a, b = q[:-1], q[1:]
    w = np.sum(a * b, axis=1)
    v = a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(b[:, :3], a[:, :3])
    sign = np.where(w < 0, -1.0, 1.0)
    size = np.linalg.norm(v, axis=1)
    angle = 2 * np.arctan2(size, np.abs(w))
    return np.asarray(v * (sign * angle / np.where(size > 1e-15, size, 1.0))[:, None])
