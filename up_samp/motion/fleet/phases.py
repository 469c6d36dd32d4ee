"""Compiled conflicts of two short moves: driven in step, or one after the other in any way.

Two robots drive *in step* when each is at the same share of its own move at every instant. A robot
may then follow right behind another, or several may turn in a ring that is full.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import kernel
from up_samp.motion.fleet.conflicts import _verdict, pieces_conflict

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@kernel
def in_step(
    ta: FloatArray,
    va: FloatArray,
    ca: IntArray,
    ra: float,
    tb: FloatArray,
    vb: FloatArray,
    cb: IntArray,
    rb: float,
    margin: float,
) -> bool:
    """Return whether two moves, driven in step, are not shown to keep ``margin`` m apart.

    ``ta``, ``tb`` are sweep tables (see ``sweep_table``) with the same number of cells. What
    counts between two pieces of the same share is how far one moves relative to the other.
    """
    a, b = np.empty(9), np.empty(9)
    half = ta.shape[1] // 2
    stack = np.empty(64, dtype=np.int64)
    for cell in range(1, len(ta) - 1):
        top = 1
        stack[0] = 1
        while top > 0:
            top -= 1
            row = stack[top]
            for k in range(9):
                a[k], b[k] = ta[cell, row, k], tb[cell, row, k]
            # all of the relative motion is given to one of the two
            x, y = a[7] * a[4] - b[7] * b[4], a[7] * a[5] - b[7] * b[5]
            a[4] = a[5] = b[4] = b[5] = 0.0
            if a[7] > 0.0:
                a[4], a[5] = x / a[7], y / a[7]
            elif b[7] > 0.0:
                b[4], b[5] = x / b[7], y / b[7]
            verdict = _verdict(a, va, ca, ra, b, vb, cb, rb, margin)
            if verdict == 2:
                continue
            if verdict == 0 or row >= half or (a[7] <= 0.0 and b[7] <= 0.0):
                return True
            stack[top], stack[top + 1] = 2 * row, 2 * row + 1
            top += 2
    return False


@kernel
def sweeps_meet(
    ta: FloatArray,
    va: FloatArray,
    ca: IntArray,
    ra: float,
    tb: FloatArray,
    vb: FloatArray,
    cb: IntArray,
    rb: float,
    margin: float,
) -> bool:
    """Return whether any part of one move is not shown to be apart from any part of the other."""
    for i in range(1, len(ta) - 1):
        for j in range(1, len(tb) - 1):
            if pieces_conflict(ta[i], va, ca, ra, tb[j], vb, cb, rb, margin):
                return True
    return False
