"""Admissible lower bounds on the durations of motions.

A motion's path is at least as long as the shortest way of the footprint's inscribed disc (about
the reference point) among what surely blocks it, and a car's at least as long as the shortest
Reeds-Shepp curve (Dubins curve, if it drives ahead only); no speed profile from rest to rest beats
the trapezoid over that length, and a car rests at each cusp.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.geometry import OccupancyGrid, Scene
from up_samp.geometry.cells import Visibility, grown, label_regions
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import along, inner, kernel
from up_samp.geometry.shapes import core_of, shape_of
from up_samp.model import Body, Configuration, Kinematics, Mobility, Placed, TrafficZone
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.model.frames import Frame
from up_samp.motion.curves.reeds_shepp import DriveLimits, run_time, shortest
from up_samp.motion.curves.slowing import OVER
from up_samp.motion.curves.trapezoid import limits_of
from up_samp.motion.proofs.certificates import Certifier


class DurationBounds:
    """Lower bounds (s) on motions in one scene, cached by body size and obstacles."""

    def __init__(self, scene: Scene, certifier: Certifier | None = None) -> None:
        self.scene = scene
        self.certifier = certifier or Certifier(scene)
        self._known: Memory[Visibility] = Memory(64)
        self._slow: Memory[SlowZone | None] = Memory(32)

    def through(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed] = ()
    ) -> float:
        """Return seconds that no motion through ``poses`` can beat; it rests at the first and at
        the last one, but need not stop at those between.

        0 for bodies with their own equations of motion (nothing is known about their speed).
        """
        kin = body.kinematics
        if kin.mobility.own_law:
            return 0.0
        if kin.parts:
            lead = self.through(replace(body, kinematics=kin.own), poses, obstacles)
            return max(lead, *(self._along(body, part, poses) for part in kin.parts[1:]))
        legs = list(itertools.pairwise(poses))
        length = sum(self.way(body, a, b, obstacles) for a, b in legs)
        least = self._least(body, legs, length)
        slow = self._slow_parts(body, legs)
        if slow:
            length = max(length, sum(metres for metres, _ in slow))
            least = max(least, fastest_with_slow(length, slow, kin.v_max, kin.a_max))
        return least * (1 - 1e-9)

    def after(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed]
    ) -> float:
        """Return seconds that no motion through ``poses`` beats, to rest at the last one, from when
        the last of the obstacles goes away that it cannot pass (0: nothing is proven).
        """
        kin = body.kinematics.own
        if kin.mobility.own_law:
            return 0.0
        left = self.certifier.left(body, poses, obstacles)
        # as long as the second half of a motion from rest to rest
        return 0.5 * run_time(2 * left, kin.v_max, kin.a_max) * (1 - 1e-9)

    @classmethod
    def _along(
        cls, body: Body, part: tuple[Configuration, Kinematics], poses: Sequence[Configuration]
    ) -> float:
        """Return seconds that one of several bodies that drive together takes at least."""
        legs = list(itertools.pairwise(Frame(*pose).of(part[0]) for pose in poses))
        length = sum(math.dist(a[:2], b[:2]) for a, b in legs)
        return cls._least(replace(body, kinematics=part[1]), legs, length) * (1 - 1e-9)

    @staticmethod
    def _least(
        body: Body, legs: Sequence[tuple[Configuration, Configuration]], length: float
    ) -> float:
        """Return seconds that no motion of so many m through some legs beats, whatever zones it
        leads through.
        """
        kin = body.kinematics
        if kin.mobility.steers and len(legs) == 1:
            return fastest_runs(*legs[0], limits_of(kin), length)
        least = max(
            run_time(length, kin.v_max, kin.a_max),
            sum(_turn(kin.mobility, a, b) for a, b in legs) / kin.omega_max,
        )
        if kin.mobility.rolls and len(legs) == 1:
            least = fastest_roll(*legs[0], kin, least)
        return least

    def _slow_parts(
        self, body: Body, legs: Sequence[tuple[Configuration, Configuration]]
    ) -> list[tuple[float, float]]:
        """Return how much (m) of any motion through some legs is in zones, and how fast (m/s) it
        may be there: of zones that overlap those that cost most.
        """
        kin = body.kinematics
        if kin.mobility.flies:
            return []
        told = []
        for zone in kin.zones:
            if not (zone.v_max < kin.v_max and zone.binds(legs[-1][1])):
                continue
            if zone.dock is not None:
                area: shapely.Geometry = shapely.Polygon(zone.polygon)
                metres = min(zone.long, math.dist(legs[0][0][:2], zone.dock[:2]))
            elif (known := self._slow_zone(body, zone)) is not None:
                area, metres = known.area, sum(self._slow_way(known, a, b) for a, b in legs)
            else:
                continue
            told.append((metres * (1.0 / zone.v_max - 1.0 / kin.v_max), metres, zone, area))
        told.sort(key=lambda one: -one[0])
        kept: list[tuple[float, float, shapely.Geometry]] = []
        for lost, metres, zone, area in told:
            if lost > 0.0 and not any(area.intersects(other) for *_, other in kept):
                kept.append((metres, zone.v_max, area))
        return [(metres, v_max) for metres, v_max, _ in kept]

    def _slow_zone(self, body: Body, zone: TrafficZone) -> SlowZone | None:
        """Return what is known of a zone for a body (None: nothing)."""
        grid, radius = self.scene.grid, shape_of(core_of(body)).inscribed
        if grid is None or radius <= 0.0:
            return None
        key = (round(radius, 9), zone.polygon)
        if key not in self._slow:
            blocked = self.certifier.blocked(radius, ())
            self._slow.put(key, slow_zone(zone, grid, blocked, radius))
        return self._slow.get(key)

    def _slow_way(self, zone: SlowZone, start: Configuration, goal: Configuration) -> float:
        """Return how much (m) of any way between two poses is slow."""
        cells = [(math.floor(y), math.floor(x)) for x, y in map(self._cells, (start, goal))]
        rows, cols = zone.kind.shape
        if not all(0 <= row < rows and 0 <= col < cols for row, col in cells):
            return 0.0
        return zone.least(cells[0], cells[1], math.dist(start[:2], goal[:2]))

    def way(
        self,
        body: Body,
        start: Configuration,
        goal: Configuration,
        obstacles: Sequence[Placed] = (),
    ) -> float:
        """Return metres that no way of a body's reference point between two poses can beat."""
        kin = body.kinematics
        if kin.mobility.flies:
            return math.dist(start[:3], goal[:3])
        length = self.length(body, start, goal, obstacles)
        if kin.mobility.steers:
            sense = limits_of(kin).sense
            length = max(length, shortest(start, goal, kin.turning_radius, sense)[0])
        return length

    def length(
        self,
        body: Body,
        start: Configuration,
        goal: Configuration,
        obstacles: Sequence[Placed] = (),
    ) -> float:
        """Return metres that no way of the reference point between two planar poses can beat."""
        straight = math.dist(start[:2], goal[:2])
        grid = self.scene.grid
        radius = shape_of(core_of(body)).inscribed
        if grid is None or radius <= 0.0:
            return straight
        a, b = self._cells(start), self._cells(goal)
        way = self._visibility(radius, obstacles).distance(a, b)
        return max(straight, way) if math.isfinite(way) else straight

    def _cells(self, pose: Configuration) -> tuple[float, float]:
        """Return a point in cells from the map's corner."""
        frame = self.scene.data.frame
        gx, gy = along(frame, pose[0], pose[1])
        return float(gx / frame.size), float(gy / frame.size)

    def _visibility(self, radius: float, obstacles: Sequence[Placed]) -> Visibility:
        key = (
            round(radius, 9),
            frozenset((p.body.footprint, tuple(p.pose)) for p in obstacles),
        )
        size = self.scene.data.frame.size
        return self._known.get_or(
            key, lambda: Visibility(self.certifier.blocked(radius, obstacles), size)
        )


