"""Conflicts of paths without those that a planner has proven to be none."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.timed_path import pose_at

IntArray = npt.NDArray[np.int64]


def is_cleared(path: Path, rest: Path) -> bool:
    """Return whether a path's planner has proven that it keeps clear of a body that rests."""
    return rest.cells == 0 and (rest.body.footprint, pose_at(rest, 0)) in path.cleared


def but_cleared(rows: IntArray, a: Path, b: Path) -> IntArray:
    """Return conflicting cells without rests of one path that the other one's planner has proven it
    keeps clear of: cells are coarser than that.
    """
    if len(rows) == 0 or not (a.cleared or b.cleared):
        return rows
    for rest, cell in zip(a.rests, (0, a.cells + 1), strict=True):
        if rest in b.cleared:
            rows = rows[rows[:, 0] != cell]
    for number, rest in enumerate(b.rests):
        if rest not in a.cleared or len(rows) == 0:
            continue
        rows = rows.copy()
        if number == 0:
            rows[:, 1] = np.maximum(rows[:, 1], 1)
        else:
            rows[:, 2] = np.minimum(rows[:, 2], b.cells)
        rows = rows[rows[:, 1] <= rows[:, 2]]
    return rows
