"""A roadmap of one kind of body: places to rest at (lattices), the short moves between them, and
what these sweep.
"""

from __future__ import annotations

import bisect
import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np

from up_samp.geometry import Shape
from up_samp.geometry.kernels import first_hit
from up_samp.geometry.scene import Scene
from up_samp.geometry.shapes import shape_of
from up_samp.model import Body, Configuration, Kinematics, Placed, check_time, same_pose
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import fastest, length_of, nodes_of
from up_samp.motion.curves.rolling import rolling_time
from up_samp.motion.curves.trajectories import twists
from up_samp.motion.curves.trapezoid import limits_of, runs_of
from up_samp.motion.fleet.conflicts import Hull, Swept, sweep_table
from up_samp.motion.fleet.paths import hull_of
from up_samp.motion.guides import widest_shape
from up_samp.motion.moves import ShortMove, steer, straight_move

Key = tuple[int, int, int]
Box = tuple[float, float, float, float]
LatticeMove = tuple[Key, float, float, Callable[[], ShortMove]]
"""The place that a move leads to, how far the body goes (m) and turns (rad), and what makes it: of
most moves that a search looks at no more has to be known.
"""

NODES = 30_000
"""Places of a roadmap at most."""
LINKS, LOCAL = 6, 3.0
"""Places of the lattice that a place off it is joined to, at most, by links that are at most so
many cells longer than the straight line.
"""
EACH = 0.05
"""Seconds that a move costs besides its length: fewer are better."""
ROOMY = 2.1
"""Radii of the body between places of the coarsest lattice."""
HEADINGS, PIVOTS = 8, 8
"""Of a car's lattice, evenly spread; of a body that turns on the spot, at most."""
OFFSETS, STRAIGHTER = 5, 1.25
"""Cells away, up to which a car's lattice looks for its moves; times the straight line that one may
be long.
"""
QUARTERS = (0.0, math.pi / 2, math.pi, -math.pi / 2)
AXES = ((-1, 0), (1, 0), (0, -1), (0, 1))


def box_around(ends: Iterable[Configuration], radius: float, turning: float) -> Box:
    """Return the region that the lattice covers: all ends, and room to step aside."""
    points = np.array([p[:2] for p in ends])
    reach = 6 * radius + 3 * turning
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def lattice_of(
    body: Body, ends: Sequence[Configuration], box: Box, cell: float
) -> Tensor | LatticeState:
    """Return the lattice for a body in a box."""
    if not body.mobility.pivots:
        x, y, _ = ends[0]
        return LatticeState(body, (x, y), cell)
    headings = dict.fromkeys(round(math.remainder(p[2], 2 * math.pi), 12) for p in ends)
    kept = () if body.mobility.sideways else QUARTERS
    near = [
        h for h in headings if all(abs(math.remainder(h - q, 2 * math.pi)) > 1e-6 for q in kept)
    ]
    chosen = sorted([*kept, *near[: PIVOTS - len(kept)]])
    xs = _coordinates([p[0] for p in ends], box[0], box[2], cell)
    ys = _coordinates([p[1] for p in ends], box[1], box[3], cell)
    return Tensor(body, xs, ys, chosen)


def _coordinates(marks: Iterable[float], low: float, high: float, cell: float) -> FloatArray:
    """Return coordinates through the marks, where they are not too close, about ``cell`` apart."""
    kept: list[float] = []
    for mark in sorted(set(marks)):
        if not kept or mark - kept[-1] >= 0.4 * cell:
            kept.append(mark)
    first = np.arange(kept[0], low, -cell)[:0:-1]
    last = np.arange(kept[-1], high, cell)[1:]
    parts = [first]
    for a, b in itertools.pairwise(kept):
        parts.append(np.linspace(a, b, max(1, round((b - a) / cell)) + 1)[:-1])
    return np.concatenate([*parts, np.array(kept[-1:]), last])


