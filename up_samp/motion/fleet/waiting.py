"""The earliest arrival along one path among runs: waiting, and speeds tuned."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from up_samp.model import (
    Configuration,
    Placed,
    TimedMotion,
)
from up_samp.motion.fleet.cell_times import (
    first_gap,
    forbidden_starts,
    safe_intervals,
)
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.speed import tune
from up_samp.motion.fleet.timed_path import TimedPath, avoids, pose_at, run_of
from up_samp.motion.fleet.timings import Timing, natural_timing
from up_samp.motion.fleet.workspace import Workspace

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """When a motion may happen: it is there from ``since``, leaves not before ``release``."""

    since: float
    release: float


def fit(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    path: Path,
    others: Sequence[TimedPath],
    best: TimedPath | None = None,
) -> TimedPath | None:
    """Return the earliest arrival along ``path`` among ``others``, by waiting and slowing down, or
    ``best`` if that is not later.
    """
    limit = best.arrival if best else math.inf
    if window.release + path.fastest >= limit:
        return best
    horizon = max(motion.due, window.release + path.natural.duration)
    while True:
        soon = [o for o in others if o.until > window.release and o.since < horizon]
        later = [o for o in others if o.since >= horizon]
        rows = workspace.forbidden(path, motion.object, motion.avoid, soon)
        ends = _end_rows(workspace, motion, path, later)
        rows = np.concatenate([rows, ends])
        timing = _earliest(motion, window, path, rows, limit, workspace.tuning.ladder.gain)
        if timing is None and (not later or limit <= horizon):
            return best
        if timing is not None and (not later or timing.trajectory.end <= horizon):
            return run_of(motion, path, timing, window.since)
        horizon = window.release + 4 * (horizon - window.release) + 60.0


def first_start(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    path: Path,
    others: Sequence[TimedPath],
) -> float | None:
    """Return when a motion can first begin its ``path`` with the path's own timing (s), if ever."""
    rows = workspace.forbidden(path, motion.object, motion.avoid, others)
    rows = rows[(rows[:, 2] > window.release) | (rows[:, 0] == path.cells + 1)]
    blocked, earliest, latest = forbidden_starts(
        rows, path.natural_held, window.release, motion.present_until
    )
    start = first_gap(blocked[np.argsort(blocked[:, 0], kind="stable")], earliest, latest)
    return start if start < math.inf else None


def _end_rows(
    workspace: Workspace, motion: TimedMotion, path: Path, later: Sequence[TimedPath]
) -> FloatArray:
    """Return the forbidden rows of the rest at the end for runs that only come later."""
    rest = workspace.resting(motion.body, pose_at(path, -1))
    visitors = [o for o in later if o.since < motion.present_until]
    rows = workspace.forbidden(rest, motion.object, motion.avoid, visitors)
    rows = rows[rows[:, 0] == 0]
    rows[:, 0] = path.cells + 1
    return rows


def _earliest(
    motion: TimedMotion,
    window: Window,
    path: Path,
    rows: FloatArray,
    limit: float,
    gain: float,
) -> Timing | None:
    """Return the earliest arrival along ``path``, before ``limit``, with forbidden (cell, from,
    until) ``rows``; at another speed only if that gains so much (s).
    """
    rows = rows[(rows[:, 2] > window.release) | (rows[:, 0] == path.cells + 1)]
    until = motion.present_until
    blocked, earliest, latest = forbidden_starts(rows, path.natural_held, window.release, until)
    blocked = blocked[np.argsort(blocked[:, 0], kind="stable")]
    start = first_gap(blocked, earliest, latest)
    best = None
    if start + path.natural.duration < limit:
        best = natural_timing(path, start)
        limit = best.trajectory.end
    if start > window.release and path.tunable and path.cells > 0:
        safe = safe_intervals(rows, path.cells)
        # at the end it must be able to rest, so it arrives after the last visit of another
        ends = rows[(rows[:, 0] == path.cells + 1) & (rows[:, 1] < until)]
        goal_free = float(np.max(ends[:, 2], initial=-math.inf))
        if goal_free < limit:
            # hundredths of a second are not worth a timing that stops and goes
            tuned = tune(path, safe, window.release, goal_free, limit - gain)
            best = tuned or best
    return best


def parked_all_the_time(motion: TimedMotion, others: Iterable[TimedPath]) -> list[Placed]:
    """Return what rests in one place all through the motion's window."""
    return [
        Placed(other.object, other.path.body, rest)
        for other in others
        if other.object != motion.object
        and avoids(motion.avoid, other.object)
        and other.since <= motion.release
        and (rest := _rest_until(other, motion)) is not None
    ]


def _rest_until(other: TimedPath, motion: TimedMotion) -> Configuration | None:
    end = max(motion.due, motion.release)
    if other.until < end:
        return None
    return other.rests_during(motion.release, end)
