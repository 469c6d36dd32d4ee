"""How long a motion at least takes after an obstacle that closed its way has gone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from up_samp.geometry.cells import distances_to
from up_samp.geometry.memory import Memory
from up_samp.geometry.shapes import core_of, shape_of
from up_samp.model import Body, Configuration, Kinematics, Placed
from up_samp.motion.proofs.certificates import Certifier
from up_samp.motion.proofs.regions import Regions

FloatArray = npt.NDArray[np.float64]
LegLength = Callable[[Configuration, Configuration], float]


class AfterOpening:
    """Admissible times from the instant an obstacle leaves to a motion's end, for one scene.

    While the obstacle rests, the body's inner disc stays in the region where it started. So when
    the way opens it is still as far from the goal as that region is (straight line, top speed of
    the reference point, which the disc's centre may outrun in turns).
    """

    def __init__(self, certifier: Certifier) -> None:
        self._certifier = certifier
        self._distances: Memory[tuple[Regions, FloatArray]] = Memory(64)

    def seconds(
        self, body: Body, poses: Sequence[Configuration], placed: Placed, leg_length: LegLength
    ) -> float:
        """Return the bound (s) for driving through ``poses``; 0 where nothing can be said.

        ``leg_length(a, b)`` bounds the way (m) of each leg after the one that is closed.
        """
        # nothing is known of how fast a body under its own equations of motion can be
        if self._certifier.scene.grid is None or body.mobility.own_law:
            return 0.0
        body = core_of(body)
        regions, _ = self._certifier._at(body, (placed,))
        labels = [self._certifier._label(regions, body, p) for p in poses]
        for index in range(len(poses) - 1):
            start, goal = labels[index], labels[index + 1]
            if start and goal and not regions.reaches(start, goal, 0):
                rest = sum(leg_length(a, b) for a, b in itertools.pairwise(poses[index + 1 :]))
                distance = self._distance(regions, body, start, poses[index + 1])
                return _roll_out(_driven(distance, body) + rest, body.kinematics)
        return 0.0

    def _distance(self, regions: Regions, body: Body, start: int, goal: Configuration) -> float:
        """Return the least distance (m) from the start's region to the goal's inner disc centre."""
        grid = self._certifier.scene.grid
        assert grid is not None

        def measured() -> tuple[Regions, FloatArray]:
            inside = np.isin(regions.labels, sorted(regions.reached(start, 0)))
            return regions, distances_to(inside)

        # the regions are kept with what is known of them: their id is not used again meanwhile
        _, distances = self._distances.get_or((id(regions), start), measured)
        cx, cy, _ = shape_of(body).inner
        c, s = math.cos(goal[2]), math.sin(goal[2])
        point = (goal[0] + c * cx - s * cy, goal[1] + s * cx + c * cy)
        row, col = grid.cells_of([point])[0]
        cells = float(distances[row, col])
        if math.isinf(cells):
            return 0.0  # the start lies in the obstacle itself: nothing is known of its way out
        # both points may lie anywhere in their cells
        return max(0.0, (cells - math.sqrt(2.0)) * grid.resolution)


def _driven(distance: float, body: Body) -> float:
    """Return how far (m) the reference point goes at least while the inner disc's centre covers
    ``distance`` m.

    The two keep their distance from each other, so the one goes that far less at most, twice; a
    car's turns are no tighter than its turning radius.
    """
    x, y, _ = shape_of(body).inner
    least = distance - 2.0 * math.hypot(x, y)
    if body.mobility.steers:
        radius = body.kinematics.turning_radius
        least = max(least, distance / math.hypot(1.0 + abs(y) / radius, x / radius))
    return max(0.0, least)


def _roll_out(distance: float, limits: Kinematics) -> float:
    """Return the least time (s) to cover ``distance`` (m) and come to rest, rolling at first."""
    braking = limits.v_max**2 / (2.0 * limits.a_max)
    if distance <= braking:
        return math.sqrt(2.0 * distance / limits.a_max)
    return (distance - braking) / limits.v_max + limits.v_max / limits.a_max
