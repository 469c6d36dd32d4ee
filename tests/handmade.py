"""A small problem with a plan made by hand: two robots, a wall with a door, three items."""

import math
import os
from types import SimpleNamespace

import numpy as np
from PIL import Image, ImageDraw
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
    SE2WithControlsPath,
)
from unified_planning.plans import MotionSchedule
from unified_planning.shortcuts import ConfigurationType, MinimizeMakespan, MovableType

from up_samp.model import Trajectory

WIDTH, HEIGHT, RESOLUTION = 30.0, 16.0, 0.1
PLACES = {
    "depot0": (4.0, 4.0, 0.0),
    "depot1": (4.0, 12.0, 0.0),
    "button": (12.0, 4.0, 0.0),
    "item": (25.0, 4.0, 0.0),
    "corner": (12.0, 13.0, 0.5 * math.pi),
    "door_closed": (15.0, 4.0, 0.0),
    "door_open": (15.0, 9.0, 0.0),
}


def write_map(folder):
    """Draw the hall with a wall at x = 15, open where the door is (y in [2, 6])."""
    image = Image.new("L", (int(WIDTH / RESOLUTION), int(HEIGHT / RESOLUTION)), 254)
    draw = ImageDraw.Draw(image)
    w, h = image.size
    draw.rectangle([0, 0, w - 1, h - 1], outline=0, width=4)
    draw.rectangle([148, 0, 152, h - 61], fill=0)
    draw.rectangle([148, h - 20, 152, h - 1], fill=0)
    draw.rectangle([255, 4, 295, 30], fill=205)
    image.save(folder / "hall.png")
    path = folder / "hall.yaml"
    path.write_text(
        "image: hall.png\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


def drive(start, pieces, begin, v_max=2.0, a_max=0.5):
    """A rest-to-rest drive from ``start`` at ``begin`` along arcs ``(length, curvature)``."""
    distance = sum(length for length, _ in pieces)
    top = min(0.99 * v_max, math.sqrt(0.99 * a_max * distance))
    ramp = top / (0.99 * a_max)
    total = 2 * ramp + (distance - top * ramp) / top

    def gone(t):
        if t < ramp:
            return 0.5 * top / ramp * t * t
        if t > total - ramp:
            return distance - 0.5 * top / ramp * (total - t) ** 2
        return 0.5 * top * ramp + top * (t - ramp)

    def when(s):
        low, high = 0.0, total
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if gone(middle) < s else (low, middle)
        return low

    # the joints of the arcs are samples, so that every step has one curvature
    joints = np.cumsum([0.0, *(length for length, _ in pieces)])
    times = np.union1d(
        np.linspace(0.0, total, max(2, math.ceil(total / 0.05) + 1)),
        [when(s) for s in joints[1:-1]],
    )
    return Trajectory(times + begin, np.array([along(start, pieces, gone(t)) for t in times]))


def along(start, pieces, s):
    """The pose after ``s`` m on the arcs."""
    x, y, heading = start
    for length, curvature in pieces:
        part = min(max(s, 0.0), length)
        turn = curvature * part
        if curvature == 0.0:
            x, y = x + part * math.cos(heading), y + part * math.sin(heading)
        else:
            x += (math.sin(heading + turn) - math.sin(heading)) / curvature
            y -= (math.cos(heading + turn) - math.cos(heading)) / curvature
        heading += turn
        s -= length
    return x, y, heading


def make(folder):
    """Return the problem, its plan (with trajectories), and their parts by name."""
    robot_type, door_type = MovableType("robot"), MovableType("door")
    pose_type = ConfigurationType(
        "pose", OccupancyMap(os.fspath(write_map(folder)), (0, 0)), ConfigurationKind.SE2
    )
    problem = SchedulingMotionProblem("hall")
    box = [(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)]
    limits = {"turning_radius": 1.0, "v_max": 2.0, "a_max": 0.5}
    robots = [
        MovableObject(
            name,
            robot_type,
            footprint=box,
            motion_model=MotionModels.REEDSSHEPP,
            motion_parameters=limits,
        )
        for name in ("r0", "r1")
    ]
    door = MovableObject(
        "door",
        door_type,
        footprint=[(-0.5, -2.0), (0.5, -2.0), (0.5, 2.0), (-0.5, 2.0)],
        motion_model=MotionModels.SE2,
    )
    places = {n: ConfigurationObject(n, pose_type, SE2(*p)) for n, p in PLACES.items()}
    problem.add_objects([*robots, door, *places.values()])
    for movable, place in ((robots[0], "depot0"), (robots[1], "depot1"), (door, "door_closed")):
        problem.set_initial_configuration(movable, places[place])

    def move(robot, start, end, lower, upper):
        activity = problem.add_motion_activity(f"move_{robot.name}_{start}_to_{end}", optional=True)
        activity.set_duration_bounds(lower, upper)
        activity.add_motion_constraint(ActivityWaypoints(robot, places[start], [places[end]]))
        activity.add_motion_effect(robot, places[end])
        return activity

    to_button = move(robots[0], "depot0", "button", 5, 20)
    to_item = move(robots[0], "button", "item", 5, 30)
    to_corner = move(robots[1], "depot1", "corner", 5, 40)
    unused = move(robots[1], "corner", "depot1", 5, 40)
    opens = problem.add_motion_activity("open_door_r0", duration=1)
    opens.add_motion_effect(door, places["door_open"])
    pick = problem.add_activity("pick_r0_item", duration=2)
    scan = problem.add_activity("scan_shelves", duration=9)
    problem.add_quality_metric(MinimizeMakespan())

    trajectories = {
        to_button.name: drive(PLACES["depot0"], [(8.0, 0.0)], 0.0),
        to_item.name: drive(PLACES["button"], [(13.0, 0.0)], 10.5),
        to_corner.name: drive(PLACES["depot1"], [(7.0, 0.0), (0.5 * math.pi, 1.0)], 1.0),
    }
    times = {
        to_button: (0, 9),
        opens: (9, 10),
        to_item: (10, 23),
        to_corner: (1, 12),
        pick: (24, 26),
        scan: (2, 11),
    }
    assignment = {}
    for activity, (start, end) in times.items():
        assignment[activity.start] = start
        assignment[activity.end] = end
    plan = MotionSchedule(list(times), assignment, {}, problem.environment)
    plan.motion_paths = {
        (a, a.motion_constraints[0]): as_path(trajectories[a.name])
        for a in (to_button, to_item, to_corner)
    }
    plan.trajectories = trajectories
    return SimpleNamespace(
        problem=problem,
        plan=plan,
        trajectories=trajectories,
        robots=robots,
        door=door,
        unused=unused,
        pick=pick,
    )


def as_path(trajectory):
    """The trajectory as UP's path of constant-twist pieces."""
    pieces = []
    for i in range(len(trajectory.times)):
        pose = SE2(*(float(v) for v in trajectory.poses[i]))
        if i + 1 == len(trajectory.times):
            pieces.append((pose, 0.0, 0.0, 0.0))
            break
        seconds = float(trajectory.times[i + 1] - trajectory.times[i])
        dx, dy, turn = (float(v) for v in trajectory.poses[i + 1] - trajectory.poses[i])
        chord = math.hypot(dx, dy)
        arc = chord if abs(turn) < 1e-12 else chord * (turn / 2) / math.sin(turn / 2)
        pieces.append((pose, arc / seconds, turn / seconds, seconds))
    return SE2WithControlsPath(pieces)
