"""UP plans with timed trajectories."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import starmap
from typing import Any

import numpy as np
from unified_planning.environment import Environment
from unified_planning.model import Parameter, Timepoint, TimepointKind
from unified_planning.model.motion import (
    SE2,
    SE3,
    SchedulingMotionProblem,
    SE2Path,
    SE2WithControlsPath,
    SE3Path,
)
from unified_planning.model.scheduling import Activity
from unified_planning.plans import MotionSchedule, Schedule

from up_samp.model import CandidateSchedule, MotionModel, ProblemError, Trajectory, check_time
from up_samp.model.snapshot import Snapshot

PLAN_GRACE = 1.0
"""Seconds after its limit that a search may go on writing a plan down: it is found already."""
_CHUNK = 20_000
"""Steps of a path between two looks at the clock."""


class SampSchedule(MotionSchedule):  # type: ignore[misc]
    """A ``MotionSchedule`` that knows when each robot is where.

    ``trajectories`` maps activities to trajectories in s from the plan's start (an activity that
    moves several objects: ``activity#k`` for its k-th further constraint). One unit of its schedule
    is ``seconds_per_unit`` s. ``margin`` is the clearance that its motions were planned with, m
    (None: not known).
    """

    def __init__(
        self,
        activities: list[Activity],
        assignment: Mapping[Any, Any],
        motion_paths: Mapping[Any, Any],
        trajectories: Mapping[str, Trajectory],
        environment: Environment,
        seconds_per_unit: float = 1.0,
    ):
        super().__init__(activities, dict(assignment), dict(motion_paths), environment)
        self.trajectories: dict[str, Trajectory] = dict(trajectories)
        self.seconds_per_unit = seconds_per_unit
        self.margin: float | None = None


def figures_told(result: Any) -> dict[str, Any]:
    """Return what an engine's result tells in figures, by name."""
    return result.metrics or {}


def words_told(result: Any) -> list[str]:
    """Return what an engine's result tells in words."""
    told = result.log_messages
    some = told if isinstance(told, list | tuple) else filter(None, [told])  # cpse's is an error
    return [getattr(message, "message", repr(message)) for message in some]


def trajectory_key(activity: str, index: int) -> str:
    """Return the name in a plan of what an activity's motion constraint of this number drives."""
    return activity if index == 0 else f"{activity}#{index}"


def build_plan(
    problem: SchedulingMotionProblem,
    snapshot: Snapshot,
    schedule: CandidateSchedule,
    trajectories: Mapping[str, Trajectory],
    margin: float | None = None,
) -> SampSchedule:
    """Return the UP plan for a schedule whose motions were found.

    ``trajectories`` are keyed as :func:`trajectory_key` says, in s from the plan's start; they
    were planned with a clearance of ``margin`` m.
    """
    activities = [a for a in problem.activities if a.name in schedule.times]
    paths = {}
    by_name = {a.name: a for a in activities}
    for task in snapshot.tasks:
        if task.activity not in by_name:
            continue
        activity = by_name[task.activity]
        model = snapshot.objects[task.object].body.kinematics.model
        paths[activity, activity.motion_constraints[task.index]] = up_path(
            trajectories[trajectory_key(task.activity, task.index)], model
        )
    plan = SampSchedule(
        activities,
        _assignment(problem, schedule, activities),
        paths,
        trajectories,
        problem.environment,
        snapshot.seconds_per_unit,
    )
    plan.margin = margin
    return plan


def build_schedule(problem: Any, schedule: CandidateSchedule) -> Schedule:
    """Return the UP plan of a problem without motions."""
    activities = [a for a in problem.activities if a.name in schedule.times]
    assignment = _assignment(problem, schedule, activities)
    return Schedule(activities, assignment, problem.environment)


def to_candidate(schedule: Schedule) -> CandidateSchedule:
    """Return times of the present activities and values of all parameters of a UP schedule.

    Raises:
        ValueError: a time is no integer.
    """
    assignment: dict[Any, int] = {}
    parameters: dict[str, Any] = {}
    for variable, value in schedule.assignment.items():
        if isinstance(variable, Timepoint):
            constant = value.constant_value()
            if constant != int(constant):
                raise ValueError(f"{variable} is at {constant}, which is not an integer")
            assignment[variable.container, variable.kind] = int(constant)
        elif isinstance(variable, Parameter):  # cpse lists presences as well
            parameters[variable.name] = (
                value.object().name if value.is_object_exp() else value.constant_value()
            )
    ends = (TimepointKind.START, TimepointKind.END)
    times = {
        a.name: (assignment[a.name, ends[0]], assignment[a.name, ends[1]])
        for a in schedule.activities
    }
    return CandidateSchedule(times, parameters)


def _assignment(
    problem: Any, schedule: CandidateSchedule, activities: list[Activity]
) -> dict[Any, Any]:
    assignment: dict[Any, Any] = {}
    for activity in activities:
        start, end = schedule.times[activity.name]
        assignment[activity.start] = start
        assignment[activity.end] = end
        for parameter in activity.parameters:
            assignment[parameter] = _value(problem, schedule, parameter)
    for variable in problem.base_variables:
        assignment[variable] = _value(problem, schedule, variable)
    return assignment


