"""Speed profiles: how long a body needs along its path when nothing holds it up."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from up_samp.execution.lives import Life
from up_samp.execution.tolerances import TOLERANCES
from up_samp.model import Body, Configuration
from up_samp.model.arrays import FloatArray
from up_samp.motion.fleet.paths import Path, hull_of

STEP = 0.1
"""Length (m) of the stretches on which speeds are bounded."""

FINEST, MOST = 0.02, 5000
"""Poses are sought on a path at points so far apart (m), and at so many at most, before the best is
looked at more closely."""


@dataclass(frozen=True, eq=False)
class TravelProfile:
    """The fastest drive along a path, rest to rest: arrays over ``progress`` (m): ``speed`` (m/s),
    ``time`` (s). ``cap`` bounds the speed where the body may not choose it freely.
    """

    progress: FloatArray
    speed: FloatArray
    time: FloatArray
    cap: FloatArray
    accel: float
    stops: tuple[float, ...]
    """Progress (m) of cusps and corners, where the body must rest; the path's end is the last."""

    def time_at(self, progress: float) -> float:
        """Return when it comes there (s from its start)."""
        return _between(self._plain[0], self._plain[1], progress)

    def progress_at(self, time: float) -> float:
        """Return where it is (m) so many seconds after its start."""
        return _between(self._plain[1], self._plain[0], time)

    def stands_from(self, time: float) -> float:
        """Return where it stands (m) that begins to brake so many seconds after its start: none
        that drives along the path, however fast, comes farther.
        """
        here = self.progress_at(time)
        return here + self.speed_at(here) ** 2 / (2 * self.accel)

    def within(self, here: float, there: float) -> float:
        """Return in how many seconds one that may stand ``here`` (m) surely stands ``there``, if it
        drives as fast as it may.
        """
        way = there - here
        if way <= 0.0:
            return 0.0
        ramps = 1 + sum(here < s < there for s in self.stops)
        inner = self.cap[(self.progress > here) & (self.progress < there)]
        caps = self.cap_at(here), self.cap_at(there), float(inner.min(initial=math.inf))
        speed = min(*caps, math.sqrt(way * self.accel / ramps))
        return way / speed + ramps * speed / self.accel

    def speed_at(self, progress: float) -> float:
        """Return how fast it is there (m/s): between points it speeds up, or slows down, evenly."""
        return math.sqrt(_between(self._plain[0], self._plain[2], progress))

    def cap_at(self, progress: float) -> float:
        """Return how fast it may be there (m/s)."""
        return _between(self._plain[0], self._plain[3], progress)

    @cached_property
    def length(self) -> float:
        """The path's length (m)."""
        return float(self.progress[-1])

    @cached_property
    def whole(self) -> float:
        """How long the whole drive takes (s)."""
        return float(self.time[-1])

    @cached_property
    def fastest(self) -> float:
        """The highest speed that is allowed anywhere (m/s)."""
        return float(self.cap.max())

    @cached_property
    def _plain(self) -> tuple[list[float], ...]:
        """Progress, times, squares of speeds, bounds as lists: one value of them is found sooner
        than by numpy.
        """
        return tuple(a.tolist() for a in (self.progress, self.time, self.speed**2, self.cap))


def _between(xs: list[float], ys: list[float], x: float) -> float:
    """Return the value at ``x`` of what is linear between points, constant outside."""
    k = bisect.bisect_right(xs, x)
    if k == 0:
        return ys[0]
    if k == len(xs):
        return ys[-1]
    low = xs[k - 1]
    return ys[k - 1] + (x - low) / (xs[k] - low) * (ys[k] - ys[k - 1])


@dataclass(frozen=True)
class Along:
    """A pose seen from a path: nearest at ``progress`` (m) of it, and ``off`` (m) it: the larger of
    the distance, and of what the body's outermost point is turned away by.
    """

    progress: float
    off: float


def along(path: Path, pose: Sequence[float], window: tuple[float, float] | None = None) -> Along:
    """Return where on a path a body is that stands at ``pose`` (x, y, theta).

    It is the point whose pose is nearest, with the heading: a path that passes a point twice does
    so in different directions, mostly. ``window`` (m) is where on the path it can be by what is
    known otherwise, which tells the rest apart; nothing outside it is looked at.
    """
    low, high = (0.0, path.length) if window is None else window
    low, high = max(0.0, min(low, path.length)), min(path.length, max(high, 0.0))
    spacing = max(FINEST, (high - low) / MOST)
    at = np.linspace(low, high, max(2, int(np.ceil((high - low) / spacing)) + 1))
    while True:
        found = _away(path.poses_at(at), pose, path.body)
        k = int(np.argmin(found))
        step = at[1] - at[0]
        if step <= FINEST / 100:
            return Along(float(at[k]), float(found[k]))
        at = np.linspace(max(low, at[k] - step), min(high, at[k] + step), 41)


