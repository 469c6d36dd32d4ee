"""ST-RRT*: bidirectional search in space-time for cars, compiled.

Grothe, Hartmann, Orthey, Toussaint, "ST-RRT*: Asymptotically-Optimal Bidirectional Motion Planning
through Space-Time", ICRA 2022, written anew: a start tree from (start, release), a goal tree with
many roots (goal, t); the range of arrival times grows while nothing is found (progressive
expansion) and shrinks to the best arrival once something is; times of samples are drawn between
what the start allows and what the goal needs (conditional sampling); the goal tree is rewired to
earlier roots (simplified rewiring). Edges are Reeds-Shepp curves driven from rest to rest, with a
wait before or after. The search looks at the other bodies step by step: what it finds is timed
exactly by those who ask.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import WorldData, inner, kernel
from up_samp.geometry.scene import Scene
from up_samp.geometry.sweeps import first_blocked
from up_samp.model import Deadline, Placed, TimedMotion
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.curves.arcs import merged, nodes_of
from up_samp.motion.curves.reeds_shepp import CarLimits, Pose, connect, fastest, run_time
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.fleet.conflicts import Hull, kept, standing, verdict
from up_samp.motion.fleet.paths import A_AVOIDS, Path, hull_of, path_of
from up_samp.motion.fleet.timed_path import TimedPath, pair_flags
from up_samp.motion.guides.search_space import search_box
from up_samp.motion.planners.car_shortcuts import Effort, improve, settle

VERTICES = 6_000
"""Of each tree."""
BATCH, BATCHES = 1_500, 6
"""Samples for one range of arrivals, and how many ranges, each twice the one before."""
NEAREST = 6
"""Vertices that a new one may be joined with."""
REACH = 10.0
"""Turning radii that an extension is long, at most."""
APART, STEP = 0.3, 0.1
"""How far apart (m) the poses of a drive are that are looked at, and the moments (s) of others."""


class Movers(NamedTuple):
    """Other bodies: their ``poses`` (n, t, 3) every ``STEP`` s from ``begin`` (s) on, when each of
    them counts (``spans`` (n, 2), s), and their shapes as in :class:`Hull`: ``verts``
    (n, p, m, 2), ``counts`` (n, p), ``radii`` (n,).
    """

    poses: FloatArray
    begin: float
    spans: FloatArray
    verts: FloatArray
    counts: IntArray
    radii: FloatArray


class Forest(NamedTuple):
    """Both trees (0 from the start, 1 from the goals): ``state`` (2, cap, 4): x, y, theta, time;
    ``parent`` (2, cap), -1: a root; ``root`` (2, cap) arrival of the vertex's root (goal tree);
    ``size`` (2,); ``best`` (3,): arrival (inf: none), vertices of the start and the goal tree.
    """

    state: FloatArray
    parent: IntArray
    root: FloatArray
    size: IntArray
    best: FloatArray


class Growth(NamedTuple):
    """What the trees grow for: a ``car`` with a ``hull`` that drives among ``movers``, a ``margin``
    (m) from them, to ``goal``, by samples from a box (``low`` and ``high`` corner, m), with
    arrivals in [``earliest``, ``latest``] (s).
    """

    world: WorldData
    hull: Hull
    car: CarLimits
    movers: Movers
    margin: float
    goal: Pose
    low: FloatArray
    high: FloatArray
    earliest: float
    latest: float


Vertex = tuple[Pose, float]
"""A pose, and the time (s) there."""


@inner
def _met(growth: Growth, pose: Pose, low: float, high: float) -> bool:
    """Return whether a body that stands at a pose during [low, high] (s) meets a mover then."""
    movers, here = growth.movers, standing(pose[0], pose[1], pose[2])
    last = movers.poses.shape[1] - 1
    for k in range(len(movers.radii)):
        first, end = max(low, movers.spans[k, 0]), min(high, movers.spans[k, 1])
        if first > end:
            continue
        body = Hull(movers.verts[k], movers.counts[k], movers.radii[k], 0.0)
        # the moments before and after count, too
        j = min(last, max(0, math.floor((first - movers.begin) / STEP)))
        stop = max(0.0, min(float(last), math.ceil((end - movers.begin) / STEP)))
        while j <= stop:
            row = movers.poses[k, j]
            there = standing(row[0], row[1], row[2])
            if verdict(here, growth.hull, there, body, growth.margin) == 0:
                return True
            j += 1
    return False


@inner
def _time_at(s: float, length: float, v: float, a: float) -> float:
    """Return when (s) a drive from rest to rest over ``length`` m has come ``s`` m far."""
    total, ramp = run_time(length, v, a), min(0.5 * length, 0.5 * v * v / a)
    if s <= ramp:
        return math.sqrt(2.0 * s / a)
    if length - s <= ramp:
        return total - math.sqrt(2.0 * max(length - s, 0.0) / a)
    return 0.5 * total + (s - 0.5 * length) / v


@inner
def _drives(growth: Growth, pose: Pose, arcs: FloatArray, n: int, begin: float) -> bool:
    """Return whether driving ``n`` arcs from rest to rest, from ``begin`` (s) on, meets nobody."""
    v, a = growth.car.v, growth.car.a
    i, now = 0, begin
    while i < n:
        last, length = i, 0.0
        while last < n and arcs[last, 1] * arcs[i, 1] > 0.0:
            length += abs(arcs[last, 1])
            last += 1
        gone = 0.0
        for k in range(i, last):
            size = abs(arcs[k, 1])
            count = max(1, math.ceil(size / APART))
            for part in range(1, count + 1):
                share = part / count
                there = advance(pose[0], pose[1], pose[2], arcs[k, 0], share * arcs[k, 1])
                t = now + _time_at(gone + share * size, length, v, a)
                if _met(growth, there, t, t):
                    return False
            pose = advance(pose[0], pose[1], pose[2], arcs[k, 0], arcs[k, 1])
            gone += size
        now += run_time(length, v, a)
        i = last
    return True


@inner
def edge_free(growth: Growth, p: Vertex, q: Vertex) -> bool:
    """Return whether one can stand at ``p`` at its time and at ``q`` at its time."""
    arcs = np.empty((5, 2))
    takes, n = connect(p[0], q[0], growth.car, (0.0, 0.0), arcs)
    if takes > q[1] - p[1] + 1e-9 or first_blocked(growth.world, p[0], arcs, n) >= 0:
        return False
    # drive at once and wait at the end, or wait first
    if _drives(growth, p[0], arcs, n, p[1]) and not _met(growth, q[0], p[1] + takes, q[1]):
        return True
    begin = q[1] - takes
    return _drives(growth, p[0], arcs, n, begin) and not _met(growth, p[0], p[1], begin)


@inner
def _vertex(forest: Forest, tree: int, i: int) -> Vertex:
    row = forest.state[tree, i]
    return (row[0], row[1], row[2]), row[3]


@inner
def _nearest(
    forest: Forest, at: tuple[int, bool], car: CarLimits, q: Vertex, later: float, out: IntArray
) -> int:
    """Fill ``out`` with the vertices that can be joined with ``q`` in time and lie nearest over the
    plane; return how many. ``at``: of which tree, and whether before ``q`` in time; ``later``: of
    the goal tree those with roots later than that (s), and no later than the best arrival.
    """
    tree, before = at
    count = 0
    far = np.full(len(out), np.inf)
    for i in range(forest.size[tree]):
        pose, time = _vertex(forest, tree, i)
        d = math.hypot(pose[0] - q[0][0], pose[1] - q[0][1])
        gap = q[1] - time if before else time - q[1]
        root = forest.root[tree, i]
        if d > gap * car.v or (tree == 1 and (root >= forest.best[0] or root <= later)):
            continue
        d += car.radius * abs((pose[2] - q[0][2] + math.pi) % (2 * math.pi) - math.pi)
        k = count
        while k > 0 and far[k - 1] > d:
            k -= 1
        if k >= len(out):
            continue
        count = min(count + 1, len(out))
        for j in range(count - 1, k, -1):
            far[j], out[j] = far[j - 1], out[j - 1]
        far[k], out[k] = d, i
    return count


@inner
def _steered(car: CarLimits, tree: int, near: Vertex, q: Vertex) -> Vertex:
    """Return ``q``, pulled towards ``near`` until the edge is within range, its time in
    proportion, or as long as the drive takes.
    """
    arcs = np.empty((5, 2))
    a, b = (near[0], q[0]) if tree == 0 else (q[0], near[0])
    _, n = connect(a, b, car, (0.0, 0.0), arcs)
    length = np.abs(arcs[:n, 1]).sum()
    share = REACH * car.radius / max(length, 1e-9)
    if share >= 1.0:
        return q
    left, pose = (share if tree == 0 else 1.0 - share) * length, a
    for i in range(n):
        part = min(left, abs(arcs[i, 1]))
        pose = advance(pose[0], pose[1], pose[2], arcs[i, 0], math.copysign(part, arcs[i, 1]))
        left -= part
    # from rest to rest a part takes more than its share
    a, b = (near[0], pose) if tree == 0 else (pose, near[0])
    takes, _ = connect(a, b, car, (0.0, 0.0), arcs)
    gap = max(share * abs(q[1] - near[1]), takes)
    return pose, near[1] + (gap if tree == 0 else -gap)


@inner
def _insert(forest: Forest, tree: int, q: Vertex, parent: int, root: float) -> int:
    n = forest.size[tree]
    for k in range(3):
        forest.state[tree, n, k] = q[0][k]
    forest.state[tree, n, 3] = q[1]
    forest.parent[tree, n], forest.root[tree, n] = parent, root
    forest.size[tree] += 1
    return n


@inner
def _drawn(forest: Forest, growth: Growth) -> Vertex:
    """Draw a pose and, between what start and goal allow, a time (nan: they allow none)."""
    (start, release), goal = _vertex(forest, 0, 0), growth.goal
    x = growth.low[0] + np.random.random() * (growth.high[0] - growth.low[0])
    y = growth.low[1] + np.random.random() * (growth.high[1] - growth.low[1])
    th = (2 * np.random.random() - 1) * math.pi
    first = release + math.hypot(x - start[0], y - start[1]) / growth.car.v
    last = min(growth.latest, forest.best[0])
    last -= math.hypot(x - goal[0], y - goal[1]) / growth.car.v
    time = first + np.random.random() * (last - first)
    return (x, y, th), time if first < last else math.nan


@inner
def _extended(forest: Forest, growth: Growth, tree: int, q: Vertex, near: IntArray) -> int:
    """Insert ``q`` into a tree, in the goal tree at the earliest root; return its number (-1: it
    cannot be joined).
    """
    parent, root = -1, np.inf
    for k in range(_nearest(forest, (tree, tree == 0), growth.car, q, -np.inf, near)):
        p = _vertex(forest, tree, near[k])
        sooner = parent < 0 or (tree == 1 and forest.root[tree, near[k]] < root)
        a, b = (p, q) if tree == 0 else (q, p)
        if sooner and edge_free(growth, a, b):
            parent, root = near[k], forest.root[tree, near[k]]
    return -1 if parent < 0 else _insert(forest, tree, q, parent, root)


@inner
def _joined(forest: Forest, growth: Growth, at: tuple[int, int], q: Vertex, near: IntArray) -> None:
    """Rewire the goal tree to ``q`` (``at``: its tree and number), where that has an earlier root,
    and join it with the other tree if that gives an earlier arrival.
    """
    tree, new = at
    root, other = forest.root[1, new], 1 - tree
    if tree == 1 and forest.parent[1, new] >= 0:
        for k in range(_nearest(forest, (1, True), growth.car, q, root, near)):
            p = _vertex(forest, 1, near[k])
            if forest.parent[1, near[k]] >= 0 and edge_free(growth, p, q):
                forest.parent[1, near[k]], forest.root[1, near[k]] = new, root
    for k in range(_nearest(forest, (other, tree == 1), growth.car, q, -np.inf, near)):
        arrival = root if tree == 1 else forest.root[1, near[k]]
        p = _vertex(forest, other, near[k])
        a, b = (q, p) if tree == 0 else (p, q)
        if arrival < forest.best[0] and edge_free(growth, a, b):
            forest.best[0] = arrival
            forest.best[1 + tree], forest.best[1 + other] = new, near[k]


@kernel
def grow(forest: Forest, growth: Growth, rounds: int, seed: int) -> None:
    """Grow both trees for ``rounds`` samples."""
    np.random.seed(seed)
    near = np.empty(NEAREST, dtype=np.int64)
    cap = forest.state.shape[1]
    for turn in range(rounds):
        bound = min(growth.latest, forest.best[0])
        if max(forest.size[0], forest.size[1]) >= cap - 1 or bound <= growth.earliest:
            return
        if turn % 10 == 0:
            time = growth.earliest + np.random.random() * (bound - growth.earliest)
            q = growth.goal, time
            tree, new = 1, _insert(forest, 1, q, -1, time)
        else:
            tree, new = turn % 2, -1
            q = _drawn(forest, growth)
            if math.isnan(q[1]):
                continue
            if _nearest(forest, (tree, tree == 0), growth.car, q, -np.inf, near) == 0:
                continue
            q = _steered(growth.car, tree, _vertex(forest, tree, near[0]), q)
            new = _extended(forest, growth, tree, q, near)
        if new >= 0:
            _joined(forest, growth, (tree, new), q, near)


def way(forest: Forest) -> FloatArray:
    """Return the best solution's vertices, shape (n, 4): x, y, theta, time."""
    halves = []
    for tree in (0, 1):
        rows, at = [], int(forest.best[1 + tree])
        while at >= 0:
            rows.append(forest.state[tree, at])
            at = int(forest.parent[tree, at])
        halves.append(rows)
    return np.array([*halves[0][::-1], *halves[1]])


