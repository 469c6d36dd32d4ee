"""Occupancy maps as rectangles (own reader: nothing is shared with the planners)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import yaml
from PIL import Image

from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.model.frames import Frame, PlacedMap


class BlockedMap:
    """The part of the plane where nothing may drive: cells that are not free, and outside.

    ``file`` is a ROS ``map_server`` YAML (PNG or PGM beside it). A cell is free if its occupancy
    is below ``free_thresh``; occupied and unknown ones are blocked. Lengths in m, world frame;
    ``frame`` is where the frame of the file's own ``origin`` lies in the world.
    """

    def __init__(self, file: str | Path, frame: Frame | None = None) -> None:
        path = Path(file)
        data = _read_yaml(path)
        self.resolution = float(data["resolution"])
        origin = [float(v) for v in data.get("origin", [0, 0, 0])]
        frame = frame or Frame()
        turned, here = (math.cos(frame.yaw), math.sin(frame.yaw)), origin[:2]
        self.x = frame.x + turned[0] * here[0] - turned[1] * here[1]
        self.y = frame.y + turned[1] * here[0] + turned[0] * here[1]
        yaw = frame.yaw + (origin[2] if len(origin) > 2 else 0.0)
        self._cos, self._sin = math.cos(yaw), math.sin(yaw)
        blocked = _blocked_cells(path, data)
        rows, columns = blocked.shape
        boxes = [
            shapely.box(*(self.resolution * v for v in corners)) for corners in _rectangles(blocked)
        ]
        width, height = columns * self.resolution, rows * self.resolution
        far = 1e5  # wide strips around the map: outside is not allowed
        boxes += [
            shapely.box(-far, -far, 0, height + far),
            shapely.box(width, -far, width + far, height + far),
            shapely.box(0, -far, width, 0),
            shapely.box(0, height, width, height + far),
        ]
        self._tree = shapely.STRtree(boxes)

    def distances(self, polygons: FloatArray) -> FloatArray:
        """Return the distances (m, 0 on contact) from polygons to the nearest blocked part.

        ``polygons`` has shape (k, n, 2), in the world frame.
        """
        return self._nearest(shapely.polygons(self._local(polygons)))

    def distances_of(self, geometries: Any) -> FloatArray:
        """Return the same for an array of shapely geometries of any kind."""
        return self._nearest(shapely.transform(geometries, self._local))

    def _local(self, points: FloatArray) -> FloatArray:
        """Return world points (..., 2) in the frame of the map's cells."""
        dx, dy = points[..., 0] - self.x, points[..., 1] - self.y
        return np.stack((self._cos * dx + self._sin * dy, self._cos * dy - self._sin * dx), axis=-1)

    def _nearest(self, geometries: Any) -> FloatArray:
        _, distances = self._tree.query_nearest(geometries, all_matches=False, return_distance=True)
        return np.asarray(distances)


def ground_of(occupancy_map: Any) -> PlacedMap:
    """Return the floor that a UP ``OccupancyMap`` is; its frame may be SE2, SE3 or a bare tuple."""
    file = str(occupancy_map.filename)
    values = [float(v) for v in occupancy_map.reference_frame]
    if len(values) == 7 and any(values):
        x, y, z, qx, qy, qz, qw = values
        if max(abs(qx), abs(qy)) > 1e-9:
            raise UnsupportedError(f"the reference frame {tuple(values)} of map {file} is tilted")
        # the heading of the turned x axis
        yaw = math.atan2(2 * qw * qz, qw * qw - qz * qz)
        return PlacedMap(file, Frame(x, y, yaw), z)
    if len(values) not in (2, 3, 7):
        raise ProblemError(f"the reference frame of map {file} has {len(values)} numbers")
    return PlacedMap(file, Frame(*(values if len(values) < 7 else ())))


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
        return {"image": data["image"], "resolution": data["resolution"], **data}
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise ProblemError(f"map {path} cannot be read: {error}") from error


def _blocked_cells(path: Path, data: dict[str, Any]) -> BoolArray:
    """Return which cells are not free, shape (rows, columns), row 0 at the lowest y."""
    try:
        with Image.open(path.parent / data["image"], formats=("PNG", "PPM")) as image:
            grey, opaque = _grey(image)
    except OSError as error:
        raise ProblemError(f"image of map {path} cannot be read: {error}") from error
    if data.get("mode", "trinary") == "raw":
        occupancy = np.where(grey <= 100, grey / 100, 1.0)
    else:
        occupancy = grey / 255 if data.get("negate", 0) else 1 - grey / 255
    free = (occupancy < float(data.get("free_thresh", 0.196))) & opaque
    return ~np.flipud(free)


def _grey(image: Any) -> tuple[FloatArray, BoolArray]:
    """Return grey levels 0..255 (the mean of the colours) and which pixels are fully opaque."""
    if image.mode.startswith("I"):
        levels = np.asarray(image, dtype=float)
        deep = image.mode != "I" or levels.max(initial=0.0) > 255
        return levels * (255 / 65535 if deep else 1.0), np.ones(levels.shape, dtype=bool)
    pixels = np.asarray(image.convert("RGBA"), dtype=float)
    return pixels[..., :3].mean(axis=-1), pixels[..., 3] == 255


def _rectangles(blocked: BoolArray) -> Iterator[tuple[int, int, int, int]]:
    """Yield disjoint rectangles ``(x0, y0, x1, y1)`` (cells) that cover all blocked cells.

    Runs within a row, joined with equal runs of the rows above.
    """
    open_runs: dict[tuple[int, int], int] = {}
    for y, row in enumerate(blocked):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], row, [False]))))
        runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        for run in [r for r in open_runs if r not in runs]:
            yield run[0], open_runs.pop(run), run[1], y
        for run in runs:
            open_runs.setdefault(run, y)
    for run, since in open_runs.items():
        yield run[0], since, run[1], blocked.shape[0]