def away(one: Configuration, other: Configuration, body: Body) -> float:
    """Return how far (m) a body is from one pose at another."""
    return float(_away(np.array([one]), other, body)[0])


def _away(poses: FloatArray, pose: Sequence[float], body: Body) -> FloatArray:
    gap = poses - np.asarray(pose, dtype=np.float64)
    turn = np.abs(gap[:, 2] - 2 * np.pi * np.round(gap[:, 2] / (2 * np.pi)))
    return np.asarray(np.hypot(np.hypot(gap[:, 0], gap[:, 1]), hull_of(body).radius * turn))


def is_same_place(one: Iterable[Any], other: Iterable[Any]) -> bool:
    """Return whether two poses (x, y, theta; in space: x, y, ...) are one place."""
    here, there = ([float(v) for v in pose] for pose in (one, other))
    turn = math.remainder(there[2] - here[2], math.tau) if len(here) == 3 else 0.0
    gap = max(abs(a - b) for a, b in zip(there[:2], here[:2], strict=True))
    return max(gap, abs(turn)) <= TOLERANCES.place


def pose_at(path: Path, progress: float) -> Configuration:
    """Return where a body is that tells a progress (m): straight on, where that is beyond an end of
    its path.
    """
    inside = min(max(progress, 0.0), path.length)
    pose, last = path.poses_at(np.array([inside]))[0], -1 if progress > 0.0 else 1
    step = (path.poses[last] - path.poses[last - 1]) / (path.s[last] - path.s[last - 1])
    x, y, theta = pose + (progress - inside) * step
    return float(x), float(y), float(theta)


def travel_of(path: Path) -> TravelProfile:
    """Return the fastest drive along a path within the body's limits (forward and backward pass).

    Where the body's speed cannot be chosen freely (hard bends, equations of its own) it is bounded
    by that of the planned trajectory.
    """
    push = path.push
    rests = path.s[path.stop]
    stops = tuple(float(x) for x in rests[rests > 1e-9]) or (path.length,)
    count = max(2, int(np.ceil(path.length / STEP)) + 1)
    grid = np.unique(np.concatenate([np.linspace(0.0, path.length, count), [0.0], stops]))
    # between points the cap is read off a line: both of them have to heed a tight arc
    cap = path.tops_within(np.append(grid[:1], grid[:-1]), np.append(grid[1:], grid[-1:]))
    if not path.tunable:
        cap = np.minimum(cap, _planned_speed(path, grid))
    gaps = np.diff(grid)
    cap = _slowing(cap, 2 * push * gaps)
    speed = cap.copy()
    speed[np.isin(grid, [0.0, *stops])] = 0.0
    for i in range(len(gaps)):
        speed[i + 1] = min(speed[i + 1], np.sqrt(speed[i] ** 2 + 2 * push * gaps[i]))
    speed = _slowing(speed, 2 * push * gaps)
    mean = 0.5 * (speed[1:] + speed[:-1])
    slow = np.sqrt(push * gaps) / 2  # from rest to rest within one stretch
    time = np.concatenate([[0.0], np.cumsum(gaps / np.maximum(mean, slow))])
    return TravelProfile(grid, speed, time, cap, push, stops)


def _slowing(speed: FloatArray, lost: FloatArray) -> FloatArray:
    """Return speeds of who slows down before it has to be slow: squares fall by ``lost`` at most
    from each one to the next.
    """
    found = speed.copy()
    for i in range(len(lost) - 1, -1, -1):
        found[i] = min(found[i], np.sqrt(found[i + 1] ** 2 + lost[i]))
    return found


def travels_of(lives: Mapping[str, Life]) -> dict[tuple[str, str], TravelProfile]:
    """Return the fastest drives of all motions, by activity and object."""
    known: dict[Path, TravelProfile] = {}
    found = {}
    for life in lives.values():
        for drive in life.drives:
            if drive.path not in known:
                known[drive.path] = travel_of(drive.path)
            found[drive.key] = known[drive.path]
    return found


def _planned_speed(path: Path, grid: FloatArray) -> FloatArray:
    times, s = path.natural.times, np.maximum.accumulate(path.natural_s)
    rates = np.diff(s) / np.diff(times)
    moving = rates > 1e-6
    if not moving.any():
        return np.full(len(grid), path.body.kinematics.v_max)
    middle = 0.5 * (s[1:] + s[:-1])[moving]
    least = 0.05 * path.body.kinematics.v_max
    return np.asarray(np.maximum(np.interp(grid, middle, rates[moving]), least))
