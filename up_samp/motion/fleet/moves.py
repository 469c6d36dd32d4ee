"""Short moves from rest to rest, the pieces that a roadmap is made of, by what a body can do."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from up_samp.model import Body, Configuration, Kinematics, Trajectory
from up_samp.motion.curves.arcs import length_of, merged, nodes_of, reversed_arcs
from up_samp.motion.curves.reeds_shepp import fastest, run_time
from up_samp.motion.curves.straight import leg_profile, timed_chain
from up_samp.motion.curves.trapezoid import (
    distance_of_time,
    limits_of,
    poses_on,
    runs_of,
    time_of_distance,
    trajectory_of,
)
from up_samp.motion.fleet.abilities import abilities_of

FloatArray = npt.NDArray[np.float64]
Key = tuple[int, int, int]

HEADINGS = 8
"""Headings of a car's lattice."""
REACH = 5
"""Offsets (cells) up to which a car's lattice looks for its moves."""
STRAIGHTER = 1.25
"""A car's move may be that much longer than the straight line."""


@dataclass(frozen=True, eq=False)
class Move:
    """A short move from rest to rest: poses ``rows`` (k, 3) with a constant twist between
    (theta continuous), the ``seconds`` it takes, and a car's ``arcs``.
    """

    rows: FloatArray
    seconds: float
    arcs: FloatArray | None = None

    @property
    def steady(self) -> bool:
        """Whether it needs no stop between its ends."""
        return len(self.rows) == 2 or (self.arcs is not None and len(runs_of(self.arcs)) == 1)

    def back(self) -> Move:
        """Return the same move from its end to its start."""
        arcs = None if self.arcs is None else reversed_arcs(self.arcs)
        return Move(np.ascontiguousarray(self.rows[::-1]), self.seconds, arcs)


def straight_move(start: FloatArray, goal: FloatArray, kinematics: Kinematics) -> Move:
    """Return the move along a line, or the turn on the spot, between two poses (3,)."""
    end = goal.copy()
    end[2] = start[2] + math.remainder(goal[2] - start[2], 2 * math.pi)
    return Move(np.array([start, end]), leg_profile(start, end, kinematics)[0])


def arc_moves(start: FloatArray, arcs: FloatArray, kinematics: Kinematics) -> list[Move]:
    """Return a car's drive along ``arcs``, one move for each run between its cusps."""
    _, v, a = limits_of(kinematics)
    moves = []
    for run in runs_of(arcs):
        run = np.ascontiguousarray(run)
        rows = nodes_of(start, run)
        moves.append(Move(rows, float(run_time(length_of(run), v, a)), run))
        start = np.ascontiguousarray(rows[-1])
    return moves


def steer(body: Body, start: Configuration, goal: Configuration) -> list[Move]:
    """Return moves that lead from one pose to another one nearby, among nothing."""
    kin, able = body.kinematics, abilities_of(body)
    p, q = (np.array(pose[:3], dtype=np.float64) for pose in (start, goal))
    if not able.pivots:
        return arc_moves(p, fastest(start, goal, *limits_of(kin))[1], kin)
    marks = [p]
    if able.sideways:
        marks.append(np.array([p[0], p[1], q[2]]))
    elif math.dist(p[:2], q[:2]) > 1e-9:
        way = math.atan2(q[1] - p[1], q[0] - p[0])
        if math.cos(way - p[2]) + math.cos(way - q[2]) < 0.0:
            way += math.pi  # backwards turns less
        marks += [np.array([p[0], p[1], way]), np.array([q[0], q[1], way])]
    marks.append(q)
    moves: list[Move] = []
    for a, b in itertools.pairwise(marks):
        here = moves[-1].rows[-1] if moves else a
        move = straight_move(here, b, kin)
        if move.seconds > 0.0:
            moves.append(move)
    return moves


def drive(moves: Sequence[Move], kinematics: Kinematics) -> Trajectory:
    """Return moves one after the other, from time 0, with as few rests as the moves allow."""
    arcs = [move.arcs for move in moves if move.arcs is not None]
    if len(arcs) == len(moves):
        ends = [tuple(float(v) for v in row) for row in (moves[0].rows[0], moves[-1].rows[-1])]
        return trajectory_of(ends, [merged(np.concatenate(arcs))], kinematics)
    return timed_chain(corners_of(moves), kinematics)


