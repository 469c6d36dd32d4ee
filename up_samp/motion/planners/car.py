"""Motions of bodies that drive along their heading: cars (REEDSSHEPP), and what turns on the spot
(PIVOT).

A car's way is sought by hybrid A*, then shortened by Reeds-Shepp connections, judged by time, then
timed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from up_samp.geometry import Scene, Shape
from up_samp.geometry.kernels import advance, first_blocked, first_hit, path_free
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import WorldData, inner, kernel
from up_samp.model import Configuration, Deadline, Kinematics, Trajectory
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.curves.reeds_shepp import (
    SPOT,
    TINY,
    DriveLimits,
    Pose,
    connect,
    driven_on,
    ends_of,
    fastest,
    merged,
    nodes_of,
    on_spot,
    path_time,
    reversed_arcs,
    run_time,
)
from up_samp.motion.curves.rolling import (
    moves_on,
    rolled,
    rolling_radius,
    rolling_time,
    rolls_of,
    rows_of,
    swerves,
)
from up_samp.motion.curves.trajectories import at_rest, with_ends
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.guides import (
    DRY,
    OUT_OF_TIME,
    STUCK,
    TOUCHES,
    Fields,
    least_value,
    pose_space,
    widest_shape,
)
from up_samp.motion.moves import corners_of, steer
from up_samp.motion.planners import hybrid_astar as hybrid
from up_samp.motion.protocol import Leg, LegQuery, WorkBudget


@inner
def _side(
    arcs: FloatArray, i: int, part: float, forward: bool, car: DriveLimits
) -> tuple[float, float]:
    """Return (signed length of the run at a cut, time of the complete runs beyond it).

    The cut leaves ``part`` (signed) of arc ``i`` on the side looked at: before it, or after it if
    ``forward``.
    """
    run, time = part, 0.0
    in_first = not on_spot(arcs[i, 0], car)
    if not in_first:
        run, time = 0.0, abs(arcs[i, 0] * part) / car.omega
    open_run = run
    k = i + 1 if forward else i - 1
    while 0 <= k < arcs.shape[0]:
        before = time
        time, after = driven_on(time, run, arcs[k, 0], arcs[k, 1], car)
        if in_first and time > before:  # what ends the run at the cut: that one's time is no part
            open_run, in_first = run, False
            time -= run_time(abs(run), car.v, car.a)
        run = after
        k = k + 1 if forward else k - 1
    if in_first:
        return run if abs(run) > TINY else 0.0, 0.0
    return open_run, time + run_time(abs(run), car.v, car.a)


@inner
def _cut(
    arcs: FloatArray, nodes: FloatArray, ends: FloatArray, p: float
) -> tuple[int, float, Pose]:
    """Return (arc, signed length into it, pose) at position ``p``."""
    i = min(int(np.searchsorted(ends, p)), ends.shape[0] - 1)
    into = p - (ends[i] - abs(arcs[i, 1]))
    into = min(max(into, 0.0), abs(arcs[i, 1]))
    part = into if arcs[i, 1] >= 0.0 else -into
    if abs(part - arcs[i, 1]) < 1e-9:
        return i, arcs[i, 1], (nodes[i + 1, 0], nodes[i + 1, 1], nodes[i + 1, 2])
    return i, part, advance(nodes[i, 0], nodes[i, 1], nodes[i, 2], arcs[i, 0], part)


@inner
def _copy(source: FloatArray, n: int, target: FloatArray, at: int) -> None:
    for k in range(n):
        target[at + k, 0], target[at + k, 1] = source[k, 0], source[k, 1]


class Shortcut(NamedTuple):
    """Where a path is cut: ``part`` (signed, m) of ``arc`` lies before it; there the car is at
    ``pose``. On the side that stays: the signed length of the ``run`` at the cut, the ``time`` (s)
    of the complete runs beyond it.
    """

    arc: int
    part: float
    pose: Pose
    run: float
    time: float


@inner
def _spliced(
    arcs: FloatArray, first: Shortcut, last: Shortcut, new: FloatArray, n: int
) -> FloatArray:
    """Return the path with everything between two cuts replaced."""
    i, j = first.arc, last.arc
    size = arcs.shape[0]
    out = np.empty((i + 1 + n + size - j, 2))
    _copy(arcs, i + 1, out, 0)
    out[i, 1] = first.part
    _copy(new, n, out, i + 1)
    _copy(arcs[j:], size - j, out, i + 1 + n)
    out[i + 1 + n, 1] = arcs[j, 1] - last.part
    return merged(out)


@inner
def random_share(state: IntArray) -> float:
    """Return the next number in [0, 1) of a linear congruential generator (Knuth's MMIX)."""
    state[0] = state[0] * 6364136223846793005 + 1442695040888963407
    return ((state[0] >> 11) & ((1 << 52) - 1)) / 4503599627370496.0


@inner
def _spread(state: IntArray) -> float:
    """Return a number of mean 0 and standard deviation 1, about normal."""
    return 2.0 * (random_share(state) + random_share(state) + random_share(state) - 1.5)


@inner
def _stretch(state: IntArray, r: int, total: float, radius: float) -> tuple[float, float]:
    """Return the positions (m along the path) between which round ``r`` replaces the path."""
    if r % 3 == 0:
        p, q = random_share(state) * total, random_share(state) * total
    else:  # local windows find what long ones cannot
        p = random_share(state) * total
        q = p + (0.5 + 8.0 * random_share(state)) * radius
    p, q = min(p, q), min(max(p, q), total)
    if r % 5 == 0:
        p = 0.0
    if r % 7 == 0:
        q = total
    return p, q


@inner
def _over(
    state: IntArray,
    middle: Shortcut,
    first: Shortcut,
    last: Shortcut,
    car: DriveLimits,
    new: FloatArray,
) -> tuple[float, int]:
    """Join two cuts over a pose near one between them, at random; fill ``new`` and return the time
    (s) with the runs at the cuts, and the number of arcs.
    """
    size = car.radius * 0.5 * 10.0 ** (-2.0 * random_share(state))
    x, y, th = middle.pose
    x += size * _spread(state)
    y += size * _spread(state)
    th += 0.3 * size / car.radius * _spread(state)
    via = x, y, th
    ahead = (1.0 if middle.run > 0.0 else -1.0) * 4.0 * car.radius
    out = np.empty((5, 2))
    _, n1 = connect(first.pose, via, car, (first.run, ahead), out)
    _copy(out, n1, new, 0)
    time, run = 0.0, first.run
    for k in range(n1):
        time, run = driven_on(time, run, new[k, 0], new[k, 1], car)
    rest, n2 = connect(via, last.pose, car, (run, last.run), out)
    _copy(out, n2, new, n1)
    return time + rest, n1 + n2


@kernel
def improve(
    world: WorldData,
    start: FloatArray,
    arcs: FloatArray,
    car: DriveLimits,
    rounds: tuple[int, int],
    seed: int,
) -> FloatArray:
    """Return a path that is not slower, by random replacements: so many ``rounds``, or so many of
    them without a gain.

    Each round cuts the path at two places and joins them by the fastest curve, directly or over a
    randomly displaced pose of the path between them. Deterministic for a seed.
    """
    state = np.empty(1, dtype=np.int64)
    state[0] = seed
    for _ in range(8):
        random_share(state)
    new = np.empty((10, 2))
    best = path_time(arcs, car)
    nodes = nodes_of(start, arcs)
    ends = ends_of(arcs)
    idle = 0
    most, patience = rounds
    for r in range(most):
        if arcs.shape[0] < 2 or idle > patience:
            break
        idle += 1
        p, q = _stretch(state, r, ends[-1], car.radius)
        if q - p < 1e-3:
            continue
        i, part, pose = _cut(arcs, nodes, ends, p)
        first = Shortcut(i, part, pose, *_side(arcs, i, part, False, car))
        i, part, pose = _cut(arcs, nodes, ends, q)
        last = Shortcut(i, part, pose, *_side(arcs, i, arcs[i, 1] - part, True, car))
        if r % 2 == 0:
            time, n = connect(first.pose, last.pose, car, (first.run, last.run), new)
        else:
            i, part, pose = _cut(arcs, nodes, ends, p + random_share(state) * (q - p))
            time, n = _over(state, Shortcut(i, part, pose, arcs[i, 1], 0.0), first, last, car, new)
        sooner = first.time + time + last.time < best - 1e-4
        if sooner and first_blocked(world, first.pose, new, n) < 0:
            arcs = _spliced(arcs, first, last, new, n)
            best = path_time(arcs, car)
            nodes = nodes_of(start, arcs)
            ends = ends_of(arcs)
            idle = 0
    return arcs


def settle(start: FloatArray, goal: FloatArray, arcs: FloatArray) -> float:
    """Return how far (m, rad: the larger) the path ends from ``goal``."""
    end = nodes_of(start, arcs)[-1]
    turn = math.remainder(float(end[2] - goal[2]), 2 * math.pi)
    return max(abs(float(end[0] - goal[0])), abs(float(end[1] - goal[1])), abs(turn))


# ------------------ The planner


@dataclass(frozen=True)
class CarSettings:
    """How hard a car's path is sought: by hybrid A* with arc primitives of ``levels`` (turning
    radii, coarse to fine), each with a tree of so many ``nodes``; then by ``rounds`` of shortening,
    so many (``patience``) without a gain. From the fourth level on a level is for ways as thin as
    the body: it is left out but where the one before gave up within the ``few``th part of this
    one's nodes, for it has about as many times the states. The clock is looked at once in a
    ``slice`` of expansions; a level is given up after so many of them that came no nearer
    (``stuck``).
    """

    levels: tuple[float, ...] = (0.7, 0.35, 0.18, 0.09, 0.045)
    nodes: tuple[int, ...] = (60_000, 250_000, 400_000, 400_000, 400_000)
    few: int = 8
    rounds: int = 1500
    patience: int = 200
    slice: int = 4000
    stuck: int = 6


QUICK = CarSettings((0.7, 0.7), (1_000, 8_000), rounds=400, patience=120)
"""Little work, for detours: most ways are found at once from one of their ends, and from the other
one not at all.
"""


def _primitives(car: DriveLimits, unit: float, share: float) -> list[tuple[float, float]]:
    """Return the arcs (curvature, signed length) that a search is made of.

    Steps are ``share`` of ``unit``, turns are as tight as can be. Where a car turns tighter than it
    is wide these lead to another heading and nowhere else: wider ones go with them.
    """
    step, radius = share * unit, car.radius
    lengths = {0.0: step, 1 / radius: share * radius, -1 / radius: share * radius}
    if unit > radius:
        lengths |= {1 / unit: step, -1 / unit: step}
    arcs = [(kappa, s) for kappa, length in lengths.items() for s in (length, -length)]
    arcs += [(0.0, 4 * step), (0.0, -4 * step)]
    arcs = [(kappa, s) for kappa, s in arcs if s * car.sense >= 0.0]
    if car.omega > 0.0:
        arcs += [(side * SPOT, share / SPOT) for side in (1.0, -1.0)]
    return arcs


class CarPlanner:
    """Plans legs of car-like bodies in one scene. Deterministic for a seed.

    The search is greedy (``Space.weight``), because a stop that is needed somewhere costs the same
    all along the way: an exact search would try all these places. The shortening makes up for it.
    """

    name = "hybrid-astar"
    reversible = True

    def __init__(self, scene: Scene, seed: int = 0, settings: CarSettings = CarSettings()) -> None:
        self.scene = scene
        self.seed = seed
        self.settings = settings
        self.fields = Fields(scene)
        self._trees: Memory[hybrid.Tree] = Memory(4)

    @classmethod
    def quick(cls, scene: Scene, seed: int = 0) -> CarPlanner:
        """Return a planner that gives up after little work, for detours."""
        return cls(scene, seed, QUICK)

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a fast motion between two poses among resting obstacles."""
        budget = WorkBudget(deadline, query.effort)
        arcs, reason = self.path(query, budget, limits_of(query.body.kinematics))
        complete = not budget.cut
        if arcs is None:
            return Leg(None, reason, budget.used, complete)
        motion = trajectory_of((query.start, query.goal), arcs, query.body.kinematics)
        return Leg(motion, reason, budget.used, complete)

    def path(
        self, query: LegQuery, budget: WorkBudget, car: DriveLimits
    ) -> tuple[FloatArray | None, str]:
        """Return arcs (n, 2) or None, and what happened; ``car``: what the body can do."""
        body, start, goal, obstacles = query.body, query.start, query.goal, query.obstacles
        shape = widest_shape(self.scene, body, (start, goal), obstacles)
        if shape is None:
            return None, TOUCHES
        world = self.scene.world(shape, obstacles)
        direct = _direct(world, query, car)
        if direct is not None:
            return direct, ""
        found: list[FloatArray] = []
        count, dry = 0, False
        sides = [False, True]  # the search from the goal's side ends in other local optima
        for level, nodes in enumerate(self.settings.nodes):
            if level >= 3 and self.settings.few * count > nodes:
                break
            for turned in tuple(sides):
                if budget.spent():
                    break
                asked, driver, form = query, car, shape
                if turned:
                    asked, form = replace(query, start=goal, goal=start), shape.turned
                    driver = car._replace(sense=-car.sense)
                arcs, count, dry = self._search(asked, driver, form, level, budget)
                if arcs is not None:
                    arcs = self._smooth(self.scene.world(form, obstacles), asked, arcs, driver)
                    found.append(reversed_arcs(arcs) if turned else arcs)
                elif dry:  # trapped, at this resolution; begin at the narrower end next time
                    trapped = count < 300  # where it began
                    sides = [turned, not turned] if trapped else [not turned, turned]
                    break
            if found or budget.cut:
                break
        if not found:
            return None, OUT_OF_TIME if budget.cut else DRY if dry else STUCK
        return min(found, key=lambda arcs: float(path_time(arcs, car))), ""

    def _search(
        self, query: LegQuery, car: DriveLimits, shape: Shape, level: int, budget: WorkBudget
    ) -> tuple[FloatArray | None, int, bool]:
        """Run hybrid A* at one resolution; return arcs or None, expansions, whether it ran dry."""
        problem = self._problem(query, car, shape, level)
        nodes = self.settings.nodes[level]
        tree = self._trees.get_or(nodes, lambda: hybrid.new_tree(nodes))
        target = np.array(problem.goal)
        hybrid.plant(tree, np.array(query.start[:3], dtype=np.float64))
        state, looked, nearest, idle = 0, 0, math.inf, 0
        while state == 0 and idle < self.settings.stuck and not budget.spent():
            # does the search still come nearer to the goal?
            new = tree.nodes[looked : tree.counters[0], :2]
            reached = (
                least_value(problem.field, new)
                if len(problem.field.values)
                else float(np.min(np.hypot(*(new - target[:2]).T), initial=math.inf))
            )
            idle = 0 if reached < nearest or tree.counters[3] >= 0 else idle + 1
            looked, nearest = int(tree.counters[0]), min(nearest, reached)
            before = int(tree.counters[2])
            state = hybrid.expand(tree, problem, self.settings.slice)
            budget.used += int(tree.counters[2]) - before
        found = tree.counters[3] >= 0
        arcs = merged(hybrid.solution(tree)) if found else None
        count = int(tree.counters[2])
        hybrid.clear(tree)
        return arcs, count, state == 2

    def _problem(
        self, query: LegQuery, car: DriveLimits, shape: Shape, level: int
    ) -> hybrid.PoseSearch:
        """Return what one search is about, at one resolution."""
        finest = self.settings.levels[level]
        # steps are shares of the turning radius, but what turns tighter than it is wide, or on the
        # spot, too, needs no finer ones, or no coarser ones
        unit = max(car.radius, 0.5 * shape.inner[2])
        if car.omega > 0.0:
            unit = min(unit, 4.0 * shape.inner[2])
        step = finest * unit
        ends, obstacles = (query.start, query.goal), query.obstacles
        reach = 8 * unit + 2 * shape.circumscribed
        bins = math.ceil(2 * math.pi / (finest / 1.5))
        space = pose_space(self.scene, ends, obstacles, reach, step / 1.5, bins)
        x, y, th = map(float, query.goal[:3])
        return hybrid.PoseSearch(
            world=self.scene.world(shape, obstacles),
            limits=car,
            goal=(x, y, th),
            field=self.fields.toward(shape, query.goal, obstacles),
            space=space._replace(weight=2.5, extra=400, near=10.0 * unit),
            steps=np.array(_primitives(car, unit, finest)),
        )

    def _smooth(
        self, world: WorldData, query: LegQuery, arcs: FloatArray, car: DriveLimits
    ) -> FloatArray:
        """Return a shortened path, or the path itself where that is no slower."""
        origin, target = (np.array(p[:3], dtype=np.float64) for p in (query.start, query.goal))
        rounds = self.settings.rounds, self.settings.patience
        found = improve(world, origin, arcs, car, rounds, self.seed)
        better = path_time(found, car) < path_time(arcs, car)
        return found if better and settle(origin, target, found) < 1e-7 else arcs


def _direct(world: WorldData, query: LegQuery, car: DriveLimits) -> FloatArray | None:
    """Return the fastest unobstructed curve if it happens to be free."""
    _, arcs = fastest(query.start, query.goal, car)
    origin = np.array(query.start[:3], dtype=np.float64)
    return arcs if path_free(world, origin, arcs) < 0 else None


# ------------------ Bodies that turn on the spot
# Their ways are sought as those of a car that turns no tighter than such a body can at top speed,
# so that it never rests but at cusps, and that may rest to turn on the spot, too; then stretches
# are replaced where a line is faster, with turns on the spot at its ends, or as it sets off and
# comes to rest.


class PivotPlanner:
    """Plans legs of bodies that turn on the spot, in one scene. Deterministic for a seed."""

    name = "pivot"
    reversible = True

    def __init__(self, scene: Scene, seed: int = 0, settings: CarSettings = CarSettings()) -> None:
        self.scene = scene
        self._car = CarPlanner(scene, seed, settings)

    @classmethod
    def quick(cls, scene: Scene, seed: int = 0) -> PivotPlanner:
        """Return a planner that gives up after little work, for detours."""
        return cls(scene, seed, QUICK)

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a fast motion between two poses among resting obstacles."""
        body, ends = query.body, (query.start, query.goal)
        shape = widest_shape(self.scene, body, ends, query.obstacles)
        if shape is None:
            return Leg(None, TOUCHES, complete=True)
        budget = WorkBudget(deadline, query.effort)
        arcs, reason = self._car.path(query, budget, rolling_limits(body.kinematics))
        found = [*self._straight(shape, query, *ends)]
        if arcs is not None:
            rows = rows_of(np.array(query.start[:3], dtype=np.float64), arcs)
            found.append(self._shortened(shape, query, rows, deadline))
        complete = not budget.cut and not deadline.expired()
        if not found:
            return Leg(None, reason, budget.used, complete)
        rows = min(found, key=lambda rows: rolling_time(rows, body.kinematics))
        return Leg(_timed(query, rows), "", budget.used, complete)

    def _shortened(
        self, shape: Shape, query: LegQuery, rows: FloatArray, deadline: Deadline
    ) -> FloatArray:
        """Return poses (n, 3), driven straight between some of their rests where that is faster."""
        rests = _rests(rows := rows[moves_on(rows)], query.body.kinematics)
        i = 0
        while i < len(rests) - 1 and not deadline.expired():
            for k in range(len(rests) - 1, i, -1):
                a, b = rests[i], rests[k]
                p, q = (tuple(rows[at].tolist()) for at in (a, b))
                seconds = rolling_time(rows[a : b + 1], query.body.kinematics)
                better = next(self._straight(shape, query, p, q, seconds - 1e-6), None)
                if better is not None:
                    rows = _replaced(rows, a, b, better)
                    rests = _rests(rows, query.body.kinematics)
                    break
            i += 1
        return rows

    def _straight(
        self,
        shape: Shape,
        query: LegQuery,
        start: Configuration,
        goal: Configuration,
        most: float = math.inf,
    ) -> Iterator[FloatArray]:
        """Yield free ways along a line between two rests that take less than ``most`` s: turning
        on the spot at its ends, or as it sets off and comes to rest.
        """
        world, kin = self.scene.world(shape, query.obstacles), query.body.kinematics
        nearest = run_time(math.dist(start[:2], goal[:2]), kin.v_max, kin.a_max)
        turning = corners_of(steer(query.body, start, goal))
        line = turning[1:-1] if len(turning) == 4 else turning[:1]
        if nearest < most and first_hit(world, line) < 0:
            # with a limit to how fast a turn begins there are no such bends at a rest
            bent = swerves(start, goal, kin) if math.isinf(kin.alpha_max) else ()
            quick = (rows for rows in (*bent, turning) if rolling_time(rows, kin) < most)
            yield from (rows for rows in quick if first_hit(world, rows) < 0)


def rolling_limits(kinematics: Kinematics) -> DriveLimits:
    """Return the limits of a car that turns no tighter than such a body does at top speed, and on
    the spot as it does.
    """
    limits = limits_of(kinematics)
    return limits._replace(radius=rolling_radius(kinematics), omega=float(kinematics.omega_max))


def _rests(rows: FloatArray, kinematics: Kinematics) -> list[int]:
    """Return at which of its poses (n, 3) a way rests."""
    kinds = rolls_of(rows, kinematics).kinds
    stops = np.flatnonzero((np.diff(kinds) != 0) | (np.abs(kinds[1:]) == 2)) + 1
    return [0, *map(int, stops), len(rows) - 1]


def _replaced(nodes: FloatArray, i: int, j: int, part: FloatArray) -> FloatArray:
    """Return ``nodes`` with those from i to j replaced by ``part``, theta continuous."""
    part, tail = part.copy(), nodes[j + 1 :].copy()
    part[:, 2] += nodes[i, 2] - part[0, 2]
    tail[:, 2] += part[-1, 2] - nodes[j, 2]
    return np.concatenate([nodes[:i], part, tail])


def _timed(query: LegQuery, rows: FloatArray) -> Trajectory:
    """Return the motion through ``rows``, exactly between the query's poses."""
    if len(rows) < 2:
        return at_rest(query.goal)
    return with_ends(rolled(rows, query.body.kinematics), query.start, query.goal)
