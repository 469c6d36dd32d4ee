"""Problems that are small to write and dear to work on: each tries one stage of a solve."""

from __future__ import annotations

import math

import numpy as np
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
from unified_planning.shortcuts import LE, get_environment

from up_samp.geometry import write_map

BOX = [(-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (-0.4, 0.3)]


class Floor:
    """A walled rectangle, ``size`` m, with robots; activities are added by ``move``."""

    def __init__(self, folder, size, cell=0.1, cells=None):
        if cells is None:
            cells = np.zeros((round(size[1] / cell), round(size[0] / cell)), dtype=bool)
        cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
        file = write_map(folder, "floor", cells, cell)
        types = get_environment().type_manager
        self.kind = types.ConfigurationType(
            "spot", OccupancyMap(str(file), (0, 0)), ConfigurationKind.SE2
        )
        self.problem = SchedulingMotionProblem("dear")
        self.problem.add_quality_metric(MinimizeMakespan())
        self.poses, self.robots = {}, {}

    def pose(self, name, x, y, yaw=0.0):
        self.poses[name] = ConfigurationObject(name, self.kind, SE2(x, y, yaw))
        self.problem.add_object(self.poses[name])

    def robot(self, name, start, footprint=BOX, model=MotionModels.REEDSSHEPP, **limits):
        item = MovableObject(
            name,
            get_environment().type_manager.MovableType(f"kind_{name}"),
            footprint=footprint,
            motion_model=model,
            motion_parameters=limits or {"turning_radius": 1.0, "v_max": 1.0, "a_max": 1.0},
        )
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.poses[start])
        self.robots[name] = item

    def move(self, name, robot, start, goal, most=10**6, after=None):
        activity = self.problem.add_motion_activity(name, 1)
        activity.set_duration_bounds(1, most)
        activity.add_motion_constraint(
            ActivityWaypoints(self.robots[robot], self.poses[start], [self.poses[goal]])
        )
        if after is not None:
            self.problem.add_constraint(LE(after.end, activity.start))
        return activity


