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

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import WorldData, inner, kernel
from up_samp.geometry.sweeps import arc_free
from up_samp.motion.curves.reeds_shepp import Pose, connect
from up_samp.motion.fleet.moving_obstacles import (
    ArcDrive,
    Begin,
    Me,
    Movers,
    clash,
    new_drive,
    sample,
    visits,
)

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


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
    (``low`` and ``high`` corner, m), with arrivals in [``earliest``, ``latest``] (s). A new
    vertex may be joined with the ``nearest`` ones; an extension is ``reach`` turning radii long at
    most.
    """

    world: WorldData
    me: Me
    movers: Movers
    goal: Pose
    low: tuple[float, float]
    high: tuple[float, float]
    earliest: float
    latest: float
    nearest: int
    reach: float


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
    busy = np.empty((me.fine.visits, 2))
    for q in range(visits(me, movers, p, False, busy)):
        if busy[q, 0] + me.fine.guard < high and low < busy[q, 1] - me.fine.guard:
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
        count, _, _ = sample(me, movers, Begin(p.pose, 0.0), arcs, n, True, drive)
    for late in range(2):
        # drive at once and wait at the end, or wait first
        begin = q.time - takes if late else p.time
        rest = p.pose if late else q.pose
        low, high = (p.time, begin) if late else (begin + takes, q.time)
        clear = clash(drive, count, drive.at, begin) == 0.0
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
        share = growth.reach * me.car.radius / max(length, 1e-9)
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
        close = away < 0.5 * growth.reach * growth.me.car.radius
        if close and forest.parent[1, i] >= 0 and forest.root[1, i] > root and count < len(out):
            out[count] = i
            count += 1
    return count


@kernel
def grow(forest: Forest, growth: Growth, rounds: int, seed: int) -> None:
    """Grow both trees for ``rounds`` samples."""
    np.random.seed(seed)
    me = growth.me
    drive = new_drive(me.fine)
    near = np.empty(growth.nearest, dtype=np.int64)
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
