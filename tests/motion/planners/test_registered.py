"""The motion service finds the right planner: by name, by motion model, as a second opinion."""

import numpy as np
import pytest

from tests.motion.planners import ompl_oracle as oracle
from tests.motion.planners.ompl_oracle import CAR, CRATE, GOAL, OMNI, START, unicycle
from up_samp.model import (
    Body,
    ControlLaw,
    Deadline,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    ProblemError,
    UnsupportedError,
)
from up_samp.motion.registry import planner_names
from up_samp.motion.service import MotionService

GRID = oracle.hall()
WALLS = oracle.walls(GRID).union(oracle.obstacles_of([CRATE]))


@pytest.mark.parametrize("body", [CAR, OMNI], ids=["car", "omni"])
@pytest.mark.parametrize("planner", ["RRT", "rrtconnect", "BITstar"])
def test_by_name(planner, body):
    service = MotionService(GRID, planner=planner, seed=5)
    query = PathQuery(body, (START, GOAL, START), (CRATE,))
    report = service.plan(query, Deadline.after(20))
    assert report.outcome is Outcome.FOUND
    assert report.planner == planner
    oracle.check_limits(body, report.trajectory)
    assert oracle.clearance(body, report.trajectory.poses[::4], WALLS) > 0
    again = MotionService(GRID, planner=planner, seed=5).plan(query, Deadline.after(20))
    assert np.array_equal(again.trajectory.poses, report.trajectory.poses)


def test_control_models_by_default():
    law = ControlLaw(unicycle, (("v", -0.5, 1.5), ("w", -1.0, 1.0)))
    body = Body(oracle.FOOTPRINT, Kinematics(MotionModel.CONTROL, control=law))
    report = MotionService(GRID).plan(PathQuery(body, (START, GOAL), (CRATE,)), Deadline.after(20))
    assert report.outcome is Outcome.FOUND
    assert report.planner == "control"


def test_second_opinions():
    assert planner_names("default", CAR) == ("car", "RRTConnect")
    assert planner_names("default", OMNI) == ("planar", "RRTConnect")


def test_unknown_names():
    query = PathQuery(CAR, (START, GOAL))
    with pytest.raises(ProblemError, match=r"'warp'.*car.*RRTConnect"):
        MotionService(GRID, planner="warp").plan(query, Deadline.after(1))
    with pytest.raises(UnsupportedError, match="AORRTC"):
        MotionService(GRID, planner="AORRTC").plan(query, Deadline.after(1))
