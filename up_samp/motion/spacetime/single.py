"""One robot among movers: a ladder from the best path at full speed to new ways round.

1. the best path among what rests there all the time, begun as soon as its planner's own timing
   meets nothing; 2. its speed tuned; 3. other paths, in a lane beside it, around parked robots and
   the places where it would meet the movers, each tuned; 4. a safe-interval search over the plane;
   5. ST-RRT*.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from up_samp.model import (
    Configuration,
    Deadline,
    FixedMotion,
    MotionModel,
    Outcome,
    PathReport,
    Placed,
    Rest,
    TimedMotion,
    UnsupportedError,
)
from up_samp.motion.spacetime.flights import earliest_flight, has_flyers
from up_samp.motion.spacetime.intervals import (
    first_gap,
    forbidden_starts,
    safe_intervals,
    shared_stretch,
)
from up_samp.motion.spacetime.lanes import lane_offsets
from up_samp.motion.spacetime.paths import Path
from up_samp.motion.spacetime.runs import (
    PathPlanner,
    Run,
    Workspace,
    avoids,
    fixed_run,
    pose_at,
    rest_run,
    run_of,
    workspace_of,
)
from up_samp.motion.spacetime.tuning import Timing, natural_timing, tune

FloatArray = npt.NDArray[np.float64]

ON_TIME = 1e-6
"""Lateness (s) that does not count."""

WORTH = 0.02
"""Gain (s) for which a new timing is worth having."""

ROUNDS = 4
"""Other paths tried for one motion."""

GHOST_STEP = 0.8
"""Distance (m) between the copies of a mover that a detour keeps clear of."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """What came of planning one motion: a ``run``, or none and the ``report`` that says why."""

    run: Run | None
    report: PathReport | None = None
    met: frozenset[str] = field(default_factory=frozenset)
    """Objects in the way of the best path at full speed."""


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
    others: Sequence[Run],
    best: Run | None = None,
) -> Run | None:
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
        timing = _earliest(motion, window, path, np.concatenate([rows, ends]), limit)
        if timing is None and (not later or limit <= horizon):
            return best
        if timing is not None and (not later or timing.trajectory.end <= horizon):
            return run_of(motion, path, timing, window.since)
        horizon = window.release + 4 * (horizon - window.release) + 60.0


def _end_rows(
    workspace: Workspace, motion: TimedMotion, path: Path, later: Sequence[Run]
) -> FloatArray:
    """Return the forbidden rows of the rest at the end for runs that only come later."""
    rest = workspace.resting(motion.body, pose_at(path, -1))
    visitors = [o for o in later if o.since < motion.present_until]
    rows = workspace.forbidden(rest, motion.object, motion.avoid, visitors)
    rows = rows[rows[:, 0] == 0]
    rows[:, 0] = path.cells + 1
    return rows


def _earliest(
    motion: TimedMotion, window: Window, path: Path, rows: FloatArray, limit: float
) -> Timing | None:
    """Return the earliest arrival along ``path``, before ``limit``, with forbidden (cell, from,
    until) ``rows``.
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
        head, safe = safe_intervals(rows, path.cells)
        # at the end it must be able to rest, so it arrives after the last visit of another
        ends = rows[(rows[:, 0] == path.cells + 1) & (rows[:, 1] < until)]
        goal_free = float(np.max(ends[:, 2], initial=-math.inf))
        if goal_free < limit:
            # hundredths of a second are not worth a timing that stops and goes
            tuned = tune(path, head, safe, window.release, goal_free, limit - WORTH)
            best = tuned or best
    return best


def parked_all_the_time(motion: TimedMotion, others: Iterable[Run]) -> list[Placed]:
    """Return what rests in one place all through the motion's window."""
    return [
        Placed(other.object, other.path.body, rest)
        for other in others
        if other.object != motion.object
        and avoids(motion.avoid, other.object)
        and other.since <= motion.release
        and (rest := _rest_until(other, motion)) is not None
    ]


def _rest_until(other: Run, motion: TimedMotion) -> Configuration | None:
    end = max(motion.due, motion.release)
    if other.until < end:
        return None
    return other.rests_during(motion.release, end)


