"""Collisions in the plane, swept and not sampled: conservative advancement by bisection.

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
import shapely

from up_samp.model import ProblemError, check_time
from up_samp.model.arrays import FloatArray
from up_samp.validation.maps import BlockedMap
from up_samp.validation.tolerances import TOLERANCES
from up_samp.validation.tracks import Track
from up_samp.validation.verdict import JUDGING_GRACE


@dataclass(frozen=True)
class JudgedShape:
    """A footprint polygon in the body frame, and the same one thinner by
    ``TOLERANCES.penetration``; what is above its ``height`` (m over the floor) does not meet it.
    """

    name: str
    corners: FloatArray
    height: float = math.inf
    thin: FloatArray = field(init=False)
    radius: float = field(init=False)

    def __post_init__(self) -> None:
        polygon = shapely.Polygon(self.corners)
        thin = polygon.buffer(-TOLERANCES.penetration, join_style="mitre")
        if not polygon.is_valid or thin.is_empty or thin.geom_type != "Polygon":
            raise ProblemError(f"the footprint of {self.name} is no simple polygon with an inside")
        object.__setattr__(self, "thin", np.array(thin.exterior.coords)[:-1])
        object.__setattr__(self, "radius", float(np.hypot(*self.corners.T).max()))


def placed(corners: FloatArray, poses: FloatArray) -> FloatArray:
    """Return a polygon (n, 2) of the body frame at world ``poses`` (k, 3): shape (k, n, 2)."""
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = corners[:, 0], corners[:, 1]
    return np.stack((poses[:, [0]] + c * x - s * y, poses[:, [1]] + s * x + c * y), axis=-1)


def first_contact(
    low: float,
    high: float,
    gap: Callable[[FloatArray], FloatArray],
    travel: Callable[[FloatArray, FloatArray], FloatArray],
) -> float | None:
    """Return a time in [low, high] at which ``gap`` is 0, ``None`` if there is none.

    ``gap(t)`` are lower bounds on the distances at times t, 0 only on contact; ``travel(a, b)``
    bounds how much they can shrink between a and b. Contacts that last less than
    ``TOLERANCES.unseen_contact`` of way between two looks may be missed. All intervals of a
    generation are judged at once.
    """
    a, b = np.array([low]), np.array([high])
    while len(a):
        check_time(JUDGING_GRACE)
        middle = (a + b) / 2
        distance = gap(middle)
        if (distance <= 0).any():
            return float(middle[distance <= 0][0])
        reach = np.maximum(travel(a, middle), travel(middle, b))
        open_ = (distance <= reach) & (reach > TOLERANCES.unseen_contact / 2)
        a, middle, b = a[open_], middle[open_], b[open_]
        a, b = np.column_stack((a, middle)).ravel(), np.column_stack((middle, b)).ravel()
    return None


def hits_map(
    shape: JudgedShape, track: Track, blocked: BlockedMap, low: float, high: float
) -> float | None:
    """Return a time in [low, high] at which a moving body meets the map's blocked part."""

    def gap(times: FloatArray) -> FloatArray:
        return blocked.distances(placed(shape.thin, track.poses_at(times)))

    return first_contact(low, high, gap, track.travel)


def hits_body(
    shape: JudgedShape,
    track: Track,
    other: JudgedShape,
    other_track: Track,
    low: float,
    high: float,
) -> float | None:
    """Return a time in [low, high] at which two bodies meet."""
    radii = shape.radius + other.radius
    mine_low, mine_high = track.box(low, high)
    its_low, its_high = other_track.box(low, high)
    if (mine_low - its_high > radii).any() or (its_low - mine_high > radii).any():
        return None

    def gap(times: FloatArray) -> FloatArray:
        mine, theirs = track.poses_at(times), other_track.poses_at(times)
        apart = np.hypot(mine[:, 0] - theirs[:, 0], mine[:, 1] - theirs[:, 1]) - radii
        near = apart <= 0.5 * radii
        apart[near] = shapely.distance(
            shapely.polygons(placed(shape.thin, mine[near])),
            shapely.polygons(placed(other.corners, theirs[near])),
        )
        return np.asarray(apart)

    def travel(a: FloatArray, b: FloatArray) -> FloatArray:
        return track.travel(a, b) + other_track.travel(a, b)

    return first_contact(low, high, gap, travel)
