"""Car motions (REEDSSHEPP): hybrid A*, then shortening, then timing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from up_samp.geometry import Scene, Shape, sweeps
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import WorldData
from up_samp.model import Deadline
from up_samp.model.arrays import FloatArray
from up_samp.motion.budget import WorkBudget
from up_samp.motion.curves.reeds_shepp import (
    SPOT,
    DriveLimits,
    fastest,
    merged,
    path_time,
    reversed_arcs,
)
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.guides.cost_to_go import Fields, least_value
from up_samp.motion.guides.search_space import (
    DRY,
    OUT_OF_TIME,
    STUCK,
    TOUCHES,
    pose_space,
    widest_shape,
)
from up_samp.motion.planners import hybrid_astar as hybrid
from up_samp.motion.planners.car_shortcuts import improve, settle
from up_samp.motion.protocol import Leg, LegQuery


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
    return arcs if sweeps.path_free(world, origin, arcs) < 0 else None
