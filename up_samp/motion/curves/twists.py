"""Constant twists between samples of planar poses: the arc through both, turned evenly.

For whole arrays; :func:`up_samp.model.interpolate` does one pose, and
:func:`up_samp.geometry.sweeps.between` is the compiled form (Lynch & Park, *Modern Robotics*,
ch. 3).
"""

from __future__ import annotations

import numpy as np

from up_samp.model.arrays import FloatArray

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
