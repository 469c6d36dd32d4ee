"""Rules of driving in pictures of plans: areas are tinted, those with a direction have an arrow."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from up_samp.plotting.style import AREA_FILL, FIXTURE, FREE, WRONG, mixed

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
        corners = [at(*corner) for corner in zone["polygon"]]
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
