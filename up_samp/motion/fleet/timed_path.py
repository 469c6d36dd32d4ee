"""Timings of paths, and timed paths (runs): who of them has to keep clear of whom."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from up_samp.geometry.records import inner, kernel
from up_samp.model import Configuration, TimedMotion, Trajectory, avoids
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.curves.reeds_shepp import DriveLimits
from up_samp.motion.fleet.conflicts import A_AVOIDS, B_AVOIDS
from up_samp.motion.fleet.paths import SAME_TIME, Path, occupancy

CLOSE = 1e-4
"""Samples nearer than this (s) to a stop, and shorter waits, are left out."""

ON_TIME = 1e-6
"""Lateness (s) that does not count."""


@inner
def speed_of(level: int, can: DriveLimits, ds: float) -> float:
    """Return the speed (m/s) at a level: one cell of ``ds`` m at full acceleration apart."""
    return min(can.v, np.sqrt(2 * can.a * ds * level))


@dataclass(frozen=True, eq=False)
class Timing:
    """A timing of a path: the trajectory and ``s`` at each of its samples."""

    trajectory: Trajectory
    s: FloatArray


def natural_timing(path: Path, start: float) -> Timing:
    """Return the planner's own timing, begun at ``start`` (s)."""
    return Timing(path.natural.shifted(start), path.natural_s)


def sampled(path: Path, level: IntArray, left: FloatArray, can: DriveLimits) -> Timing:
    """Return the trajectory for the speed level at each vertex, and when it is left (s)."""
    phases, forced = _phases(path.edges, level, left, can)
    t, s, v, acc = phases.T
    # kinks must be samples: solve s + v dt + acc dt^2 / 2 = kink in the phase that passes it
    kinks = path.s[path.kink][1:-1]
    i = np.clip(np.searchsorted(s, kinks, side="right") - 1, 0, len(s) - 1)
    ahead = np.maximum(kinks - s[i], 0.0)
    root = v[i] + np.sqrt(np.maximum(v[i] ** 2 + 2 * acc[i] * ahead, 0.0))
    crossed = t[i] + np.where(root > 0, 2 * ahead / np.where(root > 0, root, 1.0), 0.0)
    near = np.searchsorted(forced, crossed)
    close = np.minimum(
        np.abs(crossed - forced[np.minimum(near, len(forced) - 1)]),
        np.abs(crossed - forced[np.maximum(near - 1, 0)]),
    )
    marks = np.concatenate([forced, crossed[close > CLOSE]])
    marks.sort()
    marks = marks[np.concatenate([[True], np.diff(marks) > SAME_TIME])]
    times = _filled(marks)
    i = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 1)
    dt = times - t[i]
    at = np.maximum.accumulate(np.minimum(s[i] + dt * (v[i] + 0.5 * dt * acc[i]), path.length))
    at[0], at[-1] = 0.0, path.length
    # a wait is two samples in one place
    keep = np.ones(len(at), dtype=np.bool_)
    keep[1:-1] = (at[1:-1] > at[:-2]) | (at[2:] > at[1:-1])
    times, at = times[keep], at[keep]
    return Timing(Trajectory(times, path.poses_at(at)), at)


@kernel
def _phases(
    edges: FloatArray, level: IntArray, left: FloatArray, can: DriveLimits
) -> tuple[FloatArray, FloatArray]:
    """Return phases of constant acceleration (begin, s, v, acceleration; a wait has speed 0), shape
    (k, 4), and the times at which it stops or starts.
    """
    a, m = can.a, len(edges) - 1
    rows, forced = np.empty((3 * m, 4)), np.empty(2 * m + 1)
    now = left[0]
    forced[0] = now
    n, stops = 0, 1
    for i in range(1, m + 1):
        ds = edges[i] - edges[i - 1]
        v0, v1 = speed_of(level[i - 1], can, ds), speed_of(level[i], can, ds)
        high = max(v0, v1)
        ramp, length = abs(v1 - v0) / a, abs(v1 * v1 - v0 * v0) / (2 * a)
        cruise = max(0.0, ds - length) / high
        at = edges[i - 1]
        for part in range(2):
            # speed up first, slow down last
            ramps = (part == 0) == (v1 >= v0)
            lasts = ramp if ramps else cruise
            if lasts > 0.0:
                speed = v0 if ramps else high
                push = (a if v1 >= v0 else -a) if ramps else 0.0
                rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = now, at, speed, push
                n += 1
                now += lasts
                at += speed * lasts + 0.5 * push * lasts * lasts
        if level[i] == 0:
            forced[stops] = now
            stops += 1
            if i < m and left[i] - now > CLOSE:
                rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = now, edges[i], 0.0, 0.0
                n += 1
                now = left[i]
                forced[stops] = now
                stops += 1
    return rows[:n], forced[:stops]


def _filled(marks: FloatArray) -> FloatArray:
    """Return ``marks`` with evenly spread times in between, at most ``MAX_STEP`` s apart."""
    gaps = np.diff(marks)
    counts = np.maximum(1, np.ceil(gaps / Trajectory.MAX_STEP - SAME_TIME).astype(np.int64))
    which = np.repeat(np.arange(len(gaps)), counts)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    share = (np.arange(len(which)) - first[which]) / counts[which]
    return np.append(marks[which] + share * gaps[which], marks[-1])


# ------------------ Runs: bodies on timed paths, and who of them has to keep clear of whom


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
        """When each extended cell is entered (see :mod:`up_samp.motion.fleet.paths`)."""
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
            return self.path.ends[0]
        if start >= times[-1]:
            return self.path.ends[1]
        return None


def pair_flags(
    a: str, a_avoid: frozenset[str] | None, b: str, b_avoid: frozenset[str] | None
) -> int:
    """Return who of two objects must, while moving, keep clear of whom (bits)."""
    flags = A_AVOIDS if avoids(a_avoid, b) else 0
    return flags | (B_AVOIDS if avoids(b_avoid, a) else 0)


def run_of(motion: TimedMotion, path: Path, timing: Timing) -> TimedPath:
    """Return a motion with its timing as a run."""
    since, until = motion.present_from, motion.present_until
    return TimedPath(motion.name, motion.object, path, timing, since, until, motion.avoid)
