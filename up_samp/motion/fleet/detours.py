"""Other paths: in a lane beside the best one, around whom it would meet, past the places where
others may stand, and for two robots that meet on one line.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    Placed,
    TimedMotion,
)
from up_samp.motion.fleet.conflicts import CLEARANCES, separation
from up_samp.motion.fleet.lanes import lane_offsets
from up_samp.motion.fleet.paths import TIMES, Path, shared_stretch
from up_samp.motion.fleet.speed import Window, fit
from up_samp.motion.fleet.timed_path import TimedPath, natural_timing, run_of
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


# ------------------ Ways past the places where others may stand
# A robot's best way leads through places where others load or wait. On it, it has to wait for
# them; on a way past all such places it meets only those that drive. Such ways depend on nobody's
# times, so they are looked for once, before anything is decided. (On a *well-formed* floor there
# is one for each motion; Čáp, Novák, Kleiner and Selecký, IEEE T-ASE 2015.)


Stand = tuple[Body, Configuration]
"""Who may stand where."""


def ways_past(
    workspace: Workspace,
    poses: tuple[Configuration, ...],
    best: Path,
    stands: Sequence[Stand],
    deadline: Deadline,
    *,
    tries: int,
) -> Iterator[Path]:
    """Yield ways through poses, as the ``best`` path drives through them: past those of some stands
    that it runs into, then past those, too, that this way runs into, and so on.

    Stands near its ends are left out: there it has to be.

    :param tries: so many ways are looked for.
    """
    others = [s for s in stands if not crowds(workspace, best, s[1], workspace.resting(*s))]
    path, avoided = best, dict[Stand, Placed]()
    for _ in range(tries):
        met = [s for s in others if len(workspace.conflicts(path, workspace.resting(*s)))]
        if not met or deadline.expired():
            return
        avoided.update((s, Placed(f"stand {len(avoided) + n}", *s)) for n, s in enumerate(met))
        found = workspace.detour(path.body, poses, (), list(avoided.values()), deadline)
        if found is None:
            return
        yield found
        path = found


# ------------------ Two robots that would meet on one line pass each other
# Two robots that would meet on one line pass each other, each in a lane of its own. Where a way
# is just wide enough for both, neither can stay in the middle of it: who goes first has to leave
# room for who comes. Lanes to both sides are tried, as far from the paths as it takes and a bit
# more, around where the two would meet and longer ones.


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
    for lanes in _passing_lanes(workspace, runs, at):
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


def _passing_lanes(
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
