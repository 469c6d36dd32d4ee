"""Safe-interval search for another way through space and time: hybrid A*, the last rung for a car.

Safe-interval path planning (Phillips & Likhachev 2011) on the arcs of a hybrid A* (Dolgov et al.
2010): a label is a pose with an arrival time, the length of the run it is in (which gives the
speed), and the time until which it is safe to stay. From each label an arc is driven at once, or
after a stop, as soon as each later safe interval of its end can be reached. Movers are seen at
sampled poses with a margin; the path that comes out is timed and proven swept-safe elsewhere
(:mod:`up_samp.motion.fleet.speed`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import WorldData, inner, kernel
from up_samp.geometry.scene import Scene
from up_samp.geometry.sweeps import arc_free
from up_samp.model import Configuration, Deadline, Placed, TimedMotion
from up_samp.motion.curves.arcs import merged, nodes_of
from up_samp.motion.curves.reeds_shepp import Pose, connect, fastest
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.fleet import strrt
from up_samp.motion.fleet.conflicts import kept
from up_samp.motion.fleet.moving_obstacles import (
    ArcDrive,
    Begin,
    Me,
    MoverFineness,
    Movers,
    clash,
    delayed,
    new_drive,
    ramp,
    safe_until,
    sample,
    stop,
    visits,
)
from up_samp.motion.fleet.paths import Path, hull_of, path_of
from up_samp.motion.fleet.timed_path import TimedPath, pair_flags
from up_samp.motion.guides.cost_to_go import Field, Fields, field_value
from up_samp.motion.guides.heap import pop, push
from up_samp.motion.planners.car_shortcuts import Effort, improve, settle
from up_samp.motion.tuning import PlaneTuning

FloatArray = npt.NDArray[np.float64]

# ------------------ The compiled search

IntArray = npt.NDArray[np.int64]


class Labels(NamedTuple):
    """The search's labels, kept between calls.

    ``state`` (cap, 7): x, y, theta, time, signed run, safe until, estimate. ``arc`` (cap, 4):
    curvature, signed length from the parent, 1 if it stopped there first, 1 if its estimate knows
    the curve to the goal. ``link`` (cap, 3): parent, key, next label with the same hash. ``heap``
    (cap,), ``table`` (hash size,) first label. ``counters``: labels, heap size, expansions, best
    label, arcs of its tail, whether the tail begins with a stop, expansions at the first solution.
    ``best`` (1,) arrival; ``tail`` (5, 2).
    """

    state: FloatArray
    arc: FloatArray
    link: IntArray
    heap: IntArray
    table: IntArray
    counters: IntArray
    best: FloatArray
    tail: FloatArray


class Label(NamedTuple):
    """One label: a pose, the time (s), the signed length of the run it is in (m), until when it is
    safe to stay, and when the goal is reached at best.
    """

    pose: Pose
    time: float
    run: float
    until: float
    estimate: float


class Grain(NamedTuple):
    """Poses in one ``cell`` (m) and one of ``bins`` of the headings count as one."""

    cell: float
    bins: int


class Quest(NamedTuple):
    """What one search is about: a body that drives among movers to ``goal`` by arcs ``steps``
    (n, 2: curvature, signed length).
    """

    world: WorldData
    field: Field
    me: Me
    movers: Movers
    goal: Pose
    steps: FloatArray
    grain: Grain


def new_labels(cap: int) -> Labels:
    """Return room for ``cap`` labels."""
    size = 1 << math.ceil(math.log2(2 * cap))
    return Labels(
        np.zeros((cap, 7)),
        np.zeros((cap, 4)),
        np.zeros((cap, 3), dtype=np.int64),
        np.zeros(cap, dtype=np.int64),
        np.full(size, -1, dtype=np.int64),
        np.zeros(7, dtype=np.int64),
        np.zeros(1),
        np.zeros((5, 2)),
    )


@inner
def _label(labels: Labels, i: int) -> Label:
    row = labels.state[i]
    return Label((row[0], row[1], row[2]), row[3], row[4], row[5], row[6])


@inner
def _key(pose: Pose, run: float, grain: Grain) -> int:
    col, row = math.floor(pose[0] / grain.cell), math.floor(pose[1] / grain.cell)
    k = int((pose[2] % (2 * math.pi)) / (2 * math.pi) * grain.bins + 0.5) % grain.bins
    return ((int(row) * 1_000_003 + int(col)) * grain.bins + k) * 2 + (1 if run < 0 else 0)


@inner
def _offer(
    labels: Labels, quest: Quest, new: Label, parent: int, arcs: FloatArray, stopped: bool
) -> None:
    """Add a label unless another one at its key came earlier and may stay as long (``new`` comes
    without its estimate).
    """
    n = labels.counters[0]
    if n >= len(labels.heap):
        return
    me, field, goal = quest.me, quest.field, quest.goal
    key = _key(new.pose, new.run, quest.grain)
    slot = (key * 0x9E3779B1) & (len(labels.table) - 1)
    link = labels.link
    at = labels.table[slot]
    while at >= 0:
        if link[at, 1] == key:
            other = _label(labels, at)
            if other.time <= new.time + 1e-6 and other.until >= new.until - 1e-6:
                return
        at = link[at, 2]
    far = math.hypot(goal[0] - new.pose[0], goal[1] - new.pose[1])
    if field.values.shape[0] > 0:
        far = max(far, field_value(field, new.pose[0], new.pose[1]))
        if far == math.inf:
            return
    v, a, moving = me.car.v, me.car.a, abs(new.run)
    left = ramp(moving + far, v, a) - ramp(moving, v, a) + stop(moving + far, v, a)
    estimate = max(new.time + left, me.goal_free)
    if estimate >= labels.best[0]:
        return
    state = labels.state
    state[n, 0], state[n, 1], state[n, 2] = new.pose[0], new.pose[1], new.pose[2]
    state[n, 3], state[n, 4], state[n, 5] = new.time, new.run, new.until
    state[n, 6] = estimate
    labels.arc[n, 0], labels.arc[n, 1] = arcs[0, 0], arcs[0, 1]
    labels.arc[n, 2], labels.arc[n, 3] = 1.0 if stopped else 0.0, 0.0
    link[n, 0], link[n, 1], link[n, 2] = parent, key, labels.table[slot]
    labels.table[slot] = n
    labels.counters[0] += 1
    push(labels.heap, state, labels.counters, n)


def plant(labels: Labels, me: Me, movers: Movers, start: Pose) -> None:
    """Put the start into the labels, which are emptied."""
    labels.table[:] = -1
    labels.counters[:] = 0
    labels.counters[3] = -1
    labels.best[0] = math.inf
    busy = np.empty((me.fine.visits, 2))
    many, guard = visits(me, movers, start, True, busy), me.fine.guard
    soon = busy[:many][busy[:many, 1] - guard > me.release]
    until = float(np.min(soon[:, 0] + guard, initial=math.inf))
    if until >= me.release:
        # its order and key do not matter: it is taken first, and nothing is compared with it
        labels.state[0] = (*start, me.release, 0.0, until, me.release)
        labels.arc[0] = 0.0
        labels.link[0] = (-1, -1, -1)
        labels.heap[0] = 0
        labels.counters[:2] = 1


class Way(NamedTuple):
    """A sampled way from a label: its ``arcs``, the sampled ``drive`` of so ``many`` poses,
    the signed length of its last ``run`` (m), and its ``end``.
    """

    arcs: FloatArray
    drive: ArcDrive
    many: int
    run: float
    end: Pose


@inner
def _offers(labels: Labels, label: int, quest: Quest, way: Way) -> None:
    """Offer what can be reached along one sampled arc: at once, and later after a stop."""
    drive, last = way.drive, way.many - 1
    here = _label(labels, label)
    takes = drive.at[last]
    begin = here.time + stop(here.run, quest.me.car.v, quest.me.car.a)
    after = -math.inf
    for attempt in range(4):
        stopped = attempt > 0
        if not stopped:
            turns = here.run * way.arcs[0, 1] <= 0
            if turns or clash(drive, way.many, drive.on, here.time) > 0.0:
                continue
            t = here.time + drive.on[last]
        else:
            # the next safe interval at the end of the arc begins when a visit ends
            if after > -math.inf:
                begin = max(begin, after - takes + 1e-6)
            begin = delayed(drive, way.many, begin, here.until)
            if begin == math.inf:
                return
            t = begin + takes
        after = safe_until(drive, last, t)
        length = way.run if stopped else here.run + way.run
        new = Label(way.end, t, length, after, 0.0)
        _offer(labels, quest, new, label, way.arcs, stopped)
        if after == math.inf:
            return


@inner
def _finish(labels: Labels, label: int, me: Me, way: Way, n: int) -> None:
    """Keep a sampled way of ``n`` arcs to the goal if it arrives earlier than what is known: at
    once, or else after a stop.
    """
    drive, last = way.drive, way.many - 1
    here = _label(labels, label)
    stopped = False
    arrival = here.time + drive.on[last]
    blocked = here.run * way.arcs[0, 1] <= 0 or arrival < me.goal_free
    if blocked or clash(drive, way.many, drive.on, here.time) > 0.0:
        takes = drive.at[last]
        wish = max(here.time + stop(here.run, me.car.v, me.car.a), me.goal_free - takes)
        arrival, stopped = delayed(drive, way.many, wish, here.until) + takes, True
    if arrival < labels.best[0] - 1e-6:
        if labels.best[0] == math.inf:
            labels.counters[6] = labels.counters[2]
        labels.best[0] = arrival
        labels.counters[3], labels.counters[4] = label, n
        labels.counters[5] = 1 if stopped else 0
        for i in range(n):
            labels.tail[i, 0], labels.tail[i, 1] = way.arcs[i, 0], way.arcs[i, 1]


@kernel
def expand(labels: Labels, quest: Quest, rounds: int, extra: int) -> int:
    """Expand up to ``rounds`` labels; return 0 to go on, 1 if solved, 2 if nothing is left.

    Each callee has one call site: that keeps compiling short.
    """
    world, me, goal, steps = quest.world, quest.me, quest.goal, quest.steps
    drive, arcs = new_drive(me.fine), np.empty((5, 2))
    for _ in range(rounds):
        solved = labels.counters[3] >= 0
        if labels.counters[1] == 0:
            return 1 if solved else 2
        number = pop(labels.heap, labels.state, labels.counters)
        label = _label(labels, number)
        spent = labels.counters[2] - labels.counters[6]
        if solved and (label.estimate >= labels.best[0] or spent >= extra):
            return 1
        away = math.hypot(goal[0] - label.pose[0], goal[1] - label.pose[1])
        guides = away < 12 * me.car.radius and labels.arc[number, 3] == 0.0
        shoots = away < 8 * me.car.radius or labels.counters[2] % 8 == 0
        n = 0
        if guides or shoots:
            time, n = connect(label.pose, goal, me.car, (label.run, 0.0), arcs)
            if guides:
                # estimates that know the curve are made when a label's turn comes, not before
                labels.arc[number, 3] = 1.0
                estimate = label.time + time - ramp(abs(label.run), me.car.v, me.car.a)
                if estimate > label.estimate:
                    labels.state[number, 6] = estimate
                    if estimate < labels.best[0]:
                        push(labels.heap, labels.state, labels.counters, number)
                    continue
        labels.counters[2] += 1
        for k in range(-1 if shoots and n > 0 else 0, len(steps)):
            if k >= 0:
                n = 1
                arcs[0, 0], arcs[0, 1] = steps[k, 0], steps[k, 1]
            x, y, th = label.pose
            free = True
            for i in range(n):
                if not arc_free(world, x, y, th, arcs[i, 0], arcs[i, 1]):
                    free = False
                    break
                x, y, th = advance(x, y, th, arcs[i, 0], arcs[i, 1])
            if not free:
                continue
            begin = Begin(label.pose, label.run)
            count, run, end = sample(me, quest.movers, begin, arcs, n, k < 0, drive)
            way = Way(arcs, drive, count, run, end)
            if k < 0:
                _finish(labels, number, me, way, n)
            else:
                _offers(labels, number, quest, way)
    return 0


def chain(labels: Labels) -> FloatArray:
    """Return the best solution's arcs as rows (curvature, signed length, 1 if it stops before)."""
    rows = []
    label = int(labels.counters[3])
    while labels.link[label, 0] >= 0:
        rows.append(labels.arc[label, :3].copy())
        label = int(labels.link[label, 0])
    tail = np.zeros((int(labels.counters[4]), 3))
    tail[:, :2] = labels.tail[: len(tail)]
    tail[:1, 2] = labels.counters[5]
    return np.vstack([*rows[::-1], tail])


