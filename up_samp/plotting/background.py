"""The map of a plan as a picture, and the rectangle of the world that it shows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from up_samp.geometry.maps import OccupancyGrid, load_map
from up_samp.plotting.colors import FREE, OCCUPIED, UNKNOWN
from up_samp.plotting.tracks import Track, tracks_of


@dataclass(frozen=True, eq=False)
class Background:
    """``pixels`` of shape (rows, cols, 3), row 0 at the top; ``extent`` is (left, right, bottom,
    top) in m, world frame.
    """

    pixels: npt.NDArray[np.uint8]
    extent: tuple[float, float, float, float]

    def image(self, widest: int) -> Image.Image:
        """Return the picture, at most ``widest`` pixels wide and high."""
        picture = Image.fromarray(self.pixels, "RGB")
        scale = min(1.0, widest / max(picture.size))
        size = (max(1, round(picture.width * scale)), max(1, round(picture.height * scale)))
        return picture.resize(size, Image.Resampling.BOX) if scale < 1.0 else picture


def background_of(plan: dict[str, Any]) -> Background:
    """Return the picture of the plan's map: free white, occupied dark, unknown light grey.

    Without a map: a white rectangle around everything that the plan shows. Raises
    :class:`~up_samp.model.ProblemError` where the map's files are missing or wrong.
    """
    path = plan["map"].get("yaml")
    if path is None:
        return _blank(tracks_of(plan))
    return _drawn(load_map(path))


def _drawn(grid: OccupancyGrid) -> Background:
    colors = np.empty((*grid.occupied.shape, 3), dtype=np.uint8)
    colors[:] = FREE
    colors[grid.unknown] = UNKNOWN
    colors[grid.occupied] = OCCUPIED
    x, y, yaw = grid.origin
    rows, cols = grid.occupied.shape
    if yaw == 0.0:
        extent = (x, x + cols * grid.resolution, y, y + rows * grid.resolution)
        return Background(colors[::-1], extent)
    return _turned(colors, grid, (x, y, yaw))


def _turned(
    colors: npt.NDArray[np.uint8], grid: OccupancyGrid, origin: tuple[float, float, float]
) -> Background:
    """Resample a map with a yaw into the world's axes; what lies outside the map is unknown."""
    x, y, yaw = origin
    c, s = math.cos(yaw), math.sin(yaw)
    rows, cols = grid.occupied.shape
    step = grid.resolution
    corners = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]]) * step
    world = corners @ np.array([[c, s], [-s, c]]) + (x, y)
    low, high = world.min(axis=0), world.max(axis=0)
    width, height = (max(1, math.ceil(v / step)) for v in high - low)
    gx, gy = np.meshgrid((np.arange(width) + 0.5) * step, (np.arange(height) + 0.5) * step)
    dx, dy = gx + low[0] - x, gy + low[1] - y
    col = np.floor((c * dx + s * dy) / step).astype(int)
    row = np.floor((-s * dx + c * dy) / step).astype(int)
    inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    pixels[:] = UNKNOWN
    pixels[inside] = colors[row[inside], col[inside]]
    right, top = low[0] + width * step, low[1] + height * step
    return Background(pixels[::-1], (float(low[0]), float(right), float(low[1]), float(top)))


def _blank(tracks: list[Track]) -> Background:
    points = [
        corner
        for track in tracks
        for pose in _poses(track)
        for corner in track.outline(pose).tolist()
    ] or [[0.0, 0.0], [1.0, 1.0]]
    low, high = np.min(points, axis=0) - 1.0, np.max(points, axis=0) + 1.0
    pixels = np.full((8, 8, 3), 255, dtype=np.uint8)
    return Background(pixels, (float(low[0]), float(high[0]), float(low[1]), float(high[1])))


def _poses(track: Track) -> list[tuple[float, float, float]]:
    poses = [] if track.initial is None else [track.initial]
    poses += [pose for _, pose in track.changes]
    poses += [(float(p[0]), float(p[1]), float(p[2])) for leg in track.legs for p in leg.poses]
    return poses