def _turn(able: Mobility, start: Configuration, goal: Configuration) -> float:
    """Return radians that a body which may turn on the spot turns at least (a car's turns are in
    the length of its way).
    """
    if able.flies:
        dot = abs(sum(a * b for a, b in zip(start[3:], goal[3:], strict=True)))
        norm = math.hypot(*start[3:]) * math.hypot(*goal[3:])
        return 2 * math.acos(min(1.0, dot / norm))
    if able.pivots:
        return abs(math.remainder(goal[2] - start[2], 2 * math.pi))
    return 0.0


# ------------------ What no body that drives along its heading beats between two poses
# A car rests wherever it turns back, and its shortest way is rarely the fastest one. Let the
# longest run leave some metres (rest) of the way to the others: they take at least what one run
# over them all takes. If they are short, the car has hardly moved before and after the longest run,
# which is no shorter than a Dubins curve between poses as near as that.


RESTS = 0.5 * 1.2 ** np.arange(-80.0, 1.0)
"""Shares of the whole way for which the runs beside the longest one are told apart."""


@kernel
def fastest_runs(
    start: Configuration, goal: Configuration, car: DriveLimits, length: float
) -> float:
    """Return seconds that no motion of a car between two poses beats whose way is ``length`` m at
    least: from rest to rest, resting at each cusp.
    """
    least = run_time(length, car.v, car.a)
    if car.sense != 0.0:
        return least
    found = 2 * run_time(0.5 * length, car.v, car.a)  # no run is longer than half the way
    before = 0.0
    for share in RESTS:
        rest, beside = share * length, run_time(before, car.v, car.a)
        if run_time(length - rest, car.v, car.a) + beside < found:
            way = min(ahead(start, goal, car.radius, rest), ahead(goal, start, car.radius, rest))
            found = min(found, run_time(max(way, length - rest), car.v, car.a) + beside)
        before = rest
    return max(least, found)