class Tensor:
    """Places at all pairs of some coordinates, at some headings: for bodies that pivot.

    A body moves to the next place along an axis (only along its heading unless it moves sideways)
    or turns to the next heading.
    """

    def __init__(
        self, body: Body, xs: FloatArray, ys: FloatArray, headings: Sequence[float]
    ) -> None:
        self.body = body
        # one value of a list is found sooner than one of an array
        self.xs, self.ys, self.headings = xs.tolist(), ys.tolist(), [*headings]
        self.sideways = body.mobility.sideways
        self._along = {way: self._headings_along(*way) for way in AXES}
        self._angles = [
            [abs(math.remainder(n - k, 2 * math.pi)) for n in self.headings] for k in self.headings
        ]

    def pose(self, key: Key) -> Configuration:
        """Return the pose of a place."""
        return self.xs[key[0]], self.ys[key[1]], self.headings[key[2]]

    def near(self, x: float, y: float) -> list[Key]:
        """Return the places around a point."""
        cols, rows = (
            [j for j in (i - 1, i) if 0 <= j < len(axis)]
            for i, axis in (
                (bisect.bisect_left(self.xs, x), self.xs),
                (bisect.bisect_left(self.ys, y), self.ys),
            )
        )
        return [*itertools.product(cols, rows, range(len(self.headings)))]

    def moves(self, key: Key) -> list[LatticeMove]:
        """Return the moves from a place, map or no map."""
        i, j, k = key
        count, angles = len(self.headings), self._angles[k]
        turns = [(i, j, n) for n in {(k + 1) % count, (k - 1) % count} - {k}]
        found: list[LatticeMove] = [
            (n, 0.0, angles[n[2]], partial(self._straight, key, n)) for n in turns
        ]
        for dx, dy in AXES:
            if not (0 <= i + dx < len(self.xs) and 0 <= j + dy < len(self.ys)):
                continue
            way = abs(self.xs[i + dx] - self.xs[i]) + abs(self.ys[j + dy] - self.ys[j])
            # turning and driving off is one move: who is pushed has to get away at once
            for n in (k,) if self.sideways else self._along[dx, dy]:
                there, make = (i + dx, j + dy, n), self._straight if n == k else self._turned
                found.append((there, way, angles[n], partial(make, key, there)))
        return found

    def _headings_along(self, dx: int, dy: int) -> list[int]:
        """Return the headings at which the body may drive along an axis, one way."""
        headings = np.array(self.headings)
        c, s = np.cos(headings), np.sin(headings)
        along = np.abs(dx * s - dy * c) < 1e-9
        if not self.body.kinematics.reverse:
            along &= dx * c + dy * s > 0.0
        return [int(n) for n in np.flatnonzero(along)]

    def _straight(self, key: Key, there: Key) -> ShortMove:
        start, goal = np.array(self.pose(key)), np.array(self.pose(there))
        return straight_move(start, goal, self.body.kinematics)

    def _turned(self, key: Key, there: Key) -> ShortMove:
        here = (*key[:2], there[2])
        turn, drive = self._straight(key, here), self._straight(here, there)
        rows = drive.rows.copy()
        rows[:, 2] += turn.rows[-1, 2] - rows[0, 2]
        return ShortMove(np.concatenate([turn.rows[:1], rows]), turn.seconds + drive.seconds)


class LatticeState:
    """A lattice of places and headings joined by drives that a car can do (Pivtoraiko, Knepper &
    Kelly, *Differentially constrained mobile robot motion planning in state lattices*, 2009).
    """

    def __init__(self, body: Body, origin: tuple[float, float], cell: float) -> None:
        self.body, self.origin, self.cell = body, origin, cell

    def pose(self, key: Key) -> Configuration:
        """Return the pose of a place."""
        x, y = self.origin[0] + key[0] * self.cell, self.origin[1] + key[1] * self.cell
        return x, y, math.remainder(key[2] * 2 * math.pi / HEADINGS, 2 * math.pi)

    def near(self, x: float, y: float) -> list[Key]:
        """Return the places around a point."""
        i, j = round((x - self.origin[0]) / self.cell), round((y - self.origin[1]) / self.cell)
        reach = math.ceil(1.5 * self.body.kinematics.turning_radius / self.cell)
        span, headings = range(-reach, reach + 1), range(HEADINGS)
        return [(i + a, j + b, k) for a, b, k in itertools.product(span, span, headings)]

    @property
    def _primitives(self) -> tuple[tuple[Primitive, ...], ...]:
        return _primitives(self.body.kinematics, self.cell)

    def moves(self, key: Key) -> list[LatticeMove]:
        """Return the moves from a place, map or no map."""
        i, j, k = key
        here = np.array(self.pose(key))

        def made(arcs: FloatArray, seconds: float) -> ShortMove:
            return ShortMove(nodes_of(here, arcs), seconds)

        return [
            ((i + di, j + dj, n), length_of(arcs), 0.0, partial(made, arcs, seconds))
            for (di, dj, n), arcs, seconds in self._primitives[k]
        ]


