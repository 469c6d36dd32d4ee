"""Robots moved together, where no order of them works: in lanes of their own, or by joint moves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from up_samp.model import (
    Deadline,
    Rest,
    TimedMotion,
    Trajectory,
)
from up_samp.motion.curves.slowing import may_stand
from up_samp.motion.curves.trajectories import unwound
from up_samp.motion.fleet.deadlocks import Drive, untie
from up_samp.motion.fleet.one_robot import pass_by
from up_samp.motion.fleet.paths import Path, path_of
from up_samp.motion.fleet.speed import fit
from up_samp.motion.fleet.timed_path import TimedPath, Timing, run_of
from up_samp.motion.fleet.workspace import Workspace, rest_run
from up_samp.motion.legs import before_docking


def couple(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    alone: Mapping[str, TimedPath],
    world: Sequence[TimedPath],
    deadline: Deadline,
) -> dict[str, TimedPath] | None:
    """Return runs of ``motions`` moved together that keep clear of each other and of the ``world``,
    or None if none are found or they are not of the kind that this can couple.

    ``alone`` are the runs of the motions without each other. The robots must drive in the plane,
    from one pose to another each, have different names, and be there before the first release.
    """
    if workspace.scene is None or not _can_couple(motions):
        return None
    beside = pass_by(workspace, motions, alone, world)
    if beside is not None:
        return beside
    tails = _docking(workspace, motions)
    if tails is None:
        return None
    heads = [replace(m, poses=before_docking(m.body, m.poses)) for m in motions]
    sequence = untie(workspace, heads, world, deadline)
    if sequence is None:
        return None
    legs = _timed(workspace, motions, world, [*sequence, *tails])
    if legs is None or _collide(workspace, world, legs) or not _may_rest(legs):
        return None
    # who has no drive stays where it is
    return {
        m.name: _one_run(m, drives) if drives else alone[m.name]
        for m, drives in zip(motions, legs, strict=True)
    }


def _docking(workspace: Workspace, motions: Sequence[TimedMotion]) -> list[Drive] | None:
    """Return the straight drives to docks with which motions end, one after the other."""
    found: list[Drive] = []
    for robot, motion in enumerate(motions):
        if len(motion.poses) > 2:
            path = workspace.path(motion.body, motion.poses[-2:], (), Deadline.never())
            if not isinstance(path, Path):
                return None
            found.append((robot, path))
    return found


def _may_rest(legs: Sequence[Sequence[TimedPath]]) -> bool:
    """Return whether robots may stand where they rest between their drives."""
    later = (run.path for runs in legs for run in runs[1:])
    return all(may_stand(path.body, path.ends[0]) for path in later)


def _can_couple(motions: Sequence[TimedMotion]) -> bool:
    first = min(m.release for m in motions)
    return (
        len(motions) > 1
        and len({m.object for m in motions}) == len(motions)
        and all(len(before_docking(m.body, m.poses)) == 2 and not m.body.flies for m in motions)
        and all(m.present_from <= first for m in motions)
    )


def _collide(
    workspace: Workspace, world: Sequence[TimedPath], legs: Sequence[Sequence[TimedPath]]
) -> bool:
    """Return whether any two robots' drives, or a drive and the world, meet."""
    pairs = [pair for a, b in itertools.combinations(legs, 2) for pair in itertools.product(a, b)]
    pairs += itertools.product(itertools.chain(*legs), world)
    return any(workspace.meeting(a, b)[0] < math.inf for a, b in pairs)


def _timed(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    world: Sequence[TimedPath],
    sequence: Sequence[Drive],
) -> list[list[TimedPath]] | None:
    """Return the drives of each robot, every one as early as those before it in the sequence
    allow.
    """
    legs: list[list[TimedPath]] = [
        [replace(rest_run(workspace, Rest(m.object, m.body, m.poses[0])), avoid=m.avoid)]
        for m in motions
    ]
    for robot, path in sequence:
        others = [run for i, runs in enumerate(legs) if i != robot for run in runs]
        leg = _leg(motions[robot], legs[robot], path)
        run = fit(workspace, leg, path, [*world, *others])
        if run is None:
            return None
        last = legs[robot][-1]
        # from then on the robot is where this drive leaves it
        legs[robot][-1] = replace(last, until=min(last.until, run.since))
        legs[robot].append(run)
    return [runs[1:] for runs in legs]


def _leg(motion: TimedMotion, legs: Sequence[TimedPath], path: Path) -> TimedMotion:
    """Return a robot's next drive, along a path, after those in ``legs``."""
    last, moved = legs[-1], len(legs) > 1
    final = path.poses[-1][:2].tolist() == list(motion.poses[-1][:2])
    return replace(
        motion,
        poses=path.ends,
        release=max(motion.release, last.arrival) if moved else motion.release,
        present_from=last.arrival if moved else motion.present_from,
        present_until=motion.present_until if final else math.inf,
    )


def _one_run(motion: TimedMotion, legs: Sequence[TimedPath]) -> TimedPath:
    """Return the drives of one robot as one run, with rests in between."""
    times, poses = [legs[0].timing.trajectory.times], [legs[0].timing.trajectory.poses]
    for leg in legs[1:]:
        t, rows = leg.timing.trajectory.times, leg.timing.trajectory.poses
        rows = unwound(rows, poses[-1][-1])
        # without a wait the last pose is already there
        skip = 1 if t[0] <= times[-1][-1] + 1e-9 else 0
        times.append(t[skip:])
        poses.append(rows[skip:])
    whole = Trajectory(np.concatenate(times), np.concatenate(poses))
    stops = [leg.path.ends[1] for leg in legs]
    path = path_of(whole, motion.body, (motion.poses[0], *stops), decided=True)
    return run_of(motion, path, Timing(whole, path.natural_s))
