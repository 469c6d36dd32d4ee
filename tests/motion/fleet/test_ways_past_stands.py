"""Ways past the places where others may stand, and past others that drive."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.motion.fleet.spacetime_oracle import room
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Rest, TimedMotion
from up_samp.motion import MotionService
from up_samp.motion.fleet.reservations import ReservationTable
from up_samp.motion.fleet.timed_path import natural_timing, run_of

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


def met_by(floor, motion):
    """Return somebody who comes along the best way of a motion the other way round."""
    a, b = (5.0, 8.0, 0.0), (15.0, 8.0, 0.0)
    floor.alone(motion.body, (b, a), Deadline.never())
    other = replace(motion, name="d1", object="d", poses=(b, a))
    path = known(floor, other)[0]
    return other, run_of(other, path, natural_timing(path, 0.0))


def exclusion(floor, motion, path, other, there):
    """Return for how long (s) both keep each other from where they meet, the longest time."""
    gaps = floor.passing(motion, path, other, there)[:, :, 0, 0].sum(axis=1)
    return np.max(gaps, initial=0.0)


@pytest.mark.parametrize("model", [MotionModel.PIVOT, MotionModel.SE2])
def test_a_way_leads_past_who_comes_along_the_same_one(model):
    floor, motion = floor_with(model, [(0, 0, 20, 17)])
    other, run = met_by(floor, motion)
    best = known(floor, motion)[0]
    way = floor.learn_way_past(motion, best, run, Deadline.never())
    assert known(floor, motion) == [best, way]
    before = exclusion(floor, motion, best, other, run.path)
    assert before > 8.0
    assert exclusion(floor, motion, way, other, run.path) < 0.6 * before
    # it is the same one again
    assert floor.learn_way_past(motion, best, run, Deadline.never()) is None
    assert known(floor, motion) == [best, way]


def test_nobody_comes_past_in_a_corridor_or_has_to_pass_who_is_elsewhere():
    floor, motion = floor_with(MotionModel.SE2, [(1, 7, 19, 9)])
    _, run = met_by(floor, motion)
    best = known(floor, motion)[0]
    assert floor.learn_way_past(motion, best, run, Deadline.never()) is None
    floor, motion = floor_with(MotionModel.SE2, [(0, 0, 20, 17)])
    poses = (3.0, 2.0, 0.0), (17.0, 2.0, 0.0)
    floor.alone(motion.body, poses, Deadline.never())
    other = replace(motion, name="d1", object="d", poses=poses)
    path = known(floor, other)[0]
    run, best = run_of(other, path, natural_timing(path, 0.0)), known(floor, motion)[0]
    assert floor.learn_way_past(motion, best, run, Deadline.never()) is None
