"""What the planners call safe and within limits, the package's independent judge does, too."""

import numpy as np
import pytest

from tests.motion.oracle import RECTANGLE, box_map
from up_samp.geometry import load_map, write_map
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Outcome, PathQuery, Placed
from up_samp.motion import MotionService
from up_samp.validation.collisions import BlockedMap, JudgedShape, Track, hits_body, hits_map
from up_samp.validation.kinematics import Limits, motion_violations

WALLS = [(5, 0, 6, 5.5), (10, 4, 11, 10), (14, 0, 15, 6), (17, 7, 20, 7.4)]
BODIES = [
    Body(RECTANGLE, Kinematics(MotionModel.REEDSSHEPP, 1.0, 2.0, 0.5)),
    Body(
        ((-0.3, -0.4), (1.2, -0.4), (1.2, 0.4), (-0.3, 0.4)),
        Kinematics(MotionModel.REEDSSHEPP, 1.5, 1.0, 1.0),
    ),
    Body(RECTANGLE, Kinematics(MotionModel.SE2, 1.0, 1.5, 0.8, 0.7)),
]


@pytest.mark.parametrize("number", range(len(BODIES)))
def test_motions_are_judged_valid(tmp_path, number):
    body = BODIES[number]
    rng = np.random.default_rng(number)
    drawn = box_map(20, 10, WALLS)
    path = write_map(tmp_path, "floor", drawn.occupied, 0.1, (-3.0, 2.0, 0.4))
    service, blocked = MotionService(load_map(path)), BlockedMap(path)
    kin = body.kinematics
    limits = Limits(
        "robot", kin.model.name, kin.turning_radius, kin.v_max, kin.v_max, kin.a_max, kin.omega_max
    )
    shape = JudgedShape("robot", np.array(body.footprint))
    found = 0
    while found < 2:
        grid = service.grid
        ends = []
        while len(ends) < 3:
            x, y = grid.point_of(rng.uniform(0, grid.shape[0]), rng.uniform(0, grid.shape[1]))
            pose = (x, y, float(rng.uniform(-3, 3)))
            if service.scene.pose_free(body, pose, (), 0.05):
                ends.append(pose)
        parked = Placed("parked", body, ends.pop())
        report = service.plan(PathQuery(body, tuple(ends), (parked,)), Deadline.after(30))
        if report.outcome is not Outcome.FOUND or report.trajectory.duration == 0:
            continue
        found += 1
        times, poses = report.trajectory.times, report.trajectory.poses
        assert list(motion_violations("motion", limits, times, poses)) == []
        track = Track(times.copy(), poses.copy(), shape.radius)
        assert hits_map(shape, track, blocked, 0.0, float(times[-1])) is None
        still = Track(np.array([0.0]), np.array([parked.pose]), shape.radius)
        assert hits_body(shape, track, shape, still, 0.0, float(times[-1])) is None
