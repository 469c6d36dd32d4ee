"""What robots drive, piece by piece: each piece forwards, backwards, or otherwise, without a stop
in between.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from up_samp.io import PlanDict
from up_samp.io.precision import PRECISION
from up_samp.model import UnsupportedError
from up_samp.model.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class PathPiece:
    """A stretch of a motion between two rests or changes of direction.

    ``rows`` are ``[t, x, y, theta]`` (n, 4). ``direction``: ``"forward"``, ``"backward"``,
    ``"turn"`` (on the spot) or ``"any"`` (sideways in part).
    """

    rows: FloatArray
    direction: str

    @property
    def length(self) -> float:
        """Length of the way of the reference point, m."""
        return float(np.sum(np.hypot(*np.diff(self.rows[:, 1:3], axis=0).T)))

    @property
    def top_speed(self) -> float:
        """Largest speed of the reference point between two samples, m/s."""
        steps = np.hypot(*np.diff(self.rows[:, 1:3], axis=0).T)
        return float(np.max(steps / np.diff(self.rows[:, 0]), initial=0.0))


def pieces_of(motion: dict[str, Any]) -> list[PathPiece]:
    """Return the pieces of one entry of a plan's ``motions``, in order; rests are left out.

    Raises :class:`UnsupportedError` for motions in space.
    """
    rows = np.asarray(motion["samples"], dtype=np.float64)
    if rows.shape[1] != 4:
        raise UnsupportedError(
            f"'{motion['activity']}' moves '{motion['object']}' in space; this format knows the "
            "plane only"
        )
    kinds = list(itertools.starmap(_direction, itertools.pairwise(rows)))
    pieces: list[PathPiece] = []
    begin = 0
    for i in range(1, len(kinds) + 1):
        if i == len(kinds) or kinds[i] != kinds[begin]:
            if kinds[begin] != "rest":
                pieces.append(PathPiece(rows[begin : i + 1], kinds[begin]))
            begin = i
    return pieces


def _direction(a: FloatArray, b: FloatArray) -> str:
    dx, dy = b[1] - a[1], b[2] - a[2]
    turn = b[3] - a[3]
    if math.hypot(dx, dy) < PRECISION.still:
        return "rest" if abs(turn) < PRECISION.still else "turn"
    middle = (a[3] + b[3]) / 2
    angle = abs(_wrapped(math.atan2(dy, dx) - middle))
    if angle < PRECISION.straight:
        return "forward"
    return "backward" if angle > math.pi - PRECISION.straight else "any"


def _wrapped(angle: float) -> float:
    """Return an angle in (-pi, pi]."""
    turned = math.remainder(angle, 2 * math.pi)
    return math.pi if turned == -math.pi else turned


def wrapped(angle: float) -> float:
    """Return an angle (rad) in [-pi, pi], rounded to 6 digits without leaving that range."""
    return min(max(round(_wrapped(angle), 6), -3.141592), 3.141592) + 0.0


def quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a turn by ``yaw`` (rad) about the vertical axis."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def simplified(points: FloatArray, tolerance: float) -> FloatArray:
    """Return a part of the points (n, 2) whose polyline stays within ``tolerance`` (m) of all.

    Douglas and Peucker, 1973. The first and the last point stay.
    """
    line = shapely.LineString(points).simplify(tolerance, preserve_topology=False)
    return np.asarray(line.coords, dtype=np.float64)


def robots_of(plan: PlanDict) -> list[str]:
    """Return who drives in the plan, in the order of its objects."""
    driven = {m["object"] for m in plan["motions"]}
    return [o["name"] for o in plan["objects"] if o["name"] in driven]


def motions_of(plan: PlanDict, robot: str) -> Sequence[dict[str, Any]]:
    """Return what ``robot`` drives, in time order."""
    own = [m for m in plan["motions"] if m["object"] == robot]
    return sorted(own, key=lambda m: float(m["samples"][0][0]))
