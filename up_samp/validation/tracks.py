"""Where a body is at every instant, and how far any point of it can have come in between.

Between two samples a planar body moves with a constant twist, so its reference point runs along
an arc (Lynch & Park, *Modern Robotics*, ch. 3). Lengths in m, angles in rad, times in s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from up_samp.model.arrays import BoolArray, FloatArray


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
    def at_rest(self) -> BoolArray:
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
    _travel: FloatArray = field(init=False, repr=False)
    _bulge: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        pieces = pieces_of(self.times, self.poses)
        # no point of an arc is farther from its chord than that
        aside = np.sqrt(np.maximum(pieces.length**2 - (pieces.chord**2).sum(1), 0.0)) / 2
        object.__setattr__(self, "_bulge", float(aside.max(initial=0.0)))
        steps = pieces.length + self.radius * np.abs(pieces.turn)
        object.__setattr__(self, "_travel", np.concatenate(([0.0], np.cumsum(steps))))

    def pose(self, t: float) -> tuple[float, ...]:
        """Return the pose at time ``t``."""
        return tuple(self.poses_at(np.array([t]))[0].tolist())

    def poses_at(self, times: FloatArray) -> FloatArray:
        """Return the poses at ``times`` (k,), shape (k, 3)."""
        i, share = self._locate(times)
        begin = self.poses[i]
        step = self.poses[np.minimum(i + 1, len(self.poses) - 1)] - begin
        # the part of an arc has the chord sin(share * turn / 2) / sin(turn / 2), turned back
        half = step[:, 2] / 2
        bent = np.abs(half) > 1e-9
        ratio = share.copy()
        ratio[bent] = np.sin(share[bent] * half[bent]) / np.sin(half[bent])
        back = (share - 1) * half
        c, s = ratio * np.cos(back), ratio * np.sin(back)
        along = np.column_stack(
            (
                c * step[:, 0] - s * step[:, 1],
                s * step[:, 0] + c * step[:, 1],
                share * step[:, 2],
            )
        )
        return np.asarray(begin + along)

    def box(self, a: float, b: float) -> tuple[FloatArray, FloatArray]:
        """Return the corners (2,) of a box around where the reference point is from a to b."""
        first = max(int(np.searchsorted(self.times, a, side="right")) - 1, 0)
        last = min(int(np.searchsorted(self.times, b, side="left")), len(self.times) - 1)
        points = self.poses[min(first, last) : last + 1, :2]
        return points.min(0) - self._bulge, points.max(0) + self._bulge

    def travel(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return upper bounds on the way of any point of the body between times a <= b."""
        return self._travelled(b) - self._travelled(a)

    def _travelled(self, times: FloatArray) -> FloatArray:
        i, share = self._locate(times)
        step = self._travel[np.minimum(i + 1, len(self._travel) - 1)] - self._travel[i]
        return np.asarray(self._travel[i] + share * step)

    def _locate(self, times: FloatArray) -> tuple[npt.NDArray[np.intp], FloatArray]:
        """Return the pieces that hold ``times`` and the shares of them that are over."""
        clipped = np.clip(times, self.times[0], self.times[-1])
        i = np.searchsorted(self.times, clipped, side="right") - 1
        i = np.minimum(i, max(len(self.times) - 2, 0))
        length = self.times[np.minimum(i + 1, len(self.times) - 1)] - self.times[i]
        share = np.divide(
            clipped - self.times[i], length, out=np.zeros(len(clipped)), where=length > 0
        )
        return i, share
