"""Ways past the places where others may stand."""

import math

import pytest

from tests.motion.fleet.spacetime_oracle import room
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Rest, TimedMotion
from up_samp.motion import MotionService
from up_samp.motion.fleet.reservations import ReservationTable

BOX = ((-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (-0.6, 0.4))
START, GOAL = (3.0, 8.0, 0.0), (17.0, 8.0, 0.0)


def body_of(model):
    return Body(BOX, Kinematics(model, 1.0, 1.0, 1.0, 1.0))


def floor_with(model, free):
    """Return a floor, and a motion across it whose best way is known."""
    service = MotionService(room(20, 17, free))
    body = body_of(model)
    floor = ReservationTable(service, [Rest("c", body, START)])
    floor.kept_alive = service
    motion = TimedMotion("c1", "c", body, (START, GOAL), 0.0, math.inf)
    floor.alone(body, motion.poses, Deadline.never())
    return floor, motion


def known(floor, motion):
    return floor.ways(motion).quickest_first()


@pytest.mark.parametrize("model", [MotionModel.REEDSSHEPP, MotionModel.PIVOT, MotionModel.SE2])
def test_a_way_leads_past_stands_and_past_those_beside_them(model):
    floor, motion = floor_with(model, [(0, 0, 20, 17)])
    body, workspace = motion.body, floor._workspace
    stands = [(body, (10.0, y, 0.0)) for y in (6.5, 8.0, 9.5)]
    floor.learn_ways_past(motion, stands, Deadline.never(), 3)
    best, *others = known(floor, motion)
    assert best.length < 14.2
    assert others
    assert others[-1].length > best.length
    rests = [workspace.resting(*stand) for stand in stands]
    met = [sum(len(workspace.conflicts(way, rest)) > 0 for rest in rests) for way in others]
    assert min(met) == 0
    # once is enough
    floor.learn_ways_past(motion, [(body, (10.0, 3.0, 0.0))], Deadline.never(), 3)
    assert known(floor, motion) == [best, *others]


def test_there_is_no_way_past_who_stands_in_a_corridor_nor_at_the_goal():
    floor, motion = floor_with(MotionModel.SE2, [(1, 7, 19, 9)])
    floor.learn_ways_past(motion, [(motion.body, (10.0, 8.0, 0.0))], Deadline.never(), 2)
    assert len(known(floor, motion)) == 1
    floor, motion = floor_with(MotionModel.SE2, [(0, 0, 20, 17)])
    stands = [(motion.body, GOAL), (motion.body, (10.0, 2.0, 0.0))]
    floor.learn_ways_past(motion, stands, Deadline.never(), 2)
    assert len(known(floor, motion)) == 1
