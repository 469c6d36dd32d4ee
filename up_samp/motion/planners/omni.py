"""Motions of bodies that move in any direction (SE2): A* over (x, y, theta), straight shortcuts,
blended corners.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from up_samp.geometry import Scene, Shape
from up_samp.geometry.kernels import clearance, piece_obeys
from up_samp.geometry.records import WorldData, inner, kernel, lean_inner, lean_kernel
from up_samp.model import Deadline, Kinematics, MotionModel, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.blending import chain_time, glide, moved_corner, pieces
from up_samp.motion.curves.reeds_shepp import DriveLimits, Pose, run_time, wrapped
from up_samp.motion.curves.trapezoid import limits_of
from up_samp.motion.guides import (
    DRY,
    OUT_OF_TIME,
    STUCK,
    TOUCHES,
    Fields,
    field_value,
    pop,
    pose_space,
    widest_shape,
)
from up_samp.motion.planners.car import PivotPlanner, random_share
from up_samp.motion.planners.hybrid_astar import (
    PoseSearch,
    Tree,
    add_node,
    new_tree,
    plant,
    slot_of,
)
from up_samp.motion.protocol import Leg, LegQuery, WorkBudget

Move = tuple[float, float, float]
"""A straight move (dx m, dy m, turn rad): the body goes straight and turns evenly."""


def planar_limits(kinematics: Kinematics) -> DriveLimits:
    """Return the limits of a body that moves in any direction."""
    return limits_of(kinematics)._replace(omega=float(kinematics.omega_max))


@lean_inner
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


@lean_kernel
def straight_free(world: WorldData, pose: Pose, move: Move) -> bool:
    """Return whether a straight move from a pose keeps the margin all the way.

    Refuses what comes closer than a tenth of the shape's smallest slack, too, and what breaks a
    rule of ways.
    """
    (x, y, _), (dx, dy, turn) = pose, move
    if not piece_obeys(world.shape.ways, x, y, x + dx, y + dy, turn, 0.0):
        return False
    return _free_share(world, pose, move, 0.1 * world.shape.slack[2]) >= 1.0


@lean_inner
def _cost(move: Move, limits: DriveLimits) -> float:
    """Return the time (s) of a straight move at full speed."""
    dx, dy, turn = move
    return max(math.sqrt(dx * dx + dy * dy) / limits.v, abs(turn) / limits.omega)


@lean_inner
def _to_go(problem: PoseSearch, x: float, y: float, th: float) -> float:
    field, goal, limits = problem.field, problem.goal, problem.limits
    dx, dy = goal[0] - x, goal[1] - y
    far = max(math.sqrt(dx * dx + dy * dy), field_value(field, x, y))
    return max(far / limits.v, abs(wrapped(goal[2] - th)) / limits.omega)


@lean_inner
def _stepped(tree: Tree, problem: PoseSearch, node: int, move: Move) -> bool:
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


@lean_kernel
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
            if _stepped(tree, problem, node, (dx, dy, turn)):
                continue
            if problem.space.tight:
                # a little short of what straight_free takes: from there it must pass again
                free = _free_share(world, pose, (dx, dy, turn), 0.2 * world.shape.slack[2])
                for part in (0.5 * free, free):
                    if 0.02 < part < 1.0:  # too short a slide leads nowhere
                        _stepped(tree, problem, node, (part * dx, part * dy, part * turn))
    return 0


@lean_inner
def _rest_time(move: Move, limits: DriveLimits) -> float:
    """Return the rest-to-rest time (s) of a straight move."""
    dx, dy, turn = move
    way = math.sqrt(dx * dx + dy * dy)
    speed = limits.v if turn == 0.0 else min(limits.v, way * limits.omega / abs(turn))
    if way < 1e-9 or speed < 1e-9:
        return abs(turn) / limits.omega
    return run_time(way, speed, limits.a)


@lean_inner
def _to(a: FloatArray, b: FloatArray) -> Move:
    """Return the straight move between two poses."""
    return b[0] - a[0], b[1] - a[1], b[2] - a[2]


@lean_inner
def _point(nodes: FloatArray, n: int, p: float) -> tuple[float, float, float]:
    i = min(int(p), n - 2)
    f = p - i
    return (
        nodes[i, 0] + f * (nodes[i + 1, 0] - nodes[i, 0]),
        nodes[i, 1] + f * (nodes[i + 1, 1] - nodes[i, 1]),
        nodes[i, 2] + f * (nodes[i + 1, 2] - nodes[i, 2]),
    )


@lean_inner
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


# ------------------ The planner


GAIN = 1e-3
"""Seconds that a corner's new place must save."""


