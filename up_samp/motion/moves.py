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
    merged,
    nodes_of,
    reversed_arcs,
    run_time,
)
from up_samp.motion.curves.rolling import rolled, rolls_of
from up_samp.motion.curves.trajectories import partway, unwound
from up_samp.motion.curves.trapezoid import (
    distance_of_time,
    leg_profile,
    limits_of,
    poses_on,
    runs_of,
    time_of_distance,
    timed_chain,
    trajectory_of,
)


@dataclass(frozen=True, eq=False)
class ShortMove:
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

    def back(self) -> ShortMove:
        """Return the same move from its end to its start."""
        arcs = None if self.arcs is None else reversed_arcs(self.arcs)
        return ShortMove(np.ascontiguousarray(self.rows[::-1]), self.seconds, arcs)


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
        run = np.ascontiguousarray(run)
        rows = nodes_of(start, run)
        moves.append(ShortMove(rows, float(run_time(length_of(run), car.v, car.a)), run))
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
    arcs = [move.arcs for move in moves if move.arcs is not None]
    if len(arcs) == len(moves):
        ends = [tuple(row.tolist()) for row in (moves[0].rows[0], moves[-1].rows[-1])]
        return trajectory_of(ends, merged(np.concatenate(arcs)), kinematics)
    if kinematics.mobility.rolls:
        return rolled(corners_of(moves), kinematics)
    return timed_chain(corners_of(moves), kinematics)


def in_step(moves: Sequence[ShortMove], kinematics: Sequence[Kinematics]) -> list[Trajectory]:
    """Return steady moves of several robots driven at the same share of each at every instant,
    from time 0, as fast as all of them can.
    """
    speed = acceleration = math.inf
    marks = {1.0}
    for move, kin in zip(moves, kinematics, strict=True):
        if move.arcs is None:
            v, a = _shares_of(move, kin)
        else:
            lengths = np.abs(move.arcs[:, 1])
            v, a = kin.v_max / lengths.sum(), kin.a_max / lengths.sum()
            marks |= set((np.cumsum(lengths)[:-1] / lengths.sum()).tolist())
        speed, acceleration = min(speed, v), min(acceleration, a)
    times, shares = _shared_profile(sorted(marks), speed, acceleration)
    found = []
    for move, kin in zip(moves, kinematics, strict=True):
        start = move.rows[0]
        if move.arcs is None and kin.mobility.rolls:
            first, last = (np.repeat(row[None], len(shares), axis=0) for row in move.rows)
            rows = partway(first, last, shares)
        elif move.arcs is None:
            rows = start + shares[:, None] * (move.rows[-1] - start)
        else:
            ends = np.cumsum(np.abs(move.arcs[:, 1]))
            rows = poses_on(nodes_of(start, move.arcs), move.arcs, ends, shares * ends[-1])
        found.append(Trajectory(times.copy(), rows))
    return found


def _shares_of(move: ShortMove, kinematics: Kinematics) -> tuple[float, float]:
    """Return top speed and acceleration of a move with one twist, in shares of it."""
    if kinematics.mobility.rolls:
        rolls = rolls_of(move.rows, kinematics)
        size = float(rolls.sizes[0])
        return float(rolls.tops[0]) / size, float(rolls.pushes[0]) / size
    _, speed, acceleration = leg_profile(move.rows[0], move.rows[-1], kinematics)
    return speed, acceleration


def _shared_profile(
    marks: Sequence[float], speed: float, acceleration: float
) -> tuple[FloatArray, FloatArray]:
    """Return times (s) and shares (0 to 1) of a drive from rest to rest, the ``marks`` among them;
    limits in shares.
    """
    total = float(run_time(1.0, speed, acceleration))
    at = time_of_distance(np.array(marks), 1.0, speed, acceleration)
    count = max(2, math.ceil(total / Trajectory.MAX_STEP - 1e-9))
    times = np.union1d(np.linspace(0.0, total, count + 1), at)
    times = times[np.concatenate([[True], np.diff(times) > 1e-9])]
    times[-1] = total
    shares = distance_of_time(times, 1.0, speed, acceleration)
    shares[-1] = 1.0
    return times, shares


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
