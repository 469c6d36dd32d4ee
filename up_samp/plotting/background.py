"""The map of a plan as a picture, and the rectangle of the world that it shows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from up_samp.geometry.atlas import in_world
from up_samp.geometry.maps import MOST_PIXELS, OccupancyGrid
from up_samp.io.floors import maps_of, side_by_side
from up_samp.model.frames import Frame
from up_samp.plotting.style import FREE, OCCUPIED, UNKNOWN
from up_samp.plotting.tracks import ObjectTrack, tracks_of


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


@dataclass(frozen=True, eq=False)
class Backdrop:
    """A plan laid out for a picture: ``plan`` with its floors side by side, the ``background``
    under it, and ``shifts``, where the maps of each height went. ``labels`` name floors, with the
    point (m) of their upper left corner; with one floor there is none.
    """

    plan: dict[str, Any]
    background: Background
    shifts: Mapping[float, Frame]
    labels: tuple[tuple[str, tuple[float, float]], ...] = ()

    def places(self, given: Mapping[str, tuple[float, ...]] | None) -> dict[str, Sequence[float]]:
        """Return named poses (see ``NamedPlace``) where they are drawn."""
        found: dict[str, Sequence[float]] = {}
        for name, pose in (given or {}).items():
            shift = self.shifts.get(getattr(pose, "height", 0.0), Frame())
            found[name] = (pose[0] + shift.x, pose[1] + shift.y, *pose[2:])
        return found


class NamedPlace(tuple[float, ...]):
    """A pose that knows how high (m) its map is."""

    height: float = 0.0

    @classmethod
    def at(cls, pose: Iterable[float], height: float) -> NamedPlace:
        """Return a pose on a map ``height`` m up."""
        place = cls(pose)
        place.height = height
        return place


def ground_of(plan: dict[str, Any]) -> Backdrop:
    """Return a plan laid out for a picture, with the picture of its maps: free white, occupied
    dark, unknown light grey.

    Without a map: a white rectangle around everything that the plan shows. Raises
    :class:`~up_samp.model.ProblemError` where the map's files are missing or wrong.
    """
    maps = maps_of(plan)
    if not maps:
        return Backdrop(plan, _blank(tracks_of(plan)), {})
    drawn = [_drawn(in_world(placed)) for placed in maps]
    if len(maps) == 1:
        return Backdrop(plan, drawn[0], {})
    boxes = [(e[0], e[2], e[1], e[3]) for e in (d.extent for d in drawn)]
    laid, frames = side_by_side(plan, boxes)
    for k, (one, frame) in enumerate(zip(drawn, frames, strict=True)):
        left, right, bottom, top = one.extent
        extent = (left + frame.x, right + frame.x, bottom + frame.y, top + frame.y)
        drawn[k] = Background(one.pixels, extent)
    labels = tuple((m.label, (d.extent[0], d.extent[3])) for m, d in zip(maps, drawn, strict=True))
    shifts = {m.height: frame for m, frame in zip(maps, frames, strict=True)}
    return Backdrop(laid, _joined(drawn), shifts, labels)


def _joined(parts: Sequence[Background]) -> Background:
    """Return one picture of several that lie beside each other; between them it is white."""
    left, bottom = (min(p.extent[i] for p in parts) for i in (0, 2))
    right, top = (max(p.extent[i] for p in parts) for i in (1, 3))
    cell = min((p.extent[1] - p.extent[0]) / p.pixels.shape[1] for p in parts)
    cell = max(cell, math.sqrt((right - left) * (top - bottom) / MOST_PIXELS))
    size = math.ceil((right - left) / cell), math.ceil((top - bottom) / cell)
    whole = Image.new("RGB", size, "white")
    for part in parts:
        low, high, under, over = part.extent
        first, last = round((top - over) / cell), round((top - under) / cell)
        west, east = round((low - left) / cell), round((high - left) / cell)
        drawn = Image.fromarray(np.ascontiguousarray(part.pixels), "RGB")
        drawn = drawn.resize((east - west, last - first), Image.Resampling.NEAREST)
        whole.paste(drawn, (west, first))
    extent = (left, left + whole.width * cell, top - whole.height * cell, top)
    return Background(np.asarray(whole), extent)


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


def _blank(tracks: list[ObjectTrack]) -> Background:
    points = [
        corner
        for track in tracks
        for pose in _poses(track)
        for corner in track.outline(pose).tolist()
    ] or [[0.0, 0.0], [1.0, 1.0]]
    low, high = np.min(points, axis=0) - 1.0, np.max(points, axis=0) + 1.0
    pixels = np.full((8, 8, 3), 255, dtype=np.uint8)
    return Background(pixels, (float(low[0]), float(high[0]), float(low[1]), float(high[1])))


def _poses(track: ObjectTrack) -> list[tuple[float, float, float]]:
    poses = [] if track.initial is None else [track.initial]
    poses += [pose for _, pose in track.changes]
    poses += [(float(p[0]), float(p[1]), float(p[2])) for leg in track.legs for p in leg.poses]
    return poses
