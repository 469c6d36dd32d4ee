"""Kernels for bodies that move in any direction: A* over (x, y, theta), straight shortcuts."""

from __future__ import annotations

import math

import numpy as np

from up_samp.geometry.kernels import clearance
from up_samp.geometry.records import WorldData, inner, kernel
from up_samp.geometry.ways import piece_obeys
from up_samp.model import Kinematics
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import DriveLimits, Pose, run_time, wrapped
from up_samp.motion.curves.trapezoid import limits_of
from up_samp.motion.guides.cost_to_go import field_value
from up_samp.motion.guides.heap import pop
from up_samp.motion.planners.car_shortcuts import random_share
from up_samp.motion.planners.hybrid_astar import PoseSearch, Tree, add_node, slot_of

Move = tuple[float, float, float]
"""A straight move (dx m, dy m, turn rad): the body goes straight and turns evenly."""


def planar_limits(kinematics: Kinematics) -> DriveLimits:
    """Return the limits of a body that moves in any direction."""
    return limits_of(kinematics)._replace(omega=float(kinematics.omega_max))


@inner
def _free_share(world: WorldData, pose: Pose, move: Move, least: float) -> float:
    """Return the share of a straight motion up to which it keeps the margin and ``least`` m (1: all
    the way). Conservative advancement.
    """
    (x, y, th), (dx, dy, turn) = pose, move
    reach = math.sqrt(dx * dx + dy * dy) + abs(turn) * world.shape.radius
    share = 0.0
    while share < 1.0:
        c = clearance(world, x + share * dx, y + share * dy, th + share * turn)
        if c < least:
            return share
        if reach <= 0.0:
            break
        share += c / reach
    return 1.0


@kernel
def straight_free(world: WorldData, pose: Pose, move: Move) -> bool:
    """Return whether a straight move from a pose keeps the margin all the way.

    Refuses what comes closer than a tenth of the shape's smallest slack, too, and what breaks a
    rule of ways.
    """
    (x, y, _), (dx, dy, turn) = pose, move
    if not piece_obeys(world.shape.ways, x, y, x + dx, y + dy, turn, 0.0):
        return False
    return _free_share(world, pose, move, 0.1 * world.shape.slack[2]) >= 1.0


@inner
def _cost(move: Move, limits: DriveLimits) -> float:
    """Return the time (s) of a straight move at full speed."""
    dx, dy, turn = move
    return max(math.sqrt(dx * dx + dy * dy) / limits.v, abs(turn) / limits.omega)


@inner
def _to_go(problem: PoseSearch, x: float, y: float, th: float) -> float:
    field, goal, limits = problem.field, problem.goal, problem.limits
    dx, dy = goal[0] - x, goal[1] - y
    far = math.sqrt(dx * dx + dy * dy)
    if field.values.shape[0] > 0:
        far = max(far, field_value(field, x, y))
    return max(far / limits.v, abs(wrapped(goal[2] - th)) / limits.omega)


@inner
def _grown(tree: Tree, problem: PoseSearch, node: int, move: Move) -> bool:
    """Add the pose a straight move away from ``node`` to the tree, where it is free and the
    soonest way there; return False where something is in the way of the move.
    """
    pose = tree.nodes[node, 0], tree.nodes[node, 1], tree.nodes[node, 2]
    x, y, th = pose[0] + move[0], pose[1] + move[1], pose[2] + move[2]
    slot, key = slot_of(tree, problem.space, x, y, th, False)
    if slot < 0:
        return True
    time = tree.nodes[node, 3] + _cost(move, problem.limits)
    if time >= tree.table[slot] - 1e-4:
        return True
    rest = _to_go(problem, x, y, th)
    if rest == math.inf or not straight_free(problem.world, pose, move):
        return False
    tree.keys[slot], tree.table[slot] = key, time
    add_node(tree, (x, y, th), (node, slot), (time, 0.0, time + problem.space.weight * rest))
    return True


