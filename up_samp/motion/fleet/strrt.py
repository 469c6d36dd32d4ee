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

from up_samp.geometry.compiled import inner, kernel
from up_samp.geometry.kernels import WorldData, advance
from up_samp.geometry.sweeps import arc_free
from up_samp.motion.curves.reeds_shepp import CarLimits, connect
from up_samp.motion.fleet.drives import PIECES, Drive, clash, sample
from up_samp.motion.fleet.movers import GUARD, VISITS, Me, Movers, visits

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

NEAREST = 6
"""Vertices that a new one may be joined with."""
RANGE = 10.0
"""Longest edge of an extension, in turning radii."""

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
def _duration(me: Me, p: FloatArray, q: FloatArray, arcs: FloatArray) -> tuple[float, int]:
    """Return the least time (s) from rest at ``p`` to rest at ``q`` and the number of ``arcs``."""
    car = CarLimits(me.numbers[2], me.numbers[3], me.numbers[4])
    time, n = connect((p[0], p[1], p[2]), (q[0], q[1], q[2]), car, (0.0, 0.0), arcs)
    return time, n


@inner
def _still(me: Me, movers: Movers, p: FloatArray, low: float, high: float) -> bool:
    """Return whether it is safe to stand at ``p`` all through [low, high]."""
    if high <= low:
        return True
    busy = np.empty((VISITS, 2))
    for q in range(visits(me, movers, p[0], p[1], p[2], False, busy)):
        if busy[q, 0] + GUARD < high and low < busy[q, 1] - GUARD:
            return False
    return True


@inner
def _edge(
    world: WorldData,
    me: Me,
    movers: Movers,
    p: FloatArray,
    q: FloatArray,
    drive: Drive,
) -> bool:
    """Return whether one can stand at ``p`` at its time and at ``q`` at its time."""
    arcs = np.empty((5, 2))
    takes, n = _duration(me, p, q, arcs)
    if takes > q[3] - p[3] + 1e-9:
        return False
    x, y, th = p[0], p[1], p[2]
    for i in range(n):
        if not arc_free(world, x, y, th, arcs[i, 0], arcs[i, 1]):
            return False
        x, y, th = advance(x, y, th, arcs[i, 0], arcs[i, 1])
    count = 0
    if n > 0:
        label, end = np.zeros(7), np.empty(3)
        label[0], label[1], label[2] = p[0], p[1], p[2]
        count, _ = sample(me, movers, label, arcs, n, True, drive, end)
    for late in range(2):
        # drive at once and wait at the end, or wait first
        begin = q[3] - takes if late else p[3]
        rest = p if late else q
        low, high = (p[3], begin) if late else (begin + takes, q[3])
        clear = clash(drive, count, drive.at, begin) == 0.0
        if clear and _still(me, movers, rest, low, high):
            return True
    return False


@inner
def _nearest(forest: Forest, tree: int, me: Me, q: FloatArray, out: IntArray) -> int:
    """Fill ``out`` with the vertices of a tree that can be joined with ``q`` in time and lie
    nearest over the plane; return how many.
    """
    count = 0
    far = np.full(len(out), np.inf)
    for i in range(forest.size[tree]):
        p = forest.state[tree, i]
        d = math.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2)
        gap = q[3] - p[3] if tree == 0 else p[3] - q[3]
        if d > gap * me.numbers[3] or (tree == 1 and forest.root[1, i] >= forest.best[0]):
            continue
        turn = (p[2] - q[2] + math.pi) % (2 * math.pi) - math.pi
        d += me.numbers[2] * abs(turn)
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
def _steer(me: Me, tree: int, near: FloatArray, q: FloatArray) -> None:
    """Pull ``q`` towards ``near`` until the edge is within range, its time in proportion."""
    arcs = np.empty((5, 2))
    for cut in range(2):
        a, b = (near, q) if tree == 0 else (q, near)
        takes, n = _duration(me, a, b, arcs)
        if cut == 1:
            # from rest to rest a part takes more than its share
            q[3] = max(q[3], near[3] + takes) if tree == 0 else min(q[3], near[3] - takes)
            return
        length = 0.0
        for i in range(n):
            length += abs(arcs[i, 1])
        share = RANGE * me.numbers[2] / max(length, 1e-9)
        if share >= 1.0:
            return
        left = share * length if tree == 0 else (1.0 - share) * length
        x, y, th = a[0], a[1], a[2]
        for i in range(n):
            part = min(left, abs(arcs[i, 1]))
            x, y, th = advance(x, y, th, arcs[i, 0], math.copysign(part, arcs[i, 1]))
            left -= part
            if left <= 1e-12:
                break
        q[0], q[1], q[2], q[3] = x, y, th, near[3] + share * (q[3] - near[3])


