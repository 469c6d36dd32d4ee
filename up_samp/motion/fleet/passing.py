"""Two robots that would meet on one line pass each other, each in a lane of its own.

Where a way is just wide enough for both, neither can stay in the middle of it: who goes first has
to leave room for who comes. Lanes to both sides are tried, as far from the paths as it takes and a
bit more, around where the two would meet and longer ones.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from up_samp.model import TimedMotion
from up_samp.motion.fleet.margins import CLEARANCES
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.timed_path import TimedPath
from up_samp.motion.fleet.waiting import Window, fit
from up_samp.motion.fleet.workspace import Workspace


def pass_by(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    alone: Mapping[str, TimedPath],
    world: Sequence[TimedPath],
) -> dict[str, TimedPath] | None:
    """Return runs of two motions in lanes beside their best paths (``alone``: their runs without
    each other), those in which the last one arrives soonest; None if none are found.
    """
    if len(motions) != 2 or any(m.name not in alone or len(m.poses) != 2 for m in motions):
        return None
    runs = [alone[m.name] for m in motions]
    at, _, _ = workspace.meeting(*runs)
    if at == math.inf:
        return None
    for lanes in _lanes(workspace, runs, at):
        found = [_runs(workspace, motions, lanes, order, world) for order in ((0, 1), (1, 0))]
        some = [f for f in found if f is not None]
        if some:
            return min(some, key=lambda f: max(run.arrival for run in f.values()))
    return None


def _runs(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    lanes: Sequence[Path],
    order: tuple[int, int],
    world: Sequence[TimedPath],
) -> dict[str, TimedPath] | None:
    """Return the runs in two lanes, the first one of an order as soon as it can."""
    found: dict[str, TimedPath] = {}
    for i in order:
        motion = motions[i]
        window = Window(motion.present_from, motion.release)
        run = fit(workspace, motion, window, lanes[i], [*world, *found.values()])
        if run is None:
            return None
        found[motion.name] = run
    return found


def _lanes(
    workspace: Workspace, runs: Sequence[TimedPath], at: float
) -> Iterator[tuple[Path, Path]]:
    """Yield pairs of lanes of two runs that meet at a time."""
    tuning = workspace.tuning.detours
    met = [float(np.interp(at, r.timing.trajectory.times, r.timing.s)) for r in runs]
    reach = sum(r.path.hull.radius for r in runs)
    air = workspace.margin + CLEARANCES.room
    apart = 0.5 * (sum(_half_width(r.path, s) for r, s in zip(runs, met, strict=True)) + air)
    for stretch, share in itertools.product(tuning.stretch, tuning.beside):
        for sides in ((-1, -1), (1, 1), (-1, 1), (1, -1)):
            found = []
            for run, s, side in zip(runs, met, sides, strict=True):
                first, last = s - 0.25 * stretch * reach, s + 0.75 * stretch * reach
                inside = 0.0 < first < last < run.path.length
                offset = side * share * apart
                lane = workspace.lane(run.path, first, last, offset) if inside else None
                if lane is None:
                    break
                found.append(lane)
            if len(found) == 2:
                yield found[0], found[1]


def _half_width(path: Path, s: float) -> float:
    """Return how far a body reaches to the side of its way at ``s`` m along its path."""
    near = 0.1 * path.hull.radius
    a, here, b = path.poses_at(np.clip([s - near, s, s + near], 0.0, path.length))
    way = math.atan2(b[1] - a[1], b[0] - a[0])
    turn = float(here[2]) - way
    corners = np.array(path.body.footprint)
    return float(np.abs(corners @ (math.sin(turn), math.cos(turn))).max())
