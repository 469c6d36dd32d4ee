"""Rigid motions of the plane, and maps that were put somewhere by one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Frame:
    """A frame of reference: its origin ``(x, y)`` (m) and its turn ``yaw`` (rad) in another one."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    @property
    def is_identity(self) -> bool:
        """Whether it is the other frame itself."""
        return (self.x, self.y, self.yaw) == (0.0, 0.0, 0.0)

    def out(self, poses: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return poses (..., 3) in this frame as poses in the other one."""
        given = np.asarray(poses, dtype=np.float64)
        if self.is_identity:
            return given
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x = self.x + c * given[..., 0] - s * given[..., 1]
        y = self.y + s * given[..., 0] + c * given[..., 1]
        return np.stack((x, y, given[..., 2] + self.yaw), axis=-1)

    def of(self, pose: Sequence[float]) -> tuple[float, float, float]:
        """Return one pose in this frame as a pose in the other one."""
        x, y, yaw = (float(v) for v in self.out(pose))
        return x, y, yaw

    def seen(self, pose: Sequence[float]) -> tuple[float, float, float]:
        """Return a pose of the other frame as seen from this one, half a turn off at most."""
        dx, dy = pose[0] - self.x, pose[1] - self.y
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return c * dx + s * dy, c * dy - s * dx, math.remainder(pose[2] - self.yaw, math.tau)

    def points(self, given: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return points (n, 2) in this frame, such as corners, as points in the other one."""
        x, y = np.asarray(given, dtype=np.float64).reshape(-1, 2).T
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.column_stack((self.x + c * x - s * y, self.y + s * x + c * y))

    def after(self, inner: Frame) -> Frame:
        """Return the frame that ``inner``, a frame in this one, is in the other one."""
        return self if inner.is_identity else Frame(*self.of((inner.x, inner.y, inner.yaw)))

    @property
    def inverse(self) -> Frame:
        """The other frame as a frame in this one."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Frame(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)


@dataclass(frozen=True)
class PlacedMap:
    """A map file whose own frame is ``frame`` in the world, ``height`` m above its ground.

    Objects on maps of different heights never meet: these are floors.
    """

    file: str
    frame: Frame = Frame()
    height: float = 0.0

    @property
    def label(self) -> str:
        """The map in words."""
        where = [] if self.frame.is_identity else [f"at {self.frame.x:g}, {self.frame.y:g}"]
        where += [f"turned by {self.frame.yaw:g}"] if self.frame.yaw else []
        where += [f"{self.height:g} m up"] if self.height else []
        return f"'{Path(self.file).name}'" + (f" ({', '.join(where)})" if where else "")
