"""Hybrid A* for cars: search over (x, y, theta, direction) with Reeds-Shepp ways to the goal.

Dolgov, Thrun, Montemerlo, Diebel, "Path planning for autonomous vehicles in unknown
semi-structured environments", IJRR 29 (2010). Costs are *times*: each node keeps the time of its
closed runs and the length of the run it is in, so that stops at cusps and the trapezoidal speed
count exactly along every path of the search tree. Deterministic.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernels import advance, arc_free, first_blocked
from up_samp.geometry.records import WorldData, kernel, lean_inner
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.curves.reeds_shepp import DriveLimits, Pose, connect, driven_on, run_time
from up_samp.motion.guides import Field, Space, field_value, pop, push

BEAT = 0.995
"""Share of the best time that an estimate must beat."""


class Tree(NamedTuple):
    """A search tree and its open list, kept between calls.

    ``nodes`` (cap, 6): x, y, theta, time of closed runs, signed length of the open run, estimate.
    ``arcs`` (cap, 2): the arc from the parent. ``links`` (cap, 2): parent, slot. ``heap`` (cap,)
    node numbers ordered by estimate. ``keys`` (slots,): which state has a slot (-1: none), by open
    addressing; ``table`` float32 (slots,): its best time.
    ``counters``: nodes, heap size, expansions, best node, expansions at the first solution.
    ``best``: (time of the best solution). ``tail`` (5, 2): its Reeds-Shepp arcs, ``counters[5]``.
    """

    nodes: FloatArray
    arcs: FloatArray
    links: IntArray
    heap: IntArray
    keys: IntArray
    table: npt.NDArray[np.float32]
    counters: IntArray
    best: FloatArray
    tail: FloatArray


class PoseSearch(NamedTuple):
    """What one search is about: a body that gets to ``goal`` (x, y, theta) by primitive ``steps``:
    a car's are arcs (n, 2: curvature, signed length), those of what moves in any direction straight
    moves (n, 3: m, m, rad).
    """

    world: WorldData
    limits: DriveLimits
    goal: Pose
    field: Field
    space: Space
    steps: FloatArray


@lean_inner
def slot_of(
    tree: Tree, space: Space, x: float, y: float, th: float, backwards: bool
) -> tuple[int, int]:
    """Return the slot of a state and its key; -1 outside."""
    col = math.floor((x - space.x) / space.cell)
    row = math.floor((y - space.y) / space.cell)
    if col < 0 or row < 0 or col >= space.cols or row >= space.rows:
        return -1, -1
    turn = (th % (2.0 * math.pi)) / (2.0 * math.pi)
    k = int(turn * space.bins + 0.5) % space.bins
    index = (int(row) * space.cols + int(col)) * space.bins + k
    key = 2 * index + int(backwards)
    mask = tree.keys.shape[0] - 1
    # Fibonacci hashing (Knuth, The Art of Computer Programming 3, section 6.4)
    slot = ((key * 11400714819323) >> 20) & mask
    while tree.keys[slot] >= 0 and tree.keys[slot] != key:
        slot = (slot + 1) & mask
    return slot, key


@lean_inner
def _estimate(problem: PoseSearch, pose: Pose, closed: float, run: float, out: FloatArray) -> float:
    """Return the estimated total time of a path through a node."""
    goal, field, space, car = problem.goal, problem.field, problem.space, problem.limits
    dx, dy = goal[0] - pose[0], goal[1] - pose[1]
    away = math.sqrt(dx * dx + dy * dy)
    far = max(away, field_value(field, pose[0], pose[1]))
    if far == math.inf:
        return math.inf
    total = closed + run_time(abs(run) + space.weight * far, car.v, car.a)
    if away < space.near:
        time, _ = connect(pose, goal, car, (run, 0.0), out)
        total = max(total, closed + time)
    return total


@lean_inner
def add_node(
    tree: Tree, pose: Pose, link: tuple[int, int], times: tuple[float, float, float]
) -> int:
    """Add a node to the tree and to its open list; return its number. ``link``: parent and slot;
    ``times``: of closed runs, the open run, the estimate.
    """
    n = tree.counters[0]
    tree.counters[0] += 1
    for i in range(3):
        tree.nodes[n, i] = pose[i]
        tree.nodes[n, 3 + i] = times[i]
    tree.links[n, 0], tree.links[n, 1] = link
    push(tree.heap, tree.nodes, tree.counters, n)
    return int(n)


def plant(tree: Tree, start: FloatArray) -> None:
    """Put the start node into an empty tree (its order does not matter: it is taken first)."""
    tree.nodes[0] = (*start[:3], 0.0, 0.0, 0.0)
    tree.links[0] = -1
    tree.heap[0] = 0
    tree.counters[:] = (1, 1, 0, -1, 0, 0)
    tree.best[0] = math.inf


@lean_inner
def _shoot(tree: Tree, problem: PoseSearch, node: int, out: FloatArray) -> None:
    """Try to reach the goal from a node by one Reeds-Shepp curve."""
    pose = tree.nodes[node, 0], tree.nodes[node, 1], tree.nodes[node, 2]
    time, n = connect(pose, problem.goal, problem.limits, (tree.nodes[node, 4], 0.0), out)
    total = tree.nodes[node, 3] + time
    if total >= tree.best[0] - 1e-6 or first_blocked(problem.world, pose, out, n) >= 0:
        return
    if tree.counters[3] < 0:
        tree.counters[4] = tree.counters[2]
    tree.best[0] = total
    tree.counters[3] = node
    tree.counters[5] = n
    for i in range(n):
        tree.tail[i, 0], tree.tail[i, 1] = out[i, 0], out[i, 1]


@lean_inner
def _grow(
    tree: Tree, problem: PoseSearch, node: int, kappa: float, s: float, out: FloatArray
) -> None:
    """Add the child reached by one arc, if it is free and better than what is known there."""
    x0, y0, th0 = tree.nodes[node, 0], tree.nodes[node, 1], tree.nodes[node, 2]
    x, y, th = advance(x0, y0, th0, kappa, s)
    car = problem.limits
    closed, run = driven_on(tree.nodes[node, 3], tree.nodes[node, 4], kappa, s, car)
    slot, key = slot_of(tree, problem.space, x, y, th, run < 0.0)
    if slot < 0:
        return
    time = closed + run_time(abs(run), car.v, car.a)
    if time >= tree.table[slot] - 1e-4:
        return
    estimate = _estimate(problem, (x, y, th), closed, run, out)
    if estimate >= tree.best[0] * BEAT or estimate == math.inf:
        return
    if not arc_free(problem.world, x0, y0, th0, kappa, s):
        return
    tree.keys[slot], tree.table[slot] = key, time
    n = add_node(tree, (x, y, th), (node, slot), (closed, run, estimate))
    tree.arcs[n, 0], tree.arcs[n, 1] = kappa, s


@kernel
def expand(tree: Tree, problem: PoseSearch, budget: int) -> int:
    """Expand up to ``budget`` nodes. Returns 0: more to do, 1: done (see ``tree.best``), 2: the
    open list ran empty, 3: the tree is full.
    """
    out = np.empty((5, 2))
    space, steps, car = problem.space, problem.steps, problem.limits
    for _ in range(budget):
        if tree.counters[1] == 0:
            return 1 if tree.counters[3] >= 0 else 2
        if tree.counters[0] + steps.shape[0] > tree.nodes.shape[0]:
            return 1 if tree.counters[3] >= 0 else 3
        if tree.counters[3] >= 0 and tree.counters[2] > tree.counters[4] + space.extra:
            return 1
        node = pop(tree.heap, tree.nodes, tree.counters)
        if tree.nodes[node, 5] >= tree.best[0] * BEAT:
            return 1
        run = tree.nodes[node, 4]
        time = tree.nodes[node, 3] + run_time(abs(run), car.v, car.a)
        # the table is float32: 1e-6 would drop nodes of long drives
        if node > 0 and time > tree.table[tree.links[node, 1]] + 5e-5:
            continue  # a better way to the same cell was found meanwhile
        tree.counters[2] += 1
        _shoot(tree, problem, node, out)
        for i in range(steps.shape[0]):
            _grow(tree, problem, node, steps[i, 0], steps[i, 1], out)
    return 0


def solution(tree: Tree) -> FloatArray:
    """Return the arcs (n, 2) of the best solution."""
    rows = []
    node = int(tree.counters[3])
    while node > 0:
        rows.append(tree.arcs[node].copy())
        node = int(tree.links[node, 0])
    return np.vstack([*rows[::-1], tree.tail[: tree.counters[5]]])


def clear(tree: Tree) -> None:
    """Forget the tree's nodes in the table, so that the arrays can be used again."""
    slots = tree.links[1 : tree.counters[0], 1]
    tree.table[slots], tree.keys[slots] = math.inf, -1
    tree.counters[:] = 0


def new_tree(nodes: int) -> Tree:
    """Return an empty tree for up to ``nodes`` nodes."""
    slots = 1 << (2 * nodes).bit_length()
    return Tree(
        np.empty((nodes, 6)),
        np.empty((nodes, 2)),
        np.empty((nodes, 2), dtype=np.int64),
        np.empty(nodes, dtype=np.int64),
        np.full(slots, -1, dtype=np.int64),
        np.full(slots, np.inf, dtype=np.float32),
        np.zeros(6, dtype=np.int64),
        np.full(1, np.inf),
        np.empty((5, 2)),
    )
