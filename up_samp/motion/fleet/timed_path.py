"""Runs: bodies on timed paths, and who of them has to keep clear of whom."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from up_samp.model import (
    Body,
    Configuration,
    FixedMotion,
    MotionModel,
    TimedMotion,
    UnsupportedError,
)
from up_samp.motion.fleet.cell_times import (
    A_AVOIDS,
    B_AVOIDS,
    occupancy,
)
from up_samp.motion.fleet.paths import Path, path_of
from up_samp.motion.fleet.timings import Timing

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A body on a timed path. It is there from ``since`` until ``until`` (s) and, while it moves,
    keeps clear of the objects in ``avoid`` (``None``: all). A rest is a run without cells.
    """

    name: str
    object: str
    path: Path
    timing: Timing
    since: float
    until: float
    avoid: frozenset[str] | None

    @cached_property
    def held(self) -> FloatArray:
        """When each extended cell is entered (see :mod:`up_samp.motion.fleet.cell_times`)."""
        if self.path.cells == 0:
            return np.array([self.since, self.since, self.until])
        times = self.timing.trajectory.times
        return occupancy(times, self.timing.s, self.path.edges, self.since, self.until)

    @cached_property
    def speed(self) -> float:
        """A bound on its speed (m/s)."""
        trajectory = self.timing.trajectory
        if len(trajectory.times) == 1:
            return 0.0
        steps = np.hypot(*np.diff(trajectory.poses[:, :2], axis=0).T) / np.diff(trajectory.times)
        return 1.1 * float(steps.max())

    @property
    def arrival(self) -> float:
        """When it stands at its last pose (s)."""
        return self.timing.trajectory.end

    def rests_during(self, start: float, end: float) -> Configuration | None:
        """Return where it stands if it does not move in all of [start, end]."""
        times = self.timing.trajectory.times
        if end <= times[0] or self.path.cells == 0:
            return pose_at(self.path, 0)
        if start >= times[-1]:
            return pose_at(self.path, -1)
        return None


def avoids(avoid: frozenset[str] | None, name: str) -> bool:
    """Return whether a motion with this ``avoid`` set must keep clear of the object ``name``."""
    return avoid is None or name in avoid


def pose_at(path: Path, index: int) -> Configuration:
    """Return a sample of a path as a configuration."""
    return tuple(float(x) for x in path.poses[index])


def pair_flags(
    a: str, a_avoid: frozenset[str] | None, b: str, b_avoid: frozenset[str] | None
) -> int:
    """Return who of two objects must, while moving, keep clear of whom (bits)."""
    flags = A_AVOIDS if avoids(a_avoid, b) else 0
    return flags | (B_AVOIDS if avoids(b_avoid, a) else 0)


NOBODY: frozenset[str] = frozenset()
"""A resting body keeps clear of nobody: it does not move."""


def fixed_run(motion: FixedMotion) -> TimedPath:
    """Return an already decided motion as a run."""
    planar(motion.body)
    path = path_of(motion.trajectory, motion.body)
    timing = Timing(motion.trajectory, path.natural_s)
    return TimedPath(
        motion.name, motion.object, path, timing, motion.present_from, motion.present_until, None
    )


def run_of(motion: TimedMotion, path: Path, timing: Timing, since: float) -> TimedPath:
    """Return a motion with its timing as a run that is there from ``since`` on."""
    return TimedPath(
        motion.name, motion.object, path, timing, since, motion.present_until, motion.avoid
    )


def planar(body: Body) -> None:
    """Refuse bodies that do not move in the plane."""
    if body.kinematics.model is MotionModel.SE3:
        raise UnsupportedError(
            "coordinating several bodies in space-time is for planar bodies; one here is SE3"
        )