def in_step(moves: Sequence[Move], kinematics: Sequence[Kinematics]) -> list[Trajectory]:
    """Return steady moves of several robots driven at the same share of each at every instant,
    from time 0, as fast as all of them can.
    """
    speed = acceleration = math.inf
    marks = {1.0}
    for move, kin in zip(moves, kinematics, strict=True):
        if move.arcs is None:
            _, v, a = leg_profile(move.rows[0], move.rows[-1], kin)
        else:
            lengths = np.abs(move.arcs[:, 1])
            v, a = kin.v_max / lengths.sum(), kin.a_max / lengths.sum()
            marks |= set((np.cumsum(lengths)[:-1] / lengths.sum()).tolist())
        speed, acceleration = min(speed, v), min(acceleration, a)
    times, shares = _shared_profile(sorted(marks), speed, acceleration)
    found = []
    for move in moves:
        start = move.rows[0]
        if move.arcs is None:
            rows = start + shares[:, None] * (move.rows[-1] - start)
        else:
            ends = np.cumsum(np.abs(move.arcs[:, 1]))
            rows = poses_on(nodes_of(start, move.arcs), move.arcs, ends, shares * ends[-1])
        found.append(Trajectory(times.copy(), rows))
    return found


def _shared_profile(
    marks: Sequence[float], speed: float, acceleration: float
) -> tuple[FloatArray, FloatArray]:
    """Return times (s) and shares (0 to 1) of a drive from rest to rest, the ``marks`` among them;
    limits in shares.
    """
    if math.isinf(acceleration):  # turns on the spot
        total = 1.0 / speed
        at = np.array(marks) * total
    else:
        total = float(run_time(1.0, speed, acceleration))
        at = time_of_distance(np.array(marks), 1.0, speed, acceleration)
    count = max(2, math.ceil(total / Trajectory.MAX_STEP - 1e-9))
    times = np.union1d(np.linspace(0.0, total, count + 1), at)
    times = times[np.concatenate([[True], np.diff(times) > 1e-9])]
    times[-1] = total
    shares = (
        times / total
        if math.isinf(acceleration)
        else distance_of_time(times, 1.0, speed, acceleration)
    )
    shares[-1] = 1.0
    return times, shares


def corners_of(moves: Sequence[Move]) -> FloatArray:
    """Return the poses (n, 3) at which the direction of a chain of moves changes, and its ends."""
    nodes = [moves[0].rows[0]]
    for move in moves:
        turns = 2 * math.pi * round((nodes[-1][2] - move.rows[0, 2]) / (2 * math.pi))
        for row in move.rows[1:]:
            here = row + np.array([0.0, 0.0, turns])
            if len(nodes) > 1 and _straight_on(nodes[-2], nodes[-1], here):
                nodes.pop()
            nodes.append(here)
    return np.array(nodes)


def _straight_on(a: FloatArray, b: FloatArray, c: FloatArray) -> bool:
    """Return whether b is on the straight motion from a to c."""
    first, second = b - a, c - b
    sizes = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    if min(sizes) < 1e-12:
        return True
    return bool(np.abs(first / sizes[0] - second / sizes[1]).max() < 1e-9)


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
        span = range(-reach, reach + 1)
        return [(i + a, j + b, k) for a in span for b in span for k in range(HEADINGS)]

    def moves(self, key: Key) -> list[tuple[Key, Move]]:
        """Return the moves from a place, map or no map."""
        i, j, k = key
        here = np.array(self.pose(key))
        found = []
        for (di, dj, n), arcs, seconds in _primitives(self.body.kinematics, self.cell)[k]:
            there = (i + di, j + dj, n)
            found.append((there, Move(nodes_of(here, arcs), seconds, arcs)))
        return found


Primitive = tuple[Key, FloatArray, float]


@lru_cache(maxsize=64)
def _primitives(kin: Kinematics, cell: float) -> tuple[tuple[Primitive, ...], ...]:
    """Return the moves from each heading of a car's lattice: without a cusp, the shortest ones
    straight on, into the lane beside and to the next heading, forwards and backwards.
    """
    found = []
    for k in range(HEADINGS):
        start = (0.0, 0.0, k * 2 * math.pi / HEADINGS)
        best: dict[tuple[int, bool, int], tuple[float, Primitive]] = {}
        for i, j, turn in itertools.product(range(-REACH, REACH + 1), repeat=3):
            if abs(turn) > 1 or (i, j) == (0, 0):
                continue
            n = (k + turn) % HEADINGS
            goal = (i * cell, j * cell, n * 2 * math.pi / HEADINGS)
            seconds, arcs = fastest(start, goal, *limits_of(kin))
            length = length_of(arcs)
            if len(runs_of(arcs)) != 1 or length > STRAIGHTER * math.hypot(i * cell, j * cell):
                continue
            side = -math.sin(start[2]) * i + math.cos(start[2]) * j
            lane = 0 if abs(side) < 1e-9 else int(math.copysign(1, side))
            sort = (turn, bool(arcs[0, 1] > 0), lane)
            if sort not in best or length < best[sort][0] - 1e-9:
                best[sort] = (length, ((i, j, n), arcs, float(seconds)))
        found.append(tuple(primitive for _, primitive in best.values()))
    return tuple(found)
