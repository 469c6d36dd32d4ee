"""Corners that are driven round: arcs instead of stops and turns on the spot.

A body that turns on the spot need not stop to turn: it drives an arc of radius r at
``min(v_max, omega_max r)``. So a way of straight lines becomes faster where a corner is cut by an
arc, or pushed outwards and then cut, as far as walls and obstacles allow; at its ends the first and
the last turn on the spot may become arcs, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from up_samp.model import Kinematics
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.rolling import drive_time, rolling_radius

Point = tuple[float, float]


FLAT, SHARP = 1e-9, 2.6
"""Turns (rad) and lines (m) below the first are none; corners that turn by more than the second
(rad) are not cut: the arc would lie far away from them.
"""
GAIN = 1e-3
"""Seconds that another way must save."""
FITTED = 4
"""Rounds in which the place of a new corner and the angle there are made to fit."""
RADII = (1.0, 0.7, 0.5, 0.35)
"""Of arcs that are tried: shares of the rolling radius, that of the tightest arc at top speed."""
SHIFTS = (0.0, 0.5, 1.0)
"""By which a corner is pushed outwards: at 1 the arc passes where the corner was."""


@dataclass(frozen=True)
class RoundedWay:
    """Straight lines through ``points`` (m) from one heading to another (``ends``, rad), each
    driven ``ahead`` (1) or backwards (-1), with a radius (m) at each point: 0 where it rests and
    turns on the spot.
    """

    points: tuple[Point, ...]
    ahead: tuple[int, ...]
    radii: tuple[float, ...]
    ends: tuple[float, float]

    @staticmethod
    def of(nodes: FloatArray) -> RoundedWay | None:
        """Return the way through ``nodes`` (n, 3), of lines and turns on the spot (None: it never
        drives).
        """
        points: list[Point] = [(float(nodes[0, 0]), float(nodes[0, 1]))]
        ahead: list[int] = []
        for a, b in itertools.pairwise(nodes):
            dx, dy = float(b[0] - a[0]), float(b[1] - a[1])
            if math.hypot(dx, dy) > FLAT:
                along = dx * math.cos(a[2]) + dy * math.sin(a[2])
                ahead.append(1 if along > 0.0 else -1)
                points.append((float(b[0]), float(b[1])))
        if not ahead:
            return None
        rests = (0.0,) * len(points)
        return RoundedWay(
            tuple(points), tuple(ahead), rests, (float(nodes[0, 2]), float(nodes[-1, 2]))
        )

    @property
    def headings(self) -> list[float]:
        """The heading (rad) before the way, on each line, and after it."""
        found = [self.ends[0]]
        for a, b, sign in zip(self.points, self.points[1:], self.ahead, strict=False):
            found.append(math.atan2(sign * (b[1] - a[1]), sign * (b[0] - a[0])))
        return [*found, self.ends[1]]

    @property
    def turns(self) -> list[float]:
        """The turn (rad) at each point."""
        return [math.remainder(b - a, 2 * math.pi) for a, b in itertools.pairwise(self.headings)]

    def lines(self, turns: list[float]) -> tuple[list[float], list[float]] | None:
        """Return what arcs take of the lines at each point (m), and what is left of each line
        (None: less than nothing).
        """
        cuts = [
            r * math.tan(0.5 * abs(turn)) if r > 0.0 else 0.0
            for r, turn in zip(self.radii, turns, strict=True)
        ]
        left = [
            math.dist(a, b) - before - after
            for (a, b), (before, after) in zip(
                itertools.pairwise(self.points), itertools.pairwise(cuts), strict=True
            )
        ]
        return None if min(left) < 0.0 else (cuts, left)

    def seconds(self, kinematics: Kinematics) -> float:
        """Return how long it takes (s; inf: its arcs do not fit)."""
        turns = self.turns
        found = self.lines(turns)
        if found is None:
            return math.inf
        pieces: list[tuple[float, int, float]] = []
        for k, (turn, radius) in enumerate(zip(turns, self.radii, strict=True)):
            if abs(turn) > FLAT and radius == 0.0:
                pieces.append((abs(turn), 2, kinematics.omega_max))
            elif abs(turn) > FLAT:
                top = min(kinematics.v_max, kinematics.omega_max * radius)
                pieces.append((abs(turn) * radius, self.ahead[k], top))
            if k < len(self.ahead) and found[1][k] > FLAT:
                pieces.append((found[1][k], self.ahead[k], kinematics.v_max))
        return drive_time(pieces, kinematics.a_max)

    def rows(self) -> FloatArray:
        """Return the poses (n, 3) with a constant twist between them, theta continuous."""
        turns = self.turns
        found = self.lines(turns)
        assert found is not None
        theta = self.ends[0]
        rows = [(*self.points[0], theta)]
        for k, (turn, cut) in enumerate(zip(turns, found[0], strict=True)):
            x, y = self.points[k]
            if cut > 0.0:
                for side in (0, 1):
                    a, b = self.points[k - 1 + side], self.points[k + side]
                    share = (cut if side else -cut) / math.dist(a, b)
                    theta += turn * side
                    rows.append((x + share * (b[0] - a[0]), y + share * (b[1] - a[1]), theta))
                continue
            if k > 0:
                rows.append((x, y, theta))
            theta += turn
            if abs(turn) > FLAT:
                rows.append((x, y, theta))
        return np.array(rows)


@dataclass(frozen=True)
class Rounding:
    """Rounds the corners of ways. ``is_free`` says whether the body keeps clear all along poses
    with a constant twist between them; ``stop`` whether to go on no more. There are ``rounds`` over
    all corners.
    """

    kinematics: Kinematics
    rounds: int
    is_free: Callable[[FloatArray], bool]
    stop: Callable[[], bool]

    def rounded(self, way: RoundedWay) -> RoundedWay:
        """Return a free way that is not slower."""
        best, seconds = way, way.seconds(self.kinematics)
        for _ in range(self.rounds):
            before, k = seconds, 0
            while k < len(best.points) and not self.stop():
                found = self._better(self._others(best, k), seconds)
                if found is not None:
                    best, seconds = found
                k += 1
            if before - seconds < GAIN:
                break
        return best

    def _better(
        self, others: Iterator[RoundedWay], limit: float
    ) -> tuple[RoundedWay, float] | None:
        """Return the fastest free one of some ways, if it is faster than ``limit`` (s)."""
        timed = ((way.seconds(self.kinematics), k, way) for k, way in enumerate(others))
        for seconds, _, way in sorted(item for item in timed if item[0] < limit - GAIN):
            if self.is_free(way.rows()):
                return way, seconds
        return None

    def _others(self, way: RoundedWay, k: int) -> Iterator[RoundedWay]:
        """Yield ways that are others at point ``k``."""
        radii = [share * rolling_radius(self.kinematics) for share in RADII]
        if k in (0, len(way.points) - 1):
            for radius in radii:
                found = _begun_in_an_arc(way if k == 0 else _reversed(way), radius)
                if found is not None:
                    yield found if k == 0 else _reversed(found)
            return
        turn = way.turns[k]
        if way.ahead[k - 1] != way.ahead[k] or abs(turn) > SHARP:
            return
        yield _without(way, k)
        for radius, share in itertools.product(radii, SHIFTS):
            cut = radius * (1.0 / math.cos(0.5 * turn) - 1.0)
            yield _cut_by(way, k, radius, share * cut)


def _without(way: RoundedWay, k: int) -> RoundedWay:
    """Return a way that leaves out inner point ``k``."""
    points, radii = way.points[:k] + way.points[k + 1 :], way.radii[:k] + way.radii[k + 1 :]
    return replace(way, points=points, ahead=way.ahead[:k] + way.ahead[k + 1 :], radii=radii)


def _cut_by(way: RoundedWay, k: int, radius: float, shift: float) -> RoundedWay:
    """Return a way with inner point ``k`` pushed outwards by ``shift`` m, and cut by an arc."""
    (ax, ay), (x, y), (bx, by) = way.points[k - 1 : k + 2]
    before, after = math.hypot(x - ax, y - ay), math.hypot(bx - x, by - y)
    inside = (bx - x) / after - (x - ax) / before, (by - y) / after - (y - ay) / before
    bend = math.hypot(*inside)
    if bend > FLAT:
        x, y = x - shift * inside[0] / bend, y - shift * inside[1] / bend
    points = (*way.points[:k], (x, y), *way.points[k + 1 :])
    return replace(way, points=points, radii=(*way.radii[:k], radius, *way.radii[k + 1 :]))


def _begun_in_an_arc(way: RoundedWay, radius: float) -> RoundedWay | None:
    """Return a way that drives off at once, along its first heading, and bends into its way instead
    of turning on the spot at first (None: it need not turn, or there is no such arc).
    """
    turn, sign = way.turns[0], way.ahead[0]
    (x, y), (bx, by) = way.points[:2]
    if not FLAT < abs(turn) < SHARP:
        return None
    c, s = sign * math.cos(way.ends[0]), sign * math.sin(way.ends[0])
    away = 0.0
    for _ in range(FITTED):
        away = max(away, radius * math.tan(0.5 * abs(turn)))
        dx, dy = bx - x - away * c, by - y - away * s
        turn = math.remainder(math.atan2(sign * dy, sign * dx) - way.ends[0], 2 * math.pi)
        if abs(turn) > SHARP:
            return None
    radius = min(radius, away / max(math.tan(0.5 * abs(turn)), FLAT))
    points = ((x, y), (x + away * c, y + away * s), *way.points[1:])
    return replace(
        way, points=points, ahead=(sign, *way.ahead), radii=(0.0, radius, *way.radii[1:])
    )


def _reversed(way: RoundedWay) -> RoundedWay:
    """Return a way from its end to its start."""
    ahead = tuple(-sign for sign in way.ahead[::-1])
    return RoundedWay(way.points[::-1], ahead, way.radii[::-1], (way.ends[1], way.ends[0]))
