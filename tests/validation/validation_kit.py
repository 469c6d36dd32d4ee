"""A small hall with a wall and a door, two cars, and hand-made timed drives."""

import math

import numpy as np
from PIL import Image
from unified_planning.environment import get_environment
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
from up_samp.validation import validate_plan

get_environment().credits_stream = None
CAR = [(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)]
DOOR = [(-0.15, -2.0), (0.15, -2.0), (0.15, 2.0), (-0.15, 2.0)]
V, A, R = 2.0, 0.5, 1.0
HOME = (4.0, 10.0, 0.0)
WAY = [(10.0, 0.0), (3.0, 0.5), (-4.0, 0.0), (6.0, -1.0)]


def write_map(folder, cells, resolution=0.1, origin=(0.0, 0.0, 0.0), extra="", name="hall"):
    """``cells``: 0 free, 1 occupied, 2 unknown; row 0 at the lowest y."""
    levels = np.array([254, 0, 205], dtype=np.uint8)[np.flipud(np.asarray(cells))]
    Image.fromarray(levels).save(folder / f"{name}.png")
    file = folder / f"{name}.yaml"
    file.write_text(
        f"image: {name}.png\nresolution: {resolution}\norigin: {list(origin)}\nnegate: 0\n"
        f"occupied_thresh: 0.65\nfree_thresh: 0.196\n{extra}"
    )
    return file


def hall():
    """40 m x 20 m with an outer wall, and a wall one cell thin at x = 20 but for y in [8, 12]."""
    cells = np.zeros((200, 400), dtype=int)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    cells[:80, 200] = 1
    cells[120:, 200] = 1
    return cells


def profile(length, v=V, a=A):
    """Return (duration, s(t)) of a rest-to-rest trapezoid over ``length`` m."""
    top = min(v, math.sqrt(a * length))
    ramp = top / a
    total = 2 * ramp + (length - top * ramp) / top

    def way(t):
        t = min(max(t, 0.0), total)
        if t < ramp:
            return a * t * t / 2
        if t < total - ramp:
            return top * (t - ramp / 2)
        return length - a * (total - t) ** 2 / 2

    return total, way


def advance(pose, way, curvature):
    """Drive ``way`` m (signed) along an arc."""
    x, y, theta = pose
    turn = way * curvature
    chord = way * float(np.sinc(turn / 2 / math.pi))
    heading = theta + turn / 2
    return x + chord * math.cos(heading), y + chord * math.sin(heading), theta + turn


def drive(start, segments, begin=0.0, v=V, a=A, step=0.05):
    """A car's trajectory: ``segments`` are (signed length, curvature); it stops at each cusp only.

    Sampled every ``step`` s (not at the joints of segments) and at cusps.
    """
    times, poses, pose, clock = [begin], [tuple(map(float, start))], start, begin
    runs = []
    for length, curvature in segments:
        if runs and (runs[-1][-1][0] > 0) == (length > 0):
            runs[-1].append((length, curvature))
        else:
            runs.append([(length, curvature)])
    for run in runs:
        total, way = profile(sum(abs(s) for s, _ in run), v, a)
        for t in [*np.arange(step, total - 1e-6, step), total]:
            rest, here = way(t), pose
            for length, curvature in run:
                part = min(rest, abs(length))
                here = advance(here, math.copysign(part, length), curvature)
                rest -= part
            times.append(clock + float(t))
            poses.append(here)
        clock, pose = clock + total, poses[-1]
    return Trajectory(np.array(times), np.array(poses))


def controls(trajectory):
    """The UP path of a trajectory."""
    path = []
    for i in range(len(trajectory.times) - 1):
        dt = float(trajectory.times[i + 1] - trajectory.times[i])
        (x, y, a), (x2, y2, b) = trajectory.poses[i], trajectory.poses[i + 1]
        middle = (a + b) / 2
        along = (x2 - x) * math.cos(middle) + (y2 - y) * math.sin(middle)
        along /= float(np.sinc((b - a) / 2 / math.pi))
        path.append((SE2(float(x), float(y), float(a)), along / dt, (b - a) / dt, dt))
    path.append((SE2(*map(float, trajectory.poses[-1])), 0.0, 0.0, 0.0))
    return SE2WithControlsPath(path)


class World:
    """A problem and a plan that grow together: each ``move`` adds an activity and its motion."""

    def __init__(self, folder, cells=None, **options):
        file = write_map(folder, hall() if cells is None else cells, **options)
        self.problem = SchedulingMotionProblem("world")
        self.robot = MovableType("robot")
        self.place_type = ConfigurationType(
            "place", OccupancyMap(str(file), (0, 0)), ConfigurationKind.SE2
        )
        self.times, self.trajectories, self.movables, self.places = {}, {}, {}, {}
        self.problem.add_quality_metric(MinimizeMakespan())

    def place(self, pose):
        pose = tuple(map(float, pose))
        if pose not in self.places:
            item = ConfigurationObject(f"q{len(self.places)}", self.place_type, SE2(*pose))
            self.problem.add_object(item)
            self.places[pose] = item
        return self.places[pose]

    def object(self, name, pose, footprint=CAR, model=MotionModels.REEDSSHEPP, **options):
        parameters = {"turning_radius": R, "v_max": V, "a_max": A}
        options.setdefault("motion_parameters", parameters)
        item = MovableObject(name, self.robot, footprint=footprint, motion_model=model, **options)
        self.problem.add_object(item)
        if pose is not None:
            self.problem.set_initial_configuration(item, self.place(pose))
        self.movables[name] = item
        return item

    def move(self, activity, name, trajectory, start, end, stops=(), fake=None, **obstacles):
        poses = [tuple(trajectory.poses[0]), *stops, tuple(trajectory.poses[-1])]
        item = self.problem.add_motion_activity(activity)
        item.set_duration_bounds(0, 1000)
        item.add_motion_constraint(
            ActivityWaypoints(
                self.movables[name],
                self.place(poses[0]),
                [self.place(p) for p in (fake or poses)[1:]],
                **obstacles,
            )
        )
        self.times[activity] = (start, end)
        self.trajectories[activity] = trajectory
        return item

    def set_place(self, activity, name, pose, start, end):
        item = self.problem.add_motion_activity(activity)
        item.set_duration_bounds(0, 1000)
        item.add_motion_effect(self.movables[name], self.place(pose))
        self.times[activity] = (start, end)
        return item

    def plan(self, paths=False):
        assignment, motion_paths = {}, {}
        activities = [a for a in self.problem.activities if a.name in self.times]
        for a in activities:
            assignment[a.start], assignment[a.end] = self.times[a.name]
            if paths and a.name in self.trajectories:
                motion_paths[a, a.motion_constraints[0]] = controls(self.trajectories[a.name])
        return MotionSchedule(activities, assignment, motion_paths)


def kinds(verdict):
    return sorted({v.kind for v in verdict.violations})


def judge(w, **options):
    return validate_plan(
        w.problem, w.plan(), options.pop("trajectories", w.trajectories), **options
    )


def changed(trajectory, change):
    """A copy with ``change(times, poses)`` applied to copies in place."""
    times, poses = trajectory.times.copy(), trajectory.poses.copy()
    result = change(times, poses)
    return Trajectory(*(result or (times, poses)))