def _value(problem: Any, schedule: CandidateSchedule, parameter: Any) -> Any:
    value = schedule.parameters[parameter.name]
    return problem.object(value) if isinstance(value, str) else value


def up_path(trajectory: Trajectory, model: MotionModel) -> SE2Path | SE3Path | SE2WithControlsPath:
    """Return a UP path: poses with controls (m/s, rad/s, s) for what drives along its heading,
    poses for others.
    """
    poses = trajectory.poses
    if model.mobility.flies:
        return SE3Path(list(starmap(SE3, poses.tolist())))
    if model.mobility.sideways:
        return SE2Path(list(starmap(SE2, poses.tolist())))
    steps = np.diff(trajectory.times)
    moves = np.diff(poses, axis=0)
    middle = poses[:-1, 2] + 0.5 * moves[:, 2]
    across = moves[:, 1] * np.cos(middle) - moves[:, 0] * np.sin(middle)
    if model.mobility.own_law and np.abs(across).max(initial=0.0) > 1e-6:  # m
        return SE2Path(list(starmap(SE2, poses.tolist())))
    chord = moves[:, 0] * np.cos(middle) + moves[:, 1] * np.sin(middle)
    half = 0.5 * moves[:, 2]
    stretch = np.ones_like(half)
    bent = np.abs(half) > 1e-9
    stretch[bent] = half[bent] / np.sin(half[bent])
    speeds = chord * stretch / steps
    turns = moves[:, 2] / steps
    path: list[tuple[SE2, float, float, float]] = []
    for first in range(0, len(steps), _CHUNK):
        check_time(PLAN_GRACE)
        part = slice(first, first + _CHUNK)
        numbers = (a[part].tolist() for a in (poses[:-1], speeds, turns, steps))
        path += [(SE2(*p), v, w, dt) for p, v, w, dt in zip(*numbers, strict=True)]
    path.append((SE2(*poses[-1].tolist()), 0.0, 0.0, 0.0))
    return SE2WithControlsPath(path)


def trajectories(plan: Schedule, seconds_per_unit: float = 1.0) -> dict[str, Trajectory]:
    """Return the timed trajectory of each motion, by activity (s from the plan's start; further
    motions of one by :func:`trajectory_key`).

    Plans of this package carry them; what a plan does not carry is read from its paths, which begin
    as their activities do.
    Raises :class:`ProblemError` for paths that carry no times.
    """
    found: dict[str, Trajectory] = dict(getattr(plan, "trajectories", None) or {})
    for (activity, constraint), path in getattr(plan, "motion_paths", {}).items():
        key = trajectory_key(activity.name, activity.motion_constraints.index(constraint))
        if key not in found:
            start = seconds_per_unit * float(plan.get(activity.start).constant_value())
            found[key] = path_trajectory(path, start, activity.name)
    return found


def path_trajectory(path: object, start: float, activity: str) -> Trajectory:
    """Return the timed motion along a UP path that starts at ``start`` (s, plan time).

    A ``SE2WithControlsPath`` is read as pieces of constant twist: from each pose its linear
    velocity (m/s, along the heading) and angular velocity (rad/s) hold for its duration (s).
    Other paths have no times: :class:`ProblemError`.
    """
    if not isinstance(path, SE2WithControlsPath):
        raise ProblemError(
            f"the path of activity '{activity}' ({type(path).__name__}) says nothing about time; "
            "a plan needs a trajectory or a SE2WithControlsPath for every motion"
        )
    if not path.path:
        raise ProblemError(f"the path of activity '{activity}' is empty")
    times: list[float] = [start]
    poses: list[tuple[float, float, float]] = []
    turned = 0.0
    for pose, speed, turn, seconds in path.path:
        if len(poses) == len(times):
            poses.pop()  # a piece without duration led there
        # continuous heading: the representation nearest to where the last piece ended
        whole = math.tau * round((turned - pose.theta) / math.tau) if poses else 0.0
        turned = float(pose.theta + whole)
        poses.append((float(pose.x), float(pose.y), turned))
        if seconds > 0:
            after = _after(poses[-1], speed, turn, seconds)
            turned = after[2]
            times.append(times[-1] + seconds)
    if len(poses) < len(times):
        poses.append(after)
    return Trajectory(np.asarray(times), np.asarray(poses, dtype=np.float64))


def _after(
    pose: tuple[float, float, float], speed: float, turn: float, seconds: float
) -> tuple[float, float, float]:
    """Return the pose after driving an arc: unicycle model, exact integration."""
    x, y, theta = pose
    half = turn * seconds / 2
    chord = speed * seconds * float(np.sinc(half / math.pi))
    ahead = theta + half
    return x + chord * math.cos(ahead), y + chord * math.sin(ahead), theta + 2 * half