@kernel
def expand_planar(tree: Tree, problem: PoseSearch, budget: int) -> int:
    """Expand up to ``budget`` nodes towards the goal.

    Returns 0: more to do, 1: reached by a straight move from node ``counters[3]``, 2: the open
    list ran empty, 3: the tree is full.
    """
    world, steps, goal = problem.world, problem.steps, problem.goal
    for _ in range(budget):
        if tree.counters[1] == 0:
            return 2
        if tree.counters[0] + 3 * steps.shape[0] > tree.nodes.shape[0]:
            return 3
        node = pop(tree.heap, tree.nodes, tree.counters)
        pose = tree.nodes[node, 0], tree.nodes[node, 1], tree.nodes[node, 2]
        # the table is float32: 1e-6 would drop nodes of long drives
        if node > 0 and tree.nodes[node, 3] > tree.table[tree.links[node, 1]] + 5e-5:
            continue
        tree.counters[2] += 1
        way = goal[0] - pose[0], goal[1] - pose[1], wrapped(goal[2] - pose[2])
        if straight_free(world, pose, way):
            tree.counters[3] = node
            return 1
        for i in range(steps.shape[0]):
            dx, dy, turn = steps[i, 0], steps[i, 1], steps[i, 2]
            if _grown(tree, problem, node, (dx, dy, turn)):
                continue
            if problem.space.tight:
                # a little short of what straight_free takes: from there it must pass again
                free = _free_share(world, pose, (dx, dy, turn), 0.2 * world.shape.slack[2])
                for part in (0.5 * free, free):
                    if 0.02 < part < 1.0:  # too short a slide leads nowhere
                        _grown(tree, problem, node, (part * dx, part * dy, part * turn))
    return 0


@inner
def _rest_time(move: Move, limits: DriveLimits) -> float:
    """Return the rest-to-rest time (s) of a straight move."""
    dx, dy, turn = move
    way = math.sqrt(dx * dx + dy * dy)
    speed = limits.v if turn == 0.0 else min(limits.v, way * limits.omega / abs(turn))
    if way < 1e-9 or speed < 1e-9:
        return abs(turn) / limits.omega
    return run_time(way, speed, limits.a)


@inner
def _to(a: FloatArray, b: FloatArray) -> Move:
    """Return the straight move between two poses."""
    return b[0] - a[0], b[1] - a[1], b[2] - a[2]


@inner
def _point(nodes: FloatArray, n: int, p: float) -> tuple[float, float, float]:
    i = min(int(p), n - 2)
    f = p - i
    return (
        nodes[i, 0] + f * (nodes[i + 1, 0] - nodes[i, 0]),
        nodes[i, 1] + f * (nodes[i + 1, 1] - nodes[i, 1]),
        nodes[i, 2] + f * (nodes[i + 1, 2] - nodes[i, 2]),
    )


@inner
def _added(out: FloatArray, m: int, pose: FloatArray) -> int:
    """Write a pose after the first ``m`` of a chain, unless it is where the last one is; return how
    many there are then.
    """
    same = m > 0
    for d in range(3):
        out[m, d] = pose[d]
        same = same and abs(pose[d] - out[m - 1, d]) < 1e-12
    return m if same else m + 1


@inner
def _bridged(
    nodes: FloatArray, n: int, f: int, g: int, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, int]:
    """Return the chain with the poses ``a`` and ``b`` between its nodes ``f`` and ``g``."""
    out = np.empty((n + 2, 3))
    m = 0
    for k in range(f + 1):
        m = _added(out, m, nodes[k])
    m = _added(out, _added(out, m, a), b)
    for k in range(g, n):
        m = _added(out, m, nodes[k])
    return out, m


@kernel
def shortened(
    world: WorldData, chain: FloatArray, limits: DriveLimits, rounds: int, seed: int
) -> FloatArray:
    """Return a chain of straight moves (n, 3) that takes no longer, by random shortcuts.

    Deterministic for ``seed``.
    """
    state = np.empty(1, dtype=np.int64)
    state[0] = seed + 1
    nodes, n = chain.copy(), chain.shape[0]
    a, b = np.empty(3), np.empty(3)
    for r in range(rounds):
        if n < 3:
            break
        p, q = random_share(state) * (n - 1), random_share(state) * (n - 1)
        if r % 2 == 0:  # whole pieces
            p, q = math.floor(p + 0.5), math.floor(q + 0.5)
        p, q = min(p, q), max(p, q)
        f, g = math.floor(p), math.ceil(q)
        if g - f < 2:
            continue
        a[0], a[1], a[2] = _point(nodes, n, p)
        b[0], b[1], b[2] = _point(nodes, n, q)
        new = _rest_time(_to(a, nodes[f]), limits)
        new += _rest_time(_to(b, nodes[g]), limits)
        new += _rest_time(_to(a, b), limits)
        old = 0.0
        for k in range(f, g):
            old += _rest_time(_to(nodes[k + 1], nodes[k]), limits)
        if new < old - 1e-6 and straight_free(world, (a[0], a[1], a[2]), _to(a, b)):
            nodes, n = _bridged(nodes, n, f, g, a, b)
    return nodes[:n].copy()
