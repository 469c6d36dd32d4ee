"""Lower bounds that count on no stop and on no speed that a motion need not have."""

from itertools import pairwise

import pytest

from tests.motion.oracle import ROBOT, box_map
from up_samp.geometry import Scene
from up_samp.model import Body, Kinematics, MotionModel, Placed
from up_samp.motion import MotionService
from up_samp.motion.curves.reeds_shepp import run_time
from up_samp.motion.proofs.bounds import DurationBounds

FLAT = {"turning_radius": 1.0, "v_max": 2.0, "a_max": 1.0, "omega_max": 1.0}


@pytest.mark.parametrize("model", [MotionModel.REEDSSHEPP, MotionModel.SE2])
def test_nobody_need_stop_at_a_waypoint(model):
    body = Body(ROBOT.footprint, Kinematics(model, **FLAT))
    poses = [(0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (10.0, 0.0, 0.0)]
    bounds = DurationBounds(Scene(None))
    whole = run_time(10.0, 2.0, 1.0)
    assert bounds.through(body, poses) == pytest.approx(whole, rel=1e-6)
    assert sum(bounds.through(body, (a, b)) for a, b in pairwise(poses)) > whole + 1


def test_turns_add_up_over_waypoints():
    body = Body(ROBOT.footprint, Kinematics(MotionModel.SE2, **FLAT))
    poses = [(0.0, 0.0, 0.0), (0.0, 0.0, 3.0), (0.0, 0.0, 0.0)]
    assert DurationBounds(Scene(None)).through(body, poses) == pytest.approx(6.0, rel=1e-6)


def test_what_the_validator_takes_for_rounding_is_no_proof():
    service = MotionService(box_map(20, 10, []))
    body = Body(((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)), ROBOT.kinematics)
    placed = Placed("o", body, (8.0, 5.0, 0.0))
    for depth, blocked in ((0.0, False), (8e-7, False), (3e-6, True)):
        goal = (7.0 + depth, 5.0, 0.0)
        proof = service.certificate(body, ((5.0, 5.0, 0.0), goal), (placed,))
        assert (proof is not None) == blocked
        assert (service.pose_blockers(body, goal, (placed,))[1] == {"o"}) == blocked
