"""The last rung for one robot: a safe-interval search for another way through space and time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from up_samp.geometry.scene import Scene
from up_samp.model import Configuration, Deadline, MotionModel, Placed, TimedMotion
from up_samp.motion.curves.arcs import merged, nodes_of
from up_samp.motion.curves.reeds_shepp import Pose, fastest
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.fleet import sipp_kernel as search
from up_samp.motion.fleet import strrt
from up_samp.motion.fleet.conflicts import kept
from up_samp.motion.fleet.moving_obstacles import Me, MoverFineness, Movers
from up_samp.motion.fleet.paths import Path, hull_of, path_of
from up_samp.motion.fleet.timed_path import TimedPath, pair_flags
from up_samp.motion.guides.cost_to_go import Fields
from up_samp.motion.planners.car_shortcuts import Effort, improve, settle
from up_samp.motion.tuning import PlaneTuning

FloatArray = npt.NDArray[np.float64]

Corner = tuple[float, float]

STEPS = (0.7, 0.35)
"""Lengths of an arc, in turning radii, coarse to fine."""


class SafeIntervalPlanner:
    """Searches for one car at a time among movers in one scene."""

    def __init__(self, scene: Scene, tuning: PlaneTuning) -> None:
        self.tuning = tuning
        self.scene = scene
        self.fields = Fields(scene)
        self._labels: dict[int, search.Labels] = {}
        self._fine = MoverFineness(
            tuning.pieces, float(tuning.piece), tuning.visits, float(tuning.guard)
        )

    def paths(
        self,
        motion: TimedMotion,
        release: float,
        static: Sequence[Placed],
        others: Sequence[TimedPath],
        goal_free: float,
        deadline: Deadline,
    ) -> tuple[list[Path], bool]:
        """Return paths on which the motion can, with the right timing, pass the ``others``: the one
        found and a shortened one, or none; and whether the search tried everything it could.

        Only for cars with two poses; ``goal_free`` is when the goal stays free for good (s).
        """
        body = motion.body
        if body.kinematics.model is not MotionModel.REEDSSHEPP or len(motion.poses) != 2:
            return [], False
        dry = False
        for level in range(len(STEPS)):
            rows, dry = self._search(
                motion, release, tuple(static), others, goal_free, level, deadline
            )
            if rows is not None:
                return self._finished(motion, tuple(static), rows), False
            if deadline.expired():
                break
        return [], dry

    def sampled(
        self,
        motion: TimedMotion,
        release: float,
        static: Sequence[Placed],
        others: Sequence[TimedPath],
        goal_free: float,
        deadline: Deadline,
        seed: int = 0,
    ) -> list[Path]:
        """Like :meth:`paths`, by ST-RRT*: the range of arrivals doubles until one is found."""
        body = motion.body
        if body.kinematics.model is not MotionModel.REEDSSHEPP or len(motion.poses) != 2:
            return []
        world = self.scene.world(self.scene.shape(body), static)
        me = self._me(motion, others, release, goal_free)
        movers = movers_of(motion, others, release)
        start, goal = (_pose(p) for p in motion.poses)
        fastest_time, _ = fastest(motion.poses[0], motion.poses[1], *limits_of(body.kinematics))
        earliest = max(goal_free, release + fastest_time)
        forest = strrt.new_forest(self.tuning.vertices)
        forest.state[0, 0] = (*start, release)
        forest.size[0] = 1
        low, high = self._box(motion)
        for batch in range(self.tuning.batches):
            latest = earliest + max(10.0, fastest_time) * 2.0**batch
            growth = strrt.Growth(
                world,
                me,
                movers,
                goal,
                low,
                high,
                float(earliest),
                float(latest),
                self.tuning.nearest,
                float(self.tuning.reach),
            )
            strrt.grow(forest, growth, self.tuning.batch, 1000 * seed + batch)
            if deadline.expired() or (
                forest.best[0] < np.inf and batch >= self.tuning.batches // 2
            ):
                break
        if forest.best[0] == np.inf:
            return []
        nodes = strrt.way(forest)
        arcs = [
            fastest(tuple(a[:3]), tuple(b[:3]), *limits_of(body.kinematics))[1]
            for a, b in itertools.pairwise(nodes)
        ]
        rows = [np.column_stack([part, np.eye(1, len(part))[0]]) for part in arcs if len(part)]
        if not rows:  # it is there already
            arcs = [np.zeros((0, 2))]
            return [path_of(trajectory_of(motion.poses, arcs, body.kinematics), body, motion.poses)]
        return self._finished(motion, tuple(static), np.concatenate(rows))

    def _box(self, motion: TimedMotion) -> tuple[Corner, Corner]:
        """Return the area that samples are drawn from: its lower left and upper right corner."""
        grid = self.scene.grid
        if grid is None:
            points = np.array([pose[:2] for pose in motion.poses])
            reach = 8 * motion.body.kinematics.turning_radius + 4 * hull_of(motion.body).radius
            return _corner(points.min(axis=0) - reach), _corner(points.max(axis=0) + reach)
        rows, cols = grid.shape
        corners = [(r, c) for r in (-0.5, rows - 0.5) for c in (-0.5, cols - 0.5)]
        points = np.array([grid.point_of(r, c) for r, c in corners])
        return _corner(points.min(axis=0)), _corner(points.max(axis=0))

    def _me(
        self, motion: TimedMotion, others: Sequence[TimedPath], release: float, goal_free: float
    ) -> Me:
        hull = hull_of(motion.body)
        margin, ends = self.scene.margin, [np.array(p[:3]) for p in motion.poses]
        for other in others:
            if other.object != motion.object:
                margin = kept(margin, ends, hull, other.path.poses[[0, -1]], other.path.hull)
        return Me(
            hull,
            margin,
            limits_of(motion.body.kinematics),
            float(release),
            float(goal_free),
            self._fine,
        )

    def _search(
        self,
        motion: TimedMotion,
        release: float,
        static: tuple[Placed, ...],
        others: Sequence[TimedPath],
        goal_free: float,
        level: int,
        deadline: Deadline,
    ) -> tuple[FloatArray | None, bool]:
        """Return arcs (curvature, signed length, 1 if it stops before) found at one resolution, and
        whether there was nothing left to try.
        """
        body = motion.body
        world = self.scene.world(self.scene.shape(body), static)
        radius = limits_of(body.kinematics).radius
        me = self._me(motion, others, release, goal_free)
        movers = movers_of(motion, others, release)
        start, goal = (_pose(p) for p in motion.poses)
        field = self.fields.toward(self.scene.shape(body), motion.poses[1], static)
        step = STEPS[level] * radius
        arcs = [[kappa, s] for kappa in (0.0, 1 / radius, -1 / radius) for s in (step, -step)]
        steps = np.array([*arcs, [0.0, 4 * step], [0.0, -4 * step]])
        grain = search.Grain(step / 1.5, math.ceil(2 * math.pi / (step / radius / 1.5)))
        quest = search.Quest(world, field, me, movers, goal, steps, grain)
        labels = self._room(self.tuning.labels[level])
        search.plant(labels, me, movers, start)
        state = 0
        tuning = self.tuning
        most = tuning.expansions[level]
        while state == 0 and not deadline.expired() and labels.counters[2] < most:
            state = search.expand(labels, quest, tuning.slice, tuning.extra)
        full = labels.counters[0] >= len(labels.heap)
        return (
            search.chain(labels) if labels.counters[3] >= 0 else None,
            state == 2 and not full,
        )

    def _room(self, size: int) -> search.Labels:
        if size not in self._labels:
            self._labels[size] = search.new_labels(size)
        return self._labels[size]

    def _finished(
        self, motion: TimedMotion, static: tuple[Placed, ...], rows: FloatArray
    ) -> list[Path]:
        """Turn arcs into paths: as found, and shortened between the stops."""
        body, start = motion.body, motion.poses[0]
        limits = limits_of(body.kinematics)
        raw = merged(np.ascontiguousarray(rows[:, :2]))
        target = np.array(motion.poses[1][:3], dtype=np.float64)
        origin = np.array(start[:3], dtype=np.float64)
        found = []
        world, effort = self.scene.world(self.scene.shape(body), static), Effort(400, 100, 0)
        marks = [0, *(int(i) for i in np.flatnonzero(rows[:, 2]) if i > 0), len(rows)]
        pieces, here = [], origin
        for low, high in itertools.pairwise(marks):
            part = merged(np.ascontiguousarray(rows[low:high, :2]))
            pieces.append(improve(world, here, part, limits, effort))
            here = _end(here, part)
        for arcs in (merged(np.concatenate(pieces)), raw):
            if settle(origin, target, arcs) < 1e-7:
                trajectory = trajectory_of(motion.poses, [arcs], body.kinematics)
                found.append(path_of(trajectory, body, motion.poses))
        return found


def _corner(xy: FloatArray) -> Corner:
    return float(xy[0]), float(xy[1])


def _pose(pose: Configuration) -> Pose:
    return float(pose[0]), float(pose[1]), float(pose[2])


def _end(pose: FloatArray, arcs: FloatArray) -> FloatArray:
    return np.ascontiguousarray(nodes_of(pose, arcs)[-1])


def movers_of(motion: TimedMotion, others: Sequence[TimedPath], release: float) -> Movers:
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
    rows = [o.path.swept.table[:, 1].copy() for o, _ in seen]
    first = np.cumsum([0, *(len(r) for r in rows)])
    steps = [max(1e-3, float(2 * r[:, 7].max())) for r in rows]
    for row in rows:
        row[:, 4:] = 0.0
    return Movers(
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
