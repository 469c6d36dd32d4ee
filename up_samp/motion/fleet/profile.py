"""What two motions need of each other's timing, learned in one go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from up_samp.model import Deadline, PathReport, Rest, TimedMotion
from up_samp.motion.fleet.cell_times import offset_intervals
from up_samp.motion.fleet.paths import FloatArray, Path
from up_samp.motion.fleet.timed_path import pair_flags
from up_samp.motion.fleet.waiting import parked_all_the_time
from up_samp.motion.fleet.workspace import PathPlanner, Workspace, rest_run, workspace_of

Interval = tuple[float, float]


@dataclass(frozen=True)
class OffsetProfile:
    """The start offsets ``b.start - a.start`` (s) at which two motions collide on their own best
    paths at full speed: open intervals, ascending, disjoint.

    ``moving`` counts only collisions while both move. ``resting`` counts also those of one
    that moves with the other one waiting at its first pose (for ever) or resting at its last
    one (for ever). ``durations`` are those of a and b at full speed (s).
    """

    moving: tuple[Interval, ...]
    resting: tuple[Interval, ...]
    durations: tuple[float, float]


def offset_profile(
    service: PathPlanner,
    a: TimedMotion,
    b: TimedMotion,
    rests: Sequence[Rest] = (),
    *,
    deadline: Deadline | None = None,
) -> OffsetProfile | PathReport:
    """Return the interaction profile of two motions, or the report of the one without a path.

    The paths are the best ones among those ``rests`` that stay all through the motion's window.
    Safe between samples like all conflict checks here (after the forbidden offsets of
    continuous-time conflict-based search, Andreychuk et al. 2022).
    """
    workspace = workspace_of(service)
    limit = deadline or Deadline.never()
    world = [rest_run(workspace, rest) for rest in rests]
    paths: list[Path] = []
    for motion in (a, b):
        static = parked_all_the_time(motion, world)
        path = workspace.path(motion.body, motion.poses, static, limit)
        if not isinstance(path, Path):
            return path
        paths.append(workspace.timed(path))
    return profile_of(workspace, a, b, paths[0], paths[1])


def profile_of(
    workspace: Workspace, a: TimedMotion, b: TimedMotion, path_a: Path, path_b: Path
) -> OffsetProfile:
    """Return the interaction profile of two motions on paths with timed cells."""
    durations = (path_a.natural.duration, path_b.natural.duration)
    flags = pair_flags(a.object, a.avoid, b.object, b.avoid)
    if a.object == b.object or not flags:
        return OffsetProfile((), (), durations)
    runs = workspace.conflicts(path_a, path_b)
    held = [path.natural_held for path in (path_a, path_b)]
    moving = offset_intervals(runs, held[0], held[1], 0)
    resting = offset_intervals(runs, held[0], held[1], flags)
    return OffsetProfile(_pairs(moving), _pairs(resting), durations)


def _pairs(rows: FloatArray) -> tuple[Interval, ...]:
    """Return the union of open intervals as disjoint ones, ascending."""
    out: list[Interval] = []
    for low, high in sorted((float(low), float(high)) for low, high in rows):
        if out and low <= out[-1][1]:
            out[-1] = (out[-1][0], max(out[-1][1], high))
        else:
            out.append((low, high))
    return tuple(out)