def plan_one(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    others: Sequence[Run],
    deadline: Deadline,
    effort: int = 0,
) -> Attempt:
    """Return a safe run of ``motion`` among ``others``: the first one found that is on time, or
    else the earliest. ``effort`` 0 tunes and changes lanes, 1 plans detours, 2 searches space-time.
    """
    static = parked_all_the_time(motion, others)
    first = workspace.path(motion.body, motion.poses, static, deadline)
    if not isinstance(first, Path):
        # perhaps something leaves later: what is there now need not be there for ever
        static = [p for p in static if _lasts(p, others)]
        second = workspace.path(motion.body, motion.poses, static, deadline)
        if not isinstance(second, Path):
            return Attempt(None, second, second.blockers or first.blockers)
        first = second
    best = fit(workspace, motion, window, first, others)
    if _good(best, motion):
        return Attempt(best)
    met = _met_at_full_speed(workspace, motion, window, first, others)
    best = _with_lanes(workspace, motion, window, first, best, others)
    if effort > 0 and not _good(best, motion):
        best = _with_detours(workspace, motion, window, first, best, others, static, deadline)
    if effort > 1 and not _good(best, motion) and workspace.roundabout and not deadline.expired():
        paths, dry = workspace.roundabout.paths(
            motion, window.release, static, others, _goal_free(workspace, motion, others), deadline
        )
        if not paths and not dry and not deadline.expired():
            paths = _sampled(workspace, motion, window, static, others, deadline)
        for path in paths:
            best = fit(workspace, motion, window, path, others, best)
    return Attempt(best, None, frozenset(o.object for o, _, _ in met))


def _sampled(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    static: Sequence[Placed],
    others: Sequence[Run],
    deadline: Deadline,
    seed: int = 0,
) -> list[Path]:
    """Return ways that ST-RRT* finds."""
    if workspace.roundabout is None:
        return []
    free = _goal_free(workspace, motion, others)
    return workspace.roundabout.sampled(
        motion, window.release, static, others, free, deadline, seed
    )


def sample_one(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    others: Sequence[Run],
    deadline: Deadline,
    seed: int = 0,
) -> Attempt:
    """Return a safe run of a car's ``motion`` by ST-RRT* alone, its speed tuned afterwards."""
    if motion.body.kinematics.model is not MotionModel.REEDSSHEPP or len(motion.poses) != 2:
        raise UnsupportedError(
            f"ST-RRT* plans cars from one pose to another; '{motion.name}' is something else"
        )
    best: Run | None = None
    static = parked_all_the_time(motion, others)
    for path in _sampled(workspace, motion, window, static, others, deadline, seed):
        best = fit(workspace, motion, window, path, others, best)
    return Attempt(best, None, frozenset(placed.name for placed in static))


def _goal_free(workspace: Workspace, motion: TimedMotion, others: Sequence[Run]) -> float:
    """Return when (s) the last of ``others`` has left the last pose, so far as it stays there."""
    rest = workspace.resting(motion.body, motion.poses[-1])
    rows = workspace.forbidden(rest, motion.object, motion.avoid, others)
    rows = rows[(rows[:, 0] == 1) & (rows[:, 1] < motion.present_until)]
    return float(np.max(rows[:, 2], initial=-math.inf))


def _lasts(placed: Placed, others: Iterable[Run]) -> bool:
    return any(
        o.object == placed.name and o.path.cells == 0 and o.until == math.inf for o in others
    )


def _good(run: Run | None, motion: TimedMotion) -> bool:
    return run is not None and run.arrival <= motion.due + ON_TIME


def _met_at_full_speed(
    workspace: Workspace, motion: TimedMotion, window: Window, path: Path, others: Sequence[Run]
) -> list[tuple[Run, int, float]]:
    """Return the runs it meets when it drives ``path`` at once, with their cell and when."""
    run = run_of(motion, path, natural_timing(path, window.release), window.since)
    found = []
    for other in others:
        at, _, cell = workspace.meeting(run, other)
        if at < math.inf:
            found.append((at, other.object, cell, other))
    found.sort(key=lambda item: item[:3])
    return [(other, cell, at) for at, _, cell, other in found]


