"""A small hall as a UP problem: two robots, a door, a few places. Built through UP's API alone."""

from __future__ import annotations

import numpy as np
from PIL import Image
from unified_planning.environment import Environment
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
from unified_planning.shortcuts import get_environment

ROBOT = [(-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)]


def write_hall(folder, *, wall_gap=(45, 55), resolution=0.1):
    """A 20 x 10 m hall with an outer wall and a wall at x = 10 m with a gap (rows from below)."""
    rows, columns = 100, 200
    occupied = np.zeros((rows, columns), dtype=bool)
    occupied[:2, :] = occupied[-2:, :] = True
    occupied[:, :2] = occupied[:, -2:] = True
    occupied[:, 99:101] = True
    if wall_gap is not None:
        occupied[wall_gap[0] : wall_gap[1], 99:101] = False
        occupied[:2, :] = True
    image = np.where(occupied[::-1], 0, 255).astype(np.uint8)
    Image.fromarray(image).save(folder / "hall.png")
    path = folder / "hall.yaml"
    path.write_text(
        f"image: hall.png\nresolution: {resolution}\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


class Hall:
    """The problem with handles to its parts; tests spoil or extend it."""

    def __init__(self, folder, *, robots=1, door=False, map_file=None, environment=None, **robot):
        env: Environment = environment or get_environment()
        map_file = map_file or write_hall(folder)
        types = env.type_manager
        self.place = types.ConfigurationType(
            "place", OccupancyMap(str(map_file), (0, 0)), ConfigurationKind.SE2
        )
        self.robot = types.MovableType("robot")
        self.problem = SchedulingMotionProblem("hall", env)
        self.robots = []
        self.poses = {}
        keywords = {
            "footprint": ROBOT,
            "motion_model": MotionModels.REEDSSHEPP,
            "motion_parameters": {"turning_radius": 0.8, "v_max": 1.0, "a_max": 0.5},
        } | robot
        for k in range(robots):
            obj = MovableObject(f"r{k}", self.robot, env=env, **keywords)
            self.robots.append(obj)
            self.problem.add_object(obj)
            self.pose(f"left{k}", 3.0, 3.0 + 4.0 * k, 0.0)
            self.pose(f"right{k}", 17.0, 3.0 + 4.0 * k, 0.0)
            self.problem.set_initial_configuration(obj, self.poses[f"left{k}"])
        self.door = None
        if door:
            self.door = MovableObject(
                "door",
                types.MovableType("door_type"),
                footprint=[(-0.1, -0.6), (0.1, -0.6), (0.1, 0.6), (-0.1, 0.6)],
                motion_model=MotionModels.SE2,
                env=env,
            )
            self.problem.add_object(self.door)
            self.pose("shut", 10.0, 5.0, 0.0)
            self.pose("away", 10.0, 1.5, 0.0)
            self.problem.set_initial_configuration(self.door, self.poses["shut"])
        self.problem.add_quality_metric(MinimizeMakespan())

    def pose(self, name, x, y, theta):
        """Add a configuration."""
        obj = ConfigurationObject(name, self.place, SE2(x, y, theta), self.problem.environment)
        self.poses[name] = obj
        self.problem.add_object(obj)
        return obj

    def move(self, name, robot, start, goal, *, bounds=(1, 200), optional=False, **obstacles):
        """Add a motion activity between two named configurations."""
        activity = self.problem.add_motion_activity(name, 1, optional)
        activity.set_duration_bounds(*bounds)
        activity.add_motion_constraint(
            ActivityWaypoints(
                self.robots[robot], self.poses[start], [self.poses[goal]], **obstacles
            )
        )
        return activity

    def open_door(self, name="open", *, optional=False):
        """Add an activity that opens the door in one instant, at its end."""
        activity = self.problem.add_motion_activity(name, 1, optional)
        activity.add_motion_effect(self.door, self.poses["away"])
        return activity
