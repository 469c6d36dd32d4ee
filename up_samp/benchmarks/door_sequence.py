"""Doors in sequence: robots get to their goals through one door after the other.

Published beside the paper's families: walls every 10 m, each with one door; a button on the near
side of it. Starts and goals are drawn from a seed. Moves last 1 to 100 units (a
published variant): a car that turns this widely cannot keep to bounds from straight distances.
"""

from __future__ import annotations

import itertools
import math
import random

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.shortcuts import Or

from up_samp.benchmarks.maps import Rectangle, drawn_map, outer_wall
from up_samp.benchmarks.places import FamilyDoor, Pose, box, check_poses
from up_samp.benchmarks.published.form import Form, Manner, Published
from up_samp.model import ProblemError

HEIGHT, GAP = 30.0, 5.0
"""Height of the building, and width of the gap that a door closes (m)."""
FIRST_WALL, APART, BEHIND = 16.3, 10.0, 13.7
"""Where the first wall is (x), how far apart walls are, width of the room behind the last door."""
FIRST_BUTTON = (12.2, 15.0)
"""Where the first button is; each other stands as far before its wall."""
MOST_ROBOTS, MOST_DOORS = 6, 5

_UP = math.pi / 2


def wall_at(i: int) -> float:
    """Return where the middle of wall ``i`` is (x)."""
    return FIRST_WALL + APART * i


def sequence_doors(doors: int) -> list[FamilyDoor]:
    """Return the doors, 1 x 6 m; they open by 6 m along their wall."""
    found = []
    for i in range(doors):
        x = round(wall_at(i), 2)
        button = (round(FIRST_BUTTON[0] + APART * i, 2), FIRST_BUTTON[1], -_UP)
        found.append(FamilyDoor(f"door{i}", box(1, 6), (x, 15.0, 0.0), (x, 21.0, 0.0), button))
    return found


def sequence_size(doors: int) -> tuple[float, float]:
    """Return width and height of the building, m."""
    return round(wall_at(doors - 1) + BEHIND, 1), HEIGHT


def sequence_walls(doors: int) -> list[Rectangle]:
    """Return what is occupied: walls 0.6 m thick with one gap of 5 m each."""
    walls = outer_wall(*sequence_size(doors))
    for i in range(doors):
        left, right = wall_at(i) - 0.3, wall_at(i) + 0.3
        walls += [
            (left, 0.0, right, (HEIGHT - GAP) / 2),
            (left, (HEIGHT + GAP) / 2, right, HEIGHT),
        ]
    return walls


def door_sequence(
    robots: int = 2,
    doors: int = 2,
    *,
    encoding: Published = "fluents",
    metric: bool = True,
    seed: int = 0,
    name: str | None = None,
) -> SchedulingMotionProblem:
    """Build a problem of doors in sequence: every robot has to get to its goal."""
    if not 1 <= robots <= MOST_ROBOTS or not 1 <= doors <= MOST_DOORS:
        raise ProblemError(
            f"doors in sequence take 1 to {MOST_ROBOTS} robots "
            f"and 1 to {MOST_DOORS} doors, not {robots} and {doors}"
        )
    size, walls, leaves = sequence_size(doors), sequence_walls(doors), sequence_doors(doors)
    starts, goals = _draw(robots, doors, seed)
    buttons = {f"{leaf.name}_button": leaf.button for leaf in leaves}
    check_poses(size, walls, {**starts, **goals, **buttons}, doors=leaves)
    manner = Manner(
        str(drawn_map(f"doors-{doors}", size, walls)),
        guess=1.0,
        early=0,
        turning_radius=4.0,
        bounds=(1, 100),
    )
    title = name or f"doors-r{robots}-d{doors}" + (f"-s{seed}" if seed else "")
    form = Form(title, manner, encoding, metric)
    places = {key: form.place(key, pose) for key, pose in (*starts.items(), *goals.items())}
    for key in starts:
        form.robot(places[key])
    stops = [form.door(leaf).button for leaf in leaves]
    for robot in form.robots:
        for origin, to in itertools.permutations([*stops, *places.values()], 2):
            form.move(robot, origin, to)
    form.openings()
    for r, robot in enumerate(form.robots):
        arriving = robot.moves_to([places[f"robot{r}_goal"]])
        form.problem.add_constraint(Or([m.present for m in arriving]))
    return form.finish()


def _draw(robots: int, doors: int, seed: int) -> tuple[dict[str, Pose], dict[str, Pose]]:
    """Draw starts before the first door and goals behind the last one, 4 m apart each."""
    rng = random.Random(f"doors-{robots}-{doors}-{seed}")
    wall = wall_at(doors - 1)
    taken: list[Pose] = [leaf.button for leaf in sequence_doors(doors)]

    def spot(low: float, high: float) -> Pose:
        while True:
            x, y = round(rng.uniform(low, high), 2), round(rng.uniform(2.0, 28.0), 2)
            if all(math.dist((x, y), other[:2]) >= 4.0 for other in taken):
                taken.append((x, y, rng.choice((_UP, -_UP))))
                return taken[-1]

    starts = {f"robot{r}_start": spot(2.0, 13.0) for r in range(robots)}
    goals = {f"robot{r}_goal": spot(wall + 3.0, wall + BEHIND - 3.0) for r in range(robots)}
    return starts, goals