def _with_lanes(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    path: Path,
    best: Run | None,
    others: Sequence[Run],
) -> Run | None:
    """Return the best of ``best`` and of paths that change lanes where ``path`` meets somebody."""
    for _ in range(ROUNDS):
        met = _met_at_full_speed(workspace, motion, window, path, others)
        if not met or len(motion.poses) != 2:
            break
        options = []
        for lane in _lanes(workspace, motion, window, path, met[0][0]):
            again = _met_at_full_speed(workspace, motion, window, lane, others)
            if again and again[0][2] <= met[0][2] + WORTH:
                continue  # it passes nobody
            best = fit(workspace, motion, window, lane, others, best)
            if _good(best, motion):
                return best
            # go on from the lane that gets furthest at full speed
            options.append((-again[0][2] if again else -math.inf, lane.number, lane))
        if not options:
            break
        path = min(options, key=lambda option: option[:2])[2]
    return best


def _lanes(
    workspace: Workspace, motion: TimedMotion, window: Window, path: Path, other: Run
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


def _with_detours(
    workspace: Workspace,
    motion: TimedMotion,
    window: Window,
    path: Path,
    best: Run | None,
    others: Sequence[Run],
    static: Sequence[Placed],
    deadline: Deadline,
) -> Run | None:
    """Return the best of ``best`` and of paths around whatever the last path met at full speed."""
    around = list(static)
    for _ in range(ROUNDS):
        met = _met_at_full_speed(workspace, motion, window, path, others)
        ghosts = _ghosts(workspace, motion, path, met[:2])
        if not ghosts or deadline.expired():
            break
        around += ghosts
        other_path = workspace.detour(motion.body, motion.poses, around, deadline)
        if other_path is None:
            break
        path = other_path
        best = fit(workspace, motion, window, path, others, best)
        if _good(best, motion):
            break
    return best


def _ghosts(
    workspace: Workspace, motion: TimedMotion, path: Path, met: Sequence[tuple[Run, int, float]]
) -> list[Placed]:
    """Return copies of the runs that were met, where their path conflicts with ``path``.

    Copies over the first and the last pose of the motion are left out: it has to be there.
    """
    ghosts: list[Placed] = []
    for other, cell, _ in met:
        runs = workspace.conflicts(path, other.path)
        hits = np.unique(np.concatenate([np.arange(a, b + 1) for _, a, b in runs]))
        table = other.path.table
        reach = other.path.hull.radius + path.hull.radius
        centre = table[cell, 1, :2]
        last = np.full(2, math.inf)
        for j in hits:
            row = table[j, 1]
            near = float(np.hypot(*(row[:2] - centre))) <= 4 * reach
            if not near or float(np.hypot(*(row[:2] - last))) < GHOST_STEP * other.path.hull.radius:
                continue
            pose = (float(row[0]), float(row[1]), math.atan2(row[3], row[2]))
            rest = workspace.resting(other.path.body, pose)
            blocked = workspace.conflicts(path, rest)[:, 0]
            if 0 in blocked or path.cells + 1 in blocked:
                continue
            last = row[:2]
            ghosts.append(Placed(f"{other.object}~{j}", other.path.body, pose))
    return ghosts


def earliest_arrival(
    service: PathPlanner,
    motion: TimedMotion,
    rests: Sequence[Rest] = (),
    fixed: Sequence[FixedMotion] = (),
    deadline: Deadline | None = None,
) -> PathReport:
    """Return the earliest found arrival of one motion among movers and things that come and go.

    The trajectory is in plan time and may end after the motion's due. ``IMPOSSIBLE`` is a proof
    by what rests there for good; anything else without a trajectory is ``OUT_OF_TIME``.
    """
    began = time.monotonic()
    if has_flyers((motion,), rests, fixed):
        return earliest_flight(service, motion, rests, fixed, deadline or Deadline.never())
    workspace = workspace_of(service)
    others = [rest_run(workspace, rest) for rest in rests] + [fixed_run(f) for f in fixed]
    window = Window(motion.present_from, motion.release)
    limit = deadline or Deadline.never()
    attempt = plan_one(workspace, motion, window, others, limit, effort=2)
    seconds = time.monotonic() - began
    if attempt.run is not None:
        found = attempt.run.timing.trajectory
        return PathReport(Outcome.FOUND, found, planner="space-time", seconds=seconds)
    report = attempt.report
    return PathReport(
        failed(attempt),
        blockers=attempt.met,
        alternatives=report.alternatives if report else (),
        reason=report.reason if report else "no safe timing or detour found",
        planner="space-time",
        seconds=seconds,
    )


def failed(attempt: Attempt) -> Outcome:
    """Return what a failed attempt is worth: a proof only if the path planner has one."""
    report = attempt.report
    return report.outcome if report is not None else Outcome.OUT_OF_TIME
