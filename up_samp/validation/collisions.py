"""The plane: maps as rectangles (own reader: nothing is shared with the planners), where each body
is at every instant, and when it meets the map, or another one.

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
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
import yaml
from PIL import Image

from up_samp.model import ProblemError, UnsupportedError, check_time
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.model.frames import Frame, PlacedMap
from up_samp.validation.tolerances import JUDGING_GRACE, TOLERANCES


class BlockedMap:
    """The part of the plane where nothing may drive: cells that are not free, and outside.

    ``file`` is a ROS ``map_server`` YAML (PNG or PGM beside it). A cell is free if its occupancy
    is below ``free_thresh``; occupied and unknown ones are blocked. Lengths in m, world frame;
    ``frame`` is where the frame of the file's own ``origin`` lies in the world.
    """

    def __init__(self, file: str | Path, frame: Frame = Frame()) -> None:
        path = Path(file)
        data = _read_yaml(path)
        self.resolution = float(data["resolution"])
        origin = [float(v) for v in data.get("origin", [0, 0, 0])]
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


# ------------------ Where each body is


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


def rotations(quaternions: FloatArray) -> Any:
    """Return SciPy's rotations of quaternions (..., 4), x y z w, of any length (0: no turn)."""
    from scipy.spatial.transform import Rotation  # slow to import, and nothing but flyers needs it

    nothing = ~quaternions.any(axis=-1, keepdims=True)
    return Rotation.from_quat(np.where(nothing, (0.0, 0.0, 0.0, 1.0), quaternions))


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
    if (np.maximum(mine_low - its_high, its_low - mine_high) > radii).any():
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
