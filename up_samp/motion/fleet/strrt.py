"""ST-RRT*: bidirectional search in space-time for cars, compiled.

Grothe, Hartmann, Orthey, Toussaint, "ST-RRT*: Asymptotically-Optimal Bidirectional Motion Planning
through Space-Time", ICRA 2022, written anew: a start tree from (start, release), a goal tree with
many roots (goal, t); the range of arrival times grows while nothing is found (progressive
expansion) and shrinks to the best arrival once something is; times of samples are drawn between
what the start allows and what the goal needs (conditional sampling); the goal tree is rewired to
earlier roots (simplified rewiring). Edges are Reeds-Shepp curves driven from rest to rest, with a
wait before or after.
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
from up_samp.model import Deadline, Placed, TimedMotion
from up_samp.motion.curves.arcs import merged, nodes_of
from up_samp.motion.curves.reeds_shepp import CarLimits, Pose, connect, fastest
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.fleet.conflicts import Hull, Part, SweptPiece, apart, kept, piece, standing
from up_samp.motion.fleet.paths import A_AVOIDS, B_AVOIDS, Path, hull_of, path_of
from up_samp.motion.fleet.timed_path import TimedPath, pair_flags
from up_samp.motion.planners.car_shortcuts import Effort, improve, settle

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


VERTICES = 6_000
"""Of each tree."""
BATCH, BATCHES = 1_500, 6
"""Samples for one range of arrivals, and how many ranges, each twice the one before."""
NEAREST = 6
"""Vertices that a new one may be joined with."""
REACH = 10.0
"""Turning radii that an extension is long, at most."""
PIECES, PIECE = 96, 0.3
"""Poses of one drive that are looked at, at most, and how far (m) they are apart, at least."""
VISITS, GUARD = 24, 0.1
"""Visits of movers that are kept for one pose, and the time (s) kept before and after each."""

# ------------------ Other bodies as this search sees them


class Movers(NamedTuple):
    """Other bodies: ``rows`` (n, 9) poses in the middle of their extended cells (as in
    ``sweep_table``, but without extent), body k has ``first[k]:first[k + 1]``; ``held``
    its occupancy from ``first[k] + k`` on; ``hull`` (m,) the index of its shape in ``verts``
    (h, p, c, 2), ``counts`` (h, p; 0: no part), ``radii`` (h,);
    ``steps`` (m,) distance between middles at most; ``flags`` (m,) who keeps clear of whom.
    """

    rows: FloatArray
    first: IntArray
    held: FloatArray
    hull: IntArray
    verts: FloatArray
    counts: IntArray
    radii: FloatArray
    steps: FloatArray
    flags: IntArray


class Me(NamedTuple):
    """The body that is planned: its ``hull``, the ``margin`` (m) it keeps, its limits as a ``car``
    (the turning radius in m, m/s, m/s^2).
    """

    hull: Hull
    margin: float
    car: CarLimits


@inner
def _visits(me: Me, movers: Movers, pose: Pose, out: FloatArray) -> int:
    """Fill ``out`` (visits, 2) with the times at which movers are at a pose; return how many."""
    here = standing(pose[0], pose[1], pose[2])
    count = 0
    for k in range(len(movers.hull)):
        flags, hull = movers.flags[k], movers.hull[k]
        low, high = movers.first[k], movers.first[k + 1]
        shift = k
        reach = me.hull.radius + me.margin + movers.radii[hull]
        step = movers.steps[k]
        j = low
        if not flags & A_AVOIDS:
            if not flags & B_AVOIDS:
                continue
            j += 1
            high -= 1
        open_from = -1
        while j < high:
            b = piece(movers.rows[j])
            gap = math.sqrt((here.x - b.x) ** 2 + (here.y - b.y) ** 2) - reach
            hit = False
            if gap <= 0.0:
                hit = _touch(here, me, b, movers, hull)
            if hit and open_from < 0:
                open_from = j
            if not hit and open_from >= 0:
                since, until = movers.held[open_from + shift], movers.held[j + shift]
                count = _add(out, count, since - GUARD, until + GUARD)
                open_from = -1
            j += 1 if gap <= 0.0 else max(1, int(gap / step))
        if open_from >= 0:
            since, until = movers.held[open_from + shift], movers.held[high + shift]
            count = _add(out, count, since - GUARD, until + GUARD)
    return count


@inner
def _touch(here: SweptPiece, me: Me, b: SweptPiece, movers: Movers, hull: int) -> bool:
    for i in range(len(me.hull.counts)):
        mine = Part(me.hull.verts[i], me.hull.counts[i], me.hull.radius)
        for j in range(movers.counts.shape[1]):
            n = movers.counts[hull, j]
            if n > 0:
                other = Part(movers.verts[hull, j], n, movers.radii[hull])
                if apart(here, mine, b, other, me.margin) == 0:
                    return True
    return False


@inner
def _add(out: FloatArray, count: int, low: float, high: float) -> int:
    """Add [low, high] to sorted disjoint intervals; return how many there are then."""
    k = 0
    while k < count and out[k, 1] < low:
        k += 1
    last = k
    while last < count and out[last, 0] <= high:
        low, high = min(low, out[last, 0]), max(high, out[last, 1])
        last += 1
    if last == k:
        if count == len(out):
            return count
        for i in range(count, k, -1):
            out[i, 0], out[i, 1] = out[i - 1, 0], out[i - 1, 1]
        count += 1
    else:
        for i in range(last, count):
            out[i - last + k + 1, 0], out[i - last + k + 1, 1] = out[i, 0], out[i, 1]
        count -= last - k - 1
    out[k, 0], out[k, 1] = low, high
    return count


# ------------------ Drives along a few arcs among movers
# At sampled poses: how long they take, when they clash.


@inner
def _ramp(run: float, v: float, a: float) -> float:
    """Return the time (s) from rest over ``run`` m at full acceleration."""
    on_ramp = v * v / (2 * a)
    return math.sqrt(2 * run / a) if run <= on_ramp else v / a + (run - on_ramp) / v


@inner
def _stop(run: float, v: float, a: float) -> float:
    """Return the time (s) lost by coming to rest after ``run`` m instead of driving on."""
    return min(v, math.sqrt(2 * a * abs(run))) / (2 * a)


class ArcDrive(NamedTuple):
    """Sampled poses of a drive: ``at`` (pieces,) time after its begin from rest, ``busy`` (pieces,
    visits, 2), ``many`` (pieces,) how many visits.
    """

    at: FloatArray
    busy: FloatArray
    many: IntArray


@inner
def _new_drive() -> ArcDrive:
    return ArcDrive(
        np.empty(PIECES), np.empty((PIECES, VISITS, 2)), np.zeros(PIECES, dtype=np.int64)
    )


@inner
def _sampled_drive(
    me: Me, movers: Movers, pose: Pose, arcs: FloatArray, n: int, drive: ArcDrive
) -> int:
    """Sample ``n`` arcs from rest to rest; return the number of poses."""
    v, a = me.car.v, me.car.a
    total = 0.0
    for i in range(n):
        total += abs(arcs[i, 1])
    step = max(PIECE, total / (PIECES - n))
    count = 0
    rest, run, ahead = 0.0, 0.0, 0.0
    for i in range(n):
        kappa, s = arcs[i, 0], arcs[i, 1]
        if i == 0 or run * s < 0:
            # a cusp: the last run has come to rest, measure the next one
            if i > 0:
                rest += _ramp(ahead, v, a) + _stop(ahead, v, a)
            run, ahead = 0.0, 0.0
            k = i
            while k < n and arcs[k, 1] * s > 0:
                ahead += abs(arcs[k, 1])
                k += 1
        pieces = max(1, math.ceil(abs(s) / step))
        for k in range(1, pieces + 1):
            there = advance(pose[0], pose[1], pose[2], kappa, s * k / pieces)
            gone = abs(run) + abs(s) * k / pieces
            first, left = _ramp(gone, v, a), max(0.0, ahead - gone)
            if left < min(v * v / (2 * a), 0.5 * ahead):
                late = _ramp(left, v, a)
                first = max(first, _ramp(ahead, v, a) + _stop(ahead, v, a) - late)
            drive.at[count] = rest + first
            drive.many[count] = _visits(me, movers, there, drive.busy[count])
            count += 1
        pose = advance(pose[0], pose[1], pose[2], kappa, s)
        run += s
    return count


@inner
def _clashes(drive: ArcDrive, count: int, begin: float) -> bool:
    """Return whether a drive that begins then meets a mover."""
    for k in range(count):
        t = begin + drive.at[k]
        for q in range(drive.many[k]):
            if drive.busy[k, q, 0] < t < drive.busy[k, q, 1]:
                return True
    return False


# ------------------ Both trees


EXTEND, REWIRE, JOIN = 0, 1, 2
"""What edges are tested for."""


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


class Vertex(NamedTuple):
    """A ``pose`` at a ``time`` (s)."""

    pose: Pose
    time: float


class Growth(NamedTuple):
    """What the trees grow for: a body that drives among movers to ``goal``, by samples from a box
    (``low`` and ``high`` corner, m), with arrivals in [``earliest``, ``latest``] (s).
    """

    world: WorldData
    me: Me
    movers: Movers
    goal: Pose
    low: tuple[float, float]
    high: tuple[float, float]
    earliest: float
    latest: float


def new_forest(cap: int) -> Forest:
    """Return empty trees with room for ``cap`` vertices each."""
    return Forest(
        np.zeros((2, cap, 4)),
        np.full((2, cap), -1, dtype=np.int64),
        np.zeros((2, cap)),
        np.zeros(2, dtype=np.int64),
        np.array([math.inf, -1.0, -1.0]),
    )


@inner
def _vertex(forest: Forest, tree: int, i: int) -> Vertex:
    row = forest.state[tree, i]
    return Vertex((row[0], row[1], row[2]), row[3])


@inner
def _still(me: Me, movers: Movers, p: Pose, low: float, high: float) -> bool:
    """Return whether it is safe to stand at ``p`` all through [low, high]."""
    if high <= low:
        return True
    busy = np.empty((VISITS, 2))
    for q in range(_visits(me, movers, p, busy)):
        if busy[q, 0] + GUARD < high and low < busy[q, 1] - GUARD:
            return False
    return True


@inner
def _edge(growth: Growth, p: Vertex, q: Vertex, drive: ArcDrive) -> bool:
    """Return whether one can stand at ``p`` at its time and at ``q`` at its time."""
    me, movers = growth.me, growth.movers
    arcs = np.empty((5, 2))
    takes, n = connect(p.pose, q.pose, me.car, (0.0, 0.0), arcs)
    if takes > q.time - p.time + 1e-9:
        return False
    x, y, th = p.pose
    for i in range(n):
        if not arc_free(growth.world, x, y, th, arcs[i, 0], arcs[i, 1]):
            return False
        x, y, th = advance(x, y, th, arcs[i, 0], arcs[i, 1])
    count = 0
    if n > 0:
        count = _sampled_drive(me, movers, p.pose, arcs, n, drive)
    for late in range(2):
        # drive at once and wait at the end, or wait first
        begin = q.time - takes if late else p.time
        rest = p.pose if late else q.pose
        low, high = (p.time, begin) if late else (begin + takes, q.time)
        clear = not _clashes(drive, count, begin)
        if clear and _still(me, movers, rest, low, high):
            return True
    return False


@inner
def _nearest(forest: Forest, tree: int, me: Me, q: Vertex, out: IntArray) -> int:
    """Fill ``out`` with the vertices of a tree that can be joined with ``q`` in time and lie
    nearest over the plane; return how many.
    """
    count = 0
    far = np.full(len(out), np.inf)
    for i in range(forest.size[tree]):
        p = _vertex(forest, tree, i)
        d = math.sqrt((p.pose[0] - q.pose[0]) ** 2 + (p.pose[1] - q.pose[1]) ** 2)
        gap = q.time - p.time if tree == 0 else p.time - q.time
        if d > gap * me.car.v or (tree == 1 and forest.root[1, i] >= forest.best[0]):
            continue
        turn = (p.pose[2] - q.pose[2] + math.pi) % (2 * math.pi) - math.pi
        d += me.car.radius * abs(turn)
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
def _steer(growth: Growth, tree: int, near: Vertex, q: Vertex) -> Vertex:
    """Return ``q``, pulled towards ``near`` until the edge is within range, its time in
    proportion.
    """
    me, arcs = growth.me, np.empty((5, 2))
    for cut in range(2):
        a, b = (near, q) if tree == 0 else (q, near)
        takes, n = connect(a.pose, b.pose, me.car, (0.0, 0.0), arcs)
        if cut == 1:
            # from rest to rest a part takes more than its share
            least = near.time + takes if tree == 0 else near.time - takes
            return Vertex(q.pose, max(q.time, least) if tree == 0 else min(q.time, least))
        length = 0.0
        for i in range(n):
            length += abs(arcs[i, 1])
        share = REACH * me.car.radius / max(length, 1e-9)
        if share >= 1.0:
            return q
        left = share * length if tree == 0 else (1.0 - share) * length
        x, y, th = a.pose
        for i in range(n):
            part = min(left, abs(arcs[i, 1]))
            x, y, th = advance(x, y, th, arcs[i, 0], math.copysign(part, arcs[i, 1]))
            left -= part
            if left <= 1e-12:
                break
        q = Vertex((x, y, th), near.time + share * (q.time - near.time))
    return q


@inner
def _insert(forest: Forest, tree: int, q: Vertex, parent: int, root: float) -> int:
    n = forest.size[tree]
    for k in range(3):
        forest.state[tree, n, k] = q.pose[k]
    forest.state[tree, n, 3] = q.time
    forest.parent[tree, n], forest.root[tree, n] = parent, root
    forest.size[tree] += 1
    return n


@inner
def _draw(forest: Forest, growth: Growth) -> Vertex:
    """Draw a pose and, between what start and goal allow, a time (nan: they allow none)."""
    start, goal, low, high = _vertex(forest, 0, 0), growth.goal, growth.low, growth.high
    x = low[0] + np.random.random() * (high[0] - low[0])
    y = low[1] + np.random.random() * (high[1] - low[1])
    th = (2 * np.random.random() - 1) * math.pi
    v = growth.me.car.v
    first = start.time + math.hypot(x - start.pose[0], y - start.pose[1]) / v
    last = min(growth.latest, forest.best[0]) - math.hypot(x - goal[0], y - goal[1]) / v
    time = first + np.random.random() * (last - first)
    return Vertex((x, y, th), time if first < last else math.nan)


@inner
def _rewirable(forest: Forest, growth: Growth, q: Vertex, root: float, out: IntArray) -> int:
    """Fill ``out`` with vertices of the goal tree near ``q`` that have a later root than
    ``root``; return how many.
    """
    count = 0
    for i in range(forest.size[1]):
        p = _vertex(forest, 1, i)
        away = math.hypot(p.pose[0] - q.pose[0], p.pose[1] - q.pose[1])
        close = away < 0.5 * REACH * growth.me.car.radius
        if close and forest.parent[1, i] >= 0 and forest.root[1, i] > root and count < len(out):
            out[count] = i
            count += 1
    return count


@kernel
def grow(forest: Forest, growth: Growth, rounds: int, seed: int) -> None:
    """Grow both trees for ``rounds`` samples."""
    np.random.seed(seed)
    me = growth.me
    drive = _new_drive()
    near = np.empty(NEAREST, dtype=np.int64)
    cap = forest.state.shape[1]
    for turn in range(rounds):
        bound = min(growth.latest, forest.best[0])
        full = forest.size[0] >= cap or forest.size[1] >= cap - 1
        if full or bound <= growth.earliest:
            return
        if turn % 10 == 0:
            time = growth.earliest + np.random.random() * (bound - growth.earliest)
            q = Vertex(growth.goal, time)
            tree, new = 1, _insert(forest, 1, q, -1, time)
        else:
            tree, new = turn % 2, -1
            q = _draw(forest, growth)
            if math.isnan(q.time) or _nearest(forest, tree, me, q, near) == 0:
                continue
            q = _steer(growth, tree, _vertex(forest, tree, near[0]), q)
        _stages(forest, growth, (tree, new), q, near, drive)


@inner
def _stages(
    forest: Forest, growth: Growth, at: tuple[int, int], q: Vertex, near: IntArray, drive: ArcDrive
) -> None:
    """Insert ``q`` into a tree (``at``: the tree, and which vertex it is there already, or -1),
    rewire the goal tree to it, and join it with the other tree if that gives an earlier arrival.
    One place tests edges: compiling stays short.
    """
    me = growth.me
    tree, new = at
    for stage in range(JOIN if new >= 0 else EXTEND, JOIN + 1):
        side = tree if stage == EXTEND else 1 - tree
        if stage == REWIRE:
            if tree == 0:
                continue
            side, count = 1, _rewirable(forest, growth, q, forest.root[1, new], near)
        else:
            count = _nearest(forest, side, me, q, near)
        parent, root = -1, np.inf
        for k in range(count):
            i = near[k]
            # arrivals belong to the goal tree
            arrival = forest.root[1, i if side == 1 else max(new, 0)]
            if stage == EXTEND and tree == 1 and arrival >= root:
                continue
            if stage == JOIN and arrival >= forest.best[0]:
                continue
            p = _vertex(forest, side, i)
            earlier = stage == REWIRE or (stage == EXTEND) == (tree == 0)
            a, b = (p, q) if earlier else (q, p)
            if not _edge(growth, a, b, drive):
                continue
            if stage == EXTEND:
                parent, root = i, forest.root[tree, i]
                if tree == 0:
                    break
            elif stage == REWIRE:
                forest.parent[1, i], forest.root[1, i] = new, forest.root[1, new]
            else:
                forest.best[0] = arrival
                forest.best[1] = new if tree == 0 else i
                forest.best[2] = i if tree == 0 else new
        if stage == EXTEND:
            if parent < 0:
                return
            new = _insert(forest, tree, q, parent, root)


def way(forest: Forest) -> FloatArray:
    """Return the best solution's vertices, shape (n, 4): x, y, theta, time."""
    first, last = int(forest.best[1]), int(forest.best[2])
    before, after = [], []
    while first >= 0:
        before.append(forest.state[0, first])
        first = int(forest.parent[0, first])
    while last >= 0:
        after.append(forest.state[1, last])
        last = int(forest.parent[1, last])
    return np.array([*before[::-1], *after])


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
    world = scene.world(scene.shape(body), static)
    movers, limits = _movers(motion, others, release), limits_of(body.kinematics)
    start, goal = ((float(x), float(y), float(th)) for x, y, th in motion.poses)
    fastest_time, _ = fastest(start, goal, *limits)
    earliest = max(goal_free, release + fastest_time)
    forest = new_forest(VERTICES)
    forest.state[0, 0] = (*start, release)
    forest.size[0] = 1
    low, high = _box(scene, motion)
    me = Me(hull_of(body), _margin(scene, motion, others), limits)
    for batch in range(BATCHES):
        latest = earliest + max(10.0, fastest_time) * 2.0**batch
        growth = Growth(world, me, movers, goal, low, high, float(earliest), float(latest))
        grow(forest, growth, BATCH, 1000 * seed + batch)
        if deadline.expired() or (forest.best[0] < np.inf and batch >= BATCHES // 2):
            break
    if forest.best[0] == np.inf:
        return []
    pairs = itertools.pairwise(way(forest))
    arcs = [fastest(tuple(a[:3]), tuple(b[:3]), *limits)[1] for a, b in pairs]
    parts = [part for part in arcs if len(part)]
    if not parts:  # it is there already
        arcs = [np.zeros((0, 2))]
        return [path_of(trajectory_of(motion.poses, arcs, body.kinematics), body, motion.poses)]
    return _finished(scene, motion, tuple(static), parts)


def _box(scene: Scene, motion: TimedMotion) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the area that samples are drawn from: its lower left and upper right corner."""
    if scene.grid is None:
        points = np.array([pose[:2] for pose in motion.poses])
        reach = 8 * motion.body.kinematics.turning_radius + 4 * hull_of(motion.body).radius
    else:
        rows, cols = scene.grid.shape
        corners = itertools.product((-0.5, rows - 0.5), (-0.5, cols - 0.5))
        points, reach = np.array([scene.grid.point_of(r, c) for r, c in corners]), 0.0
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def _margin(scene: Scene, motion: TimedMotion, others: Sequence[TimedPath]) -> float:
    hull, ends = hull_of(motion.body), [np.array(p[:3]) for p in motion.poses]
    margin = scene.margin
    for other in others:
        if other.object != motion.object and not other.path.body.flies:
            margin = kept(margin, ends, hull, other.path.poses[[0, -1]], other.path.hull)
    return margin


def _finished(
    scene: Scene, motion: TimedMotion, static: tuple[Placed, ...], parts: Sequence[FloatArray]
) -> list[Path]:
    """Turn arcs between stops into paths: shortened between the stops, and as found."""
    body, limits = motion.body, limits_of(motion.body.kinematics)
    start, target = (np.array(pose[:3], dtype=np.float64) for pose in motion.poses)
    world, effort = scene.world(scene.shape(body), static), Effort(400, 100, 0)
    pieces, here = [], start
    for part in parts:
        pieces.append(improve(world, here, part, limits, effort))
        here = np.ascontiguousarray(nodes_of(here, part)[-1])
    found = []
    for arcs in (merged(np.concatenate(pieces)), merged(np.concatenate(parts))):
        if settle(start, target, arcs) < 1e-7:
            trajectory = trajectory_of(motion.poses, [arcs], body.kinematics)
            found.append(path_of(trajectory, body, motion.poses))
    return found


def _movers(motion: TimedMotion, others: Sequence[TimedPath], release: float) -> Movers:
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