@kernel
def ahead(start: Configuration, goal: Configuration, radius: float, moved: float) -> float:
    """Return metres that no curve driven ahead alone beats whose two ends together may have been
    driven ``moved`` m from the two poses: bounds on Dubins' words (see
    :mod:`up_samp.motion.curves.reeds_shepp`), each of their parts as short as it may be then.
    """
    x, y, near = (goal[0] - start[0]) / radius, (goal[1] - start[1]) / radius, moved / radius
    left = _words(x, y, start[2], goal[2], near)
    return radius * min(left, _words(x, -y, -start[2], -goal[2], near)) * (1 - 1e-9)


@inner
def _words(x: float, y: float, t0: float, t1: float, near: float) -> float:
    """Return a bound on the words that begin with a left turn, for a radius of 1: from (0, 0, t0)
    to (x, y, t1), both moved by ``near`` together.
    """
    # a turn's centre moves by as much as the car does and turns
    cx, cy = x + math.sin(t0), y - math.cos(t0)
    low, high, off, toward = _between(cx - math.sin(t1), cy + math.cos(t1), near)
    best = low + _arc(toward - t0, off) + _arc(t1 - toward, off)
    if low <= 4:
        least, most = math.asin(low / 4), math.asin(min(high / 4, 1.0))
        tilt, wide = 0.5 * (least + most), off + 0.5 * (most - least)
        turns = _arc(toward - t0 - tilt + math.pi, wide) + _arc(t1 - toward - tilt - math.pi, wide)
        best = min(best, 2 * math.pi - 2 * most + turns)
    low, high, off, toward = _between(cx + math.sin(t1), cy - math.cos(t1), near)
    if high >= 2:
        least, most = math.asin(2 / high), math.asin(2 / max(low, 2.0))
        tilt, wide = 0.5 * (least + most), off + 0.5 * (most - least)
        turns = _arc(toward + tilt - t0, wide) + _arc(toward + tilt - t1, wide)
        best = min(best, math.sqrt(max(low, 2.0) ** 2 - 4) + turns)
    return best


@inner
def _between(x: float, y: float, near: float) -> tuple[float, float, float, float]:
    """Return how far apart two turns' centres are at least and at most, by how much (rad) a heading
    from one to the other may be off beside the car's own, and that heading.
    """
    apart = math.hypot(x, y)
    off = math.asin(2 * near / apart) if 2 * near < apart else math.pi
    return max(apart - 2 * near, 0.0), apart + 2 * near, off + near, math.atan2(y, x)


