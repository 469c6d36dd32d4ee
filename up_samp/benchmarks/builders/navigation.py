"""Navigation: cars cross the halls of a building, each its own, all at the same time.

``robots`` halls lie one above the other, with a corridor between neighbours. Each robot drives from
the left of its hall to the right of it, and heeds all others. Published beside the paper's
families; the measures of the halls are this package's own. Seeds other than 0 draw where corridors
are, starts, goals, and the robots' shape.
"""

from __future__ import annotations

import math
import random

from unified_planning.model.motion import MotionModels, SchedulingMotionProblem

from up_samp.benchmarks.instances import Encoding
from up_samp.benchmarks.places import (
    FamilyFloor,
    Pose,
    check_sizes,
    drawing,
    drawn_name,
    outer_wall,
)
from up_samp.benchmarks.published import Form, Manner

HALL = (40.0, 12.0)
"""Width and height of one hall, m."""
CORRIDOR = 18.0, 4.0
"""Where corridors begin (x), and how wide they are, m."""
THICK, MOST_ROBOTS = 3.0, 10
"""Thickness of what lies between two halls (m: the corridor's length), and how many there are."""


def hall_floor(robot: int) -> float:
    """Return the y of the floor of a robot's hall, m."""
    return robot * (HALL[1] + THICK)


def navigation_floor(robots: int, rng: random.Random | None, name: str) -> FamilyFloor:
    """Return the building: the usual one, or one drawn from ``rng``."""
    size = HALL[0], robots * HALL[1] + (robots - 1) * THICK
    walls = outer_wall(*size)
    for r in range(1, robots):
        low, high = hall_floor(r) - THICK, hall_floor(r)
        left = CORRIDOR[0] if rng is None else round(rng.uniform(4, 32), 1)
        walls += [(0.0, low, left, high), (left + CORRIDOR[1], low, HALL[0], high)]
    floor = FamilyFloor(name, size, walls)
    return floor.reshaped(rng)


def navigation(
    robots: int = 2,
    *,
    encoding: Encoding = "fluents",
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a navigation problem: one optional move per robot, that has to be made."""
    check_sizes("navigation", {"robots": MOST_ROBOTS}, robots)
    title = drawn_name(f"navigation-r{robots}", seed)
    rng = drawing(title, seed)
    floor = navigation_floor(robots, rng, title)
    poses: dict[str, Pose] = {}
    for r in range(robots):
        y = hall_floor(r) + HALL[1] / 2
        for what, x in (("start", 4.0), ("goal", HALL[0] - 4.0)):
            place = f"robot{r}_{what}"
            poses[place] = (x, y, 0.0)
            if rng is not None:
                region = (x - 2, y - 4, x + 2, y + 4)
                poses[place] = floor.spot(rng, region, (0.0, math.pi), [], 0.0)
    floor.check(poses)
    manner = Manner(floor, guess=0.5, model=MotionModels.SE2, heed_all=True)
    form = Form(title, manner, encoding, metric)
    places = {key: form.place(key, pose) for key, pose in poses.items()}
    for r in range(robots):
        form.robot(places[f"robot{r}_start"])
    for r, robot in enumerate(form.robots):
        move = form.move(robot, robot.start, places[f"robot{r}_goal"])
        form.problem.add_constraint(move.present)
    form.end_at({r: places[f"robot{r}_goal"] for r in range(robots)})
    return form.finish()