def large_map(folder, scale):
    """A map of up to 9,000 x 9,000 cells with a comb of walls."""
    n = round(9000 * scale)
    cells = np.zeros((n, n), dtype=bool)
    for k, x in enumerate(range(n // 10, n - 20, max(40, n // 10))):
        cells[: n - 60, x : x + 3] |= k % 2 == 0
        cells[60:, x : x + 3] |= k % 2 == 1
    floor = Floor(folder, None, 0.05, cells)
    floor.pose("a", 1.5, 1.5)
    floor.pose("b", n * 0.05 - 1.5, n * 0.05 - 1.5)
    floor.robot("r0", "a")
    floor.move("go", "r0", "a", "b")
    return floor.problem


def long_chain(folder, scale):
    """One robot with up to 1,000 drives, one after the other."""
    floor = Floor(folder, (20, 10))
    spots = [(2 + 4 * (k % 5), 2 + 3 * (k // 5)) for k in range(15)]
    for k, spot in enumerate(spots):
        floor.pose(f"p{k}", *spot)
    floor.robot("r0", "p0")
    last = None
    for k in range(round(1000 * scale)):
        last = floor.move(f"go{k}", "r0", f"p{k % 15}", f"p{(k + 1) % 15}", after=last)
    return floor.problem


def many_robots(folder, scale):
    """Up to 40 robots that cross one hall, each there and back."""
    count = max(3, round(40 * scale))
    floor = Floor(folder, (20, 2 * count + 2))
    for k in range(count):
        floor.pose(f"w{k}", 2, 2 + 2 * k)
        floor.pose(f"e{k}", 18, 2 + 2 * (count - 1 - k))
    for k in range(count):
        floor.robot(f"r{k}", f"w{k}")
        out = floor.move(f"out{k}", f"r{k}", f"w{k}", f"e{k}")
        floor.move(f"back{k}", f"r{k}", f"e{k}", f"w{k}", after=out)
    return floor.problem


def star(folder, scale):
    """A robot whose footprint is a star with up to 1,000 corners."""
    n = max(6, 2 * round(500 * scale))
    corners = [
        (r * math.cos(2 * math.pi * k / n), r * math.sin(2 * math.pi * k / n))
        for k in range(n)
        for r in [0.6 if k % 2 else 0.4]
    ]
    floor = Floor(folder, (20, 10))
    floor.pose("a", 3, 3)
    floor.pose("b", 17, 7, 1.0)
    floor.pose("c", 3, 7)
    floor.pose("d", 17, 3)
    floor.robot("r0", "a", corners)
    floor.robot("r1", "c", corners)
    floor.move("go0", "r0", "a", "b")
    floor.move("go1", "r1", "c", "d")
    return floor.problem


def slow(folder, scale):
    """Robots that need hours: as slow as 1 cm/s over 100 m."""
    floor = Floor(folder, (110, 10))
    limits = {"v_max": 0.01 / scale, "a_max": 0.01, "turning_radius": 1.0}
    floor.pose("a", 3, 3)
    floor.pose("b", 105, 7)
    floor.pose("c", 105, 3)
    floor.pose("d", 3, 7)
    floor.robot("r0", "a", **limits)
    floor.robot("r1", "c", **limits)
    floor.move("go0", "r0", "a", "b")
    floor.move("go1", "r1", "c", "d")
    return floor.problem


def tight_turns(folder, scale):
    """Cars with turning radii down to 1 mm, behind a wall."""
    cells = np.zeros((100, 200), dtype=bool)
    cells[:70, 99:101] = True
    floor = Floor(folder, None, 0.1, cells)
    limits = {"turning_radius": 0.001 / scale, "v_max": 5.0, "a_max": 50.0}
    floor.pose("a", 3, 3)
    floor.pose("b", 17, 3, 2.0)
    floor.pose("c", 17, 7)
    floor.pose("d", 3, 7)
    floor.robot("r0", "a", **limits)
    floor.robot("r1", "c", **limits)
    floor.move("go0", "r0", "a", "b")
    floor.move("go1", "r1", "c", "d")
    return floor.problem


def long_lists(folder, scale):
    """Up to 300 robots that stand about, and one that drives past them all."""
    count = round(300 * scale)
    floor = Floor(folder, (40, 20))
    for k in range(count):
        floor.pose(f"s{k}", 2 + 1.2 * (k % 30), 4 + 1.2 * (k // 30))
    floor.pose("a", 2, 2)
    floor.pose("b", 38, 2)
    floor.robot("r", "a")
    for k in range(count):
        floor.robot(f"o{k}", f"s{k}")
    floor.move("go", "r", "a", "b")
    return floor.problem


def many_choices(folder, scale):
    """A drive to one of up to 400 places, then to another one."""
    count = max(4, round(400 * scale))
    floor = Floor(folder, (40, 40))
    for k in range(count):
        floor.pose(f"p{k}", 2 + 1.8 * (k % 20), 2 + 1.8 * (k // 20), 0.1 * k)
    floor.robot("r0", "p0")
    first = floor.problem.add_motion_activity("first", 1)
    first.set_duration_bounds(1, 1000)
    to = first.add_parameter("to", floor.kind)
    first.add_motion_constraint(ActivityWaypoints(floor.robots["r0"], floor.poses["p0"], [to]))
    then = floor.problem.add_motion_activity("then", 1)
    then.set_duration_bounds(1, 1000)
    on = then.add_parameter("on", floor.kind)
    then.add_motion_constraint(ActivityWaypoints(floor.robots["r0"], to, [on]))
    floor.problem.add_constraint(LE(first.end, then.start))
    return floor.problem


KINDS = {
    f.__name__: f
    for f in (
        large_map, long_chain, many_robots, star, slow, tight_turns, long_lists, many_choices,
    )
}  # fmt: skip
