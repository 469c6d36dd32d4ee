"""Bodies that drive along their heading and turn on the spot."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import MovableType

from up_samp.geometry import OccupancyGrid
from up_samp.geometry.kernels import samples_free
from up_samp.model import (
    Body,
    Deadline,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    Placed,
    ProblemError,
)
from up_samp.motion.legs import parking_clears
from up_samp.motion.planners.car import PivotPlanner
from up_samp.motion.protocol import LegQuery
from up_samp.motion.service import MotionService
from up_samp.upio.read_maps import read_movable
from up_samp.validation.kinematics import limits_of, motion_violations

RING = ((-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (-0.6, 0.4))
BODY = Body(RING, Kinematics(MotionModel.PIVOT, v_max=1.5, a_max=0.7, omega_max=0.8))


def robot(**parameters):
    return MovableObject(
        "r",
        MovableType("robot"),
        footprint=list(RING),
        motion_model=MotionModels.REEDSSHEPP,
        motion_parameters=parameters,
    )


def limits():
    return limits_of(robot(turning_radius=0, v_max=1.5, a_max=0.7, omega_max=0.8))


def hall():
    cells = np.zeros((100, 160), dtype=bool)
    cells[:70, 70:76] = True
    return OccupancyGrid(cells, 0.1)


def planned(service, start, goal, obstacles=()):
    report = service.plan(PathQuery(BODY, (start, goal), obstacles), Deadline.after(60))
    assert report.outcome is Outcome.FOUND, report.reason
    return report.trajectory


def test_a_turning_radius_of_0_turns_on_the_spot():
    assert read_movable(robot(turning_radius=0)).body.kinematics.model is MotionModel.PIVOT
    assert limits().model == "PIVOT"
    with pytest.raises(ProblemError, match="turning_radius"):
        read_movable(robot(turning_radius=-1))
    with pytest.raises(ProblemError, match="v_max"):
        limits_of(robot(turning_radius=0, v_max=0))


def test_it_turns_while_it_comes_to_rest():
    motion = planned(MotionService(None), (0.0, 0.0, 0.0), (3.0, 0.0, math.pi / 2))
    top = 1.5**2 / 0.7
    drive = 3.0 / 1.5 + 1.5 / 0.7 if top < 3.0 else 2 * math.sqrt(3.0 / 0.7)
    assert drive < motion.duration < drive + 0.5 * math.pi / 2 / 0.8
    back = planned(MotionService(None), (0.0, 0.0, 0.0), (-3.0, 0.0, 0.0))
    assert back.duration == pytest.approx(drive, abs=1e-6)  # backwards, without turning round


@settings(max_examples=8, deadline=None)
@given(
    st.tuples(st.floats(1, 6), st.floats(1, 6), st.floats(-3, 3)),
    st.tuples(st.floats(9, 15), st.floats(1, 6), st.floats(-3, 3)),
)
def test_around_a_wall_within_limits_and_not_below_the_bound(start, goal):
    service = MotionService(hall())
    parked = (Placed("parked", BODY, (7.3, 9.2, 0.3)),)
    motion = planned(service, start, goal, parked)
    assert not list(motion_violations("m", limits(), motion.times, motion.poses))
    assert motion.duration >= service.lower_bound(BODY, (start, goal), parked) - 1e-9
    assert parking_clears(service.scene, motion, BODY, parked[0], 0.0)
    assert motion.poses[0, :2].tolist() == list(start[:2])
    assert motion.poses[-1, :2].tolist() == list(goal[:2])


def broken(change):
    motion = planned(MotionService(None), (0.0, 0.0, 0.0), (3.0, 2.0, math.pi / 2))
    times, poses = motion.times.copy(), motion.poses.copy()
    times, poses = change(times, poses)
    return {v.kind for v in motion_violations("m", limits(), times, poses)}


def test_the_validator_sees_what_such_a_body_cannot_do():
    assert not broken(lambda t, p: (t, p))
    assert "side-slip" in broken(lambda t, p: (t, p + np.array([0.0, 0.0, 0.5])))
    assert {"speed", "turn-rate"} <= broken(lambda t, p: (t / 1.2, p))
    assert "acceleration" in broken(lambda t, p: (t / 1.1, p))


def test_no_way_is_no_proof_unless_it_is_one():
    cells = np.zeros((60, 100), dtype=bool)
    cells[:, 48:52] = True
    report = MotionService(OccupancyGrid(cells, 0.1)).plan(
        PathQuery(BODY, ((2.0, 3.0, 0.0), (8.0, 3.0, 0.0))), Deadline.after(20)
    )
    assert report.outcome is Outcome.IMPOSSIBLE
    # a slot that the body can drive through, but not turn in, and both ends lie across it
    cells = np.ones((60, 100), dtype=bool)
    cells[25:35, 5:95] = False
    service = MotionService(OccupancyGrid(cells, 0.1))
    ends = [(x, 3.0, heading) for x, heading in itertools.product((2.0, 8.0), (0.0, math.pi))]
    report = service.plan(PathQuery(BODY, (ends[0], ends[3])), Deadline.after(20))
    assert report.outcome in (Outcome.NOT_FOUND, Outcome.IMPOSSIBLE)
    assert planned(service, ends[0], ends[2]).duration > 0


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("reverse", [True, False])
def test_who_stands_along_a_wall_leaves_it_and_comes_to_it_on_arcs(side, reverse):
    # no room to turn anywhere along the walls; the way leads round the one in the middle
    body = Body(RING, replace(BODY.kinematics, reverse=reverse))
    service = MotionService(hall())
    planner = PivotPlanner(service.scene)
    along = math.pi / 2
    start, goal = (0.55, 4.0, side * along), (15.45, 3.0, -side * along)
    for ends in ((start, goal), (goal, start)):
        leg = planner.leg(LegQuery(body, *ends, ()), Deadline.never())
        assert leg.trajectory is not None, leg.reason
        assert leg.effort < 2_000
        times, poses = leg.trajectory.times, leg.trajectory.poses
        assert list(motion_violations("m", limits(), times, poses)) == []
        world = service.scene.world(service.scene.shape(body), ())
        assert samples_free(world, np.ascontiguousarray(poses), 1e-6) < 0
