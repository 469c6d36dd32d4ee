"""Flyers as bodies that drive below them meet them: moving shadows on the floor.

While all of a flyer is above the drivers it is no obstacle to them. While some of it is not, it
counts as the hull of all of it, in every orientation that it has in that while: more than it is,
which proves nothing and is never told as a proof.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.geometry.meshes import load_mesh, rotation
from up_samp.geometry.shadows import on_the_floor
from up_samp.model import (
    Body,
    FixedMotion,
    GroupQuery,
    Kinematics,
    MotionModel,
    Placed,
    Rest,
    Trajectory,
)

FloatArray = npt.NDArray[np.float64]

SLACK = 0.02
"""How much (m) a flyer may be lower, or reach further, between two samples than at both."""


def among_shadows(query: GroupQuery) -> GroupQuery:
    """Return a query of drivers in which flyers that rest, or are decided, are shadows."""
    bodies = [*(r.body for r in query.rests), *(m.body for m in query.fixed)]
    if not any(body.flies for body in bodies):
        return query
    height = max(motion.body.height for motion in query.motions)
    rests, fixed = flat(query.rests, query.fixed, height)
    return GroupQuery(query.motions, rests, fixed)


def flat(
    rests: Sequence[Rest], fixed: Sequence[FixedMotion], height: float
) -> tuple[tuple[Rest, ...], tuple[FixedMotion, ...]]:
    """Return what rests and what is decided as drivers of a ``height`` (m) meet it."""
    still = [r for rest in rests for r in _resting(rest, height)]
    moving: list[FixedMotion] = []
    for motion in fixed:
        if not motion.body.flies:
            moving.append(motion)
            continue
        first, last = (tuple(map(float, motion.trajectory.poses[i])) for i in (0, -1))
        begin, end = motion.trajectory.start, motion.trajectory.end
        before = Rest(motion.object, motion.body, first, motion.present_from, begin)
        after = Rest(motion.object, motion.body, last, end, motion.present_until)
        still += [r for rest in (before, after) for r in _resting(rest, height)]
        moving += _low(motion, height)
    return tuple(still), tuple(moving)


def _resting(rest: Rest, height: float) -> Iterator[Rest]:
    if rest.since >= rest.until:
        return
    for part in on_the_floor([Placed(rest.name, rest.body, rest.pose)], height):
        yield Rest(rest.name, part.body, part.pose, rest.since, rest.until)


def _low(motion: FixedMotion, height: float) -> Iterator[FixedMotion]:
    """Yield the stretches in which a flight is not above ``height``, as motions of discs."""
    assert motion.body.mesh is not None
    vertices = load_mesh(motion.body.mesh).vertices
    times, poses = motion.trajectory.times, motion.trajectory.poses
    turned = [vertices @ rotation(pose[3:]).T for pose in poses]
    lowest = np.array([t[:, 2].min() for t in turned]) + poses[:, 2] - SLACK
    low = np.minimum(lowest[:-1], lowest[1:]) < height  # by piece between two samples
    edges = np.flatnonzero(np.diff(np.concatenate(([False], low, [False])).astype(np.int8)))
    for i, j in edges.reshape(-1, 2):
        kept = slice(int(i), int(j) + 1)
        body = _hull([t[:, :2] for t in turned[kept]], motion.body.kinematics)
        flat_poses = np.column_stack((poses[kept, :2], np.zeros(j + 1 - i)))
        path = Trajectory(times[kept].copy(), flat_poses)
        yield FixedMotion(
            motion.name, motion.object, body, path, float(times[i]), float(times[int(j)])
        )


def _hull(points: Sequence[FloatArray], limits: Kinematics) -> Body:
    """Return a planar body that holds all ``points`` about its own middle, and a little more."""
    around = shapely.convex_hull(shapely.MultiPoint(np.concatenate(points)))
    ring = shapely.get_coordinates(around.buffer(SLACK, quad_segs=2).exterior)[:-1]
    kinematics = Kinematics(
        MotionModel.SE2, v_max=limits.v_max, a_max=limits.a_max, omega_max=limits.omega_max
    )
    return Body(tuple(map(tuple, ring.tolist())), kinematics)
