"""Two robots change sides through a corridor that is too narrow for both.

Nothing in the schedule says who goes first: the motions do. Run
``up-samp solve examples/swap.py --out swap-out``.
"""

from pathlib import Path

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
from unified_planning.shortcuts import ConfigurationType, MinimizeMakespan, MovableType

MAP = Path(__file__).parent / "maps" / "corridor.yaml"


def get_problem() -> SchedulingMotionProblem:
    """Return the problem: two motion activities and no constraint between them."""
    problem = SchedulingMotionProblem("swap")
    robot_type = MovableType("robot")
    pose = ConfigurationType("pose", OccupancyMap(str(MAP), SE2(0, 0, 0)), ConfigurationKind.SE2)
    trips = {
        "east": (SE2(6.0, 10.0, 0.0), SE2(34.0, 10.0, 0.0)),
        "west": (SE2(34.0, 4.0, 3.14159), SE2(6.0, 4.0, 3.14159)),
    }
    robots = {
        name: MovableObject(
            f"robot_{name}",
            robot_type,
            footprint=[(-1.2, -0.7), (1.2, -0.7), (1.2, 0.7), (-1.2, 0.7)],
            motion_model=MotionModels.REEDSSHEPP,
            motion_parameters={"turning_radius": 1.5, "v_max": 2.0, "a_max": 0.5},
        )
        for name in trips
    }
    for name, (start, goal) in trips.items():
        here = ConfigurationObject(f"start_{name}", pose, start)
        there = ConfigurationObject(f"goal_{name}", pose, goal)
        problem.add_objects([robots[name], here, there])
        problem.set_initial_configuration(robots[name], here)
        activity = problem.add_motion_activity(f"go_{name}")
        activity.set_duration_bounds(1, 200)
        activity.add_motion_constraint(
            ActivityWaypoints(
                robots[name],
                here,
                [there],
                dynamic_obstacles_at_start=[r for n, r in robots.items() if n != name],
            )
        )
        activity.add_motion_effect(robots[name], there)
    problem.add_quality_metric(MinimizeMakespan())
    return problem
