"""Compiled conflicts of two short moves: driven in step, or one after the other in any way.

Two robots drive *in step* when each is at the same share of its own move at every instant. A robot
may then follow right behind another, or several may turn in a ring that is full.
"""

from __future__ import annotations

import numpy as np

from up_samp.geometry.compiled import inner, kernel
from up_samp.motion.fleet.conflicts import pieces_conflict, verdict
from up_samp.motion.fleet.swept import Piece, Swept, piece


@inner
def _moved(p: Piece, tx: float, ty: float) -> Piece:
    """Return a piece with another direction of travel."""
    return Piece(p.x, p.y, p.cos, p.sin, tx, ty, p.turn, p.half, p.jump)


@kernel
def in_step(one: Swept, other: Swept, margin: float) -> bool:
    """Return whether two moves, driven in step, are not shown to keep ``margin`` m apart.

    Their tables have the same number of cells. What counts between two pieces of the same share is
    how far one moves relative to the other.
    """
    ta, tb = one.table, other.table
    half = ta.shape[1] // 2
    stack = np.empty(64, dtype=np.int64)
    for cell in range(1, len(ta) - 1):
        top = 1
        stack[0] = 1
        while top > 0:
            top -= 1
            row = stack[top]
            a, b = piece(ta[cell, row]), piece(tb[cell, row])
            # all of the relative motion is given to one of the two
            x, y = a.half * a.tx - b.half * b.tx, a.half * a.ty - b.half * b.ty
            if a.half > 0.0:
                a, b = _moved(a, x / a.half, y / a.half), _moved(b, 0.0, 0.0)
            elif b.half > 0.0:
                a, b = _moved(a, 0.0, 0.0), _moved(b, x / b.half, y / b.half)
            said = verdict(a, one.hull, b, other.hull, margin)
            if said == 2:
                continue
            if said == 0 or row >= half or (a.half <= 0.0 and b.half <= 0.0):
                return True
            stack[top], stack[top + 1] = 2 * row, 2 * row + 1
            top += 2
    return False


@kernel
def sweeps_meet(one: Swept, other: Swept, margin: float) -> bool:
    """Return whether any part of one move is not shown to be apart from any part of the other."""
    for i in range(1, len(one.table) - 1):
        for j in range(1, len(other.table) - 1):
            if pieces_conflict(one.table[i], one.hull, other.table[j], other.hull, margin):
                return True
    return False