@inner
def _arc(angle: float, off: float) -> float:
    """Return the least turn (rad, below a full one) to an angle that may be ``off`` (rad)."""
    turn, wide = angle % (2 * math.pi), off + 1e-9  # for rounding
    return 0.0 if turn < wide or turn + wide >= 2 * math.pi else turn - wide


# ------------------ Bodies that turn on the spot


def fastest_roll(
    start: Configuration, goal: Configuration, kinematics: Kinematics, least: float
) -> float:
    """Return seconds that no motion between two poses beats of a body that drives along its heading
    and turns at will, by ``omega_max`` at most; none is faster than ``least``.

    It comes nearer to its goal as fast as it drives that way, and looks that way no sooner than it
    can have turned there, nor later than it has to turn from it.
    """
    toward = math.atan2(goal[1] - start[1], goal[0] - start[0])
    far = math.dist(start[:2], goal[:2])
    offs = [_off(pose[2] - toward, kinematics.reverse) for pose in (start, goal)]
    high = run_time(far, kinematics.v_max, kinematics.a_max) + sum(offs) / kinematics.omega_max
    if high <= least or _nearer(least, offs, kinematics) >= far:
        return least
    for _ in range(20):
        middle = 0.5 * (least + high)
        if _nearer(middle, offs, kinematics) < far:
            least = middle
        else:
            high = middle
    return least


def _off(angle: float, reverse: bool) -> float:
    """Return by how much (rad) a body looks away from where it drives, perhaps backwards."""
    off = abs(math.remainder(angle, 2 * math.pi))
    return min(off, math.pi - off) if reverse else off


def _nearer(
    seconds: float, offs: Sequence[float], kinematics: Kinematics, parts: int = 256
) -> float:
    """Return metres that a body which looks so far (rad) away in the beginning and in the end
    comes nearer at most, from rest to rest: an upper sum.
    """
    times = np.linspace(0.0, seconds, parts + 1)
    since, left = times[1:], times[:0:-1]  # the most that any part's moments have
    speed = np.minimum(kinematics.v_max, kinematics.a_max * np.minimum(since, left))
    turned = (
        off - kinematics.omega_max * some for off, some in zip(offs, (since, left), strict=True)
    )
    off = np.clip(np.maximum(*turned), 0.0, 0.5 * math.pi)
    return float((speed * np.cos(off)).sum()) * seconds / parts


# ------------------ How much of any way lies in zones that slow it, and what it takes then
# While the largest disc about the reference point that is inside the footprint overlaps a zone, the
# body does. The cells in which it surely does are slow; the free cells that are not fall apart into
# regions. What leads from one region to another leads through slow cells in between, and that is no
# shorter than the regions are apart: the shortest chain of such gaps from start to goal is a bound.


Cell = tuple[int, int]
"""Row and column."""
MOST_REGIONS = 8
"""So many regions beside a zone are looked at; where there are more nothing is proven."""


@dataclass(frozen=True, eq=False)
class SlowZone:
    """What there is beside a zone in its ``area``: the ``kind`` of each cell (-1: slow, 0: nobody
    can be there, else the number of its region), the cells of each region that touch slow ones
    (``borders``, (n, 2) each), and how much (m) of a way from one region to another is slow,
    shape (k, k). ``size``: of a cell, m.
    """

    area: shapely.Geometry
    kind: npt.NDArray[np.int8]
    borders: tuple[IntArray, ...]
    gaps: FloatArray
    size: float

    def least(self, start: Cell, goal: Cell, straight: float) -> float:
        """Return metres of any way between two cells, ``straight`` m apart, that are slow (0 where
        there is none: others prove that).
        """
        if not (self.kind[start] and self.kind[goal]):
            return 0.0
        through = self._from(start)[:, None] + self.gaps + self._from(goal)[None, :]
        inside = straight if self.kind[start] == self.kind[goal] == -1 else math.inf
        metres = float(min(inside, through.min(initial=math.inf)))
        return metres if math.isfinite(metres) else 0.0

    def _from(self, cell: Cell) -> FloatArray:
        """Return how much (m) of a way from a cell to each region is slow."""
        if self.kind[cell] == -1:
            return np.array([_apart(self.size, some, np.array([cell])) for some in self.borders])
        own = np.arange(1, len(self.borders) + 1) == self.kind[cell]
        return np.where(own, 0.0, math.inf)


