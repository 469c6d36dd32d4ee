"""Robots on floors of width for one: who is behind whom cannot change."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import numpy as np
from unified_planning.environment import get_environment
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)

from tests.shuffled import shuffled
from up_samp.geometry.maps import write_map

CELL, WIDE = 0.1, 1.2
BOX = ((-0.5, -0.4), (0.5, -0.4), (0.5, 0.4), (-0.5, 0.4))
MODELS = (
    (MotionModels.SE2, {}),
    (MotionModels.REEDSSHEPP, {"turning_radius": 1.0}),
    (MotionModels.REEDSSHEPP, {"turning_radius": 0.0}),
)


@dataclass(frozen=True)
class Floor:
    """Free boxes (m), and places along the way in their order; ``round``: a way without ends."""

    free: tuple[tuple[float, float, float, float], ...]
    places: tuple[tuple[float, float, float], ...]
    round: bool = False


def aisle(places: int, *, pocket: float = 0.0) -> Floor:
    """Return a straight way; with a ``pocket`` so deep (m) beside it."""
    length = 2.0 * places + 1.0
    free = [(0.5, 0.5, 0.5 + length, 0.5 + WIDE)]
    if pocket:
        free.append((length / 2 - 0.7, 0.5, length / 2 + 0.7, 0.5 + WIDE + pocket))
    at = tuple((1.5 + 2.0 * k, 0.5 + WIDE / 2, 0.0) for k in range(places))
    return Floor(tuple(free), at)


def bend(places: int) -> Floor:
    """Return a way round a corner."""
    half = places // 2
    long = 2.0 * half + 2.5
    free = ((0.5, 0.5, long, 0.5 + WIDE), (long - WIDE, 0.5, long, 0.5 + 2.0 * places))
    low = [(1.3 + 2.0 * k, 0.5 + WIDE / 2, 0.0) for k in range(half)]
    up = [(long - WIDE / 2, 3.0 + 2.0 * k, math.pi / 2) for k in range(places - half)]
    return Floor(free, (*low, *up))


def ring(*, pocket: float = 0.0, wide: float = 6.0, high: float = 5.0) -> Floor:
    """Return a way round; with a ``pocket`` so deep (m) beside it."""
    x, y = 0.5 + wide, 0.5 + high
    free = [
        (0.5, 0.5, x, 0.5 + WIDE),
        (0.5, y - WIDE, x, y),
        (0.5, 0.5, 0.5 + WIDE, y),
        (x - WIDE, 0.5, x, y),
    ]
    if pocket:
        free.append((0.5 + wide / 2 - 0.7, y - WIDE, 0.5 + wide / 2 + 0.7, y + pocket))
    low, left, right = 0.5 + WIDE / 2, 0.5 + WIDE / 2, x - WIDE / 2
    side, middle, top = math.pi / 2, 0.5 + high / 2, y - WIDE / 2
    at = [(2.3, low, 0.0), (0.5 + wide - 1.8, low, 0.0), (right, middle, side)]
    at += [(0.5 + wide - 1.8, top, 0.0), (2.3, top, 0.0), (left, middle, side)]
    return Floor(tuple(free), tuple(at), True)


FLOORS = {
    "aisle": lambda: aisle(6),
    "bend": lambda: bend(6),
    "shallow pocket": lambda: aisle(6, pocket=0.1),
    "ring": ring,
    "ring with a shallow pocket": lambda: ring(pocket=0.1),
}


@dataclass(frozen=True)
class Row:
    """Robots at places of a floor: ``starts`` and ``goals`` are numbers of places. Those in
    ``optional`` may drive, and need not. Drives begin where robots are, by another name of
    it if they are ``called_otherwise``.
    """

    floor: Floor
    starts: tuple[int, ...]
    goals: tuple[int, ...]
    optional: frozenset[int] = frozenset()
    model: int = 0
    called_otherwise: bool = False

    @property
    def solvable(self) -> bool:
        """Whether some choice of optional drives keeps everybody's order."""
        choices = [()]
        for i, goal in enumerate(self.goals):
            ends = {goal, self.starts[i] if i in self.optional else goal}
            choices = [(*some, end) for some in choices for end in ends]
        return any(len(set(c)) == len(c) and self._keeps(c) for c in choices)

    def _keeps(self, ends) -> bool:
        before = [i for _, i in sorted(zip(self.starts, range(len(ends)), strict=True))]
        after = [i for _, i in sorted(zip(ends, range(len(ends)), strict=True))]
        if self.floor.round:
            turn = after.index(before[0])
            after = after[turn:] + after[:turn]
        return before == after


def drawn(seed: int, floor: str) -> Row:
    """Return a row of a seed."""
    rng = random.Random(f"{floor} {seed}")
    made = FLOORS[floor]()
    count = rng.randint(2, 4)
    places = range(len(made.places))
    starts, goals = rng.sample(places, count), rng.sample(places, count)
    model = 0 if floor == "bend" or made.round else rng.choice((0, 0, 1))
    parked = frozenset({rng.randrange(count)} if rng.random() < 0.3 else ())
    return Row(made, tuple(starts), tuple(goals), parked, model, rng.random() < 0.5)


def problem_of(row: Row, folder, seed: int = 0):
    """Return the UP problem of a row, its lists shuffled by a seed."""
    high = max(max(box[2:]) for box in row.floor.free) + 0.5
    cells = np.ones((round(high / CELL),) * 2, dtype=bool)
    for x0, y0, x1, y1 in row.floor.free:
        cells[round(y0 / CELL) : round(y1 / CELL), round(x0 / CELL) : round(x1 / CELL)] = False
    write_map(folder, "row", cells, CELL)
    env = get_environment()
    types = env.type_manager
    floor = OccupancyMap(str(folder / "row.yaml"), (0, 0))
    kind = types.ConfigurationType("place", floor, ConfigurationKind.SE2)
    problem = SchedulingMotionProblem("row", env)
    places = {}
    for name, turns in (("p", 0), ("q", 1)):
        for k, (x, y, turn) in enumerate(row.floor.places):
            pose = SE2(x, y, turn + 2 * math.pi * turns)
            places[name, k] = ConfigurationObject(f"{name}{k}", kind, pose, env)
            problem.add_object(places[name, k])
    model, more = MODELS[row.model]
    for i, (start, goal) in enumerate(zip(row.starts, row.goals, strict=True)):
        robot = MovableObject(
            f"r{i}",
            types.MovableType("robot"),
            footprint=list(BOX),
            motion_model=model,
            motion_parameters={"v_max": 1.0, "a_max": 1.0, **more},
            env=env,
        )
        problem.add_object(robot)
        problem.set_initial_configuration(robot, places["p", start])
        go = problem.add_motion_activity(f"go{i}", 1, optional=i in row.optional)
        go.set_duration_bounds(1, 500)
        begin = places["p", start]
        if row.called_otherwise:
            begin = problem.add_fluent(f"at{i}", kind, default_initial_value=places["q", start])()
            go.add_effect(go.end, begin, places["p", goal])
        go.add_motion_constraint(ActivityWaypoints(robot, begin, [places["p", goal]]))
    problem.add_quality_metric(MinimizeMakespan())
    return shuffled(problem, seed, rename=False).problem
