"""Moves between the places of a roadmap, and what they sweep."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from up_samp.motion.fleet.moves import Move
from up_samp.motion.fleet.swept import Hull, Swept, sweep_table

FloatArray = npt.NDArray[np.float64]

CELLS = 4
"""Cells of a move: two robots in step are compared cell by cell."""


@dataclass(frozen=True, eq=False)
class Edge:
    """A move between two places of a roadmap (a rest: from a place to itself)."""

    number: int
    source: int
    target: int
    move: Move
    hull: Hull
    cost: float
    """Seconds at top speed, and a little for each move."""

    @cached_property
    def swept(self) -> Swept:
        """Swept bounds of the cells, all of them for rests, too."""
        rows = self.move.rows
        if len(rows) == 1:
            one = sweep_table(np.zeros(1), rows, np.zeros(1))
            table = np.ascontiguousarray(np.repeat(one[:1], CELLS + 2, axis=0))
            return Swept(table, self.hull)
        s = np.concatenate([[0.0], np.cumsum(steps_of(rows, self.hull.radius))])
        return Swept(sweep_table(s, rows, np.linspace(0.0, s[-1], CELLS + 1)), self.hull)

    @cached_property
    def circle(self) -> tuple[float, float, float]:
        """A disc (x, y, radius) around all that is swept."""
        xy = self.move.rows[:, :2]
        low, high = xy.min(axis=0), xy.max(axis=0)
        # between two rows an arc may leave their box by less than half its length
        bulge = 0.0
        if len(xy) > 1:
            turning = np.abs(np.diff(self.move.rows[:, 2])) > 1e-9
            lengths = np.hypot(*np.diff(xy, axis=0).T)
            bulge = 0.5 * float(np.max(lengths[turning], initial=0.0))
        x, y = (float(v) for v in 0.5 * (low + high))
        return x, y, float(0.5 * np.hypot(*(high - low))) + bulge + self.hull.radius


def steps_of(rows: FloatArray, radius: float) -> FloatArray:
    """Return the larger of way and turn times ``radius`` between poses (k, 3): shape (k - 1,)."""
    d = np.diff(rows, axis=0)
    half = 0.5 * np.abs(d[:, 2])
    grow = np.where(half < 1e-9, 1.0, half / np.maximum(np.sin(np.minimum(half, 3.0)), 1e-9))
    steps = np.maximum(np.hypot(d[:, 0], d[:, 1]) * grow, radius * np.abs(d[:, 2]))
    return np.asarray(np.maximum(steps, 1e-9))
