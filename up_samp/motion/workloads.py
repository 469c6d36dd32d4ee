"""What is run once so that numba compiles it: a small motion of each kind (see :mod:`.compile`)."""

from __future__ import annotations

import math

import numpy as np

from up_samp.geometry import OccupancyGrid, Scene
from up_samp.geometry.shapes import shape_of
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    Rest,
    TimedMotion,
    Trajectory,
)
from up_samp.model.arrays import BoolArray
from up_samp.motion.curves.reeds_shepp import shortest
from up_samp.motion.curves.trapezoid import limits_of
from up_samp.motion.service import MotionService

_BODY = Body(
    ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)), Kinematics(MotionModel.REEDSSHEPP)
)


class _Straight:
    """Plans straight drives, so that comparing and tuning paths needs no path kernels."""

    def plan(self, query: PathQuery, deadline: Deadline) -> PathReport:
        """Return a straight drive (for compiling only: it heeds nothing)."""
        drive = _drive(query.poses[0], query.poses[-1])
        return PathReport(Outcome.FOUND, drive, planner="straight")


def _drive(start: Configuration, goal: Configuration) -> Trajectory:
    times = np.linspace(0.0, 8.0, 161)
    shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, 161))
    poses = np.array(start) + shares[:, None] * (np.array(goal) - np.array(start))
    return Trajectory(times, poses)


def _hall() -> OccupancyGrid:
    """Return a hall of 12 x 8 m with a wall in it."""
    cells: BoolArray = np.zeros((40, 60), dtype=np.bool_)
    cells[:20, 28:32] = True
    return OccupancyGrid(cells, 0.2)


def compile_bounds() -> None:
    """Run what bounds and refutes motions of single bodies, once."""
    from up_samp.geometry.cells import Visibility
    from up_samp.motion.guides import Fields

    hall = _hall()
    start, goal = (3.0, 2.0, 0.0), (9.0, 2.0, math.pi / 2)
    Visibility(hall.blocked, 0.2).distance((5.0, 5.0), (55.0, 5.0))
    service = MotionService(hall)
    parked = (Placed("parked", _BODY, (3.0, 6.5, 0.0)),)
    Fields(service.scene).toward(shape_of(_BODY, 0.01), goal, parked)
    service.lower_bound(_BODY, (start, goal))
    service.certificate(_BODY, (start, goal), parked)


def compile_paths() -> None:
    """Run what plans single cars, once: first what bounds do not need (see :mod:`.compile`)."""
    service = MotionService(_hall())
    start, goal = (3.0, 2.0, 0.0), (9.0, 2.0, math.pi / 2)
    parked = (Placed("parked", _BODY, (3.0, 6.5, 0.0)),)
    service.scene.map_free(_BODY, start)
    shortest(start, goal, 1.0)
    service.plan(PathQuery(_BODY, (start, goal), parked), Deadline.never())


def compile_shortcuts() -> None:
    """Run what shortens a car's path, once: the last that planning it needs, so that another
    process has time to compile it.
    """
    from up_samp.motion.planners.car import improve

    scene = Scene(_hall())
    world = scene.world(shape_of(_BODY, 0.01), (Placed("parked", _BODY, (3.0, 6.5, 0.0)),))
    arcs = np.array([[0.0, 2.0], [1.0, 1.0], [0.0, 1.0]])
    start = np.array((1.0, 6.0, 0.0))
    improve(world, start, arcs, limits_of(_BODY.kinematics), (4, 4), 0)


def _motion(name: str, *poses: tuple[float, float, float]) -> TimedMotion:
    return TimedMotion(name, name, _BODY, poses, 0.0, 8.5)


def compile_groups() -> None:
    """Run what coordinates cars, once: two that cross where a third one rests; and what proposes a
    way around one that rests.
    """
    from up_samp.motion.fleet import coordinate
    from up_samp.motion.fleet.paths import path_of
    from up_samp.motion.fleet.space_time import Proposer
    from up_samp.motion.fleet.workspace import Workspace, rest_run

    east = _motion("east", (1.0, 4.0, 0.0), (7.0, 4.0, 0.0))
    north = _motion("north", (4.0, 1.0, math.pi / 2), (4.0, 7.0, math.pi / 2))
    third = Rest("third", _BODY, (1.0, 7.5, 0.0), -math.inf, math.inf)
    straight = _Straight()
    coordinate(straight, GroupQuery((east, north), (third,)), Deadline.never())
    workspace = Workspace(straight)
    one, other = (path_of(_drive(*m.poses), _BODY, m.poses) for m in (east, north))
    workspace.passing(one, other, 3)
    fourth = rest_run(workspace, Rest("fourth", _BODY, (4.0, 4.0, 0.0)))
    Proposer(Scene(_hall(), 0.01)).propose(east, [fourth])


def compile_knots() -> None:
    """Run the search for joint moves, once: two that change places."""
    from up_samp.motion.fleet.deadlocks import Agent, Joint
    from up_samp.motion.fleet.roadmap import Roadmap

    ends = ((2.0, 4.0, 0.0), (4.0, 4.0, 0.0))
    body = Body(_BODY.footprint, Kinematics(MotionModel.SE2))
    roadmap = Roadmap(Scene(_hall()), body, ends, (), 1.0)
    places = [roadmap.place(pose) for pose in ends]
    agents = [
        Agent(roadmap, start, goal, roadmap.to_go(goal))
        for start, goal in (places, reversed(places))
    ]
    Joint(agents, [[False, True], [True, False]], 0.01).search(10_000, Deadline.never())


def compile_planar() -> None:
    """Run what plans single omnidirectional bodies, once."""
    service = MotionService(_hall())
    body = Body(_BODY.footprint, Kinematics(MotionModel.SE2))
    start, goal = (3.0, 2.0, 0.0), (9.0, 2.0, math.pi / 2)
    service.lower_bound(body, (start, goal))
    service.plan(PathQuery(body, (start, goal)), Deadline.never())
