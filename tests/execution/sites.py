"""Small motion problems with their plans, written drive by drive."""

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
from unified_planning.shortcuts import ConfigurationType, MovableType

from tests import handmade
from up_samp.io.sampling import trajectory_rows

BOX = [(-0.4, -0.25), (0.4, -0.25), (0.4, 0.25), (-0.4, 0.25)]


class Site:
    """A motion problem with its plan, drive by drive."""

    def __init__(self, yaml):
        self.problem = SchedulingMotionProblem("site")
        grid = OccupancyMap(str(yaml), (0, 0))
        self.kind = ConfigurationType("pose", grid, ConfigurationKind.SE2)
        self.robots, self.activities = {}, {}
        self.times, self.trajectories = {}, {}
        self.data = {
            "format": "up-samp-plan", "version": 1, "problem": "site", "engine": "made",
            "status": "SOLVED_SATISFICING", "makespan": 0, "lower_bound": None,
            "seconds_per_unit": 1, "map": {"yaml": str(yaml)}, "objects": [], "activities": [],
            "motions": [], "changes": [],
        }  # fmt: skip

    def place(self, name, pose):
        item = ConfigurationObject(name, self.kind, SE2(*pose))
        self.problem.add_object(item)
        return item

    def robot(self, name, pose):
        limits = {"turning_radius": 1.0, "v_max": 1.0, "a_max": 0.5}
        item = MovableObject(
            name, MovableType("robot"), footprint=BOX, motion_model=MotionModels.REEDSSHEPP,
            motion_parameters=limits,
        )  # fmt: skip
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.place(f"{name}_first", pose))
        self.robots[name] = item
        entry = {"name": name, "type": "robot", "footprint": [list(c) for c in BOX]}
        entry |= {"model": "REEDSSHEPP", "initial": list(pose), **limits, "omega_max": 1.0}
        self.data["objects"].append(entry)

    def drive(self, name, robot, pose, pieces, start, obstacles=None, goal=None):
        trajectory = handmade.drive(pose, pieces, float(start), 1.0, 0.5)
        rows = trajectory_rows(trajectory)
        end = start + int(trajectory.duration) + 1
        a = self.problem.add_motion_activity(name)
        a.set_duration_bounds(1, 200)
        ends = [self.place(f"{name}_{k}", row[1:]) for k, row in enumerate((rows[0], rows[-1]))]
        listed = None if obstacles is None else [self.robots[o] for o in obstacles]
        goal = ends[1] if goal is None else goal
        way = ActivityWaypoints(self.robots[robot], ends[0], [goal], None, listed)
        a.add_motion_constraint(way)
        self.data["motions"].append({"activity": name, "object": robot, "samples": rows})
        return self.timed(name, a, start, end)

    def lift(self, name, robot, pose, start, end):
        a = self.problem.add_motion_activity(name, end - start)
        a.add_motion_effect(self.robots[robot], self.place(f"{name}_up", pose))
        change = {"activity": name, "object": robot, "time": end, "configuration": list(pose)}
        self.data["changes"].append(change)
        return self.timed(name, a, start, end)

    def timed(self, name, activity, start, end):
        self.activities[name] = activity
        self.data["activities"].append({"name": name, "start": start, "end": end})
        self.data["makespan"] = max(self.data["makespan"], end)
        return end

    def task(self, name, start, end):
        return self.timed(name, self.problem.add_activity(name, end - start), start, end)
