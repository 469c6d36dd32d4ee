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
import shapely

from up_samp.geometry import OccupancyGrid
from up_samp.geometry.cells import distances_to, label_regions
from up_samp.model import TrafficZone
from up_samp.model.arrays import BoolArray, FloatArray, Int32Array
from up_samp.motion.curves.slowing import OVER

MOST_REGIONS = 8
"""So many regions beside a zone are looked at; where there are more nothing is proven."""


@dataclass(frozen=True, eq=False)
class SlowZone:
    """What there is beside the ``slow`` cells of a zone: ``regions`` (from 1; 0: slow, or nobody
    can be there), how far (m) each is from each cell, shape (k, rows, cols), and how much of a
    way from one to another is slow, shape (k, k).
    """

    area: shapely.Geometry
    slow: BoolArray
    regions: Int32Array
    far: FloatArray
    gaps: FloatArray

    def least(self, start: tuple[int, int], goal: tuple[int, int], straight: float) -> float:
        """Return metres of any way between two cells, ``straight`` m apart, that are slow."""
        ways = [self._from(cell) for cell in (start, goal)]
        if any(way is None for way in ways):
            return 0.0
        through = ways[0][:, None] + self.gaps + ways[1][None, :]  # type: ignore[index]
        inside = straight if self.slow[start] and self.slow[goal] else math.inf
        return float(min(inside, through.min(initial=math.inf)))

    def _from(self, cell: tuple[int, int]) -> FloatArray | None:
        """Return how much of a way to each region is slow (None: nobody can be there)."""
        if self.slow[cell]:
            return self.far[:, cell[0], cell[1]]
        own = int(self.regions[cell])
        if own == 0:
            return None
        return np.where(np.arange(1, len(self.gaps) + 1) == own, 0.0, math.inf)


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
    # between some points of two cells: less than between their middles by half a diagonal each
    diagonal = math.sqrt(2.0) * grid.resolution
    far = np.array([distances_to(regions == k, grid.resolution) for k in range(1, count + 1)])
    far = np.maximum(far - diagonal, 0.0)
    gaps = np.array([[far[i][regions == j + 1].min() for j in range(count)] for i in range(count)])
    for k in range(count):
        gaps = np.minimum(gaps, gaps[:, [k]] + gaps[[k]])
    return SlowZone(area, slow, regions, far, gaps)


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
