"""Two drones change sides through a corridor: one flies above the other.

They are free flyers (SE3), given by a mesh; this needs the extra ``[meshes]``. Run
``up-samp solve examples/drones.py --out drones-out``.
"""

from pathlib import Path

from unified_planning.model.motion import (
    SE3,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import ConfigurationType, MinimizeMakespan, MovableType

FOLDER = Path(__file__).parent
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
"""No turn, as a quaternion (x, y, z, w)."""


def get_problem() -> SchedulingMotionProblem:
    """Return the problem: two flights, and no constraint between them."""
    problem = SchedulingMotionProblem("drones")
    drone_type = MovableType("drone")
    site = OccupancyMap(str(FOLDER / "maps" / "corridor.yaml"), (0, 0))
    pose = ConfigurationType("pose", site, ConfigurationKind.SE3)
    flights = {
        "east": (SE3(6.0, 7.0, 1.0, *UPRIGHT), SE3(34.0, 7.0, 1.0, *UPRIGHT)),
        "west": (SE3(34.0, 8.5, 1.0, *UPRIGHT), SE3(6.0, 8.5, 1.0, *UPRIGHT)),
    }
    for name, (start, goal) in flights.items():
        drone = MovableObject(
            f"drone_{name}",
            drone_type,
            geometric_model=str(FOLDER / "meshes" / "drone.obj"),
            motion_model=MotionModels.SE3,
            motion_parameters={"v_max": 2.0, "a_max": 1.0, "omega_max": 1.0},
        )
        here = ConfigurationObject(f"start_{name}", pose, start)
        there = ConfigurationObject(f"goal_{name}", pose, goal)
        problem.add_objects([drone, here, there])
        problem.set_initial_configuration(drone, here)
        activity = problem.add_motion_activity(f"fly_{name}")
        activity.set_duration_bounds(1, 200)
        activity.add_motion_constraint(ActivityWaypoints(drone, here, [there]))
        activity.add_motion_effect(drone, there)
    problem.add_quality_metric(MinimizeMakespan())
    return problem
