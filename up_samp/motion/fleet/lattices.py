"""Lattices: regular places of a body, at some headings, and the moves between neighbours."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from up_samp.model import Body, Configuration, Kinematics
from up_samp.motion.curves.arcs import length_of, nodes_of
from up_samp.motion.curves.reeds_shepp import fastest
from up_samp.motion.curves.trapezoid import limits_of, runs_of
from up_samp.motion.fleet.abilities import abilities_of
from up_samp.motion.fleet.moves import Move, straight_move
from up_samp.motion.fleet.paths import Path
from up_samp.motion.tuning import RoadmapTuning

FloatArray = npt.NDArray[np.float64]
Key = tuple[int, int, int]
Box = tuple[float, float, float, float]

QUARTERS = (0.0, math.pi / 2, math.pi, -math.pi / 2)


def box_around(
    ends: Iterable[Configuration], paths: Iterable[Path], radius: float, turning: float
) -> Box:
    """Return the region that the lattice covers: all ends and paths, and room to step aside."""
    points = np.concatenate([np.array([p[:2] for p in ends]), *(p.poses[:, :2] for p in paths)])
    reach = 6 * radius + 3 * turning
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def lattice_of(
    body: Body, ends: Sequence[Configuration], box: Box, cell: float, tuning: RoadmapTuning
) -> Tensor | State:
    """Return the lattice for a body in a box."""
    if not abilities_of(body).pivots:
        x, y, _ = ends[0]
        return State(body, (x, y), cell, tuning)
    headings = dict.fromkeys(round(math.remainder(p[2], 2 * math.pi), 12) for p in ends)
    near = [
        h for h in headings if all(abs(math.remainder(h - q, 2 * math.pi)) > 1e-6 for q in QUARTERS)
    ]
    chosen = sorted([*QUARTERS, *near[: tuning.pivots - len(QUARTERS)]])
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
        self.sideways = abilities_of(body).sideways

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

    def moves(self, key: Key) -> list[tuple[Key, Move]]:
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
            for n in self._along(0 if way[1] == j else 1):
                drive = self._straight((i, j, n), (*way, n))
                found.append(((*way, n), drive if n == k else self._turned(key, n, drive)))
        return found

    def _along(self, axis: int) -> list[int]:
        """Return the headings along an axis."""
        across = np.sin(self.headings) if axis == 0 else np.cos(self.headings)
        return [int(n) for n in np.flatnonzero(np.abs(across) < 1e-9)]

    def _straight(self, key: Key, there: Key) -> Move:
        start, goal = np.array(self.pose(key)), np.array(self.pose(there))
        return straight_move(start, goal, self.body.kinematics)

    def _turned(self, key: Key, heading: int, drive: Move) -> Move:
        turn = self._straight(key, (key[0], key[1], heading))
        rows = drive.rows.copy()
        rows[:, 2] += turn.rows[-1, 2] - rows[0, 2]
        return Move(np.concatenate([turn.rows[:1], rows]), turn.seconds + drive.seconds)


class State:
    """A lattice of places and headings joined by drives that a car can do (Pivtoraiko, Knepper &
    Kelly, *Differentially constrained mobile robot motion planning in state lattices*, 2009).
    """

    def __init__(
        self, body: Body, origin: tuple[float, float], cell: float, tuning: RoadmapTuning
    ) -> None:
        self.body, self.origin, self.cell, self.tuning = body, origin, cell, tuning

    def pose(self, key: Key) -> Configuration:
        """Return the pose of a place."""
        x, y = self.origin[0] + key[0] * self.cell, self.origin[1] + key[1] * self.cell
        return x, y, math.remainder(key[2] * 2 * math.pi / self.tuning.headings, 2 * math.pi)

    def near(self, x: float, y: float) -> list[Key]:
        """Return the places around a point."""
        i, j = round((x - self.origin[0]) / self.cell), round((y - self.origin[1]) / self.cell)
        reach = math.ceil(1.5 * self.body.kinematics.turning_radius / self.cell)
        span, headings = range(-reach, reach + 1), range(self.tuning.headings)
        return [(i + a, j + b, k) for a in span for b in span for k in headings]

    @property
    def _primitives(self) -> tuple[tuple[Primitive, ...], ...]:
        return _primitives(self.body.kinematics, self.cell, self.tuning)

    def moves(self, key: Key) -> list[tuple[Key, Move]]:
        """Return the moves from a place, map or no map."""
        i, j, k = key
        here = np.array(self.pose(key))
        found = []
        for (di, dj, n), arcs, seconds in self._primitives[k]:
            there = (i + di, j + dj, n)
            found.append((there, Move(nodes_of(here, arcs), seconds, arcs)))
        return found


Primitive = tuple[Key, FloatArray, float]


@lru_cache(maxsize=64)
def _primitives(
    kin: Kinematics, cell: float, tuning: RoadmapTuning
) -> tuple[tuple[Primitive, ...], ...]:
    """Return the moves from each heading of a car's lattice: without a cusp, the shortest ones
    straight on, into the lane beside and to the next heading, forwards and backwards.
    """
    found = []
    headings, offsets = tuning.headings, range(-tuning.offsets, tuning.offsets + 1)
    for k in range(headings):
        start = (0.0, 0.0, k * 2 * math.pi / headings)
        best: dict[tuple[int, bool, int], tuple[float, Primitive]] = {}
        for i, j, turn in itertools.product(offsets, repeat=3):
            if abs(turn) > 1 or (i, j) == (0, 0):
                continue
            n = (k + turn) % headings
            goal = (i * cell, j * cell, n * 2 * math.pi / headings)
            seconds, arcs = fastest(start, goal, *limits_of(kin))
            length = length_of(arcs)
            longest = tuning.straighter * math.hypot(i * cell, j * cell)
            if len(runs_of(arcs)) != 1 or length > longest:
                continue
            side = -math.sin(start[2]) * i + math.cos(start[2]) * j
            lane = 0 if abs(side) < 1e-9 else int(math.copysign(1, side))
            sort = (turn, bool(arcs[0, 1] > 0), lane)
            if sort not in best or length < best[sort][0] - 1e-9:
                best[sort] = (length, ((i, j, n), arcs, float(seconds)))
        found.append(tuple(primitive for _, primitive in best.values()))
    return tuple(found)
