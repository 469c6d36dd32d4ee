"""What lies under a plan in pictures: its maps, the rectangle of the world that they show, and the
rules of driving (areas are tinted, those with a direction have an arrow).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import starmap
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from up_samp.geometry.atlas import in_world
from up_samp.geometry.maps import MOST_PIXELS, OccupancyGrid
from up_samp.io.floors import maps_of, side_by_side
from up_samp.model.frames import Frame
from up_samp.plotting.style import AREA_FILL, FIXTURE, FREE, OCCUPIED, UNKNOWN, WRONG, mixed
from up_samp.plotting.tracks import ObjectTrack, tracks_of

LANE_FILL = mixed(FIXTURE, 0.75)
Zone = Mapping[str, Any]
"""Rules of a part of the floor, as a plan file tells them."""
Corners = frozenset[tuple[float, ...]]


def rules_of(plan: Mapping[str, Any]) -> list[Zone]:
    """Return the rules that robots of a plan keep, each once."""
    all_zones = [zone for one in plan["objects"] for zone in one.get("zones", ())]
    return list({json.dumps(zone, sort_keys=True): zone for zone in all_zones}.values())


def is_lane(zone: Zone) -> bool:
    """Return whether robots like to drive there."""
    return "prefer" in zone


def told(zone: Zone) -> str:
    """Return what a zone asks of robots, in a few words."""
    said = [f"{zone['v_max']:g} m/s"] if "v_max" in zone else []
    said += [text for key, text in (("pivots", "no turning"), ("stops", "no stop")) if key in zone]
    said += [text for key, text in (("one_way", "one way"), ("dock", "docking")) if key in zone]
    return ", ".join(said + (["go round"] if "cost" in zone else []))


def tinted(
    pixels: npt.NDArray[np.uint8],
    extent: tuple[float, float, float, float],
    rules: Sequence[Zone],
    *,
    wide: int = 1500,
) -> npt.NDArray[np.uint8]:
    """Return a picture (rows, cols, 3), row 0 at the top, of ``extent`` (left, right, bottom, top;
    m), whose free floor is tinted where there are ``rules``, in some ``wide`` pixels at least.
    """
    if not rules:
        return pixels
    fine = max(1, wide // max(pixels.shape[:2]))
    pixels = pixels.repeat(fine, axis=0).repeat(fine, axis=1)
    (left, right, bottom, top), (rows, cols) = extent, pixels.shape[:2]

    def at(x: float, y: float) -> tuple[float, float]:
        return (x - left) / (right - left) * cols, (top - y) / (top - bottom) * rows

    free = np.all(pixels == np.asarray(FREE), axis=-1)
    picture = Image.fromarray(np.ascontiguousarray(pixels), "RGB")
    draw = ImageDraw.Draw(picture)
    for zone in sorted(rules, key=is_lane, reverse=True):  # what is preferred below what is ruled
        corners = list(starmap(at, zone["polygon"]))
        draw.polygon(corners, fill=LANE_FILL if is_lane(zone) else AREA_FILL)
    for zone in rules:
        if "one_way" in zone:
            _draw_arrow(draw, zone, at)
    return np.where(free[..., None], np.asarray(picture), pixels)


def _draw_arrow(
    draw: ImageDraw.ImageDraw, zone: Zone, at: Callable[[float, float], tuple[float, float]]
) -> None:
    """Draw the way that a zone allows across its middle."""
    corners = np.asarray(zone["polygon"], dtype=np.float64)
    (x, y), reach = corners.mean(axis=0), 0.3 * float(np.ptp(corners, axis=0).min())
    tip = x + reach * math.cos(zone["one_way"]), y + reach * math.sin(zone["one_way"])
    for turn, length in ((0.0, 2.0), (0.5, 0.8), (-0.5, 0.8)):
        heading = zone["one_way"] + turn
        back = length * reach * math.cos(heading), length * reach * math.sin(heading)
        draw.line([at(*tip), at(tip[0] - back[0], tip[1] - back[1])], fill=WRONG, width=3)


def corners_of(outline: Any) -> Corners:
    """Return what tells a part of the floor, by its corners (n, 2), from others."""
    return frozenset(tuple(round(float(v), 3) for v in corner) for corner in outline)


Extent = tuple[float, float, float, float]
"""(left, right, bottom, top) in m, world frame."""
Drawn = tuple[npt.NDArray[np.uint8], Extent]
"""Pixels of shape (rows, cols, 3), row 0 at the top, and what they show."""


@dataclass(frozen=True)
class FloorPanel:
    """A floor in a picture: its name, the part ``extent`` of the picture that it is, and the
    ``frame`` in which its own coordinates lie there.
    """

    name: str
    extent: Extent
    frame: Frame


@dataclass(frozen=True, eq=False)
class Backdrop:
    """A plan laid out for a picture: ``plan`` with its floors side by side, the ``pixels`` (rows,
    cols, 3), row 0 at the top, of what is under it within ``extent``, and ``shifts``, where the
    maps of each height went. ``floors`` are drawn in panels of their own, the lowest first; if
    there is one only, it has no name.
    """

    plan: dict[str, Any]
    pixels: npt.NDArray[np.uint8]
    extent: Extent
    shifts: Mapping[float, Frame] = field(default_factory=dict)
    floors: tuple[FloorPanel, ...] = ()

    def places(self, given: Mapping[str, tuple[float, ...]] | None) -> dict[str, Sequence[float]]:
        """Return named poses, in the plane or in space, where they are drawn."""
        found: dict[str, Sequence[float]] = {}
        for name, pose in (given or {}).items():
            shift = self.shifts.get(pose[2] if len(pose) == 7 else 0.0, Frame())
            found[name] = (pose[0] + shift.x, pose[1] + shift.y, *pose[2:])
        return found


def ground_of(plan: dict[str, Any]) -> Backdrop:
    """Return a plan laid out for a picture, with the picture of its maps: free white, occupied
    dark, unknown light grey, rules of driving tinted.

    Without a map: a white rectangle around everything that the plan shows. Raises
    :class:`~up_samp.model.ProblemError` where the map's files are missing or wrong.
    """
    laid = _laid_out(plan)
    pixels = tinted(laid.pixels, laid.extent, rules_of(laid.plan))
    return replace(laid, pixels=pixels)


def _laid_out(plan: dict[str, Any]) -> Backdrop:
    """Return a plan laid out for a picture, and its maps."""
    maps = maps_of(plan)
    if not maps:
        return _whole(plan, _blank(tracks_of(plan)))
    drawn = [_drawn(in_world(placed)) for placed in maps]
    if len(maps) == 1:
        return _whole(plan, drawn[0])
    boxes = [(left, bottom, right, top) for _, (left, right, bottom, top) in drawn]
    laid, frames = side_by_side(plan, boxes)
    for k, frame in enumerate(frames):
        pixels, (left, right, bottom, top) = drawn[k]
        extent = (left + frame.x, right + frame.x, bottom + frame.y, top + frame.y)
        drawn[k] = pixels, extent
    shifts = {m.height: frame for m, frame in zip(maps, frames, strict=True)}
    floors = []
    for height, frame in sorted(shifts.items()):
        own = [k for k, m in enumerate(maps) if m.height == height]
        name = " / ".join(maps[k].label.replace("'", "") for k in own)
        floors.append(FloorPanel(name, _around([drawn[k] for k in own]), frame))
    if len(floors) == 1:
        floors = [replace(floors[0], name="")]
    return Backdrop(laid, *_joined(drawn), shifts, tuple(floors))


def _whole(plan: dict[str, Any], drawn: Drawn) -> Backdrop:
    return Backdrop(plan, *drawn, floors=(FloorPanel("", drawn[1], Frame()),))


def _around(parts: Sequence[Drawn]) -> Extent:
    """Return what several pictures show together."""
    left, bottom = (min(at[i] for _, at in parts) for i in (0, 2))
    right, top = (max(at[i] for _, at in parts) for i in (1, 3))
    return left, right, bottom, top


def _joined(parts: Sequence[Drawn]) -> Drawn:
    """Return one picture of several that lie beside each other; between them it is white."""
    left, right, bottom, top = _around(parts)
    cell = min((at[1] - at[0]) / pixels.shape[1] for pixels, at in parts)
    cell = max(cell, math.sqrt((right - left) * (top - bottom) / MOST_PIXELS))
    size = math.ceil((right - left) / cell), math.ceil((top - bottom) / cell)
    whole = Image.new("RGB", size, "white")
    for pixels, (low, high, under, over) in parts:
        first, last = round((top - over) / cell), round((top - under) / cell)
        west, east = round((low - left) / cell), round((high - left) / cell)
        drawn = Image.fromarray(np.ascontiguousarray(pixels), "RGB")
        drawn = drawn.resize((east - west, last - first), Image.Resampling.NEAREST)
        whole.paste(drawn, (west, first))
    extent = (left, left + whole.width * cell, top - whole.height * cell, top)
    return np.asarray(whole), extent


def _drawn(grid: OccupancyGrid) -> Drawn:
    colors = np.empty((*grid.occupied.shape, 3), dtype=np.uint8)
    colors[:] = FREE
    colors[grid.unknown] = UNKNOWN
    colors[grid.occupied] = OCCUPIED
    x, y, yaw = grid.origin
    width, height = grid.size
    return _turned(colors, grid) if yaw else (colors[::-1], (x, x + width, y, y + height))


def _turned(colors: npt.NDArray[np.uint8], grid: OccupancyGrid) -> Drawn:
    """Resample a map with a yaw into the world's axes; what lies outside the map is unknown."""
    (low, high), step = grid.box, grid.resolution
    width, height = (max(1, math.ceil(v / step)) for v in high - low)
    x, y = np.meshgrid(
        low[0] + (np.arange(width) + 0.5) * step, low[1] + (np.arange(height) + 0.5) * step
    )
    row, col = grid.cells_of(np.column_stack((x.ravel(), y.ravel()))).T.reshape(2, height, width)
    rows, cols = grid.shape
    inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    pixels[:] = UNKNOWN
    pixels[inside] = colors[row[inside], col[inside]]
    right, top = low[0] + width * step, low[1] + height * step
    return pixels[::-1], (float(low[0]), float(right), float(low[1]), float(top))


def _blank(tracks: list[ObjectTrack]) -> Drawn:
    points = [
        corner
        for track in tracks
        for pose in _poses(track)
        for corner in track.outline(pose).tolist()
    ] or [[0.0, 0.0], [1.0, 1.0]]
    low, high = np.min(points, axis=0) - 1.0, np.max(points, axis=0) + 1.0
    pixels = np.full((8, 8, 3), 255, dtype=np.uint8)
    return pixels, (float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def _poses(track: ObjectTrack) -> list[tuple[float, float, float]]:
    poses = [] if track.initial is None else [track.initial]
    poses += [pose for _, pose in track.changes]
    poses += [(float(p[0]), float(p[1]), float(p[2])) for leg in track.legs for p in leg.poses]
    return poses
