"""A small hall with robots, and straight drives in it: what the test cases are made of."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    MotionModels,
    MovableObject,
    SE2WithControlsPath,
)
from unified_planning.plans import MotionSchedule
from unified_planning.shortcuts import MovableType

from up_samp.benchmarks.places import FamilyDoor, Pose, ProblemOnMap, box, drawn_map, outer_wall

HALL = (40.0, 20.0)
DIVIDER = ((19.5, 0.0, 20.5, 8.0), (19.5, 12.0, 20.5, 20.0))


def hall_map(*, divided: bool) -> Path:
    """Return the YAML file of a hall of 40 x 20 m; ``divided``: a wall with an opening of 4 m."""
    walls = [*outer_wall(*HALL), *(DIVIDER if divided else ())]
    return drawn_map("two-rooms" if divided else "one-room", HALL, walls)


@dataclass(frozen=True)
class DriveLimits:
    """What robots can do, and how finely their drives are cut."""

    v_max: float = 2.0
    """m/s"""
    a_max: float = 1.0
    """m/s^2"""
    step: float = 0.04
    """Longest piece of constant speed, s."""


PACE = DriveLimits()


DOOR = FamilyDoor("door", box(1, 5), (20.0, 10.0, 0.0), (20.0, 4.0, 0.0), (10.0, 10.0, 0.0))
"""Closes the opening between the two rooms; open it rests in the wall."""


class SceneBuilder(ProblemOnMap):
    """A problem in a hall of 40 x 20 m (``rooms``: with a wall across and an opening of 4 m)."""

    def __init__(self, name: str, *, rooms: bool = False, metric: bool = True) -> None:
        super().__init__(name, str(hall_map(divided=rooms)), metric=metric)
        self.robot_type = MovableType("robot")

    def robot(
        self, name: str, start: ConfigurationObject, model: MotionModels = MotionModels.REEDSSHEPP
    ) -> MovableObject:
        """Add a robot of 2 x 1 m with v_max 2 m/s and a_max 1 m/s^2 that stands at ``start``."""
        robot = MovableObject(
            name,
            self.robot_type,
            footprint=list(box(2, 1)),
            motion_model=model,
            motion_parameters={"v_max": PACE.v_max, "a_max": PACE.a_max},
        )
        self.problem.add_object(robot)
        self.problem.set_initial_configuration(robot, start)
        return robot

    def door(self) -> tuple[MovableObject, ConfigurationObject, ConfigurationObject]:
        """Add a closed door in the opening between the rooms; return it, closed, and open."""
        door = MovableObject(
            DOOR.name,
            MovableType("door"),
            footprint=list(DOOR.footprint),
            motion_model=MotionModels.SE2,
        )
        closed, opened = self.place("closed", DOOR.closed), self.place("open", DOOR.open)
        self.problem.add_object(door)
        self.problem.set_initial_configuration(door, closed)
        return door, closed, opened

    def drive(
        self,
        name: str,
        robot: MovableObject,
        stops: Sequence[ConfigurationObject],
        bounds: tuple[int, int],
        *,
        optional: bool = False,
    ) -> MotionActivity:
        """Add the motion of ``robot`` through ``stops``; every other object is an obstacle."""
        a = self.problem.add_motion_activity(name, optional=optional)
        a.set_duration_bounds(*bounds)
        a.add_motion_constraint(ActivityWaypoints(robot, stops[0], list(stops[1:])))
        return a


def straight(
    a: Pose, b: Pose, *, v_max: float = PACE.v_max, a_max: float = PACE.a_max
) -> SE2WithControlsPath:
    """Return the fastest drive straight ahead or back from ``a`` to ``b``, rest to rest.

    Trapezoidal speed, cut into pieces of constant speed of at most 0.04 s.
    """
    length = math.dist(a[:2], b[:2])
    ahead = (b[0] - a[0]) * math.cos(a[2]) + (b[1] - a[1]) * math.sin(a[2]) > 0
    ramp = min(v_max / a_max, math.sqrt(length / a_max))
    top = a_max * ramp
    total = length / top + ramp
    pieces = math.ceil(total / PACE.step)
    times = [total * i / pieces for i in range(pieces + 1)]

    def travelled(t: float) -> float:
        rest = max(0.0, t - (total - ramp))
        return top * (t - min(t, ramp) + min(t, ramp) ** 2 / (2 * ramp)) - a_max * rest**2 / 2

    def pose(s: float) -> SE2:
        share = s / length
        return SE2(a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2])

    path = []
    for t, u in itertools.pairwise(times):
        s = travelled(t)
        path.append((pose(s), (travelled(u) - s) / (u - t) * (1 if ahead else -1), 0.0, u - t))
    path.append((pose(length), 0.0, 0.0, 0.0))
    return SE2WithControlsPath(path)


def plan(
    scene: SceneBuilder,
    times: Mapping[str, tuple[int, int]],
    paths: Mapping[str, SE2WithControlsPath],
) -> MotionSchedule:
    """Return the plan in which the activities of ``times`` are present, with their paths."""
    present = [a for a in scene.problem.activities if a.name in times]
    assignment = {}
    for a in present:
        assignment[a.start], assignment[a.end] = times[a.name]
    motion_paths = {(a, a.motion_constraints[0]): paths[a.name] for a in present if a.name in paths}
    return MotionSchedule(present, assignment, motion_paths)
