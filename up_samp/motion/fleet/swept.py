"""What bodies sweep on fixed paths: each path cut into cells, each cell into halves, quarters, ...

A piece of half-length ``half`` around a middle pose is bounded by how far any point of the body
can move along a separating axis while ``s`` stays in the piece (conservative advancement in the
sense of Zhang, Lee & Kim 2006).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner, kernel

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

DEPTH = 2
"""Times that a cell may be halved."""


class Hull(NamedTuple):
    """A planar body's convex parts: ``verts`` (p, m, 2) padded by repeating the last corner,
    ``counts`` (p,), circumscribed ``radius`` and inscribed radius ``core`` about the reference
    point (m).
    """

    verts: FloatArray
    counts: IntArray
    radius: float
    core: float


class Swept(NamedTuple):
    """A body on its path: the ``table`` (see :func:`sweep_table`) and its ``hull``."""

    table: FloatArray
    hull: Hull


class Piece(NamedTuple):
    """A stretch of a path: the pose in its middle (``x``, ``y`` in m, ``cos`` and ``sin`` of the
    heading), the direction of travel ``tx``, ``ty`` there per unit of ``s``, the largest ``turn``
    per unit of ``s``, ``half`` its length, and the displacement (m) that jumps of the direction
    inside it may add.
    """

    x: float
    y: float
    cos: float
    sin: float
    tx: float
    ty: float
    turn: float
    half: float
    jump: float


@inner
def piece(row: FloatArray) -> Piece:
    """Return the piece in a row (9,) of a table."""
    return Piece(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8])


@inner
def standing(x: float, y: float, heading: float) -> Piece:
    """Return the piece of a body that rests at a pose."""
    at = float(x), float(y)  # poses of whole numbers, too
    return Piece(at[0], at[1], np.cos(heading), np.sin(heading), 0.0, 0.0, 0.0, 0.0, 0.0)


@inner
def reach_of(p: Piece, radius: float) -> float:
    """Return how far (m) any point of a body can be from where it is in the middle of a piece."""
    return p.half * (1.0 + p.turn * (radius + 0.5 * p.half)) + p.jump


@kernel
def sweep_table(s: FloatArray, poses: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the pieces of all extended cells as rows, shape (cells + 2, 2 ** (DEPTH + 1), 9).

    Row 1 of an extended cell is the whole cell, rows 2k and 2k + 1 are the halves of row k. The
    rests have ``half = 0``.
    """
    cells = len(edges) - 1
    rows = 1 << (DEPTH + 1)
    table = np.zeros((cells + 2, rows, 9))
    n = len(s)
    for cell in range(cells + 2):
        rest = cell == 0 or cell == cells + 1
        low = edges[0] if cell == 0 else edges[min(cell - 1, cells)]
        high = low if rest else edges[cell]
        for row in range(1, rows):
            level = 0
            while (1 << (level + 1)) <= row:
                level += 1
            share = (row - (1 << level)) / (1 << level)
            a = low + (high - low) * share
            b = a + (high - low) / (1 << level)
            middle = 0.5 * (a + b)
            i = max(0, min(n - 2, np.searchsorted(s, middle, side="right") - 1))
            at = _piece_at(s, poses, i, middle)
            tx, ty, turn, half, jump = 0.0, 0.0, 0.0, 0.0, 0.0
            if not rest and n > 1:
                tx, ty, half = at.tx, at.ty, 0.5 * (b - a)
                k = i
                while k > 0 and s[k] > a:
                    k -= 1
                while k < n - 1 and s[k] < b:
                    turn = max(turn, abs(poses[k + 1, 2] - poses[k, 2]) / (s[k + 1] - s[k]))
                    if s[k] > a:
                        jump += half * _jump(s, poses, k)
                    k += 1
            out = table[cell, row]
            out[0], out[1], out[2], out[3], out[4] = at.x, at.y, at.cos, at.sin, tx
            out[5], out[6], out[7], out[8] = ty, turn, half, jump
    return table


@inner
def _jump(s: FloatArray, poses: FloatArray, k: int) -> float:
    """Return how much the direction of travel per unit of ``s`` jumps at the inner sample ``k``."""
    ends = np.empty((2, 2))
    for side in range(2):
        i = k - 1 + side
        dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
        half = 0.5 * (poses[i + 1, 2] - poses[i, 2])
        grow = 1.0 if abs(half) < 1e-9 else half / np.sin(half)
        angle = half if side == 0 else -half
        c, q = np.cos(angle), np.sin(angle)
        step = grow / (s[i + 1] - s[i])
        ends[side, 0], ends[side, 1] = step * (c * dx - q * dy), step * (q * dx + c * dy)
    return np.hypot(ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1])


@inner
def _piece_at(s: FloatArray, poses: FloatArray, i: int, at: float) -> Piece:
    """Return the pose and the direction of travel at parameter ``at`` of sample interval ``i``."""
    if len(s) == 1 or at <= s[0]:
        return standing(poses[0, 0], poses[0, 1], poses[0, 2])
    share = min(1.0, (at - s[i]) / (s[i + 1] - s[i]))
    dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
    turn = poses[i + 1, 2] - poses[i, 2]
    half = 0.5 * turn
    if abs(half) < 1e-9:
        scale, angle, grow = share, 0.0, 1.0
    else:
        scale = np.sin(share * half) / np.sin(half)
        angle = (share - 1.0) * half
        grow = half / np.sin(half)
    c, q = np.cos(angle), np.sin(angle)
    x = poses[i, 0] + scale * (c * dx - q * dy)
    y = poses[i, 1] + scale * (q * dx + c * dy)
    theta = poses[i, 2] + share * turn
    # direction of travel: the chord turned by what is missing to the arc's tangent here
    c, q = np.cos(share * turn - half), np.sin(share * turn - half)
    step = grow / (s[i + 1] - s[i])
    tx, ty = step * (c * dx - q * dy), step * (q * dx + c * dy)
    return Piece(x, y, np.cos(theta), np.sin(theta), tx, ty, 0.0, 0.0, 0.0)
