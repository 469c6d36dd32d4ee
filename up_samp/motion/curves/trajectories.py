"""Joining timed motions, turning them round, and where they begin and end."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from up_samp.model import Configuration, Trajectory


def reversed_trajectory(trajectory: Trajectory) -> Trajectory:
    """Return the motion driven from its end to its start, from time 0."""
    times = trajectory.times[-1] - trajectory.times[::-1]
    return Trajectory(times, trajectory.poses[::-1].copy())


def joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Return planar or spatial motions one after the other, from time 0, theta continuous."""
    times, poses = [np.zeros(1)], [parts[0].poses[:1].copy()]
    for part in parts:
        rows = part.poses[1:].copy()
        if rows.shape[1] == 3:
            turns = round(float(poses[-1][-1, 2] - part.poses[0, 2]) / (2 * math.pi))
            rows[:, 2] += turns * 2 * math.pi
        times.append(times[-1][-1] + (part.times[1:] - part.times[0]))
        poses.append(rows)
        if len(rows) == 0:
            times.pop()
            poses.pop()
    return Trajectory(np.concatenate(times), np.concatenate(poses))


def with_ends(motion: Trajectory, start: Configuration, goal: Configuration) -> Trajectory:
    """Return a planar motion with its ends exactly at two poses, off which it is by rounding."""
    poses = motion.poses.copy()
    for k, pose in ((0, start), (-1, goal)):
        turns = 2 * math.pi * round((float(poses[k, 2]) - pose[2]) / (2 * math.pi))
        poses[k] = (pose[0], pose[1], pose[2] + turns)
    return Trajectory(motion.times.copy(), poses)


def at_rest(pose: Configuration) -> Trajectory:
    """Return the motion that stays where it is."""
    return Trajectory(np.zeros(1), np.array([pose], dtype=np.float64))
