"""A roadmap of one kind of body: places to rest at (lattices), the short moves between them, and
what these sweep.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from up_samp.geometry import Shape, sweeps
from up_samp.geometry.scene import Scene
from up_samp.geometry.shapes import shape_of
from up_samp.model import Body, Configuration, Kinematics, Placed, check_time
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.arcs import length_of, nodes_of
from up_samp.motion.curves.reeds_shepp import fastest
from up_samp.motion.curves.trapezoid import limits_of, runs_of
from up_samp.motion.fleet.conflicts import Hull, Swept, sweep_table
from up_samp.motion.fleet.paths import hull_of
from up_samp.motion.guides.search_space import widest_shape
from up_samp.motion.moves import ShortMove, steer, straight_move

Key = tuple[int, int, int]
Box = tuple[float, float, float, float]

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
        self.xs, self.ys = xs, ys
        self.headings = np.array(headings)
        self.sideways = body.mobility.sideways

    def pose(self, key: Key) -> Configuration:
        """Return the pose of a place."""
        return float(self.xs[key[0]]), float(self.ys[key[1]]), float(self.headings[key[2]])

    def near(self, x: float, y: float) -> list[Key]:
        """Return the places around a point."""
        cols, rows = (
            [j for j in (i - 1, i) if 0 <= j < len(axis)]
            for i, axis in (
                (int(np.searchsorted(self.xs, x)), self.xs),
                (int(np.searchsorted(self.ys, y)), self.ys),
            )
        )
        return [(i, j, k) for i in cols for j in rows for k in range(len(self.headings))]

    def moves(self, key: Key) -> list[tuple[Key, ShortMove]]:
        """Return the moves from a place, map or no map."""
        i, j, k = key
        count = len(self.headings)
        turns = [(i, j, n) for n in {(k + 1) % count, (k - 1) % count} - {k}]
        ways = [(i + d, j) for d in (-1, 1) if 0 <= i + d < len(self.xs)]
        ways += [(i, j + d) for d in (-1, 1) if 0 <= j + d < len(self.ys)]
        if self.sideways:
            return [(n, self._straight(key, n)) for n in (*turns, *((*way, k) for way in ways))]
        found = [(n, self._straight(key, n)) for n in turns]
        # turning and driving off is one move: who is pushed has to get away at once
        for way in ways:
            for n in self._along(way[0] - i, way[1] - j):
                drive = self._straight((i, j, n), (*way, n))
                found.append(((*way, n), drive if n == k else self._turned(key, n, drive)))
        return found

    def _along(self, dx: int, dy: int) -> list[int]:
        """Return the headings at which the body may drive along an axis, one way."""
        c, s = np.cos(self.headings), np.sin(self.headings)
        along = np.abs(dx * s - dy * c) < 1e-9
        if not self.body.kinematics.reverse:
            along &= dx * c + dy * s > 0.0
        return [int(n) for n in np.flatnonzero(along)]

    def _straight(self, key: Key, there: Key) -> ShortMove:
        start, goal = np.array(self.pose(key)), np.array(self.pose(there))
        return straight_move(start, goal, self.body.kinematics)

    def _turned(self, key: Key, heading: int, drive: ShortMove) -> ShortMove:
        turn = self._straight(key, (key[0], key[1], heading))
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
        return [(i + a, j + b, k) for a in span for b in span for k in headings]

    @property
    def _primitives(self) -> tuple[tuple[Primitive, ...], ...]:
        return _primitives(self.body.kinematics, self.cell)

    def moves(self, key: Key) -> list[tuple[Key, ShortMove]]:
        """Return the moves from a place, map or no map."""
        i, j, k = key
        here = np.array(self.pose(key))
        found = []
        for (di, dj, n), arcs, seconds in self._primitives[k]:
            there = (i + di, j + dj, n)
            found.append((there, ShortMove(nodes_of(here, arcs), seconds, arcs)))
        return found


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
            seconds, arcs = fastest(start, goal, *limits_of(kin))
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
    move: ShortMove
    hull: Hull
    cost: float
    """Seconds at top speed, and a little for each move."""

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
    d = np.diff(rows, axis=0)
    half = 0.5 * np.abs(d[:, 2])
    grow = np.where(half < 1e-9, 1.0, half / np.maximum(np.sin(np.minimum(half, 3.0)), 1e-9))
    steps = np.maximum(np.hypot(d[:, 0], d[:, 1]) * grow, radius * np.abs(d[:, 2]))
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
        box: Box | None = None,
    ) -> None:
        """``ends``: where the robots of this body start and go; ``cell``: grain of the lattice (m);
        ``box``: what the lattice covers (x low, y low, x high, y high; by default what is around
        the ends).
        """
        shape = widest_shape(scene, body, ends, static)
        self.scene, self.body, self.hull = scene, body, hull_of(body)
        self.usable = shape is not None
        self._pivots, self._both_ways = body.mobility.pivots, body.kinematics.reverse
        self._orders = (1,) if self._both_ways else (1, -1)
        self.shape: Shape = shape if shape is not None else scene.shape(body)
        self._world = scene.world(self.shape, static)
        self.poses: list[Configuration] = []
        self.edges: list[RoadmapEdge] = []
        self._keys: dict[int, Key] = {}
        self._nodes: dict[Key, int] = {}
        self._extra: dict[int, list[int]] = {}
        self._known: dict[int, list[RoadmapEdge]] = {}
        self._free: dict[Key, bool] = {}
        self.cell = cell
        self._box = box or box_around(ends, self.hull.radius, body.kinematics.bend_radius)
        self.lattice = lattice_of(body, ends, self._box, self.cell)
        self.places: dict[Configuration, int] = {}
        self._rests: dict[int, RoadmapEdge] = {}
        for pose in ends:
            self.place(pose)

    def place(self, pose: Configuration) -> int:
        """Return the place at a pose, joined to the places of the lattice near it."""
        if pose not in self.places:
            node = self.places[pose] = self._new(pose)
            self._join(node)
        return self.places[pose]

    def rest(self, node: int) -> RoadmapEdge:
        """Return the rest at a place."""
        if node not in self._rests:
            self._rests[node] = self._edge(node, node, ShortMove(np.array([self.poses[node]]), 0.0))
        return self._rests[node]

    def out(self, node: int) -> list[RoadmapEdge]:
        """Return the free moves from a place."""
        if node not in self._known:
            check_time()
            found = [self.edges[k] for k in self._extra.get(node, ())]
            if node in self._keys and len(self.poses) < NODES:
                found += self._lattice_moves(node)
            self._known[node] = found
        return self._known[node]

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
        most: int | None = None,
    ) -> tuple[tuple[RoadmapEdge, ...] | None, int]:
        """Return a cheap way between two places (A*), and the places looked at (``most``: as many
        at most). ``estimate``: cost to go from a place; ``limit``: cost at most.
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
            if most is not None and len(closed) > most:
                return None, len(closed)
            for edge in self.out(node):
                after = best[node][0] + edge.cost
                if edge.target in best and best[edge.target][0] <= after:
                    continue
                ahead = after + estimate(edge.target)
                if ahead > limit or not (allowed is None or allowed(edge)):
                    continue
                best[edge.target] = after, edge
                heapq.heappush(queue, (ahead, edge.target))
        if goal not in best:
            return None, len(closed)
        way: list[RoadmapEdge] = []
        at = goal
        while (last := best[at][1]) is not None:
            way.append(last)
            at = last.source
        return tuple(way[::-1]), len(closed)

    def _lattice_moves(self, node: int) -> list[RoadmapEdge]:
        return [
            self._edge(node, self._lattice_place(key), move)
            for key, move in self.lattice.moves(self._keys[node])
            if self._is_place(key) and self._sweeps_free(move.rows)
        ]

    def _lattice_place(self, key: Key) -> int:
        if key not in self._nodes:
            pose = self.lattice.pose(key)
            # an end on the lattice is the lattice's own place
            node = next((n for p, n in self.places.items() if _same(p, pose)), None)
            self._nodes[key] = self._new(pose) if node is None else node
            self._keys[self._nodes[key]] = key
        return self._nodes[key]

    def _is_place(self, key: Key) -> bool:
        if key not in self._free:
            x, y, _ = pose = self.lattice.pose(key)
            low_x, low_y, high_x, high_y = self._box
            inside = low_x <= x <= high_x and low_y <= y <= high_y
            self._free[key] = inside and self._sweeps_free(np.array([pose]))
        return self._free[key]

    def _sweeps_free(self, rows: FloatArray) -> bool:
        least = 1e-3 * float(self.shape.data.slack[2])
        return bool(sweeps.samples_free(self._world, rows, least) < 0)

    def _new(self, pose: Configuration) -> int:
        self.poses.append(pose)
        return len(self.poses) - 1

    def _edge(self, source: int, target: int, move: ShortMove) -> RoadmapEdge:
        kin = self.body.kinematics
        way = float(steps_of(move.rows, 0.0).sum()) if len(move.rows) > 1 else 0.0
        turn = float(np.abs(np.diff(move.rows[:, 2])).sum()) if self._pivots else 0.0
        cost = max(way / kin.v_max, turn / kin.omega_max) + EACH
        edge = RoadmapEdge(len(self.edges), source, target, move, self.hull, cost)
        self.edges.append(edge)
        return edge

    def _link(self, ends: tuple[int, ...], moves: Sequence[ShortMove]) -> None:
        """Add moves between two places, and back where the body may drive both ways, with places
        where one move ends.
        """
        inner = (self._new(tuple(m.rows[-1].tolist())) for m in moves[:-1])
        nodes = [ends[0], *inner, ends[1]]
        for (a, b), move in zip(itertools.pairwise(nodes), moves, strict=True):
            self._extra.setdefault(a, []).append(self._edge(a, b, move).number)
            if self._both_ways:
                self._extra.setdefault(b, []).append(self._edge(b, a, move.back()).number)

    def _join(self, node: int) -> None:
        """Join a place off the lattice to free places near it, and these to it."""
        pose = self.poses[node]
        options = []
        for key in self.lattice.near(pose[0], pose[1]):
            target = self.lattice.pose(key)
            if _same(pose, target):
                self._nodes[key], self._keys[node] = node, key
                return
            away = math.dist(pose[:2], target[:2])
            bend = abs(math.remainder(target[2] - pose[2], 2 * math.pi))
            options.append((away + self.hull.radius * bend, key))
        options.sort()
        limit = LOCAL * max(self.cell, self.body.kinematics.bend_radius)
        for order in self._orders:
            joined = 0
            for _, key in options[: 8 * LINKS]:
                if joined >= LINKS:
                    break
                if not self._is_place(key):
                    continue
                moves = steer(self.body, *(pose, self.lattice.pose(key))[::order])
                way = sum(float(steps_of(m.rows, 0.0).sum()) for m in moves)
                if way <= limit and all(self._sweeps_free(m.rows) for m in moves):
                    self._link((node, self._lattice_place(key))[::order], moves)
                    joined += 1


def _same(p: Configuration, q: Configuration) -> bool:
    if abs(p[0] - q[0]) > 1e-9 or abs(p[1] - q[1]) > 1e-9:
        return False
    return abs(math.remainder(p[2] - q[2], 2 * math.pi)) < 1e-9
