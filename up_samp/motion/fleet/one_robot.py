"""One robot among movers: a ladder from the best path at full speed to new ways round.

1. the best path among what rests there all the time, begun as soon as its planner's own timing
   meets nothing; 2. its speed tuned; 3. other paths, in a lane beside it, around parked robots and
   the places where it would meet the movers, each tuned.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from up_samp.model import (
    Deadline,
    Outcome,
    PathReport,
    Placed,
    TimedMotion,
    Trajectory,
)
from up_samp.motion.fleet.detours import is_good, met_at_full_speed, with_detours, with_lanes
from up_samp.motion.fleet.paths import Path, path_of
from up_samp.motion.fleet.speed import fit, parked_all_the_time
from up_samp.motion.fleet.timed_path import TimedPath, Timing
from up_samp.motion.fleet.workspace import PathPlanner, Workspace, workspace_of


@dataclass(frozen=True, eq=False)
class Attempt:
    """What came of planning one motion: a ``run``, or none and the ``report`` that says why."""

    run: TimedPath | None
    report: PathReport | None = None
    met: frozenset[str] = field(default_factory=frozenset)
    """Objects in the way of the best path at full speed."""


def plan_one(
    workspace: Workspace,
    motion: TimedMotion,
    others: Sequence[TimedPath],
    deadline: Deadline,
) -> Attempt:
    """Return a safe run of ``motion`` among ``others``: the first one found that is on time, or
    else the earliest.
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
    best = fit(workspace, motion, first, others)
    if is_good(best, motion):
        return Attempt(best)
    met = met_at_full_speed(workspace, motion, first, others)
    best = with_lanes(workspace, motion, first, best, others)
    if not is_good(best, motion):
        best = with_detours(workspace, motion, first, best, others, static, deadline)
    names = frozenset(o.object for o, _, _ in met)
    why = PathReport(nothing(deadline), blockers=names, reason="no safe timing or detour found")
    return Attempt(best, why, names)


def _lasts(placed: Placed, others: Iterable[TimedPath]) -> bool:
    return any(
        o.object == placed.name and o.path.cells == 0 and o.until == math.inf for o in others
    )


def earliest_arrival(
    service: PathPlanner,
    motion: TimedMotion,
    leader: TimedMotion,
    drive: Trajectory,
    deadline: Deadline = Deadline.never(),
) -> float | None:
    """Return the earliest found arrival (s) of one motion among nothing but a ``leader``, who is
    there as long as its decided ``drive``; None where none was found, or a search was cut short:
    what that found need not be the earliest.
    """
    workspace = workspace_of(service)
    truncated = workspace.truncated
    path = path_of(drive, leader.body, decided=True)
    timing = Timing(drive, path.natural_s)
    ahead = TimedPath(leader.name, leader.object, path, timing, drive.start, drive.end, None)
    run = plan_one(workspace, motion, [ahead], deadline).run
    cut = deadline.expired() or workspace.truncated != truncated
    return None if run is None or cut else run.arrival


def nothing(deadline: Deadline) -> Outcome:
    """Return what it means that nothing was found: the search is at its end, or the time is."""
    return Outcome.OUT_OF_TIME if deadline.expired() else Outcome.NOT_FOUND
