"""Navigation: cars cross the halls of a building, each its own, all at the same time.

``robots`` halls lie one above the other, with a corridor between neighbours. Each robot drives from
the left of its hall to the right of it, and heeds all others. Published beside the paper's
families; the measures of the halls are this package's own.
"""

from __future__ import annotations

from unified_planning.model.motion import MotionModels, SchedulingMotionProblem

from up_samp.benchmarks.maps import Rectangle, drawn_map, outer_wall
from up_samp.benchmarks.places import Pose, check_poses
from up_samp.benchmarks.published.form import Form, Manner, Published
from up_samp.model import ProblemError

HALL = (40.0, 12.0)
"""Width and height of one hall, m."""
CORRIDOR = (18.0, 22.0)
"""Where corridors are (x), m."""
THICK, MOST_ROBOTS = 3.0, 10
"""Thickness of what lies between two halls (m: the corridor's length), and how many there are."""


def hall_floor(robot: int) -> float:
    """Return the y of the floor of a robot's hall, m."""
    return robot * (HALL[1] + THICK)


def navigation_size(robots: int) -> tuple[float, float]:
    """Return width and height of the building, m."""
    return HALL[0], robots * HALL[1] + (robots - 1) * THICK


def navigation_walls(robots: int) -> list[Rectangle]:
    """Return what is occupied."""
    walls = outer_wall(*navigation_size(robots))
    for r in range(1, robots):
        low, high = hall_floor(r) - THICK, hall_floor(r)
        walls += [(0.0, low, CORRIDOR[0], high), (CORRIDOR[1], low, HALL[0], high)]
    return walls


def navigation(
    robots: int = 2,
    *,
    encoding: Published = "fluents",
    metric: bool = True,
    name: str | None = None,
) -> SchedulingMotionProblem:
    """Build a navigation problem: one optional move per robot, that has to be made."""
    if not 1 <= robots <= MOST_ROBOTS:
        raise ProblemError(f"navigation takes 1 to {MOST_ROBOTS} robots, not {robots}")
    size, walls = navigation_size(robots), navigation_walls(robots)
    poses: dict[str, Pose] = {}
    for r in range(robots):
        y = hall_floor(r) + HALL[1] / 2
        poses |= {f"robot{r}_start": (4.0, y, 0.0), f"robot{r}_goal": (HALL[0] - 4.0, y, 0.0)}
    check_poses(size, walls, poses)
    manner = Manner(
        str(drawn_map(f"navigation-{robots}", size, walls)),
        guess=0.5,
        model=MotionModels.SE2,
        heed_all=True,
    )
    form = Form(name or f"navigation-r{robots}", manner, encoding, metric)
    places = {key: form.place(key, pose) for key, pose in poses.items()}
    for r in range(robots):
        form.robot(places[f"robot{r}_start"])
    for r, robot in enumerate(form.robots):
        move = form.move(robot, robot.start, places[f"robot{r}_goal"])
        form.problem.add_constraint(move.present)
    form.end_at({r: places[f"robot{r}_goal"] for r in range(robots)})
    return form.finish()
