"""What the compiled checks need of a map and of objects that rest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt

from up_samp.geometry import kernels
from up_samp.geometry.cells import distances_to, grown
from up_samp.geometry.maps import OccupancyGrid
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import GridData, GridFrame, PolyData, WorldData, open_plane
from up_samp.geometry.shapes import Shape, padded, shape_of
from up_samp.model import Body, Configuration, Placed, check_time
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.model.frames import Frame


def clearance_field(blocked: BoolArray, resolution: float) -> npt.NDArray[np.float32]:
    """Return for each cell the smallest distance (m) from any of its points to a blocked cell or to
    the outside of the map.

    The squares of two cells i, j are max(|i - j| - 1, 0) cells apart along an axis, which is the
    distance from i's centre to the blocked cells dilated by one cell: one exact Euclidean distance
    transform gives a bound that holds for whole cells.
    """
    walled = np.pad(blocked, 1, constant_values=True)
    distance = distances_to(grown(walled), resolution * (1 - 1e-6), np.float32)[1:-1, 1:-1]
    return np.ascontiguousarray(distance)


def grid_data(grid: OccupancyGrid | None) -> GridData:
    """Return a map (or the open plane) as the kernels take it."""
    if grid is None:
        return open_plane()
    blocked = grid.blocked
    sums = np.zeros((blocked.shape[0] + 1, blocked.shape[1] + 1), dtype=np.int32)
    check_time()
    np.cumsum(blocked, axis=1, dtype=np.int32, out=sums[1:, 1:])
    check_time()
    np.cumsum(sums, axis=0, out=sums)
    x, y, yaw = grid.origin
    place = (x, y, math.cos(yaw), math.sin(yaw), yaw, grid.resolution)
    frame = GridFrame(*map(float, place))
    return GridData(sums, clearance_field(blocked, grid.resolution), frame)


def placed_polygons(body: Body, pose: Configuration) -> list[FloatArray]:
    """Return the convex parts of a resting planar body in the world frame, each of shape (n, 2)."""
    return [Frame(*pose[:3]).points(part) for part in shape_of(body).parts]


def poly_data(obstacles: Sequence[Placed]) -> PolyData:
    """Return resting objects as the kernels take them; ``owner`` indexes ``obstacles``."""
    owned = [
        (index, polygon)
        for index, placed in enumerate(obstacles)
        for polygon in placed_polygons(placed.body, placed.pose)
    ]
    verts, counts = padded([polygon for _, polygon in owned])
    middles = 0.5 * (verts.min(axis=1) + verts.max(axis=1))
    radii = np.linalg.norm(verts - middles[:, None], axis=2).max(axis=1)
    owners = np.array([index for index, _ in owned], dtype=np.int64)
    return PolyData(verts, counts, np.column_stack((middles, radii)), owners)


class Scene:
    """A map with a clearance margin (m), and resting objects turned into kernel data on demand."""

    def __init__(self, grid: OccupancyGrid | None, margin: float = 0.01) -> None:
        if not (math.isfinite(margin) and margin >= 0):
            raise ValueError(f"the margin must be a finite number >= 0 m, not {margin!r}")
        self.grid = grid
        self.margin = float(margin)  # kernels are compiled for floats
        self._polys: Memory[PolyData] = Memory(512)

    @cached_property
    def data(self) -> GridData:
        """The map as the kernels take it."""
        return grid_data(self.grid)

    @property
    def digest(self) -> str:
        """A hash of the map ("open" without one)."""
        return self.grid.digest if self.grid is not None else "open"

    def shape(self, body: Body, margin: float | None = None) -> Shape:
        """Return the footprint of ``body`` with this scene's margin (or another one)."""
        return shape_of(body, self.margin if margin is None else margin)

    def polys(self, obstacles: Iterable[Placed] = ()) -> PolyData:
        """Return resting objects as kernel data (cached by their bodies and poses, in order)."""
        obstacles = tuple(obstacles)
        key = tuple((p.body.footprint, tuple(p.pose)) for p in obstacles)
        return self._polys.get_or(key, lambda: poly_data(obstacles))

    def world(self, shape: Shape, obstacles: Iterable[Placed] = ()) -> WorldData:
        """Return a footprint among resting objects on the map, as the kernels take it."""
        return WorldData(self.data, self.polys(obstacles), shape.data)

    def pose_free(
        self,
        body: Body,
        pose: Configuration,
        obstacles: Sequence[Placed] = (),
        margin: float | None = None,
    ) -> bool:
        """Return whether ``body`` at ``pose`` keeps the margin from the map and the obstacles."""
        return self.clearance(self.shape(body, margin), obstacles, pose) >= 0.0

    def room(self, x: float, y: float) -> float:
        """Return a lower bound (m) on a point's distance to what the map blocks (far without one,
        0 in blocked cells and outside).
        """
        return float(kernels.point_clearance(self.data, float(x), float(y)))

    def clearance(self, shape: Shape, obstacles: Iterable[Placed], pose: Configuration) -> float:
        """Return a lower bound (m) on the clearance beyond the shape's margin, or -1."""
        x, y, th = map(float, pose[:3])
        return float(kernels.clearance(self.world(shape, obstacles), x, y, th))

    def map_free(self, body: Body, pose: Configuration) -> bool:
        """Return whether ``body`` at ``pose`` touches no blocked cell."""
        return self.pose_free(body, pose, (), 0.0)

    def overlap(
        self, body_a: Body, pose_a: Configuration, body_b: Body, pose_b: Configuration
    ) -> bool:
        """Return whether two placed bodies share area (touching is no overlap)."""
        return self.distance(body_a, pose_a, body_b, pose_b) < -1e-9

    def distance(
        self, body_a: Body, pose_a: Configuration, body_b: Body, pose_b: Configuration
    ) -> float:
        """Return the distance (m) of two placed bodies; <= 0 where they overlap."""
        a, b = shape_of(body_a).data, shape_of(body_b).data
        (ax, ay, ath), (bx, by, bth) = (map(float, pose[:3]) for pose in (pose_a, pose_b))
        return float(kernels.pair_distance(a, (ax, ay, ath), b, (bx, by, bth)))
