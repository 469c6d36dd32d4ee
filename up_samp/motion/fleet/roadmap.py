"""A roadmap of one kind of body: places to rest at, and the short moves between them.

The places are those of a lattice around everybody's ends, the ends themselves, and marks along the
robots' own best paths, so that what is too tight for the lattice is on the map all the same. Every
move is swept against the map and what rests for good.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from up_samp.geometry import Shape, sweeps
from up_samp.geometry.scene import Scene
from up_samp.geometry.shapes import shape_of
from up_samp.model import Body, Configuration, Placed, check_time
from up_samp.motion.fleet.abilities import abilities_of
from up_samp.motion.fleet.edges import Edge, steps_of
from up_samp.motion.fleet.lanes import arcs_between
from up_samp.motion.fleet.lattices import Box, Key, box_around, lattice_of
from up_samp.motion.fleet.moves import Move, steer, straight_move
from up_samp.motion.fleet.paths import Path, hull_of
from up_samp.motion.guides.search_space import widest_shape
from up_samp.motion.tuning import RoadmapTuning

FloatArray = npt.NDArray[np.float64]


def cells_of(body: Body, tuning: RoadmapTuning) -> tuple[float, float, float, float]:
    """Return grains (m) of a lattice for a body, coarse to fine. At the first one neighbours can
    turn on the spot at the same time.
    """
    shape, able = shape_of(body), abilities_of(body)
    inner = shape.inner[2]
    most = math.inf if able.pivots else 0.5 * able.radius
    cells = (tuning.roomy * shape.circumscribed, 2.0 * inner, inner, 0.5 * inner)
    return tuple(min(cell, most) for cell in cells)  # type: ignore[return-value]


class Roadmap:
    """Places and moves of one body among what rests for good."""

    def __init__(
        self,
        scene: Scene,
        body: Body,
        ends: Sequence[Configuration],
        paths: Sequence[Path],
        static: tuple[Placed, ...],
        cell: float,
        tuning: RoadmapTuning,
        box: Box | None = None,
    ) -> None:
        """``ends``: where the robots of this body start and go; ``paths``: their best paths;
        ``cell``: grain of the lattice (m); ``box``: what
        the lattice covers (x low, y low, x high, y high; by default what is around the ends).
        """
        shape = widest_shape(scene, body, ends, static)
        self.scene, self.body, self.hull = scene, body, hull_of(body)
        self.usable = shape is not None
        self._pivots = abilities_of(body).pivots
        self.shape: Shape = shape if shape is not None else scene.shape(body)
        self._world = scene.world(self.shape, static)
        self.poses: list[Configuration] = []
        self.edges: list[Edge] = []
        self._keys: dict[int, Key] = {}
        self._nodes: dict[Key, int] = {}
        self._extra: dict[int, list[int]] = {}
        self._known: dict[int, list[Edge]] = {}
        self._free: dict[Key, bool] = {}
        self.cell, self.tuning = cell, tuning
        self._box = box or box_around(ends, paths, self.hull.radius, abilities_of(body).radius)
        self.lattice = lattice_of(body, ends, self._box, self.cell, tuning)
        self.places: dict[Configuration, int] = {}
        self._rests: dict[int, Edge] = {}
        for pose in ends:
            self.place(pose)
        for path in paths:
            self._chain(path)

    def place(self, pose: Configuration) -> int:
        """Return the place at a pose, joined to the places of the lattice near it."""
        if pose not in self.places:
            node = self.places[pose] = self._new(pose)
            self._join(node, self.tuning.links)
            if node not in self._keys and node not in self._extra:
                self._drive_out(node)
        return self.places[pose]

    def _drive_out(self, node: int) -> None:
        """Join a place at which the body cannot turn to places straight ahead and behind."""
        x, y, theta = self.poses[node]
        for away in (-2.0, -1.0, 1.0, 2.0):
            reach = away * self.cell
            pose = (x + reach * math.cos(theta), y + reach * math.sin(theta), theta)
            moves = steer(self.body, self.poses[node], pose)
            if all(self._sweeps_free(m.rows) for m in moves):
                there = self._new(pose)
                self._link(node, there, moves)
                self._join(there, self.tuning.links)

    def rest(self, node: int) -> Edge:
        """Return the rest at a place."""
        if node not in self._rests:
            self._rests[node] = self._edge(node, node, Move(np.array([self.poses[node]]), 0.0))
        return self._rests[node]

    def out(self, node: int) -> list[Edge]:
        """Return the free moves from a place."""
        if node not in self._known:
            check_time()
            found = [self.edges[k] for k in self._extra.get(node, ())]
            if node in self._keys and len(self.poses) < self.tuning.nodes:
                found += self._lattice_moves(node)
            self._known[node] = found
        return self._known[node]

    def to_go(self, goal: int) -> dict[int, float]:
        """Return the cost from each place to a goal, over free moves (each has its reverse)."""
        best = {goal: 0.0}
        queue = [(0.0, goal)]
        while queue:
            cost, node = heapq.heappop(queue)
            if cost > best[node]:
                continue
            for edge in self.out(node):
                after = cost + edge.cost
                if after < best.get(edge.target, math.inf):
                    best[edge.target] = after
                    heapq.heappush(queue, (after, edge.target))
        return best

    def route(
        self,
        ends: tuple[int, int],
        estimate: Callable[[int], float],
        allowed: Callable[[Edge], bool] | None = None,
        limit: float = math.inf,
        most: int | None = None,
    ) -> tuple[tuple[Edge, ...] | None, int]:
        """Return a cheap way between two places (A*), and the places looked at (``most``: as many
        at most). ``estimate``: cost to go from a place; ``limit``: cost at most.
        """
        start, goal = ends
        best: dict[int, tuple[float, Edge | None]] = {start: (0.0, None)}
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
        way: list[Edge] = []
        at = goal
        while (last := best[at][1]) is not None:
            way.append(last)
            at = last.source
        return tuple(way[::-1]), len(closed)

    def _lattice_moves(self, node: int) -> list[Edge]:
        found = []
        for key, move in self.lattice.moves(self._keys[node]):
            if self._is_place(key) and self._sweeps_free(move.rows):
                found.append(self._edge(node, self._lattice_place(key), move))
        return found

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

    def _edge(self, source: int, target: int, move: Move) -> Edge:
        kin = self.body.kinematics
        way = float(steps_of(move.rows, 0.0).sum()) if len(move.rows) > 1 else 0.0
        turn = float(np.abs(np.diff(move.rows[:, 2])).sum()) if self._pivots else 0.0
        cost = max(way / kin.v_max, turn / kin.omega_max) + self.tuning.each
        edge = Edge(len(self.edges), source, target, move, self.hull, cost)
        self.edges.append(edge)
        return edge

    def _link(self, source: int, target: int, moves: Sequence[Move]) -> None:
        """Add moves between two places, and back, with places where one move ends."""
        nodes = [source, *(self._new(tuple(m.rows[-1].tolist())) for m in moves[:-1]), target]
        for (a, b), move in zip(itertools.pairwise(nodes), moves, strict=True):
            self._extra.setdefault(a, []).append(self._edge(a, b, move).number)
            self._extra.setdefault(b, []).append(self._edge(b, a, move.back()).number)

    def _join(self, node: int, most: int) -> None:
        """Join a place off the lattice to free places near it."""
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
        joined = 0
        for _, key in options[: 8 * most]:
            if joined >= most:
                break
            if not self._is_place(key):
                continue
            moves = steer(self.body, pose, self.lattice.pose(key))
            way = sum(float(steps_of(m.rows, 0.0).sum()) for m in moves)
            limit = self.tuning.local * max(self.cell, abilities_of(self.body).radius)
            if way <= limit and all(self._sweeps_free(m.rows) for m in moves):
                self._link(node, self._lattice_place(key), moves)
                joined += 1

    def _chain(self, path: Path) -> None:
        """Add marks along a path, and the drives between them."""
        stops = path.s[path.stop]
        counts = [max(1, math.ceil((b - a) / self.cell)) for a, b in itertools.pairwise(stops)]
        marks = np.concatenate(
            [
                np.linspace(a, b, n + 1)[:-1]
                for (a, b), n in zip(itertools.pairwise(stops), counts, strict=True)
            ]
            + [stops[-1:]]
        )
        poses = path.poses_at(marks)
        nodes = [self.place(_pose(path.poses[0]))]
        nodes += [self._new(tuple(row.tolist())) for row in poses[1:-1]]
        nodes.append(self.place(_pose(path.poses[-1])))
        for i, (a, b) in enumerate(itertools.pairwise(marks)):
            self._link(nodes[i], nodes[i + 1], [self._along(path, float(a), float(b))])
        for node in nodes[1:-1]:
            self._join(node, 2)

    def _along(self, path: Path, first: float, last: float) -> Move:
        """Return the move between two marks of a path, straight where the body can."""
        if abilities_of(self.body).sideways:
            start, goal = path.poses_at(np.array([first, last]))
            move = straight_move(start, goal, self.body.kinematics)
            if self._sweeps_free(move.rows):
                return move
        return _part(path, first, last)


def _pose(row: FloatArray) -> Configuration:
    return tuple(float(v) for v in row)


def _part(path: Path, first: float, last: float) -> Move:
    """Return the part of a path between two marks (m along it) as a move."""
    inside = path.s[(path.s > first + 1e-9) & (path.s < last - 1e-9)]
    rows = path.poses_at(np.concatenate([[first], inside, [last]]))
    v, a = path.body.kinematics.v_max, path.body.kinematics.a_max
    seconds = (last - first) / v + v / a
    able = abilities_of(path.body)
    arcs = None if able.pivots or able.free else arcs_between(path, first, last)
    return Move(rows, seconds, arcs)


def _same(p: Configuration, q: Configuration) -> bool:
    if abs(p[0] - q[0]) > 1e-9 or abs(p[1] - q[1]) > 1e-9:
        return False
    return abs(math.remainder(p[2] - q[2], 2 * math.pi)) < 1e-9