Primitive = tuple[Key, FloatArray, float]


@lru_cache(maxsize=64)
def _primitives(kin: Kinematics, cell: float) -> tuple[tuple[Primitive, ...], ...]:
    """Return the moves from each heading of a car's lattice: without a cusp, the shortest ones
    straight on, into the lane beside and to the next heading, forwards and backwards.
    """
    found = []
    offsets = range(-OFFSETS, OFFSETS + 1)
    for k in range(HEADINGS):
        start = (0.0, 0.0, k * 2 * math.pi / HEADINGS)
        best: dict[tuple[int, bool, int], tuple[float, Primitive]] = {}
        for i, j, turn in itertools.product(offsets, repeat=3):
            if abs(turn) > 1 or (i, j) == (0, 0):
                continue
            n = (k + turn) % HEADINGS
            goal = (i * cell, j * cell, n * 2 * math.pi / HEADINGS)
            seconds, arcs = fastest(start, goal, limits_of(kin))
            length = length_of(arcs)
            longest = STRAIGHTER * math.hypot(i * cell, j * cell)
            if len(runs_of(arcs)) != 1 or length > longest:
                continue
            side = -math.sin(start[2]) * i + math.cos(start[2]) * j
            lane = 0 if abs(side) < 1e-9 else int(math.copysign(1, side))
            sort = (turn, bool(arcs[0, 1] > 0), lane)
            if sort not in best or length < best[sort][0] - 1e-9:
                best[sort] = (length, ((i, j, n), arcs, float(seconds)))
        found.append(tuple(primitive for _, primitive in best.values()))
    return tuple(found)


# ------------------ Moves between the places of a roadmap, and what they sweep


CELLS = 4
"""Cells of a move: two robots in step are compared cell by cell."""


@dataclass(frozen=True, eq=False)
class RoadmapEdge:
    """A move between two places of a roadmap (a rest: from a place to itself)."""

    number: int
    source: int
    target: int
    make: Callable[[], ShortMove]
    hull: Hull
    cost: float
    """Seconds at top speed, and a little for each move."""

    @cached_property
    def move(self) -> ShortMove:
        """How it is driven."""
        return self.make()

    @cached_property
    def swept(self) -> Swept:
        """Swept bounds of the cells, all of them for rests, too."""
        rows = self.move.rows
        if len(rows) == 1:
            one = sweep_table(np.zeros(1), rows, np.zeros(1))
            table = np.ascontiguousarray(np.repeat(one[:1], CELLS + 2, axis=0))
            return Swept(table, self.hull)
        s = np.concatenate([[0.0], np.cumsum(steps_of(rows, self.hull.radius))])
        return Swept(sweep_table(s, rows, np.linspace(0.0, s[-1], CELLS + 1)), self.hull)

    @cached_property
    def circle(self) -> tuple[float, float, float]:
        """A disc (x, y, radius) around all that is swept."""
        xy = self.move.rows[:, :2]
        low, high = xy.min(axis=0), xy.max(axis=0)
        # between two rows an arc may leave their box by less than half its length
        bulge = 0.0
        if len(xy) > 1:
            turning = np.abs(np.diff(self.move.rows[:, 2])) > 1e-9
            lengths = np.hypot(*np.diff(xy, axis=0).T)
            bulge = 0.5 * float(np.max(lengths[turning], initial=0.0))
        x, y = (float(v) for v in 0.5 * (low + high))
        return x, y, float(0.5 * np.hypot(*(high - low))) + bulge + self.hull.radius


