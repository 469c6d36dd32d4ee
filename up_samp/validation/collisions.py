"""Bodies in the plane: where each is at every instant, and when two of them meet.

Between two samples a planar body moves with a constant twist, so its reference point runs along
an arc (Lynch & Park, *Modern Robotics*, ch. 3). Collisions are swept and not sampled, by
conservative advancement and bisection: at a time in the middle of an interval the gap is compared
with how far the bodies' farthest points can move until its ends: a larger gap proves the interval
free, otherwise it is halved (the idea of conservative advancement, Mirtich 1996, and of Schwarzer,
Saha & Latombe, *Adaptive dynamic collision checking*, 2005). Lengths in m, angles in rad, times in
s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.model import ProblemError, check_time
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.validation.maps import BlockedMap
from up_samp.validation.tolerances import JUDGING_GRACE, TOLERANCES


@dataclass(frozen=True)
class Pieces:
    """The motions between neighbouring samples of a planar trajectory; arrays of length n - 1."""

    dt: FloatArray
    chord: FloatArray
    """Displacements in the world frame, shape (n - 1, 2)."""
    turn: FloatArray
    along: FloatArray
    """Signed length of the arc along the body's heading (its component; backwards: negative)."""
    across: FloatArray
    """Displacement to the left of the heading in the middle of the piece."""
    length: FloatArray
    """Length of the reference point's arc (>= 0)."""

    @property
    def at_rest(self) -> BoolArray:
        """Which pieces are rests."""
        return np.asarray((self.length < 1e-9) & (np.abs(self.turn) < 1e-9))


def pieces_of(times: FloatArray, poses: FloatArray) -> Pieces:
    """Split a planar trajectory (times (n,), poses (n, 3)) into its pieces."""
    step = np.diff(poses, axis=0)
    chord, turn = step[:, :2], step[:, 2]
    middle = poses[:-1, 2] + turn / 2
    half = turn / 2
    # arc length over chord length; np.sinc(x) is sin(pi x) / (pi x)
    stretch = 1 / np.maximum(np.abs(np.sinc(half / math.pi)), 1e-6)
    along = (chord[:, 0] * np.cos(middle) + chord[:, 1] * np.sin(middle)) * stretch
    across = (chord[:, 1] * np.cos(middle) - chord[:, 0] * np.sin(middle)) * stretch
    length = np.hypot(chord[:, 0], chord[:, 1]) * stretch
    return Pieces(np.diff(times), chord, turn, along, across, length)


@dataclass(frozen=True)
class Track:
    """A planar body's pose over all time; it rests before the first and after the last sample.

    ``radius`` is the distance of the body's farthest point from its reference point.
    """

    times: FloatArray
    poses: FloatArray
    radius: float
    _travel: FloatArray = field(init=False, repr=False)
    _bulge: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        pieces = pieces_of(self.times, self.poses)
        # no point of an arc is farther from its chord than that
        aside = np.sqrt(np.maximum(pieces.length**2 - (pieces.chord**2).sum(1), 0.0)) / 2
        object.__setattr__(self, "_bulge", float(aside.max(initial=0.0)))
        steps = pieces.length + self.radius * np.abs(pieces.turn)
        object.__setattr__(self, "_travel", np.concatenate(([0.0], np.cumsum(steps))))

    def pose(self, t: float) -> tuple[float, ...]:
        """Return the pose at time ``t``."""
        return tuple(self.poses_at(np.array([t]))[0].tolist())

    def poses_at(self, times: FloatArray) -> FloatArray:
        """Return the poses at ``times`` (k,), shape (k, 3)."""
        i, share = self._locate(times)
        begin = self.poses[i]
        step = self.poses[np.minimum(i + 1, len(self.poses) - 1)] - begin
        # the part of an arc has the chord sin(share * turn / 2) / sin(turn / 2), turned back
        half = step[:, 2] / 2
        bent = np.abs(half) > 1e-9
        ratio = share.copy()
        ratio[bent] = np.sin(share[bent] * half[bent]) / np.sin(half[bent])
        back = (share - 1) * half
        c, s = ratio * np.cos(back), ratio * np.sin(back)
        along = np.column_stack(
            (
                c * step[:, 0] - s * step[:, 1],
                s * step[:, 0] + c * step[:, 1],
                share * step[:, 2],
            )
        )
        return np.asarray(begin + along)

    def box(self, a: float, b: float) -> tuple[FloatArray, FloatArray]:
        """Return the corners (2,) of a box around where the reference point is from a to b."""
        first = max(int(np.searchsorted(self.times, a, side="right")) - 1, 0)
        last = min(int(np.searchsorted(self.times, b, side="left")), len(self.times) - 1)
        points = self.poses[min(first, last) : last + 1, :2]
        return points.min(0) - self._bulge, points.max(0) + self._bulge

    def travel(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return upper bounds on the way of any point of the body between times a <= b."""
        return self._travelled(b) - self._travelled(a)

    def _travelled(self, times: FloatArray) -> FloatArray:
        i, share = self._locate(times)
        step = self._travel[np.minimum(i + 1, len(self._travel) - 1)] - self._travel[i]
        return np.asarray(self._travel[i] + share * step)

    def _locate(self, times: FloatArray) -> tuple[npt.NDArray[np.intp], FloatArray]:
        """Return the pieces that hold ``times`` and the shares of them that are over."""
        clipped = np.clip(times, self.times[0], self.times[-1])
        i = np.searchsorted(self.times, clipped, side="right") - 1
        i = np.minimum(i, max(len(self.times) - 2, 0))
        length = self.times[np.minimum(i + 1, len(self.times) - 1)] - self.times[i]
        share = np.divide(
            clipped - self.times[i], length, out=np.zeros(len(clipped)), where=length > 0
        )
        return i, share


# ------------------ When two of them meet


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
