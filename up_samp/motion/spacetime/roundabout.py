"""The last rung for one robot: a safe-interval search for another way through space and time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from up_samp.geometry.scene import Scene
from up_samp.model import Deadline, MotionModel, Placed, TimedMotion
from up_samp.motion.arcs import merged, nodes_of
from up_samp.motion.fields import Fields
from up_samp.motion.smoothing import improve, settle
from up_samp.motion.spacetime import search
from up_samp.motion.spacetime.paths import Path, hull_of, path_of
from up_samp.motion.spacetime.runs import MARGIN, Run, pair_flags
from up_samp.motion.timing import relaxed, trajectory_of

FloatArray = npt.NDArray[np.float64]

STEPS = (0.7, 0.35)
"""Lengths of an arc, in turning radii, coarse to fine."""
LABELS = (60_000, 200_000)
"""Labels per resolution."""
SLICE = 300
"""Expansions between two looks at the deadline."""
EXTRA = 600
"""Expansions after the first solution."""
EXPANSIONS = (6_000, 12_000)
"""Expansions per resolution."""
SHARES = (1.0, 0.25, 0.06, 0.015, 0.004, 0.001)
"""Shares of the clearance margin tried where an end of the motion is closer to something."""


class Roundabout:
    """Searches for one car at a time among movers in one scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.fields = Fields(scene)
        self._labels: dict[int, search.Labels] = {}

    def paths(
        self,
        motion: TimedMotion,
        release: float,
        static: Sequence[Placed],
        others: Sequence[Run],
        goal_free: float,
        deadline: Deadline,
    ) -> list[Path]:
        """Return paths on which the motion can, with the right timing, pass the ``others``: the one
        found and a shortened one; none if the search finds none.

        Only for cars with two poses; ``goal_free`` is when the goal stays free for good (s).
        """
        body = motion.body
        if body.kinematics.model is not MotionModel.REEDSSHEPP or len(motion.poses) != 2:
            return []
        for level in range(len(STEPS)):
            rows = self._search(motion, release, tuple(static), others, goal_free, level, deadline)
            if rows is not None:
                return self._finished(motion, tuple(static), rows)
            if deadline.expired():
                break
        return []

    def _search(
        self,
        motion: TimedMotion,
        release: float,
        static: tuple[Placed, ...],
        others: Sequence[Run],
        goal_free: float,
        level: int,
        deadline: Deadline,
    ) -> FloatArray | None:
        """Return arcs (curvature, signed length, 1 if it stops before) found at one resolution."""
        body = motion.body
        shape = self.scene.shape(body).data
        grid, polys = self.scene.data, self.scene.polys(static)
        radius, v, a = relaxed(body.kinematics)
        hull = hull_of(body)
        me = search.Me(
            hull.verts,
            hull.counts,
            np.array([hull.radius, MARGIN, radius, v, a, release, goal_free]),
        )
        movers = movers_of(motion, others, release)
        start, goal = (np.array(p[:3], dtype=np.float64) for p in motion.poses)
        field = self.fields.toward(self.scene.shape(body), motion.poses[1], static)
        step = STEPS[level] * radius
        arcs = [[kappa, s] for kappa in (0.0, 1 / radius, -1 / radius) for s in (step, -step)]
        steps = np.array([*arcs, [0.0, 4 * step], [0.0, -4 * step]])
        grain = np.array([step / 1.5, math.ceil(2 * math.pi / (step / radius / 1.5))])
        labels = self._room(LABELS[level])
        labels.table[:] = -1
        labels.counters[:] = 0
        search.plant(labels, field, me, movers, start, goal, grain)
        state = 0
        while state == 0 and not deadline.expired() and labels.counters[2] < EXPANSIONS[level]:
            state = search.expand(
                labels, grid, polys, shape, field, me, movers, steps, goal, grain, SLICE, EXTRA
            )
        return search.chain(labels) if labels.counters[3] >= 0 else None

    def _room(self, size: int) -> search.Labels:
        if size not in self._labels:
            self._labels[size] = search.new_labels(size)
        return self._labels[size]

    def _finished(
        self, motion: TimedMotion, static: tuple[Placed, ...], rows: FloatArray
    ) -> list[Path]:
        """Turn arcs into paths: as found, and shortened between the stops."""
        body, start = motion.body, motion.poses[0]
        limits = relaxed(body.kinematics)
        raw = merged(np.ascontiguousarray(rows[:, :2]))
        target = np.array(motion.poses[1][:3], dtype=np.float64)
        origin = np.array(start[:3], dtype=np.float64)
        found = []
        shape = self.scene.shape(body).data
        marks = [0, *(int(i) for i in np.flatnonzero(rows[:, 2]) if i > 0), len(rows)]
        pieces, here = [], origin
        for low, high in itertools.pairwise(marks):
            part = merged(np.ascontiguousarray(rows[low:high, :2]))
            scratch = np.array([*limits, 0.0, 0.0])
            shorter = improve(
                self.scene.data, self.scene.polys(static), shape, here, part, scratch, 400, 100, 0
            )
            pieces.append(shorter)
            here = _end(here, part)
        for arcs in (merged(np.concatenate(pieces)), raw):
            if settle(origin, target, arcs) < 1e-7:
                trajectory = trajectory_of(motion.poses, [arcs], body.kinematics)
                found.append(path_of(trajectory, body, motion.poses))
        return found


def _end(pose: FloatArray, arcs: FloatArray) -> FloatArray:
    return np.ascontiguousarray(nodes_of(pose, arcs)[-1])


def movers_of(motion: TimedMotion, others: Sequence[Run], release: float) -> search.Movers:
    """Return what the search needs of the other bodies that are there after ``release`` (s)."""
    seen = []
    for other in others:
        flags = pair_flags(motion.object, motion.avoid, other.object, other.avoid)
        if flags and other.object != motion.object and other.until > release:
            seen.append((other, flags))
    hulls = {id(o.path.hull): o.path.hull for o, _ in seen}
    index = {key: i for i, key in enumerate(hulls)}
    parts = max((len(h.counts) for h in hulls.values()), default=1)
    corners = max((h.verts.shape[1] for h in hulls.values()), default=3)
    verts = np.zeros((max(1, len(hulls)), parts, corners, 2))
    counts = np.zeros((max(1, len(hulls)), parts), dtype=np.int64)
    radii = np.zeros(max(1, len(hulls)))
    for i, hull in enumerate(hulls.values()):
        n, m = hull.verts.shape[:2]
        verts[i, :n, :m] = hull.verts
        counts[i, :n] = hull.counts
        radii[i] = hull.radius
    rows = [o.path.table[:, 1].copy() for o, _ in seen]
    first = np.cumsum([0, *(len(r) for r in rows)])
    steps = [max(1e-3, float(2 * r[:, 7].max())) for r in rows]
    for row in rows:
        row[:, 4:] = 0.0
    return search.Movers(
        np.concatenate(rows) if rows else np.zeros((0, 9)),
        first.astype(np.int64),
        np.concatenate([o.held for o, _ in seen]) if seen else np.zeros(0),
        np.array([index[id(o.path.hull)] for o, _ in seen], dtype=np.int64),
        verts,
        counts,
        radii,
        np.array(steps, dtype=np.float64),
        np.array([flags for _, flags in seen], dtype=np.int64),
    )