# ------------------ For one car


def sampled(
    scene: Scene,
    motion: TimedMotion,
    times: tuple[float, float],
    static: Sequence[Placed],
    others: Sequence[TimedPath],
    deadline: Deadline,
    seed: int = 0,
) -> list[Path]:
    """Return paths on which a car's motion can, with the right timing, pass the ``others``: the one
    found and a shortened one, or none. The range of arrivals doubles until one is found.

    :param times: when it may leave, and when its goal stays free for good (s).
    """
    body, (release, goal_free) = motion.body, times
    limits, hull = limits_of(body.kinematics), hull_of(body)
    start, goal = ((float(x), float(y), float(th)) for x, y, th in motion.poses)
    fastest_time, _ = fastest(start, goal, *limits)
    earliest = max(goal_free, release + fastest_time)
    trees = (2, VERTICES)
    forest = Forest(
        np.zeros((*trees, 4)),
        np.full(trees, -1, dtype=np.int64),
        np.zeros(trees),
        np.array([1, 0], dtype=np.int64),
        np.array([math.inf, -1.0, -1.0]),
    )
    forest.state[0, 0] = (*start, release)
    reach = 8 * body.kinematics.turning_radius + 4 * hull.radius
    low, high = search_box(scene, motion.poses, (), reach)
    seen = [o for o in others if _counts(motion, o, release)]
    ends, margin = [np.array(p[:3]) for p in motion.poses], scene.margin
    for o in seen:
        margin = kept(margin, ends, hull, o.path.poses[[0, -1]], o.path.hull)
    world, movers = scene.world(scene.shape(body), static), _movers(motion, seen, release)
    growth = Growth(world, hull, limits, movers, margin, goal, low, high, float(earliest), 0.0)
    for batch in range(BATCHES):
        latest = float(earliest + max(10.0, fastest_time) * 2.0**batch)
        grow(forest, growth._replace(latest=latest), BATCH, 1000 * seed + batch)
        if deadline.expired() or (forest.best[0] < np.inf and batch >= BATCHES // 2):
            break
    if forest.best[0] == np.inf:
        return []
    pairs = itertools.pairwise(way(forest))
    arcs = [fastest(tuple(a[:3]), tuple(b[:3]), *limits)[1] for a, b in pairs]
    return _finished(motion, world, [part for part in arcs if len(part)])


def _finished(motion: TimedMotion, world: WorldData, parts: Sequence[FloatArray]) -> list[Path]:
    """Turn arcs between stops into paths: shortened between the stops, and as found."""
    body, limits, effort = motion.body, limits_of(motion.body.kinematics), Effort(400, 100, 0)
    start, target = (np.array(pose[:3], dtype=np.float64) for pose in motion.poses)
    pieces, here = [np.zeros((0, 2))], start
    for part in parts:
        pieces.append(improve(world, here, part, limits, effort))
        here = np.ascontiguousarray(nodes_of(here, part)[-1])
    found = []
    for arcs in (merged(np.concatenate(pieces)), merged(np.concatenate([pieces[0], *parts]))):
        if settle(start, target, arcs) < 1e-7:
            trajectory = trajectory_of(motion.poses, [arcs], body.kinematics)
            found.append(path_of(trajectory, body, motion.poses))
    return found


def _counts(motion: TimedMotion, other: TimedPath, release: float) -> bool:
    """Return whether a motion has to do with another body after ``release`` (s). (Who flies is seen
    by those who time the path.)
    """
    flags = pair_flags(motion.object, motion.avoid, other.object, other.avoid)
    here = other.object != motion.object and other.until > release
    return flags != 0 and here and not other.path.body.flies


def _movers(motion: TimedMotion, seen: Sequence[TimedPath], release: float) -> Movers:
    """Return what the search needs of the other bodies."""
    last = max((o.arrival for o in seen), default=release)
    moments = np.arange(release, max(last, release) + 2 * STEP, STEP)
    poses = np.array([[o.timing.trajectory.at(t)[:3] for t in moments] for o in seen])
    spans = []
    for o in seen:
        drive = o.timing.trajectory
        flags = pair_flags(motion.object, motion.avoid, o.object, o.avoid)
        # who need not be avoided at rest counts while it moves
        spans.append((o.since, o.until) if flags & A_AVOIDS else (drive.start, drive.end))
    hulls = [o.path.hull for o in seen]
    parts = max((len(h.counts) for h in hulls), default=1)
    corners = max((h.verts.shape[1] for h in hulls), default=1)
    verts = np.zeros((len(seen), parts, corners, 2))
    counts = np.zeros((len(seen), parts), dtype=np.int64)
    for k, hull in enumerate(hulls):
        n, m = hull.verts.shape[:2]
        # where there are fewer parts, the first one is there again
        each = [i if i < n else 0 for i in range(parts)]
        verts[k, :, :m], counts[k] = hull.verts[each], hull.counts[each]
    radii = np.array([h.radius for h in hulls])
    shape = (len(seen), len(moments), 3)
    spans_of = np.array(spans, dtype=np.float64).reshape(-1, 2)
    return Movers(poses.reshape(shape), float(release), spans_of, verts, counts, radii)
