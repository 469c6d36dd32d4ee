"""The margin holds between robots, too, not only from walls and from what rests."""

import math

import pytest

from tests.motion.fleet.spacetime_oracle import clearance, room
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    Rest,
    TimedMotion,
)
from up_samp.motion import MotionService

BOX = ((-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (-0.6, 0.4))


def crossing(model, gap):
    """Two that pass each other on lanes ``gap`` m apart, and one that crosses."""
    body = Body(BOX, Kinematics(model, 1.0, 1.0, 1.0, 1.0))
    offset = 0.8 + gap
    ways = {
        "east": ((3.0, 8.0, 0.0), (17.0, 8.0, 0.0)),
        "west": ((17.0, 8.0 + offset, math.pi), (3.0, 8.0 + offset, math.pi)),
        "north": ((10.0, 3.0, math.pi / 2), (10.0, 14.0, math.pi / 2)),
    }
    return [TimedMotion(name, name.upper(), body, poses, 0.0, 1e9) for name, poses in ways.items()]


@pytest.mark.parametrize("margin", [0.01, 0.5])
@pytest.mark.parametrize("model", [MotionModel.REEDSSHEPP, MotionModel.SE2])
def test_robots_pass_each_other_by_the_margin(model, margin):
    motions = crossing(model, 1.2)
    service = MotionService(room(20, 17, [(0, 0, 20, 17)]), margin=margin)
    report = service.coordinate(GroupQuery(tuple(motions)), Deadline.after(60))
    assert report.outcome is Outcome.FOUND, report.reason
    assert clearance(motions, report.trajectories, (), 0.02) >= margin - 2e-3


@pytest.mark.parametrize("model", [MotionModel.REEDSSHEPP, MotionModel.SE2])
def test_robots_that_start_closer_than_the_margin_keep_less(model):
    motions = crossing(model, 0.3)[:2]
    side = Rest("side", motions[0].body, (3.0, 6.9, 0.0))
    service = MotionService(room(20, 17, [(0, 0, 20, 17)]), margin=0.5)
    report = service.coordinate(GroupQuery(tuple(motions), (side,)), Deadline.after(60))
    assert report.outcome is Outcome.FOUND, report.reason
    assert clearance(motions, report.trajectories, (side,), 0.02) >= 0.1