@inner
def _insert(forest: Forest, tree: int, q: FloatArray, parent: int, root: float) -> int:
    n = forest.size[tree]
    for k in range(4):
        forest.state[tree, n, k] = q[k]
    forest.parent[tree, n], forest.root[tree, n] = parent, root
    forest.size[tree] += 1
    return n


@inner
def _draw(
    forest: Forest, me: Me, goal: FloatArray, box: FloatArray, latest: float, q: FloatArray
) -> bool:
    """Draw a pose and, between what start and goal allow, a time."""
    start = forest.state[0, 0]
    q[0] = box[0] + np.random.random() * (box[2] - box[0])
    q[1] = box[1] + np.random.random() * (box[3] - box[1])
    q[2] = (2 * np.random.random() - 1) * math.pi
    v = me.numbers[3]
    low = start[3] + math.hypot(q[0] - start[0], q[1] - start[1]) / v
    high = min(latest, forest.best[0]) - math.hypot(q[0] - goal[0], q[1] - goal[1]) / v
    q[3] = low + np.random.random() * (high - low)
    return low < high


@inner
def _rewirable(forest: Forest, me: Me, q: FloatArray, root: float, out: IntArray) -> int:
    """Fill ``out`` with vertices of the goal tree near ``q`` that have a later root than
    ``root``; return how many.
    """
    count = 0
    for i in range(forest.size[1]):
        p = forest.state[1, i]
        close = math.hypot(p[0] - q[0], p[1] - q[1]) < 0.5 * RANGE * me.numbers[2]
        if close and forest.parent[1, i] >= 0 and forest.root[1, i] > root and count < len(out):
            out[count] = i
            count += 1
    return count


@kernel
def grow(
    forest: Forest,
    world: WorldData,
    me: Me,
    movers: Movers,
    goal: FloatArray,
    box: FloatArray,
    earliest: float,
    latest: float,
    rounds: int,
    seed: int,
) -> None:
    """Grow both trees for ``rounds`` samples; arrivals are sought in [earliest, latest] (s)."""
    np.random.seed(seed)
    drive = Drive(
        np.empty(PIECES),
        np.empty(PIECES),
        np.empty((PIECES, VISITS, 2)),
        np.zeros(PIECES, dtype=np.int64),
    )
    near = np.empty(NEAREST, dtype=np.int64)
    q = np.empty(4)
    cap = forest.state.shape[1]
    for turn in range(rounds):
        bound = min(latest, forest.best[0])
        if forest.size[0] >= cap or forest.size[1] >= cap - 1 or bound <= earliest:
            return
        if turn % 10 == 0:
            q[0], q[1], q[2] = goal[0], goal[1], goal[2]
            q[3] = earliest + np.random.random() * (bound - earliest)
            tree, new = 1, _insert(forest, 1, q, -1, q[3])
        else:
            tree, new = turn % 2, -1
            if not _draw(forest, me, goal, box, latest, q):
                continue
            if _nearest(forest, tree, me, q, near) == 0:
                continue
            _steer(me, tree, forest.state[tree, near[0]], q)
        _stages(forest, world, me, movers, tree, new, q, near, drive)


@inner
def _stages(
    forest: Forest,
    world: WorldData,
    me: Me,
    movers: Movers,
    tree: int,
    new: int,
    q: FloatArray,
    near: IntArray,
    drive: Drive,
) -> None:
    """Insert ``q`` (unless it is the vertex ``new``), rewire the goal tree to it, and join it with
    the other tree if that gives an earlier arrival. One place tests edges: compiling stays short.
    """
    for stage in range(JOIN if new >= 0 else EXTEND, JOIN + 1):
        side = tree if stage == EXTEND else 1 - tree
        if stage == REWIRE:
            if tree == 0:
                continue
            side, count = 1, _rewirable(forest, me, q, forest.root[1, new], near)
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
            p = forest.state[side, i]
            earlier = stage == REWIRE or (stage == EXTEND) == (tree == 0)
            a, b = (p, q) if earlier else (q, p)
            if not _edge(world, me, movers, a, b, drive):
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
