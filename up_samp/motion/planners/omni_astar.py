"""Kernels for bodies that move in any direction: A* over (x, y, theta), straight shortcuts."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner, kernel
from up_samp.geometry.kernels import GridData, PolyData, ShapeData, clearance
from up_samp.motion.curves.reeds_shepp import run_time
from up_samp.motion.guides.heap import pop, push
from up_samp.motion.guides.search_space import Space
from up_samp.motion.planners.car_shortcuts import _random
from up_samp.motion.planners.hybrid_astar import Field, Tree, _key, field_value

FloatArray = npt.NDArray[np.float64]

SLIDE = 0.02
"""Shares of a step that are too short for a slide."""


@inner
def _free_share(
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    x: float,
    y: float,
    th: float,
    dx: float,
    dy: float,
    turn: float,
    least: float,
) -> float:
    """Return the share of a straight motion up to which it keeps the margin and ``least`` m (1: all
    the way). Conservative advancement.
    """
    reach = math.sqrt(dx * dx + dy * dy) + abs(turn) * shape.numbers[0]
    share = 0.0
    while share < 1.0:
        c = clearance(grid, polys, shape, x + share * dx, y + share * dy, th + share * turn)
        if c < least:
            return share
        if reach <= 0.0:
            break
        share += c / reach
    return 1.0


@kernel
def straight_free(
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    x: float,
    y: float,
    th: float,
    dx: float,
    dy: float,
    turn: float,
) -> bool:
    """Return whether moving straight by (dx, dy) while turning evenly keeps the margin all the way.

    Refuses what comes closer than a tenth of the shape's smallest slack, too.
    """
    least = 0.1 * shape.slack[2]
    return _free_share(grid, polys, shape, x, y, th, dx, dy, turn, least) >= 1.0


@inner
def _wrapped(angle: float) -> float:
    angle = angle % (2.0 * math.pi)
    return angle - 2.0 * math.pi if angle > math.pi else angle


@inner
def _cost(dx: float, dy: float, turn: float, limits: FloatArray) -> float:
    """Return the time (s) of a straight piece at full speed; ``limits``: v, omega."""
    return max(math.sqrt(dx * dx + dy * dy) / limits[0], abs(turn) / limits[1])


@inner
def _to_go(
    field: Field, x: float, y: float, th: float, goal: FloatArray, limits: FloatArray
) -> float:
    dx, dy = goal[0] - x, goal[1] - y
    far = math.sqrt(dx * dx + dy * dy)
    if field.values.shape[0] > 0:
        far = max(far, field_value(field, x, y))
    return max(far / limits[0], abs(_wrapped(goal[2] - th)) / limits[1])


@inner
def _grown(
    tree: Tree,
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    field: Field,
    space: Space,
    node: int,
    dx: float,
    dy: float,
    dth: float,
    goal: FloatArray,
    limits: FloatArray,
) -> bool:
    """Add the pose a straight step away from ``node`` to the tree, where it is free and the
    soonest way there; return False where something is in the way of the step.
    """
    x, y, th = tree.nodes[node, 0], tree.nodes[node, 1], tree.nodes[node, 2]
    key = _key(space, x + dx, y + dy, th + dth, False)
    if key < 0:
        return True
    time = tree.nodes[node, 3] + _cost(dx, dy, dth, limits)
    if time >= tree.table[key] - 1e-4:
        return True
    rest = _to_go(field, x + dx, y + dy, th + dth, goal, limits)
    if rest == math.inf or not straight_free(grid, polys, shape, x, y, th, dx, dy, dth):
        return False
    tree.table[key] = time
    n = tree.counters[0]
    tree.counters[0] += 1
    tree.nodes[n, 0], tree.nodes[n, 1], tree.nodes[n, 2] = x + dx, y + dy, th + dth
    tree.nodes[n, 3], tree.nodes[n, 5] = time, time + space.weight * rest
    tree.links[n, 0], tree.links[n, 1] = node, key
    push(tree.heap, tree.nodes, tree.counters, n)
    return True


@kernel
def expand_planar(
    tree: Tree,
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    field: Field,
    space: Space,
    steps: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    limits: FloatArray,
    tight: bool,
    budget: int,
) -> int:
    """Expand up to ``budget`` nodes towards ``goal``; plants the tree if it is empty.

    ``steps`` (n, 3): primitive moves. ``space.weight``: of the time to
    go. ``limits``: v (m/s), omega (rad/s). ``tight``:
    where a step does not go all the way, slide up to what is in the way, and half as far: so the
    tree gets into gaps that are narrower than its steps. Returns 0: more to do, 1: reached
    by a straight piece from node ``counters[3]``, 2: the open list ran empty, 3: the tree is full.
    """
    if tree.counters[0] == 0:
        for i in range(3):
            tree.nodes[0, i] = start[i]
        tree.nodes[0, 3] = tree.nodes[0, 5] = 0.0
        tree.links[0, 0] = -1
        tree.links[0, 1] = _key(space, start[0], start[1], start[2], False)
        tree.counters[0] = 1
        tree.counters[3] = -1
        push(tree.heap, tree.nodes, tree.counters, 0)
    for _ in range(budget):
        if tree.counters[1] == 0:
            return 2
        if tree.counters[0] + 3 * steps.shape[0] > tree.nodes.shape[0]:
            return 3
        node = pop(tree.heap, tree.nodes, tree.counters)
        x, y, th = tree.nodes[node, 0], tree.nodes[node, 1], tree.nodes[node, 2]
        # the table is float32: 1e-6 would drop nodes of long drives
        if node > 0 and tree.nodes[node, 3] > tree.table[tree.links[node, 1]] + 5e-5:
            continue
        tree.counters[2] += 1
        turn = _wrapped(goal[2] - th)
        if straight_free(grid, polys, shape, x, y, th, goal[0] - x, goal[1] - y, turn):
            tree.counters[3] = node
            return 1
        for i in range(steps.shape[0]):
            dx, dy, dth = steps[i, 0], steps[i, 1], steps[i, 2]
            if _grown(tree, grid, polys, shape, field, space, node, dx, dy, dth, goal, limits):
                continue
            if tight:
                # a little short of what straight_free takes: from there it must pass again
                least = 0.2 * shape.slack[2]
                free = _free_share(grid, polys, shape, x, y, th, dx, dy, dth, least)
                for part in (0.5 * free, free):
                    if SLIDE < part < 1.0:
                        _grown(
                            tree, grid, polys, shape, field, space, node,
                            part * dx, part * dy, part * dth, goal, limits,
                        )  # fmt: skip
    return 0


@inner
def _rest_time(dx: float, dy: float, turn: float, limits: FloatArray) -> float:
    """Return the rest-to-rest time (s) of a straight piece; ``limits``: v, omega, a."""
    way = math.sqrt(dx * dx + dy * dy)
    speed = limits[0] if turn == 0.0 else min(limits[0], way * limits[1] / abs(turn))
    if way < 1e-9 or speed < 1e-9:
        return abs(turn) / limits[1]
    return run_time(way, speed, limits[2])


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
def _between(nodes: FloatArray, i: int, x: float, y: float, th: float, limits: FloatArray) -> float:
    return _rest_time(nodes[i, 0] - x, nodes[i, 1] - y, nodes[i, 2] - th, limits)


@inner
def _bridged(
    nodes: FloatArray, n: int, f: int, g: int, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, int]:
    """Return the chain with the poses ``a`` and ``b`` between its nodes ``f`` and ``g``."""
    out = np.empty((n + 2, 3))
    m = 0
    for k in range(f + 1):
        for d in range(3):
            out[m, d] = nodes[k, d]
        m += 1
    for pose in (a, b):
        same = True
        for d in range(3):
            out[m, d] = pose[d]
            same = same and abs(out[m, d] - out[m - 1, d]) < 1e-12
        m += 0 if same else 1
    for k in range(g, n):
        same = True
        for d in range(3):
            out[m, d] = nodes[k, d]
            same = same and abs(out[m, d] - out[m - 1, d]) < 1e-12
        m += 0 if same else 1
    return out, m


@kernel
def shortened(
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    chain: FloatArray,
    limits: FloatArray,
    rounds: int,
    seed: int,
) -> FloatArray:
    """Return a chain of straight pieces (n, 3) that takes no longer, by random shortcuts.

    ``limits``: v (m/s), omega (rad/s), a (m/s^2). Deterministic for ``seed``.
    """
    state = np.empty(1, dtype=np.int64)
    state[0] = seed + 1
    nodes, n = chain.copy(), chain.shape[0]
    a, b = np.empty(3), np.empty(3)
    for r in range(rounds):
        if n < 3:
            break
        p, q = _random(state) * (n - 1), _random(state) * (n - 1)
        if r % 2 == 0:  # whole pieces
            p, q = math.floor(p + 0.5), math.floor(q + 0.5)
        p, q = min(p, q), max(p, q)
        f, g = math.floor(p), math.ceil(q)
        if g - f < 2:
            continue
        a[0], a[1], a[2] = _point(nodes, n, p)
        b[0], b[1], b[2] = _point(nodes, n, q)
        new = _between(nodes, f, a[0], a[1], a[2], limits)
        new += _between(nodes, g, b[0], b[1], b[2], limits)
        new += _rest_time(b[0] - a[0], b[1] - a[1], b[2] - a[2], limits)
        old = 0.0
        for k in range(f, g):
            old += _between(nodes, k, nodes[k + 1, 0], nodes[k + 1, 1], nodes[k + 1, 2], limits)
        if new < old - 1e-6 and straight_free(
            grid, polys, shape, a[0], a[1], a[2], b[0] - a[0], b[1] - a[1], b[2] - a[2]
        ):
            nodes, n = _bridged(nodes, n, f, g, a, b)
    return nodes[:n].copy()
