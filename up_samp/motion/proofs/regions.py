"""Regions of the map that a disc cannot leave, and what keeps them apart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from up_samp.geometry.records import GridFrame, PolyData, grid_along, grid_point, kernel
from up_samp.model.arrays import Int32Array, IntArray
from up_samp.motion.guides.cost_to_go import point_to_convex


@kernel
def mark_blocked(owners: IntArray, frame: GridFrame, polys: PolyData, radius: float) -> None:
    """Set bit i in the cells that obstacle ``i`` surely blocks for a disc of ``radius`` m."""
    rows, cols = owners.shape
    size = frame.size
    for p in range(polys.counts.shape[0]):
        bit = np.int64(1) << polys.owner[p]
        gx, gy = grid_along(frame, polys.centres[p, 0], polys.centres[p, 1])
        cx, cy = gx / size, gy / size
        span = (polys.centres[p, 2] + radius) / size + 1.0
        r0, r1 = max(0, math.floor(cy - span)), min(rows, math.ceil(cy + span))
        c0, c1 = max(0, math.floor(cx - span)), min(cols, math.ceil(cx + span))
        if r1 <= r0 or c1 <= c0:
            continue
        near = np.empty((r1 - r0 + 1, c1 - c0 + 1), dtype=np.bool_)
        for row in range(r0, r1 + 1):
            for col in range(c0, c1 + 1):
                x, y = grid_point(frame, col * size, row * size)
                d = point_to_convex(x, y, polys.verts[p], polys.counts[p])
                near[row - r0, col - c0] = d < radius - 1e-9
        for i in range(r1 - r0):
            for j in range(c1 - c0):
                if near[i, j] and near[i + 1, j] and near[i, j + 1] and near[i + 1, j + 1]:
                    owners[r0 + i, c0 + j] |= bit


@dataclass(frozen=True)
class Regions:
    """Connected regions of cells, each blocked by a (possibly empty) set of obstacles.

    ``labels`` int32 (rows, cols): 0 where the map blocks. ``owners[label]``: bit set of obstacles.
    ``links[label]``: neighbouring labels.
    """

    labels: Int32Array
    owners: Mapping[int, int]
    links: Mapping[int, frozenset[int]]

    def reaches(self, start: int, goal: int, removed: int) -> bool:
        """Return whether two labels are joined once the obstacles in ``removed`` are gone."""
        if self.owners.get(start, 0) & ~removed:
            return False
        seen, stack = {start}, [start]
        while stack:
            for other in self.links.get(stack.pop(), ()):
                if other not in seen and not self.owners.get(other, 0) & ~removed:
                    seen.add(other)
                    stack.append(other)
        return goal in seen


def box_of(owners: IntArray) -> tuple[slice, slice]:
    """Return the smallest part of the grid that holds all cells that are not 0."""
    rows = np.flatnonzero(owners.any(axis=1))
    if len(rows) == 0:
        return slice(0, 0), slice(0, 0)
    band = slice(int(rows[0]), int(rows[-1]) + 1)
    cols = np.flatnonzero(owners[band].any(axis=0))
    return band, slice(int(cols[0]), int(cols[-1]) + 1)


def links_of(
    labels: Int32Array, rows: npt.NDArray[np.intp], cols: npt.NDArray[np.intp]
) -> dict[int, frozenset[int]]:
    """Return which regions touch (8-connected); only the cells at ``rows`` and ``cols`` can join
    two regions.
    """
    links: dict[int, set[int]] = {}
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            r, c = rows + dr, cols + dc
            ok = (r >= 0) & (c >= 0) & (r < labels.shape[0]) & (c < labels.shape[1])
            mine, theirs = labels[rows[ok], cols[ok]], labels[r[ok], c[ok]]
            differ = (mine != theirs) & (theirs != 0)
            for a, b in set(zip(mine[differ].tolist(), theirs[differ].tolist(), strict=True)):
                links.setdefault(a, set()).add(b)
                links.setdefault(b, set()).add(a)
    return {label: frozenset(others) for label, others in links.items()}