def slow_zone(
    zone: TrafficZone, grid: OccupancyGrid, blocked: BoolArray, radius: float
) -> SlowZone | None:
    """Return what is known of a zone for a disc of ``radius`` m whose centre can nowhere be in
    ``blocked`` cells (None: nothing).
    """
    # arcs are drawn as polygons inside them
    area = shapely.Polygon(zone.polygon).buffer(max(radius - 1e-6, 0.0))
    slow = _covered(area, grid) & ~blocked
    regions = np.empty(blocked.shape, dtype=np.int32)
    count = label_regions(~blocked & ~slow, regions)
    if not slow.any() or not 0 < count <= MOST_REGIONS:
        return None
    # who leaves the slow cells comes to a cell beside them
    beside = grown(slow) & ~slow
    borders = tuple(np.argwhere(beside & (regions == k)) for k in range(1, count + 1))
    gaps = np.array([[_apart(grid.resolution, a, b) for b in borders] for a in borders])
    np.fill_diagonal(gaps, 0.0)
    for k in range(count):
        gaps = np.minimum(gaps, gaps[:, [k]] + gaps[[k]])
    kind = np.where(slow, -1, regions).astype(np.int8)
    return SlowZone(area, kind, borders, gaps, grid.resolution)


def _apart(size: float, some: IntArray, others: IntArray) -> float:
    """Return how far (m) points of some cells (n, 2) are from those of others at least (inf: there
    are none).
    """
    least = min(
        (float(np.hypot(*(some - cell).T).min(initial=math.inf)) for cell in others),
        default=math.inf,
    )
    # points of two cells are nearer than their middles by half a diagonal each
    return max(0.0, least - math.sqrt(2.0)) * size


def _covered(area: shapely.Geometry, grid: OccupancyGrid) -> BoolArray:
    """Return the cells that lie wholly in an area."""
    found = np.zeros(grid.shape, dtype=np.bool_)
    (rows, cols), (x, y, yaw) = grid.shape, grid.origin
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    local = shapely.transform(area, lambda at: (at - (x, y)) @ turn / grid.resolution)
    left, bottom, right, top = local.bounds
    r0, r1 = max(0, math.floor(bottom)), min(rows, math.ceil(top))
    c0, c1 = max(0, math.floor(left)), min(cols, math.ceil(right))
    if r0 >= r1 or c0 >= c1:
        return found
    low, up = np.meshgrid(np.arange(c0, c1), np.arange(r0, r1))
    shapely.prepare(local)
    found[r0:r1, c0:c1] = shapely.covers(local, shapely.box(low, up, low + 1, up + 1))
    return found


def fastest_with_slow(
    length: float, slow: Sequence[tuple[float, float]], v_max: float, a_max: float
) -> float:
    """Return seconds that no motion from rest to rest over ``length`` m beats, of which so many m
    (each once) are driven no faster than so many m/s: ``slow`` has both.

    Whatever the order on the way, it takes least where the slowest parts are at both ends, where
    speeds are low anyway: speed over the way is bounded by what it was at either end of the part
    that is faster, and that is the longest where it is in one piece.
    """
    reached = at = speed = 0.0
    seconds = 0.0
    layers = sorted((cap * (1.0 + OVER), metres) for metres, cap in slow)
    for cap, metres in (*layers, (v_max, math.inf)):
        reached = min(reached + 0.5 * metres, 0.5 * length)
        part, at = reached - at, reached
        ramp = max(0.0, (cap**2 - speed**2) / (2.0 * a_max))
        if part <= ramp:
            peak = math.sqrt(speed**2 + 2.0 * a_max * part)
            seconds += (peak - speed) / a_max
        else:
            peak = max(speed, cap)
            seconds += (peak - speed) / a_max + (part - ramp) / peak
        speed = peak
    return 2.0 * seconds
