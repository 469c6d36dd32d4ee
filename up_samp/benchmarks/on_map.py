"""A problem under construction on one map: what every family begins with."""

from __future__ import annotations

from unified_planning.model.motion import (
    SE2,
    ConfigurationKind,
    ConfigurationObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import ConfigurationType, MinimizeMakespan

from up_samp.benchmarks.places import Pose


class ProblemOnMap:
    """A problem with a map and named places on it; ``metric``: the makespan is minimised."""

    def __init__(self, name: str, map_yaml: str, *, metric: bool, poses: str = "pose") -> None:
        self.problem = SchedulingMotionProblem(name)
        occupancy = OccupancyMap(map_yaml, SE2(0.0, 0.0, 0.0))
        self.pose_type = ConfigurationType(poses, occupancy, ConfigurationKind.SE2)
        self.poses: dict[str, Pose] = {}
        if metric:
            self.problem.add_quality_metric(MinimizeMakespan())

    def place(self, name: str, pose: Pose) -> ConfigurationObject:
        """Add a named configuration at ``pose`` (x, y, theta; m, rad; world frame)."""
        place = ConfigurationObject(name, self.pose_type, SE2(*pose))
        self.problem.add_object(place)
        self.poses[name] = pose
        return place