Way = tuple[Trajectory, FloatArray]
"""A motion, and the nodes (n, 3) of the straight pieces that it blends, theta continuous."""


class PlanarGrain(NamedTuple):
    """A resolution: ``step`` in inner radii of the footprint, ``bins`` of headings, size of the
    search tree in ``nodes``. With a ``cell`` (m), by which poses are told apart: slide along walls
    into gaps narrower than the steps.
    """

    step: float
    bins: int
    nodes: int
    cell: float = math.inf

    @property
    def tight(self) -> bool:
        """Whether it slides."""
        return math.isfinite(self.cell)


@dataclass(frozen=True)
class PlanarSettings:
    """Effort of the planar planner: the searches, in the order in which they are tried, ``finer``
    ones where the others find nothing.
    ``roundabout``: what takes longer than so many times the shortest way of a disc is sought from
    its goal as well, where the steps fall elsewhere. ``soon``: nodes expanded, after which
    a way is sought from the goal as well, with as many. ``tries``: how often a way is cut short by
    ``rounds`` random shortcuts; the fastest counts. ``shifts`` (inner radii): by how much corners
    are pushed outwards.
    """

    grains: tuple[PlanarGrain, ...] = (
        PlanarGrain(1.0, 16, 60_000),
        PlanarGrain(0.5, 24, 250_000),
    )
    finer: tuple[PlanarGrain, ...] = (
        PlanarGrain(0.25, 36, 400_000),
        PlanarGrain(0.5, 24, 60_000, cell=0.02),
    )
    soon: int = 1000
    rounds: int = 600
    shifts: tuple[float, ...] = (0.25, 1.0, 0.5, 0.125)
    roundabout: float = 1.15
    tries: int = 4


