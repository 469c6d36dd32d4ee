"""Where a body is at every instant, and how far any point of it can have come in between.

Between two samples a planar body moves with a constant twist, so its reference point runs along
an arc (Lynch & Park, *Modern Robotics*, ch. 3). Lengths in m, angles in rad, times in s.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Pieces:
    """The motions between neighbouring samples of a planar trajectory; arrays of length n - 1."""

    dt: FloatArray
    chord: FloatArray
    """Displacements in the world frame, shape (n - 1, 2)."""
    turn: FloatArray
    along: FloatArray
    """Signed length of the arc along the body's heading (its component; backwards: negative)."""
    across: FloatArray
    """Displacement to the left of the heading in the middle of the piece."""
    length: FloatArray
    """Length of the reference point's arc (>= 0)."""

    @property
    def at_rest(self) -> npt.NDArray[np.bool_]:
        """Which pieces are rests."""
        return np.asarray((self.length < 1e-9) & (np.abs(self.turn) < 1e-9))


def pieces_of(times: FloatArray, poses: FloatArray) -> Pieces:
    """Split a planar trajectory (times (n,), poses (n, 3)) into its pieces."""
    step = np.diff(poses, axis=0)
    chord, turn = step[:, :2], step[:, 2]
    middle = poses[:-1, 2] + turn / 2
    half = turn / 2
    # arc length over chord length; np.sinc(x) is sin(pi x) / (pi x)
    stretch = 1 / np.maximum(np.abs(np.sinc(half / math.pi)), 1e-6)
    along = (chord[:, 0] * np.cos(middle) + chord[:, 1] * np.sin(middle)) * stretch
    across = (chord[:, 1] * np.cos(middle) - chord[:, 0] * np.sin(middle)) * stretch
    length = np.hypot(chord[:, 0], chord[:, 1]) * stretch
    return Pieces(np.diff(times), chord, turn, along, across, length)


@dataclass(frozen=True)
class Track:
    """A planar body's pose over all time; it rests before the first and after the last sample.

    ``radius`` is the distance of the body's farthest point from its reference point.
    """

    times: FloatArray
    poses: FloatArray
    radius: float
    _times: list[float] = field(init=False, repr=False)
    _travel: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_times", self.times.tolist())
        pieces = pieces_of(self.times, self.poses)
        steps = pieces.length + self.radius * np.abs(pieces.turn)
        object.__setattr__(self, "_travel", np.concatenate(([0.0], np.cumsum(steps))))

    @staticmethod
    def resting(pose: Pose, radius: float) -> Track:
        """Return the track of a body that never moves."""
        return Track(np.zeros(1), np.array([pose], dtype=float), radius)

    def pose(self, t: float) -> Pose:
        """Return the pose at time ``t``."""
        i, share = self._locate(t)
        x, y, theta = self.poses[i].tolist()
        if share <= 0:
            return x, y, theta
        dx, dy, turn = (self.poses[i + 1] - self.poses[i]).tolist()
        # the part of an arc has the chord sin(share * turn / 2) / sin(turn / 2), turned back
        half = turn / 2
        ratio = math.sin(share * half) / math.sin(half) if abs(half) > 1e-9 else share
        back = (share - 1) * half
        c, s = ratio * math.cos(back), ratio * math.sin(back)
        return x + c * dx - s * dy, y + s * dx + c * dy, theta + share * turn

    def travel(self, a: float, b: float) -> float:
        """Return an upper bound on the way of any point of the body between times a <= b."""
        return self._travelled(b) - self._travelled(a)

    def _travelled(self, t: float) -> float:
        i, share = self._locate(t)
        if share <= 0:
            return float(self._travel[i])
        return float(self._travel[i] + share * (self._travel[i + 1] - self._travel[i]))

    def _locate(self, t: float) -> tuple[int, float]:
        """Return the piece that holds ``t`` and the share of it that is over."""
        i = bisect_right(self._times, t) - 1
        if i < 0:
            return 0, 0.0
        if i >= len(self._times) - 1:
            return len(self._times) - 1, 0.0
        return i, (t - self._times[i]) / (self._times[i + 1] - self._times[i])
