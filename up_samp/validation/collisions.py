"""Do bodies meet? Swept, not sampled: conservative advancement by bisection.

At a time in the middle of an interval the gap is compared with how far the bodies' farthest points
can move until its ends: a larger gap proves the interval free, otherwise it is halved (the idea
of conservative advancement, Mirtich 1996, and of Schwarzer, Saha & Latombe, *Adaptive dynamic
collision checking*, 2005). Lengths in m, times in s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.model import ProblemError
from up_samp.validation.maps import BlockedMap
from up_samp.validation.tracks import Pose, Track

FloatArray = npt.NDArray[np.float64]

PENETRATION = 1e-6
"""Bodies may touch, and be into each other by this much (m): rounding is no crash."""

RESOLUTION = 1e-3
"""Where bodies nearly touch: no more than this way (m) is left unlooked at between two looks."""


@dataclass(frozen=True)
class Shape:
    """A footprint polygon in the body frame, and the same one thinner by ``PENETRATION``."""

    name: str
    corners: FloatArray
    thin: FloatArray = field(init=False)
    radius: float = field(init=False)

    def __post_init__(self) -> None:
        polygon = shapely.Polygon(self.corners)
        thin = polygon.buffer(-PENETRATION, join_style="mitre")
        if not polygon.is_valid or thin.is_empty or thin.geom_type != "Polygon":
            raise ProblemError(f"the footprint of {self.name} is no simple polygon with an inside")
        object.__setattr__(self, "thin", np.array(thin.exterior.coords)[:-1])
        object.__setattr__(self, "radius", float(np.hypot(*self.corners.T).max()))


def placed(corners: FloatArray, pose: Pose) -> FloatArray:
    """Return a polygon's corners, shape (n, 2), in the world frame at ``pose``."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.column_stack(
        (
            pose[0] + c * corners[:, 0] - s * corners[:, 1],
            pose[1] + s * corners[:, 0] + c * corners[:, 1],
        )
    )


def first_contact(
    low: float,
    high: float,
    gap: Callable[[float], float],
    travel: Callable[[float, float], float],
) -> float | None:
    """Return a time in [low, high] at which ``gap`` is 0, ``None`` if there is none.

    ``gap(t)`` is a lower bound on the distance at time t, 0 only on contact; ``travel(a, b)``
    bounds how much it can shrink between a and b. Contacts that last less than ``RESOLUTION`` of
    way between two looks may be missed.
    """
    waiting = [(low, high)]
    while waiting:
        a, b = waiting.pop()
        middle = (a + b) / 2
        distance = gap(middle)
        reach = max(travel(a, middle), travel(middle, b))
        if distance > reach:
            continue
        if distance <= 0:
            return middle
        if reach > RESOLUTION / 2:
            waiting += [(middle, b), (a, middle)]
    return None


def hits_map(
    shape: Shape, track: Track, blocked: BlockedMap, low: float, high: float
) -> float | None:
    """Return a time in [low, high] at which a moving body meets the map's blocked part."""
    return first_contact(
        low, high, lambda t: blocked.distance(placed(shape.thin, track.pose(t))), track.travel
    )


def hits_body(
    shape: Shape, track: Track, other: Shape, other_track: Track, low: float, high: float
) -> float | None:
    """Return a time in [low, high] at which two bodies meet."""
    radii = shape.radius + other.radius

    def gap(t: float) -> float:
        mine, theirs = track.pose(t), other_track.pose(t)
        around = math.hypot(mine[0] - theirs[0], mine[1] - theirs[1]) - radii
        if around > 0.5 * radii:
            return around
        return float(
            shapely.distance(
                shapely.Polygon(placed(shape.thin, mine)),
                shapely.Polygon(placed(other.corners, theirs)),
            )
        )

    def travel(a: float, b: float) -> float:
        return track.travel(a, b) + other_track.travel(a, b)

    return first_contact(low, high, gap, travel)
