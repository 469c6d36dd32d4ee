"""The kinematic bicycle that the published problems give their robots as a control model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Bicycle:
    """``qdot = f(q, u)`` of a car ``length`` m long: q = (x, y, theta), u = (speed, steering)."""

    length: float

    def __call__(self, q: Sequence[float], u: Sequence[float], qdot: Any) -> None:
        """Fill ``qdot`` (m/s, m/s, rad/s)."""
        speed, steering = u
        qdot[0] = speed * math.cos(q[2])
        qdot[1] = speed * math.sin(q[2])
        qdot[2] = speed * math.tan(steering) / self.length
