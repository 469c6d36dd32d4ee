"""One robot, two rooms, a closed door: press the button, drive through, fetch the item.

Run ``up-samp solve examples/door.py --out door-out``, or this file itself.
"""

from itertools import pairwise
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
from unified_planning.shortcuts import LT, ConfigurationType, MinimizeMakespan, MovableType

MAP = Path(__file__).parent / "maps" / "two_rooms.yaml"


def get_problem() -> SchedulingMotionProblem:
    """Return the problem: five activities, one after the other."""
    problem = SchedulingMotionProblem("door")

    # what moves: a car of 2 m x 1 m, and a door leaf of 1 m x 4 m
    robot = MovableObject(
        "robot",
        MovableType("robot_type"),
        footprint=[(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)],
        motion_model=MotionModels.REEDSSHEPP,
        motion_parameters={"turning_radius": 1.0, "v_max": 2.0, "a_max": 0.5},
    )
    door = MovableObject(
        "door",
        MovableType("door_type"),
        footprint=[(-0.5, -1.9), (0.5, -1.9), (0.5, 1.9), (-0.5, 1.9)],
        motion_model=MotionModels.SE2,
    )

    # where things can be: x and y in m from the map's lower-left corner, heading in rad
    pose = ConfigurationType("pose", OccupancyMap(str(MAP), SE2(0, 0, 0)), ConfigurationKind.SE2)
    home = ConfigurationObject("home", pose, SE2(4.0, 12.0, 0.0))
    button = ConfigurationObject("button", pose, SE2(11.0, 9.0, 0.0))
    item = ConfigurationObject("item", pose, SE2(25.0, 11.0, 0.0))
    closed = ConfigurationObject("closed", pose, SE2(15.0, 4.0, 0.0))
    opened = ConfigurationObject("opened", pose, SE2(15.0, 8.0, 0.0))

    problem.add_objects([robot, door, home, button, item, closed, opened])
    problem.set_initial_configuration(robot, home)
    problem.set_initial_configuration(door, closed)

    def drive(name, start, goal):
        activity = problem.add_motion_activity(name)
        activity.set_duration_bounds(1, 100)
        activity.add_motion_constraint(
            ActivityWaypoints(robot, start, [goal], static_obstacles=[door])
        )
        activity.add_motion_effect(robot, goal)
        return activity

    to_button = drive("drive_to_button", home, button)
    press = problem.add_motion_activity("press_button", duration=2)
    press.add_motion_effect(door, opened)  # no constraint: it happens at once, when pressing ends
    to_item = drive("drive_to_item", button, item)
    pick = problem.add_activity("pick_item", duration=3)
    back = drive("drive_home", item, home)

    steps = [to_button, press, to_item, pick, back]
    for earlier, later in pairwise(steps):
        problem.add_constraint(LT(earlier.end, later.start))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


if __name__ == "__main__":
    from unified_planning.shortcuts import OneshotPlanner

    import up_samp

    with OneshotPlanner(name="samp-refine[aries]") as planner:
        result = planner.solve(get_problem(), timeout=60)
    print(result.plan)
    for name, motion in up_samp.trajectories(result.plan).items():
        print(f"{name}: {motion.duration:.1f} s of driving")
