"""The cache of motions: what is remembered is used again, by other services, too."""

from dataclasses import replace

import numpy as np
import pytest

from tests.motion.oracle import RECTANGLE, ROBOT, box_map, smallest_clearance
from up_samp.model import (
    Body,
    Deadline,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    Placed,
    TrafficZone,
)
from up_samp.motion import Leg, LegQuery, MotionCache, MotionService

GRID = box_map(20, 10, [(9, 0, 10, 4), (9, 6, 10, 10)])
POSES = ((4.0, 3.0, 0.0), (16.0, 7.0, 1.0))
SLIDER = Body(RECTANGLE, Kinematics(MotionModel.SE2, 1.0, 1.5, 0.8, 0.7))


def plan(cache, body=ROBOT, grid=GRID, whole=True):
    service = MotionService(grid, cache=cache)
    report = service.plan(PathQuery(body, POSES), Deadline.after(60))
    assert report.outcome is Outcome.FOUND
    assert report.complete or not whole
    return report.trajectory, service


@pytest.mark.parametrize("body", [ROBOT, SLIDER])
def test_what_was_kept_is_used(body):
    cache = MotionCache()
    first, _ = plan(cache, body)
    again, service = plan(cache, body)
    assert service.cache.hits == 1
    assert np.array_equal(first.poses, again.poses)
    turned = MotionService(GRID, cache=cache)
    back = turned.plan(PathQuery(body, POSES[::-1]), Deadline.after(60))
    assert turned.cache.hits == 2
    assert back.trajectory.duration == pytest.approx(first.duration, rel=1e-12)


def test_a_finished_motion_is_not_sought_again(monkeypatch):
    slow = TrafficZone(((9.0, 4.0), (10.0, 4.0), (10.0, 6.0), (9.0, 6.0)), v_max=0.2)
    for kinematics in (ROBOT.kinematics, replace(ROBOT.kinematics, zones=(slow,))):
        first, service = plan(MotionCache(), replace(ROBOT, kinematics=kinematics), whole=False)
        monkeypatch.setattr(service, "legs", None)
        query = PathQuery(replace(ROBOT, kinematics=kinematics), POSES)
        again = service.plan(query, Deadline.after(60))
        assert again.trajectory is first


def test_a_leg_is_used_only_among_obstacles_that_it_clears():
    cache = MotionCache()
    free, _ = plan(cache)
    small = Body(((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)), ROBOT.kinematics)
    parked = Placed("p", small, tuple(map(float, free.poses[len(free.poses) // 4])))
    again = MotionService(GRID, cache=cache)
    report = again.plan(PathQuery(ROBOT, POSES, (parked,)), Deadline.after(60))
    assert report.outcome is Outcome.FOUND
    assert smallest_clearance(report.trajectory, ROBOT, GRID, (parked,)) > 0


def test_a_truncated_leg_gives_way_to_a_finished_one():
    best, _ = plan(MotionCache())
    slow = type(best)(best.times * 2.0, best.poses.copy())
    other = MotionService(GRID, cache=MotionCache())
    query = LegQuery(ROBOT, *POSES)
    other.legs.remember("car", query, Leg(slow, complete=False), limit=1.0)
    soon = other.plan(PathQuery(ROBOT, POSES), Deadline.after(1.0))
    assert soon.trajectory.duration == pytest.approx(slow.duration)
    assert not soon.complete
    later = other.plan(PathQuery(ROBOT, POSES), Deadline.after(60))
    assert later.complete
    assert later.trajectory.duration == pytest.approx(best.duration)
    # and what is finished is not replaced by what is not
    other.legs.remember("car", query, Leg(best, complete=False), limit=1.0)
    assert other.plan(PathQuery(ROBOT, POSES), Deadline.after(60)).complete
