"""How much of any way lies in zones that slow it, and what a way takes at least then.

While the largest disc about the reference point that is inside the footprint overlaps a zone, the
body does. The cells in which it surely does are *slow*; the free cells that are not fall apart into
regions. What leads from one region to another leads through slow cells in between, and that is no
shorter than the regions are apart: the shortest chain of such gaps from start to goal is a bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.geometry import OccupancyGrid
from up_samp.geometry.cells import grown, label_regions
from up_samp.model import TrafficZone
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.slowing import OVER

Cell = tuple[int, int]
"""Row and column."""
MOST_REGIONS = 8
"""So many regions beside a zone are looked at; where there are more nothing is proven."""


@dataclass(frozen=True, eq=False)
class SlowZone:
    """What there is beside a zone in its ``area``: the ``kind`` of each cell (-1: slow, 0: nobody
    can be there, else the number of its region), the cells of each region that touch slow ones
    (``borders``, (n, 2) each), and how much (m) of a way from one region to another is slow,
    shape (k, k). ``size``: of a cell, m.
    """

    area: shapely.Geometry
    kind: npt.NDArray[np.int8]
    borders: tuple[IntArray, ...]
    gaps: FloatArray
    size: float

    def least(self, start: Cell, goal: Cell, straight: float) -> float:
        """Return metres of any way between two cells, ``straight`` m apart, that are slow (0 where
        there is none: others prove that).
        """
        if not (self.kind[start] and self.kind[goal]):
            return 0.0
        through = self._from(start)[:, None] + self.gaps + self._from(goal)[None, :]
        inside = straight if self.kind[start] == self.kind[goal] == -1 else math.inf
        metres = float(min(inside, through.min(initial=math.inf)))
        return metres if math.isfinite(metres) else 0.0

    def _from(self, cell: Cell) -> FloatArray:
        """Return how much (m) of a way from a cell to each region is slow."""
        if self.kind[cell] == -1:
            return np.array([_apart(self.size, some, np.array([cell])) for some in self.borders])
        own = np.arange(1, len(self.borders) + 1) == self.kind[cell]
        return np.where(own, 0.0, math.inf)


def slow_zone(
    zone: TrafficZone, grid: OccupancyGrid, blocked: BoolArray, radius: float
) -> SlowZone | None:
    """Return what is known of a zone for a disc of ``radius`` m whose centre can nowhere be in
    ``blocked`` cells (None: nothing).
    """
    # arcs are drawn as polygons inside them
    area = shapely.Polygon(zone.polygon).buffer(max(radius - 1e-6, 0.0))
    slow = _covered(area, grid) & ~blocked
    regions = np.empty(blocked.shape, dtype=np.int32)
    count = label_regions(~blocked & ~slow, regions)
    if not slow.any() or not 0 < count <= MOST_REGIONS:
        return None
    # who leaves the slow cells comes to a cell beside them
    beside = grown(slow) & ~slow
    borders = tuple(np.argwhere(beside & (regions == k)) for k in range(1, count + 1))
    gaps = np.array([[_apart(grid.resolution, a, b) for b in borders] for a in borders])
    np.fill_diagonal(gaps, 0.0)
    for k in range(count):
        gaps = np.minimum(gaps, gaps[:, [k]] + gaps[[k]])
    kind = np.where(slow, -1, regions).astype(np.int8)
    return SlowZone(area, kind, borders, gaps, grid.resolution)


def _apart(size: float, some: IntArray, others: IntArray) -> float:
    """Return how far (m) points of some cells (n, 2) are from those of others at least (inf: there
    are none).
    """
    least = min(
        (float(np.hypot(*(some - cell).T).min(initial=math.inf)) for cell in others),
        default=math.inf,
    )
    # points of two cells are nearer than their middles by half a diagonal each
    return max(0.0, least - math.sqrt(2.0)) * size


def _covered(area: shapely.Geometry, grid: OccupancyGrid) -> BoolArray:
    """Return the cells that lie wholly in an area."""
    found = np.zeros(grid.shape, dtype=np.bool_)
    (rows, cols), (x, y, yaw) = grid.shape, grid.origin
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    local = shapely.transform(area, lambda at: (at - (x, y)) @ turn / grid.resolution)
    left, bottom, right, top = local.bounds
    r0, r1 = max(0, math.floor(bottom)), min(rows, math.ceil(top))
    c0, c1 = max(0, math.floor(left)), min(cols, math.ceil(right))
    if r0 >= r1 or c0 >= c1:
        return found
    low, up = np.meshgrid(np.arange(c0, c1), np.arange(r0, r1))
    shapely.prepare(local)
    found[r0:r1, c0:c1] = shapely.covers(local, shapely.box(low, up, low + 1, up + 1))
    return found


def fastest_with_slow(
    length: float, slow: Sequence[tuple[float, float]], v_max: float, a_max: float
) -> float:
    """Return seconds that no motion from rest to rest over ``length`` m beats, of which so many m
    (each once) are driven no faster than so many m/s: ``slow`` has both.

    Whatever the order on the way, it takes least where the slowest parts are at both ends, where
    speeds are low anyway: speed over the way is bounded by what it was at either end of the part
    that is faster, and that is the longest where it is in one piece.
    """
    reached = at = speed = 0.0
    seconds = 0.0
    layers = sorted((cap * (1.0 + OVER), metres) for metres, cap in slow)
    for cap, metres in (*layers, (v_max, math.inf)):
        reached = min(reached + 0.5 * metres, 0.5 * length)
        part, at = reached - at, reached
        ramp = max(0.0, (cap**2 - speed**2) / (2.0 * a_max))
        if part <= ramp:
            peak = math.sqrt(speed**2 + 2.0 * a_max * part)
            seconds += (peak - speed) / a_max
        else:
            peak = max(speed, cap)
            seconds += (peak - speed) / a_max + (part - ramp) / peak
        speed = peak
    return 2.0 * seconds
