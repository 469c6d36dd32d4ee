"""Short moves from rest to rest, the pieces that a roadmap is made of, by what a body can do."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from up_samp.model import Body, Configuration, Kinematics, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import (
    fastest,
    length_of,
    nodes_of,
    run_time,
)
from up_samp.motion.curves.rolling import rolled
from up_samp.motion.curves.trajectories import unwound
from up_samp.motion.curves.trapezoid import (
    leg_profile,
    limits_of,
    runs_of,
    timed_chain,
)


@dataclass(frozen=True, eq=False)
class ShortMove:
    """A short move from rest to rest: poses ``rows`` (k, 3) with a constant twist between
    (theta continuous), and the ``seconds`` it takes.
    """

    rows: FloatArray
    seconds: float

    def back(self) -> ShortMove:
        """Return the same move from its end to its start."""
        return ShortMove(np.ascontiguousarray(self.rows[::-1]), self.seconds)


def straight_move(start: FloatArray, goal: FloatArray, kinematics: Kinematics) -> ShortMove:
    """Return the move along a line, or the turn on the spot, between two poses (3,)."""
    end = goal.copy()
    end[2] = start[2] + math.remainder(goal[2] - start[2], 2 * math.pi)
    return ShortMove(np.array([start, end]), leg_profile(start, end, kinematics)[0])


def arc_moves(start: FloatArray, arcs: FloatArray, kinematics: Kinematics) -> list[ShortMove]:
    """Return a car's drive along ``arcs``, one move for each run between its cusps."""
    car = limits_of(kinematics)
    moves = []
    for run in runs_of(arcs):
        rows = nodes_of(start, np.ascontiguousarray(run))
        moves.append(ShortMove(rows, float(run_time(length_of(run), car.v, car.a))))
        start = np.ascontiguousarray(rows[-1])
    return moves


def steer(body: Body, start: Configuration, goal: Configuration) -> list[ShortMove]:
    """Return moves that lead from one pose to another one nearby, among nothing."""
    kin, able = body.kinematics, body.mobility
    p, q = (np.array(pose[:3], dtype=np.float64) for pose in (start, goal))
    if not able.pivots:
        return arc_moves(p, fastest(start, goal, limits_of(kin))[1], kin)
    marks = [p]
    if able.sideways:
        marks.append(np.array([p[0], p[1], q[2]]))
    elif math.dist(p[:2], q[:2]) > 1e-9:
        way = math.atan2(q[1] - p[1], q[0] - p[0])
        if kin.reverse and math.cos(way - p[2]) + math.cos(way - q[2]) < 0.0:
            way += math.pi  # backwards turns less
        marks += [np.array([p[0], p[1], way]), np.array([q[0], q[1], way])]
    marks.append(q)
    moves: list[ShortMove] = []
    for a, b in itertools.pairwise(marks):
        here = moves[-1].rows[-1] if moves else a
        move = straight_move(here, b, kin)
        if move.seconds > 0.0:
            moves.append(move)
    return moves


def drive(moves: Sequence[ShortMove], kinematics: Kinematics) -> Trajectory:
    """Return moves one after the other, from time 0, with as few rests as the moves allow."""
    timed = timed_chain if kinematics.mobility.sideways else rolled
    return timed(corners_of(moves), kinematics)


def corners_of(moves: Sequence[ShortMove]) -> FloatArray:
    """Return the poses (n, 3) at which the direction of a chain of moves changes, and its ends."""
    nodes = [moves[0].rows[0]]
    for move in moves:
        for here in unwound(move.rows, nodes[-1])[1:]:
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
