"""Random floors, and groups of robots that cross on them, for tests of rules of driving."""

import math
from itertools import islice

import numpy as np
import pytest

from tests.motion.fleet.independent import broken_by, judge
from tests.usual import usually
from up_samp.geometry import OccupancyGrid
from up_samp.model import (
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    TimedMotion,
)
from up_samp.motion import MotionService
from up_samp.motion.curves.slowing import may_stand

RING = ((-0.6, -0.35), (0.6, -0.35), (0.6, 0.35), (-0.6, 0.35))
WEDGE = ((-0.3, -0.35), (0.9, 0.0), (-0.3, 0.35))
CAR = Kinematics(MotionModel.REEDSSHEPP, 0.8, 1.5, 0.7)
WHEELS = Kinematics(MotionModel.PIVOT, v_max=1.5, a_max=0.7, omega_max=0.8)
ANY = Kinematics(MotionModel.SE2, v_max=1.5, a_max=0.7, omega_max=0.8)
NAMED = {"argnames": "kinematics", "ids": ["car", "diff", "omni"]}
KINDS = pytest.mark.parametrize(argvalues=[CAR, WHEELS, ANY], **NAMED)
CARS = pytest.mark.parametrize(argvalues=usually(CAR, of=[CAR, WHEELS, ANY]), **NAMED)
"""The others only where the slow tests are run."""


def hall(length=16.0, width=9.0):
    return OccupancyGrid(np.zeros((round(10 * width), round(10 * length)), dtype=bool), 0.1)


def floor(rng, blocks, largest=2.2):
    """A hall of 14 m by 10 m with blocks in it."""
    cells = np.zeros((100, 140), dtype=bool)
    for _ in range(blocks):
        row, col = int(rng.integers(15, 85)), int(rng.integers(15, 125))
        high, wide = rng.integers(4, round(10 * largest), 2)
        cells[row : row + high, col : col + wide] = True
    cells[[0, -1]] = cells[:, [0, -1]] = True
    return OccupancyGrid(cells, 0.1)


def free_pose(rng, service, body):
    while True:
        pose = tuple(map(float, rng.uniform((0.9, 0.9, -math.pi), (13.1, 9.1, math.pi))))
        if service.scene.pose_free(body, pose) and may_stand(body, pose):
            return pose


def drive(body, *poses, service=None):
    """Return the report on a motion that was found, and that the rules allow."""
    report = (service or MotionService(hall())).plan(PathQuery(body, poses), Deadline.after(300))
    assert report.outcome is Outcome.FOUND, report.reason
    assert not broken_by("r", body, report.trajectory)
    return report


class Crossing:
    """Robots with some ``bodies`` on one floor: each has a way, and its ends to itself.
    ``before`` tells through which poses a way to a goal leads.
    """

    def __init__(self, rng, grid, bodies, count, seconds, due, before=lambda goal: ()):
        self.grid, self.service = grid, MotionService(grid, seed=0)
        starts, goals, motions = [], [], []
        for k, body in enumerate(islice(bodies, count)):
            while True:
                start, goal = (free_pose(rng, self.service, body) for _ in range(2))
                poses = (start, *before(goal), goal)
                far = all(
                    math.dist(pose[:2], other[:2]) > 2.2
                    for pose, known in ((start, starts), (goal, goals))
                    for other in known
                )
                alone = self.service.plan(PathQuery(body, poses), Deadline.after(seconds))
                if far and alone.outcome is Outcome.FOUND:
                    break
            starts.append(start)
            goals.append(goal)
            motions.append(TimedMotion(f"m{k}", f"r{k}", body, poses, 0.0, due))
        self.query, self.seconds = GroupQuery(tuple(motions)), seconds

    def found(self, folder):
        """Whether the group is found, after judging it by every rule."""
        report = self.service.coordinate(self.query, Deadline.after(self.seconds))
        if report.outcome is not Outcome.FOUND:
            return False
        judge(self, report, folder)
        return True
