"""Robots, doors, poses and duration bounds that all families share (the paper's figures), and a
problem under construction on one map.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import shapely
import shapely.affinity
from unified_planning.model.motion import (
    SE2,
    ConfigurationKind,
    ConfigurationObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import ConfigurationType, MinimizeMakespan

from up_samp.benchmarks.maps import Rectangle
from up_samp.model import ProblemError

Pose = tuple[float, float, float]
"""``(x, y, theta)``: m, m, rad, world frame."""

ROBOT_FOOTPRINT = ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5))


CAR = {"turning_radius": 1.0, "v_max": 2.0}
"""Motion parameters of the robots of all families (m, m/s), which are 2 x 1 m large."""


@dataclass(frozen=True)
class FamilyDoor:
    """A door: its footprint (m, body frame), where it is closed and open, and its button."""

    name: str
    footprint: tuple[tuple[float, float], ...]
    closed: Pose
    open: Pose
    button: Pose


@dataclass(frozen=True)
class Shop:
    """One drawn job shop.

    ``jobs[j]`` is job j's route: (machine, processing time) pairs in order. ``machines[m]`` and
    ``starts[r]`` are poses (x, y, theta; m, rad).
    """

    jobs: tuple[tuple[tuple[int, int], ...], ...]
    machines: tuple[Pose, ...]
    starts: tuple[Pose, ...]


@dataclass(frozen=True)
class Layout:
    """Where things are: ``depots[r]``, ``inner[i]`` and ``outer[i]`` (x, y, theta; m, rad)."""

    depots: tuple[Pose, ...]
    inner: tuple[Pose, ...]
    outer: tuple[Pose, ...]


def box(length: float, width: float) -> tuple[tuple[float, float], ...]:
    """Return the corners of a ``length`` x ``width`` rectangle around the origin."""
    x, y = length / 2, width / 2
    return ((-x, -y), (x, -y), (x, y), (-x, y))


def duration_bounds(a: Pose, b: Pose, a_max: float) -> tuple[int, int]:
    """Return the bounds, s, that a user who knows no motion would set for a move from a to b.

    Lower: rest to rest over the Euclidean distance with a symmetric trapezoidal speed profile of
    acceleration ``a_max`` (m/s^2) and top speed 20 m/s, rounded down, at least 1. Upper: the same
    distance at 0.1 m/s, rounded up.
    """
    distance = math.hypot(b[0] - a[0], b[1] - a[1])
    fastest, slowest = 20.0, 0.1
    ramp = fastest**2 / a_max
    if distance < ramp:
        seconds = 2 * math.sqrt(distance / a_max)
    else:
        seconds = distance / fastest + fastest / a_max
    lower = max(1, math.floor(seconds))
    return lower, max(lower, math.ceil(round(distance / slowest, 9)))


def outline(footprint: Sequence[tuple[float, float]], pose: Pose) -> shapely.Polygon:
    """Return the region that a body with ``footprint`` covers at ``pose``, world frame, m."""
    turned = shapely.affinity.rotate(
        shapely.Polygon(footprint), pose[2], origin=(0, 0), use_radians=True
    )
    return shapely.affinity.translate(turned, pose[0], pose[1])


def check_poses(
    size: tuple[float, float],
    walls: Sequence[Rectangle],
    poses: dict[str, Pose],
    *,
    doors: Iterable[FamilyDoor] = (),
) -> None:
    """Check that robots may stand at all ``poses`` at the same time: inside the map, out of the
    walls, clear of every door open or closed, and 0.5 m apart from each other.

    :raises ProblemError: naming the pose that is wrong and what it touches.
    """
    room = shapely.box(0, 0, *size)
    solid = shapely.union_all([shapely.box(*w) for w in walls])
    leaves = [(d, outline(d.footprint, at)) for d in doors for at in (d.closed, d.open)]
    standing = {name: outline(ROBOT_FOOTPRINT, pose) for name, pose in poses.items()}
    for name, robot in standing.items():
        if not room.contains(robot) or robot.intersects(solid):
            raise ProblemError(f"a robot cannot stand at {name} {poses[name]}: it is in a wall")
        for door, leaf in leaves:
            if robot.intersects(leaf):
                raise ProblemError(f"a robot cannot stand at {name}: door {door.name} is there")
    names = list(standing)
    tree = shapely.STRtree(list(standing.values()))
    for i, name in enumerate(names):
        for j in tree.query(standing[name].buffer(0.5), predicate="intersects"):
            if i < j:
                raise ProblemError(f"{name} and {names[j]} are less than 0.5 m apart")


# ------------------ A problem under construction on one map: what every family begins with


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