class PlanarPlanner:
    """Plans legs of omnidirectional bodies in one scene. Deterministic for a seed."""

    name = "planar-astar"
    reversible = True

    def __init__(
        self, scene: Scene, seed: int = 0, settings: PlanarSettings = PlanarSettings()
    ) -> None:
        self.scene = scene
        self.seed = seed
        self.settings = settings
        self.fields = Fields(scene)

    @classmethod
    def quick(cls, scene: Scene, seed: int = 0) -> PlanarPlanner:
        """Return a planner that gives up after little work, for detours."""
        grains = (PlanarGrain(1.0, 16, 20_000),)
        few = PlanarSettings(grains, (), rounds=200, shifts=(0.25,), roundabout=math.inf, tries=1)
        return cls(scene, seed, few)

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a fast motion between two poses among resting obstacles."""
        budget = WorkBudget(deadline, query.effort)
        ends = query.start, query.goal
        shape = widest_shape(self.scene, query.body, ends, query.obstacles)
        if shape is None:
            return Leg(None, TOUCHES, complete=True)
        grains = self.settings.grains
        leg = self._one_way(query, shape, budget, grains)
        if leg.trajectory is None and self.settings.finer:
            grains = self.settings.finer
            leg = self._through_bends(query, shape, budget)
        if not leg.complete or leg.trajectory is None:
            return leg
        if not self._is_roundabout(query, shape, leg.trajectory):
            return leg
        turned = replace(query, start=query.goal, goal=query.start)
        back = self._one_way(turned, shape.turned, budget, grains)
        if back.trajectory is None or back.trajectory.duration > leg.trajectory.duration - GAIN:
            return replace(leg, effort=budget.used, complete=not budget.cut)
        return back.turned(query.start)

    def _through_bends(self, query: LegQuery, shape: Shape, budget: WorkBudget) -> Leg:
        """Return the faster of a motion on wheels, which takes little time to find, and one by the
        finer searches.
        """
        driven = self._on_wheels(query, shape, budget)
        leg = self._one_way(query, shape, budget, self.settings.finer)
        soonest, other = (one.trajectory for one in (leg, driven))
        if other is not None and (soonest is None or other.duration < soonest.duration):
            leg = driven
        return replace(leg, effort=budget.used, complete=not budget.cut)

    def _on_wheels(self, query: LegQuery, shape: Shape, budget: WorkBudget) -> Leg:
        """Return a motion that always leads along the heading, or turns on the spot: in bends as
        thin as the body there are no straight moves, and no others.
        """
        kin, radius = query.body.kinematics, 4.0 * shape.inner[2]  # of its bends
        if kin.reach:  # turns on the spot begin at once, which nothing far off can follow
            return Leg(None, "not in formation", complete=True)
        # the acceleration is shared by what leads ahead and what leads round
        push = float(kin.a_max) / math.sqrt(2)
        v = min(float(kin.v_max), math.sqrt(push * radius), float(kin.omega_max) * radius)
        wheels = replace(
            kin, model=MotionModel.PIVOT, v_max=v, a_max=push, omega_max=v / radius,
            drives_along=False,
        )  # fmt: skip
        effort = None if budget.effort is None else max(0, budget.effort - budget.used)
        asked = replace(query, body=replace(query.body, kinematics=wheels), effort=effort)
        leg = PivotPlanner(self.scene, self.seed).leg(asked, budget.deadline)
        budget.used += leg.effort
        budget.cut = budget.cut or not leg.complete
        return leg

    def _is_roundabout(self, query: LegQuery, shape: Shape, motion: Trajectory) -> bool:
        """Return whether a motion takes much longer than the shortest way of the disc in the body
        and the turn on it.
        """
        limits, (x, y, th) = query.body.kinematics, map(float, query.start[:3])
        turn = abs(math.remainder(float(query.goal[2]) - th, 2 * math.pi)) / float(limits.omega_max)

        def slow(metres: float) -> bool:
            least = max(run_time(metres, float(limits.v_max), float(limits.a_max)), turn)
            return motion.duration > self.settings.roundabout * least + GAIN

        # most legs are hardly longer than the beeline, and a field of the whole map is dear
        beeline = math.dist((x, y), query.goal[:2])
        if not slow(beeline):
            return False
        field = self.fields.toward(shape, query.goal, query.obstacles)
        metres = float(field_value(field, x, y))
        return slow(max(metres, beeline) if math.isfinite(metres) else beeline)

    def _one_way(
        self,
        query: LegQuery,
        shape: Shape,
        budget: WorkBudget,
        grains: Sequence[PlanarGrain],
    ) -> Leg:
        """Return a motion by searches from the start. One whose steps do not lead out of a nook
        around the goal has its turn after all others: it would look everywhere else first.
        """
        reason = OUT_OF_TIME
        enclosed: list[PlanarGrain] = []
        for k, grain in enumerate(itertools.chain(grains, enclosed)):
            if k > 0 and budget.spent():
                break
            own = shape.finer if grain.tight else shape
            nodes, why = self._search(query, own, grain, budget, wholly=k >= len(grains))
            if nodes is None:
                reason = why
                if not why:
                    enclosed.append(grain)
                continue
            found = min(self._short(query, own, nodes), key=_duration, default=None)
            if found is not None:
                motion, chain = self._rounded(query, own, found, budget)
                return Leg(motion, "", budget.used, not budget.cut, chain)
            reason = "no safe timing along the path found"
        reason = OUT_OF_TIME if budget.cut else reason
        return Leg(None, reason, budget.used, not budget.cut)

    def _short(self, query: LegQuery, shape: Shape, nodes: FloatArray) -> Iterator[Way]:
        """Yield motions along a way that is cut short at random, and their nodes."""
        world, kin = self.scene.world(shape, query.obstacles), query.body.kinematics
        limits, cuts = planar_limits(kin), self.settings
        for n in range(cuts.tries):
            chain = pieces(shortened(world, nodes, limits, cuts.rounds, self.seed + n))
            found = glide(world, kin, chain, query.goal)
            if found is not None:
                yield found[0], chain

    def _search(
        self,
        query: LegQuery,
        shape: Shape,
        grain: PlanarGrain,
        budget: WorkBudget,
        wholly: bool = False,
    ) -> tuple[FloatArray | None, str]:
        """Run A* at one resolution; return the chain, or None and why. If none is found soon, one
        from the goal is sought as long: steps from there fall elsewhere, and lead through a gap
        that these miss. If they do not even lead out of a nook, there is no why, unless all is to
        be searched ``wholly``.
        """
        turn = math.remainder(query.goal[2] - query.start[2], 2 * math.pi)
        ends = np.array([query.start[:3], (*query.goal[:2], query.start[2] + turn)])
        world = self.scene.world(shape, query.obstacles)
        if straight_free(world, _floats(ends[0]), _floats(ends[1] - ends[0])):
            return ends, ""
        soon, problem = self.settings.soon, self._problem(query, shape, grain)
        tree = _planted(query, grain.nodes)
        state = _grown(tree, problem, budget, soon)
        if state == 0 and not wholly and not budget.spent():
            turned = replace(query, start=query.goal, goal=query.start)
            back = _planted(turned, min(grain.nodes, 40 * soon))
            met = _grown(back, self._problem(turned, shape.turned, grain), budget, soon)
            if met == 1:
                rows = _chain(back, turned)[::-1].copy()
                rows[:, 2] += ends[0, 2] - rows[0, 2]  # whole turns
                return rows, ""
            if met == 2:
                return None, ""
        while state == 0 and not budget.spent():
            state = _grown(tree, problem, budget, 4000)  # between two looks at the clock
        if state != 1:
            return None, DRY if state == 2 else STUCK
        return _chain(tree, query), ""

    def _problem(self, query: LegQuery, shape: Shape, grain: PlanarGrain) -> PoseSearch:
        """Return what one search is about, at one resolution."""
        ends, obstacles, bins = (query.start, query.goal), query.obstacles, grain.bins
        step = grain.step * shape.inner[2]
        cell = min(step, grain.cell)
        space = pose_space(self.scene, ends, obstacles, 16 * shape.circumscribed, cell, bins)
        moves = [(i * step, j * step, 0.0) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
        moves += [(0.0, 0.0, 2 * math.pi / bins), (0.0, 0.0, -2 * math.pi / bins)]
        return PoseSearch(
            world=self.scene.world(shape, obstacles),
            limits=planar_limits(query.body.kinematics),
            goal=_floats(query.goal),
            field=self.fields.toward(shape, query.goal, obstacles),
            space=space._replace(weight=1.15, tight=grain.tight),
            steps=np.array(moves),
        )

    def _rounded(self, query: LegQuery, shape: Shape, way: Way, budget: WorkBudget) -> Way:
        """Return a motion that is not slower, and its nodes: corners pushed outwards or cut in two.

        A shortest path hugs the inner side of every corner, where a blend has no room.
        """
        slower = math.inf
        while _duration(way) < slower - GAIN:
            slower = _duration(way)
            for pushed in itertools.product(self.settings.shifts, (0.0, 1.0)):
                way = self._pushed(query, shape, way, pushed, budget)
        return way

    def _pushed(
        self,
        query: LegQuery,
        shape: Shape,
        way: Way,
        pushed: tuple[float, float],
        budget: WorkBudget,
    ) -> Way:
        """Return a motion with those corners ``pushed`` (outwards in inner, and cut in
        circumscribed radii) that are passed sooner then, and its nodes.
        """
        (motion, nodes), (shift, cut) = way, pushed
        world, body = self.scene.world(shape, query.obstacles), query.body
        i = 1
        while i < len(nodes) - 1 and not budget.spent():
            trial = moved_corner(nodes, i, shift * shape.inner[2], cut * shape.circumscribed)
            i += 1
            if trial is None or chain_time(trial, body) > motion.duration - GAIN:
                continue
            if not all(
                straight_free(world, _floats(a), _floats(b - a))
                for a, b in itertools.pairwise(trial[i - 2 : i + 2])
            ):
                continue
            faster = glide(world, body.kinematics, trial, query.goal)
            if faster is not None and faster[0].duration < motion.duration - GAIN:
                i += len(trial) - len(nodes)
                nodes, motion = trial, faster[0]
        return motion, nodes


def _planted(query: LegQuery, nodes: int) -> Tree:
    """Return a search tree of so many nodes at most, with the start of a leg."""
    tree = new_tree(nodes)
    plant(tree, np.array(query.start[:3], dtype=np.float64))
    return tree


def _grown(tree: Tree, problem: PoseSearch, budget: WorkBudget, most: int) -> int:
    """Expand up to so many nodes; return what :func:`expand_planar` does."""
    before = int(tree.counters[2])
    state = int(expand_planar(tree, problem, most))
    budget.used += int(tree.counters[2]) - before
    return state


def _chain(tree: Tree, query: LegQuery) -> FloatArray:
    """Return the nodes from the start of a leg to its goal that a search has reached (n, 3)."""
    rows, node = [np.array(query.goal[:3], dtype=np.float64)], int(tree.counters[3])
    while node >= 0:
        rows.append(tree.nodes[node, :3].copy())
        node = int(tree.links[node, 0])
    rows.reverse()
    rows[-1][2] = rows[-2][2] + math.remainder(rows[-1][2] - rows[-2][2], 2 * math.pi)
    return np.array(rows)


def _duration(way: Way) -> float:
    return way[0].duration


def _floats(row: Sequence[float] | FloatArray) -> tuple[float, float, float]:
    x, y, th = map(float, row[:3])
    return x, y, th
