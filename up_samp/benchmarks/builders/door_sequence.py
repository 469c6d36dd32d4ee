"""Doors in sequence: robots get to their goals through one door after the other.

Published beside the paper's families: walls every 10 m, each with one door; a button on the near
side of it. Starts and goals are drawn from a seed; others than 0 draw where walls and gaps are, and
the robots' shape, too. Moves last 1 to 100 units (a
published variant): a car that turns this widely cannot keep to bounds from straight distances.
"""

from __future__ import annotations

import itertools
import random

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.shortcuts import Or

from up_samp.benchmarks.instances import Encoding
from up_samp.benchmarks.places import (
    DOWN,
    UP,
    FamilyDoor,
    FamilyFloor,
    Pose,
    box,
    check_sizes,
    drawing,
    drawn_name,
    outer_wall,
)
from up_samp.benchmarks.published import Form, Manner

HEIGHT, GAP = 30.0, 5.0
"""Height of the building, and width of the gap that a door closes (m)."""
FIRST_WALL, APART, BEHIND = 16.3, 10.0, 13.7
"""Where the first wall is (x), how far apart walls are, width of the room behind the last door."""
MIDDLE, BUTTON = 15.0, 4.1
"""Where gaps are (y), and how far before its wall a button is (m)."""
MOST = {"robots": 6, "doors": 5}


def sequence_floor(doors: int, rng: random.Random | None, name: str) -> FamilyFloor:
    """Return the building, with walls 0.6 m thick, one gap of 5 m in each, and doors, 1 x 6 m, that
    open by 6 m along their wall: the usual one, or one drawn from ``rng``.
    """
    at, middles = [FIRST_WALL + APART * i for i in range(doors)], [MIDDLE] * doors
    if rng is not None:
        at = [round(x + rng.uniform(-1, 1), 1) for x in at]
        middles = [round(rng.uniform(7, 19), 1) for _ in at]
    size = (round(at[-1] + BEHIND, 1), HEIGHT)
    walls, leaves = outer_wall(*size), []
    for i, (x, y) in enumerate(zip(at, middles, strict=True)):
        walls += [(x - 0.3, 0.0, x + 0.3, y - GAP / 2), (x - 0.3, y + GAP / 2, x + 0.3, HEIGHT)]
        x = round(x, 2)
        button = (round(x - BUTTON, 2), y, DOWN)
        leaves.append(FamilyDoor(f"door{i}", box(1, 6), (x, y, 0.0), (x, y + 6, 0.0), button))
    floor = FamilyFloor(name, size, walls, leaves)
    return floor.reshaped(rng)


def door_sequence(
    robots: int = 2,
    doors: int = 2,
    *,
    encoding: Encoding = "fluents",
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a problem of doors in sequence: every robot has to get to its goal."""
    check_sizes("a sequence of doors", MOST, robots, doors)
    title = drawn_name(f"doors-r{robots}-d{doors}", seed)
    floor = sequence_floor(doors, drawing(title, seed), title)
    starts, goals = _draw(floor, robots, seed)
    floor.check(starts | goals | {f"{leaf.name}_button": leaf.button for leaf in floor.doors})
    manner = Manner(floor, guess=1.0, early=0, turning_radius=4.0, bounds=(1, 100))
    form = Form(title, manner, encoding, metric)
    places = {key: form.place(key, pose) for key, pose in (*starts.items(), *goals.items())}
    for key in starts:
        form.robot(places[key])
    stops = [form.door(leaf).button for leaf in floor.doors]
    ways = itertools.permutations([*stops, *places.values()], 2)
    for robot, (origin, to) in itertools.product(form.robots, ways):
        form.move(robot, origin, to)
    form.openings()
    for r, robot in enumerate(form.robots):
        arriving = robot.moves_to([places[f"robot{r}_goal"]])
        form.problem.add_constraint(Or([m.present for m in arriving]))
    return form.finish()


def _draw(floor: FamilyFloor, robots: int, seed: int) -> tuple[dict[str, Pose], dict[str, Pose]]:
    """Draw starts before the first door and goals behind the last one, 4 m apart each."""
    rng = random.Random(f"doors-{robots}-{len(floor.doors)}-{seed}")
    (width, _), taken = floor.size, [leaf.button for leaf in floor.doors]
    first, last = (2.0, 2.0, 13.0, 28.0), (width - BEHIND + 3.0, 2.0, width - 3.0, 28.0)
    starts = {f"robot{r}_start": floor.spot(rng, first, (UP, DOWN), taken) for r in range(robots)}
    goals = {f"robot{r}_goal": floor.spot(rng, last, (UP, DOWN), taken) for r in range(robots)}
    return starts, goals