def steps_of(rows: FloatArray, radius: float) -> FloatArray:
    """Return the larger of way and turn times ``radius`` between poses (k, 3): shape (k - 1,)."""
    moves = twists(rows)
    steps = np.maximum(np.hypot(moves[:, 0], moves[:, 1]), radius * np.abs(moves[:, 2]))
    return np.asarray(np.maximum(steps, 1e-9))


# ------------------ A roadmap of one kind of body
# Places to rest at, and the short moves between them. The places are those of a lattice around
# everybody's ends, and the ends themselves. Every move is swept against the map and what rests for
# good.


def cells_of(body: Body) -> tuple[float, float, float, float]:
    """Return grains (m) of a lattice for a body, coarse to fine. At the first one neighbours can
    turn on the spot at the same time.
    """
    shape, able = shape_of(body), body.mobility
    inner = shape.inner[2]
    most = math.inf if able.pivots else 0.5 * body.kinematics.bend_radius
    cells = (ROOMY * shape.circumscribed, 2.0 * inner, inner, 0.5 * inner)
    return tuple(min(cell, most) for cell in cells)  # type: ignore[return-value]


class Roadmap:
    """Places and moves of one body among what rests for good."""

    def __init__(
        self,
        scene: Scene,
        body: Body,
        ends: Sequence[Configuration],
        static: tuple[Placed, ...],
        cell: float,
    ) -> None:
        """``ends``: where the robots of this body start and go; ``cell``: grain of the lattice
        (m), which covers what is around the ends.
        """
        shape = widest_shape(scene, body, ends, static)
        self.scene, self.body, self.hull = scene, body, hull_of(body)
        self.usable = shape is not None
        self._pivots, self._both_ways = body.mobility.pivots, body.kinematics.both_ways
        self._orders = (1,) if self._both_ways else (1, -1)
        self.shape: Shape = shape if shape is not None else scene.shape(body)
        self._world = scene.world(self.shape, static)
        self.poses: list[Configuration] = []
        self.edges: list[RoadmapEdge] = []
        self._keys: dict[int, Key] = {}
        self._nodes: dict[Key, int] = {}
        self._extra: dict[int, list[RoadmapEdge]] = {}
        self._moves: dict[int, list[RoadmapEdge]] = {}
        self._known: dict[int, list[RoadmapEdge]] = {}
        self._places: dict[Key, bool] = {}
        self._free: dict[int, bool] = {}
        self.cell = cell
        self._box = box_around(ends, self.hull.radius, body.kinematics.bend_radius)
        self.lattice = lattice_of(body, ends, self._box, self.cell)
        self.places: dict[Configuration, int] = {}
        self._rests: dict[int, RoadmapEdge] = {}
        # what is on the lattice is known before anything is joined to it
        for node in [self._placed(pose) for pose in dict.fromkeys(ends)]:
            self._join(node)

    def place(self, pose: Configuration) -> int:
        """Return the place at a pose, joined to the places of the lattice near it."""
        if pose not in self.places:
            self._join(self._placed(pose))
        return self.places[pose]

    def rest(self, node: int) -> RoadmapEdge:
        """Return the rest at a place."""
        if node not in self._rests:
            rest = ShortMove(np.array([self.poses[node]]), 0.0)
            self._rests[node] = self._edge(node, node, 0.0, 0.0, partial(_itself, rest))
        return self._rests[node]

    def out(self, node: int) -> list[RoadmapEdge]:
        """Return the free moves from a place."""
        if node not in self._known:
            self._known[node] = [edge for edge in self.moves(node) if self.is_free(edge)]
        return self._known[node]

    def moves(self, node: int) -> list[RoadmapEdge]:
        """Return the moves from a place to free places, those too on which something is in the way
        (:meth:`is_free`).
        """
        if node not in self._moves:
            check_time()
            found = self._moves[node] = list(self._extra.get(node, ()))
            if node in self._keys and len(self.poses) < NODES:
                for key, way, turn, make in self.lattice.moves(self._keys[node]):
                    if self._is_place(key):
                        found.append(self._edge(node, self._lattice_place(key), way, turn, make))
        return self._moves[node]

    def is_free(self, edge: RoadmapEdge) -> bool:
        """Return whether nothing is in the way of a move."""
        if edge.number not in self._free:
            self._free[edge.number] = self._sweeps_free(edge.move.rows)
        return self._free[edge.number]

    def to_go(self, goal: int) -> dict[int, float]:
        """Return the cost from each place to a goal, over free moves: back along the moves from it,
        where each has its reverse, else along those to it.
        """
        best = {goal: 0.0}
        queue = [(0.0, goal)]
        before = self._before()
        while queue:
            cost, node = heapq.heappop(queue)
            if cost > best[node]:
                continue
            for there, takes in before(node):
                after = cost + takes
                if after < best.get(there, math.inf):
                    best[there] = after
                    heapq.heappush(queue, (after, there))
        return best

    def _before(self) -> Callable[[int], Sequence[tuple[int, float]]]:
        """Return what tells the places before a place, and the cost of the moves from there: of all
        places that can be reached from the robots' ends.
        """
        if self._both_ways:
            return lambda node: [(edge.target, edge.cost) for edge in self.out(node)]
        found: dict[int, list[tuple[int, float]]] = {node: [] for node in self.places.values()}
        queue = list(found)
        while queue:
            node = queue.pop()
            for edge in self.out(node):
                if edge.target not in found:
                    queue.append(edge.target)
                found.setdefault(edge.target, []).append((node, edge.cost))
        return found.__getitem__

    def route(
        self,
        ends: tuple[int, int],
        estimate: Callable[[int], float],
        allowed: Callable[[RoadmapEdge], bool] | None = None,
        limit: float = math.inf,
    ) -> tuple[RoadmapEdge, ...] | None:
        """Return a cheap way between two places (A*). ``estimate``: cost to go from a place;
        ``limit``: cost at most.
        """
        start, goal = ends
        best: dict[int, tuple[float, RoadmapEdge | None]] = {start: (0.0, None)}
        queue, closed = [(0.0, start)], set()
        while queue:
            _, node = heapq.heappop(queue)
            if node == goal:
                break
            if node in closed:
                continue
            closed.add(node)
            for edge in self.moves(node):
                after = best[node][0] + edge.cost
                if edge.target in best and best[edge.target][0] <= after:
                    continue
                ahead = after + estimate(edge.target)
                # to look what is in the way is dearer than all else
                if ahead > limit or not self.is_free(edge):
                    continue
                if allowed is not None and not allowed(edge):
                    continue
                best[edge.target] = after, edge
                heapq.heappush(queue, (ahead, edge.target))
        if goal not in best:
            return None
        way: list[RoadmapEdge] = []
        at = goal
        while (last := best[at][1]) is not None:
            way.append(last)
            at = last.source
        return tuple(way[::-1])

    def _lattice_place(self, key: Key) -> int:
        if key not in self._nodes:
            self._nodes[key] = self._new(self.lattice.pose(key))
            self._keys[self._nodes[key]] = key
        return self._nodes[key]

    def _is_place(self, key: Key) -> bool:
        if key not in self._places:
            x, y, _ = pose = self.lattice.pose(key)
            low_x, low_y, high_x, high_y = self._box
            inside = low_x <= x <= high_x and low_y <= y <= high_y
            self._places[key] = inside and self._sweeps_free(np.array([pose]))
        return self._places[key]

    def _sweeps_free(self, rows: FloatArray) -> bool:
        return first_hit(self._world, rows) < 0

    def _new(self, pose: Configuration) -> int:
        self.poses.append(pose)
        return len(self.poses) - 1

    def _edge(
        self, source: int, target: int, way: float, turn: float, make: Callable[[], ShortMove]
    ) -> RoadmapEdge:
        """Return a move that goes so far (m) and turns so much (rad)."""
        kin = self.body.kinematics
        turning = turn / kin.omega_max if self._pivots else 0.0
        cost = max(way / kin.v_max, turning) + EACH
        edge = RoadmapEdge(len(self.edges), source, target, make, self.hull, cost)
        self.edges.append(edge)
        return edge

    def _link(self, ends: tuple[int, ...], moves: Sequence[ShortMove]) -> None:
        """Add free moves between two places, and back where the body may drive both ways, with
        places where one move ends.
        """
        inner = (self._new(tuple(m.rows[-1].tolist())) for m in moves[:-1])
        nodes = [ends[0], *inner, ends[1]]
        for (a, b), move in zip(itertools.pairwise(nodes), moves, strict=True):
            way = float(steps_of(move.rows, 0.0).sum())
            turn = float(np.abs(np.diff(move.rows[:, 2])).sum())
            for driven, source, target in ((move, a, b), (move.back(), b, a)):
                if driven is move or self._both_ways:
                    edge = self._edge(source, target, way, turn, partial(_itself, driven))
                    self._free[edge.number] = True
                    self._extra.setdefault(source, []).append(edge)

    def _placed(self, pose: Configuration) -> int:
        """Return a new place at a pose; where the lattice has one, it is the lattice's, too."""
        node = self.places[pose] = self._new(pose)
        for key in self.lattice.near(pose[0], pose[1]):
            if same_pose(pose, self.lattice.pose(key), 1e-9):
                self._nodes[key], self._keys[node] = node, key
        return node

    def _join(self, node: int) -> None:
        """Join a place to free places of the lattice near it, and these to it; where there is no
        room to turn, by way of others nearby.
        """
        known = node in self._keys
        for order in self._orders:
            joined = self._turns_freely(self.poses[node]) if known else self._linked(node, order)
            if not joined and self.body.mobility.rolls:
                self._leave(node, order)

    def _turns_freely(self, pose: Configuration) -> bool:
        """Return whether there is room to turn all round at a pose."""
        quarters = np.linspace(0.0, 2.0 * math.pi, 5)
        return self._sweeps_free(np.array([(*pose[:2], pose[2] + turn) for turn in quarters]))

    def _linked(self, node: int, order: int) -> bool:
        """Link a place with free places of the lattice near it, there (``order`` 1) or from there;
        return whether there are any.
        """
        pose = self.poses[node]
        options = []
        for key in self.lattice.near(pose[0], pose[1]):
            target = self.lattice.pose(key)
            bend = abs(math.remainder(target[2] - pose[2], 2 * math.pi))
            options.append((math.dist(pose[:2], target[:2]) + self.hull.radius * bend, key))
        limit = LOCAL * max(self.cell, self.body.kinematics.bend_radius)
        joined = 0
        for _, key in sorted(options)[: 8 * LINKS]:
            if joined >= LINKS:
                break
            if not self._is_place(key):
                continue
            moves = steer(self.body, *(pose, self.lattice.pose(key))[::order])
            way = sum(float(steps_of(m.rows, 0.0).sum()) for m in moves)
            if way <= limit and all(self._sweeps_free(m.rows) for m in moves):
                self._link((node, self._lattice_place(key))[::order], moves)
                joined += 1
        return joined > 0

    def _leave(self, node: int, order: int) -> None:
        """Link a place with those on lines and arcs ahead of it and behind it that have room to
        turn: who stands along a wall has none.
        """
        start = np.array(self.poses[node])
        wide = 2.0 * self.hull.radius
        for sign in (1, -1) if self._both_ways else (order,):
            for kappa in (0.0, 1.0 / wide, -1.0 / wide, 0.5 / wide, -0.5 / wide):
                # up to four radii of the body, half of one at a time
                for k in range(1, 9):
                    arc = np.array([[kappa, 0.25 * sign * k * wide]])
                    rows = np.ascontiguousarray(nodes_of(start, arc)[::order])
                    if not self._sweeps_free(rows):
                        break
                    pose = tuple(rows[::order][-1].tolist())
                    if not self._turns_freely(pose):
                        continue
                    beside = self._new(pose)
                    if self._linked(beside, order):
                        move = ShortMove(rows, rolling_time(rows, self.body.kinematics))
                        self._link((node, beside)[::order], [move])
                        break


def _itself(move: ShortMove) -> ShortMove:
    return move
