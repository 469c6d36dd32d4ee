"""A small hall with a wall that has a gap, and bodies of every motion model in it."""

import itertools
import math
import os

import numpy as np
from PIL import Image
from unified_planning.model.motion import (
    SE2,
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

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
QUARTER = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))
BOX = [(-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)]


class World:
    """20 m x 12 m; a wall at x = 10 but for y in [4, 8]. Heights are free."""

    def __init__(self, folder, gap=(4.0, 8.0), resolution=0.1):
        self.folder = folder
        cells = np.zeros((120, 200), dtype=bool)
        cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
        cells[:, 99:101] = True
        cells[round(gap[0] / resolution) : round(gap[1] / resolution), 99:101] = False
        Image.fromarray(np.where(np.flipud(cells), 0, 254).astype(np.uint8)).save(
            folder / "hall.png"
        )
        (folder / "hall.yaml").write_text(
            f"image: hall.png\nresolution: {resolution}\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
        )
        area = OccupancyMap(os.fspath(folder / "hall.yaml"), (0, 0))
        self.kinds = {
            3: ConfigurationType("plane", area, ConfigurationKind.SE2),
            7: ConfigurationType("space", area, ConfigurationKind.SE3),
        }
        self.thing = MovableType("thing")
        self.problem = SchedulingMotionProblem("hall")
        self.problem.add_quality_metric(MinimizeMakespan())
        self.count = itertools.count()

    def place(self, *pose):
        value = (SE2 if len(pose) == 3 else SE3)(*map(float, pose))
        item = ConfigurationObject(f"q{next(self.count)}", self.kinds[len(pose)], value)
        self.problem.add_object(item)
        return item

    def put(self, item, pose):
        self.problem.add_object(item)
        item.home = self.place(*pose)
        self.problem.set_initial_configuration(item, item.home)
        return item

    def flyer(self, name, pose, size=(0.8, 0.8, 0.3)):
        trimesh = __import__("trimesh")
        file = self.folder / f"{'x'.join(map(str, size))}.stl"
        trimesh.creation.box(size).export(file)
        limits = {"v_max": 2.0, "a_max": 1.0, "omega_max": 1.0}
        item = MovableObject(
            name,
            self.thing,
            geometric_model=str(file),
            motion_model=MotionModels.SE3,
            motion_parameters=limits,
        )
        return self.put(item, pose)

    def flat(self, name, pose, model=MotionModels.SE2, corners=None, **more):
        more.setdefault("motion_parameters", {"v_max": 1.5, "a_max": 1.0})
        item = MovableObject(name, self.thing, footprint=corners or BOX, motion_model=model, **more)
        return self.put(item, pose)

    def move(self, name, item, *places, **obstacles):
        """Drive ``item`` from the first place through the others."""
        activity = self.problem.add_motion_activity(name)
        activity.set_duration_bounds(1, 200)
        activity.add_motion_constraint(
            ActivityWaypoints(item, places[0], list(places[1:]), **obstacles)
        )
        activity.add_motion_effect(item, places[-1])
        return activity
