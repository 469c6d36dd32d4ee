"""Other paths for one robot: in a lane beside the best one, or around whom it would meet."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from up_samp.model import (
    Configuration,
    Deadline,
    Placed,
    TimedMotion,
)
from up_samp.motion.fleet.cell_times import TIMES, shared_stretch
from up_samp.motion.fleet.conflicts import separation
from up_samp.motion.fleet.lanes import lane_offsets
from up_samp.motion.fleet.margins import CLEARANCES
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.timed_path import TimedPath, run_of
from up_samp.motion.fleet.timings import natural_timing
from up_samp.motion.fleet.waiting import Window, fit
from up_samp.motion.fleet.workspace import Workspace


def is_good(run: TimedPath | None, motion: TimedMotion) -> bool:
    """Return whether a run arrives in time."""
    return run is not None and run.arrival <= motion.due + TIMES.on_time


def met_at_full_speed(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    path: Path,
    others: Sequence[TimedPath],
) -> list[tuple[TimedPath, int, float]]:
    """Return the runs it meets when it drives ``path`` at once, with their cell and when."""
    run = run_of(motion, path, natural_timing(path, window.release), window.since)
    found = []
    for other in others:
        at, _, cell = workspace.meeting(run, other)
        if at < math.inf:
            found.append((at, other.object, cell, other))
    found.sort(key=lambda item: item[:3])
    return [(other, cell, at) for at, _, cell, other in found]


def with_lanes(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    path: Path,
    best: TimedPath | None,
    others: Sequence[TimedPath],
) -> TimedPath | None:
    """Return the best of ``best`` and of paths that change lanes where ``path`` meets somebody."""
    for _ in range(workspace.tuning.ladder.detours):
        met = met_at_full_speed(workspace, motion, window, path, others)
        if not met or len(motion.poses) != 2:
            break
        options = []
        for lane in _lanes(workspace, motion, window, path, met[0][0]):
            best = fit(workspace, motion, window, lane, others, best)
            if is_good(best, motion):
                return best
            # go on from the lane that gets furthest at full speed
            again = met_at_full_speed(workspace, motion, window, lane, others)
            options.append((-again[0][2] if again else -math.inf, lane.number, lane))
        if not options:
            break
        path = min(options, key=lambda option: option[:2])[2]
    return best


def _lanes(
    workspace: Workspace, motion: TimedMotion, window: Window, path: Path, other: TimedPath
) -> Iterator[Path]:
    """Yield versions of ``path`` that pass ``other`` sideways where it would be met."""
    run = run_of(motion, path, natural_timing(path, window.release), window.since)
    at, _, _ = workspace.meeting(run, other)
    runs = workspace.conflicts(path, other.path)
    first, last = shared_stretch(runs, run.held, other.held, at)
    if workspace.scene is None or first < 1 or last > path.cells:
        return
    for offset in lane_offsets(path, other.path):
        lane = workspace.lane(path, float(path.edges[first - 1]), float(path.edges[last]), offset)
        if lane is not None:
            yield lane


def with_detours(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    path: Path,
    best: TimedPath | None,
    others: Sequence[TimedPath],
    static: Sequence[Placed],
    deadline: Deadline,
) -> TimedPath | None:
    """Return the best of ``best`` and of paths around whatever the last path met at full speed."""
    copies: list[Placed] = []
    for _ in range(workspace.tuning.ladder.detours):
        met = met_at_full_speed(workspace, motion, window, path, others)
        virtual = _virtual_obstacles(workspace, motion, path, met[:2])
        if not virtual or deadline.expired():
            break
        copies += virtual
        other_path = workspace.detour(motion.body, motion.poses, static, copies, deadline)
        if other_path is None:
            break
        path = other_path
        best = fit(workspace, motion, window, path, others, best)
        if is_good(best, motion):
            break
    return best


def _virtual_obstacles(
    workspace: Workspace,
    motion: TimedMotion,
    path: Path,
    met: Sequence[tuple[TimedPath, int, float]],
) -> list[Placed]:
    """Return copies of the runs that were met, where their path conflicts with ``path``.

    Copies closer to the first or the last pose of the motion than the margin are left out: it has
    to be there, and with them no way would keep more of the margin, from anything.
    """
    virtual: list[Placed] = []
    copies = workspace.tuning.detours.copies
    for other, cell, _ in met:
        runs = workspace.conflicts(path, other.path)
        hits = np.unique(np.concatenate([np.arange(a, b + 1) for _, a, b in runs]))
        table = other.path.swept.table
        reach = other.path.hull.radius + path.hull.radius
        centre = table[cell, 1, :2]
        last = np.full(2, math.inf)
        for j in hits:
            row = table[j, 1]
            near = float(np.hypot(*(row[:2] - centre))) <= 4 * reach
            if not near or float(np.hypot(*(row[:2] - last))) < copies * other.path.hull.radius:
                continue
            pose = (float(row[0]), float(row[1]), math.atan2(row[3], row[2]))
            if crowds(workspace, path, pose, other.path):
                continue
            last = row[:2]
            virtual.append(Placed(f"{other.object}~{j}", other.path.body, pose))
    return virtual


def crowds(workspace: Workspace, path: Path, pose: Configuration, other: Path) -> bool:
    """Return whether the body of ``other``, at a pose, is near an end of a path."""
    enough = workspace.margin + CLEARANCES.room
    return any(
        separation(end, path.hull, np.array(pose), other.hull, enough) < enough
        for end in path.poses[[0, -1]]
    )
