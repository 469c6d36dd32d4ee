"""What is proposed among reservations: a search in space and time over a lattice."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.motion.fleet import tight_places as tight
from up_samp.geometry.shapes import rules_of
from up_samp.model import Deadline, Rest, TimedMotion
from up_samp.motion.fleet.one_robot import drivable
from up_samp.motion.fleet.space_time import Lattice, proposer_of, visits
from up_samp.motion.fleet.workspace import rest_run, workspace_of
from up_samp.motion.service import MotionService


@pytest.mark.parametrize("since", [-math.inf, -5.0])
@pytest.mark.parametrize("kind", ["omni", "car", "differential"])
def test_a_way_leads_around_who_rests_on_the_straight_one(kind, since):
    body = tight.BODIES[kind]()
    service = MotionService(tight.hall(20, 10, [(0.5, 0.5, 19.5, 9.5)]))
    workspace = workspace_of(service)
    motion = TimedMotion("go", "mover", body, ((3.0, 5.0, 0.0), (17.0, 5.0, 0.0)), 0.0, 1e6)
    rest = rest_run(workspace, Rest("rests", body, (10.0, 5.0, 0.0), since))
    straight = workspace.path(body, motion.poses, (), Deadline.never())
    assert len(workspace.conflicts(straight, rest.path))
    found = proposer_of(workspace).propose(motion, [rest])
    assert not len(workspace.conflicts(found, rest.path))
    assert abs(found.poses[:, 1] - 5.0).max() > 0.5


@pytest.mark.parametrize("ends", [(-math.inf, math.inf), (-math.inf, 3.0), (-5.0, 9.0)])
def test_places_are_visited_while_somebody_is_near(ends):
    free, nowhere = np.ones((9, 21), dtype=bool), np.full((189, 16), -1, dtype=np.int32)
    lattice = Lattice(0.0, 0.0, 0.5, 0.4, free, rules_of((), 0.4), nowhere)
    times = np.arange(0.0, 3.01, 0.2)
    poses = np.stack([2.0 + 2.0 * times, np.full(len(times), 2.0), np.zeros(len(times))], axis=1)
    rows = visits(lattice, times, poses, np.array(ends), 0.9)
    middles = np.concatenate([ends[:1], 0.5 * (times[1:] + times[:-1]), ends[1:]])
    for place in range(lattice.free.size):
        x, y = 0.5 * (place % 21), 0.5 * (place // 21)
        near = np.hypot(poses[:, 0] - x, poses[:, 1] - y) < 0.9
        mine = rows[rows[:, 0] == place, 1:]
        expected = [(middles[k], middles[k + 1]) for k in np.flatnonzero(near)]
        assert len(mine) == (1 if expected else 0)  # who drives straight on comes by once
        if expected:
            assert tuple(mine[0]) == (expected[0][0], expected[-1][1])


@pytest.mark.parametrize("side", [0.02, 0.2, 1.0])
def test_corners_without_room_for_an_arc_are_turned_on_the_spot(side):
    """An arc driven at a crawl would set the length of all cells of its stretch."""
    body = tight.BODIES["differential"]()
    service = MotionService(tight.hall(20, 10, [(0.5, 0.5, 19.5, 9.5)]))
    points = np.array([(3.0, 4.0), (9.0, 4.0), (9.0, 4.0 + side), (16.0, 4.0 + side)])
    poses = (*points[0], 0.0), (*points[-1], 0.0)
    found = drivable(service.scene, body, poses, points, False)
    assert found.cells < 1000
    assert found.poses[-1] == pytest.approx(poses[1])
    assert found.natural.duration < 13.0 / body.kinematics.v_max + 8.0


@pytest.mark.parametrize("kind", ["omni", "differential"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_way_through_a_door_is_driven_with_bends_as_its_frame_allows(kind, mirrored):
    body = tight.BODIES[kind]()
    body = replace(body, kinematics=replace(body.kinematics, v_max=2.0, a_max=0.5))
    rooms = [(0.5, 0.5, 19.5, 4.0), (3.65, 4.0, 4.95, 4.4), (0.5, 4.4, 19.5, 7.4)]
    scene = MotionService(tight.hall(20, 10, rooms)).scene
    points = np.array([(14.0, 2.0), (4.3, 2.0), (4.3, 5.2), (16.0, 5.2)])
    points = points[::-1] if mirrored else points
    poses = (*points[0], 0.0), (*points[-1], 0.0)
    found = drivable(scene, body, poses, points, False)
    assert found is not None
    near = np.abs(found.poses[:, None, :2] - points).max(axis=2).min(axis=0)
    assert near.max() < 0.6
