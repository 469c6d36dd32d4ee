"""Where two ways meet: does it decide everything who goes first there?

Two bodies on fixed ways are a point in the plane of their cells that only moves up and to the
right; the cells in which they conflict are obstacles to it (the coordination diagram, O'Donnell and
Lozano-Perez 1989). Where these are one piece without dents, the point passes on one side or on the
other. Who goes first may then be as fast as it can: it is always as far ahead as in any other
motion on that side, and the other one has all the room that it could have. So two attempts, with
the one first and with the other, tell what is possible on these ways.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from up_samp.model import Deadline, TimedMotion
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.workspace import PathPlanner, workspace_of

IntArray = npt.NDArray[np.int64]


def one_decides(runs: IntArray) -> bool:
    """Return whether conflicting cells, as rows (i, j first, j last) by rising i, are one piece in
    which each row and each column is without a gap.
    """
    if len(runs) == 0:
        return True
    i, low, high = runs.T
    if np.any(np.diff(i) != 1):
        return False  # a row is missing, or has a gap
    if np.any(np.maximum(low[1:], low[:-1]) > np.minimum(high[1:], high[:-1]) + 1):
        return False  # neighbouring rows do not touch
    for j in range(int(low.min()), int(high.max()) + 1):
        rows = np.flatnonzero((low <= j) & (j <= high))
        if len(rows) and rows[-1] - rows[0] + 1 != len(rows):
            return False
    return True


def heeds(one: TimedMotion, other: TimedMotion) -> bool:
    """Return whether a motion keeps clear of the other one's body."""
    return one.avoid is None or other.object in one.avoid


def order_decides(
    service: PathPlanner, first: TimedMotion, second: TimedMotion, deadline: Deadline
) -> bool:
    """Return whether it decides everything who goes first, on the fastest ways of two motions when
    nobody else is there.
    """
    if first.body.flies or second.body.flies:
        return False
    if not (heeds(first, second) and heeds(second, first)):
        return False
    workspace = workspace_of(service)
    ways = [workspace.path(m.body, m.poses, (), deadline) for m in (first, second)]
    one, other = ways
    if not isinstance(one, Path) or not isinstance(other, Path):
        return False
    return one_decides(workspace.conflicts(one, other))