# ------------------ For one car


Corner = tuple[float, float]

STEPS = (0.7, 0.35)
"""Lengths of an arc, in turning radii, coarse to fine."""


class SafeIntervalPlanner:
    """Searches for one car at a time among movers in one scene."""

    def __init__(self, scene: Scene, tuning: PlaneTuning) -> None:
        self.tuning = tuning
        self.scene = scene
        self.fields = Fields(scene)
        self._labels: dict[int, Labels] = {}
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
        if not body.mobility.steers or len(motion.poses) != 2:
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
        if not body.mobility.steers or len(motion.poses) != 2:
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
            if other.object != motion.object and not other.path.body.flies:
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
        grain = Grain(step / 1.5, math.ceil(2 * math.pi / (step / radius / 1.5)))
        quest = Quest(world, field, me, movers, goal, steps, grain)
        labels = self._room(self.tuning.labels[level])
        plant(labels, me, movers, start)
        state = 0
        tuning = self.tuning
        most = tuning.expansions[level]
        while state == 0 and not deadline.expired() and labels.counters[2] < most:
            state = expand(labels, quest, tuning.slice, tuning.extra)
        full = labels.counters[0] >= len(labels.heap)
        return (
            chain(labels) if labels.counters[3] >= 0 else None,
            state == 2 and not full,
        )

    def _room(self, size: int) -> Labels:
        if size not in self._labels:
            self._labels[size] = new_labels(size)
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
        flies = other.path.body.flies  # who flies is seen by those who time the path
        if flags and other.object != motion.object and other.until > release and not flies:
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
