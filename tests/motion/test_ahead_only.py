"""Bodies that may not drive backwards: planned, bounded, proven, judged."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import MovableType

from tests.motion.crossings import RING, WEDGE, Crossing, floor, free_pose, hall
from tests.motion.fleet.independent import limits_of
from up_samp.extensions import extended
from up_samp.geometry import OccupancyGrid
from up_samp.model import (
    Body,
    Deadline,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    Placed,
    ProblemError,
    UnsupportedError,
)
from up_samp.motion import Leg, MotionService
from up_samp.motion.curves.trajectories import reversed_trajectory
from up_samp.motion.fleet.roadmap import Roadmap, cells_of
from up_samp.motion.proofs.heading_slices import separated
from up_samp.upio.read_maps import read_movable
from up_samp.validation.collisions import pieces_of
from up_samp.validation.kinematics import driven_backwards, motion_violations
from up_samp.validation.kinematics import limits_of as limits_read

CAR = Kinematics(MotionModel.REEDSSHEPP, 0.8, 1.5, 0.7, reverse=False)
WHEELS = Kinematics(MotionModel.PIVOT, v_max=1.5, a_max=0.7, omega_max=0.8, reverse=False)


def free(body):
    return replace(body, kinematics=replace(body.kinematics, reverse=True))


def assert_ahead(body, motion):
    limits = limits_of("r", body)
    assert limits.v_back == 0.0
    assert not list(motion_violations("m", limits, motion.times, motion.poses))


@settings(max_examples=6, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    ring=st.sampled_from((RING, WEDGE)),
    kinematics=st.sampled_from((CAR, WHEELS)),
)
def test_no_motion_is_driven_backwards(seed, ring, kinematics):
    rng, body = np.random.default_rng(seed), Body(ring, kinematics)
    service = MotionService(floor(rng, 5), seed=seed)
    start, goal = (free_pose(rng, service, body) for _ in range(2))
    report = service.plan(PathQuery(body, (start, goal)), Deadline.after(60))
    bound = service.lower_bound(body, (start, goal))
    assert service.lower_bound(free(body), (start, goal)) <= bound
    if report.outcome is Outcome.FOUND:
        assert_ahead(body, report.trajectory)
        assert report.trajectory.duration >= bound - 1e-9
        ends = (start, goal)
        nearest, limit = service.certifier.nearest, Deadline.after(20)
        assert not separated(service.scene, nearest, body, ends, (), limit)


@pytest.mark.parametrize("kinematics", [CAR, WHEELS], ids=["car", "diff"])
def test_a_leg_is_not_its_reverse(kinematics):
    body, service = Body(RING, kinematics), MotionService(hall())
    a, b = (4.0, 4.5, 0.0), (12.0, 4.5, 0.0)
    there, back = (
        service.plan(PathQuery(body, ends), Deadline.after(30)).trajectory
        for ends in ((a, b), (b, a))
    )
    assert_ahead(body, there)
    assert_ahead(body, back)
    assert back.duration > there.duration + 2.0
    turned = service.plan(PathQuery(free(body), (b, a)), Deadline.after(30)).trajectory
    assert turned.duration == pytest.approx(there.duration, abs=1e-6)


def pocket(width):
    """A hall with a dead end to its right, ``width`` m wide."""
    cells = np.zeros((90, 160), dtype=bool)
    cells[:, 100:] = True
    half = round(5 * width)
    cells[45 - half : 45 + half, 100:140] = False
    return OccupancyGrid(cells, 0.1)


IN, OUT, INSIDE = (6.0, 4.5, 0.0), (6.0, 4.5, math.pi), (12.8, 4.5, 0.0)


@pytest.mark.parametrize("kinematics", [CAR, WHEELS], ids=["car", "diff"])
def test_a_dead_end_too_narrow_to_turn_in_keeps_who_is_in_it(kinematics):
    body, service = Body(RING, kinematics), MotionService(pocket(1.0))
    deep = PathQuery(body, (IN, INSIDE))
    assert_ahead(body, service.plan(deep, Deadline.after(30)).trajectory)
    for ends in ((INSIDE, IN), (INSIDE, OUT), (IN, (12.8, 4.5, math.pi))):
        report = service.plan(PathQuery(body, ends), Deadline.after(60))
        assert report.outcome is Outcome.IMPOSSIBLE, ends
        other = service.plan(PathQuery(free(body), ends), Deadline.after(60))
        assert other.outcome is Outcome.FOUND, ends


def test_a_dead_end_with_room_to_turn_round_is_left_by_who_turns_on_the_spot():
    body, service = Body(RING, WHEELS), MotionService(pocket(2.0))
    report = service.plan(PathQuery(body, (INSIDE, OUT)), Deadline.after(30))
    assert_ahead(body, report.trajectory)
    turned = np.abs(np.diff(report.trajectory.poses[:, 2])).sum()
    assert turned > math.pi - 1e-6
    car = Body(RING, CAR)
    report = service.plan(PathQuery(car, (INSIDE, OUT)), Deadline.after(30))
    assert report.outcome in (Outcome.NOT_FOUND, Outcome.OUT_OF_TIME)  # no proof sees its radius


BODIES = (Body(RING, CAR), Body(WEDGE, CAR), Body(RING, WHEELS), Body(WEDGE, WHEELS))


def crossing(seed, count):
    """Robots of all kinds on one floor; the last may drive backwards."""
    rng = np.random.default_rng(seed)
    grid = floor(rng, 3)
    bodies = [BODIES[int(k)] for k in rng.integers(0, len(BODIES), count)]
    return Crossing(rng, grid, [*bodies[:-1], free(bodies[-1])], count, seconds=60, due=60.0)


def test_several_robots(tmp_path):
    assert all(crossing(seed, 3).found(tmp_path) for seed in range(2))


@pytest.mark.long
def test_many_groups_of_robots(tmp_path):
    found = [crossing(seed, 4).found(tmp_path) for seed in range(25)]
    assert sum(found) >= 12


@pytest.mark.parametrize("body", [BODIES[0], BODIES[2]], ids=["car", "diff"])
def test_no_move_of_a_roadmap_leads_back(body):
    service = MotionService(hall(8, 8))
    ends = ((2.5, 2.3, 0.4), (5.5, 5.5, math.pi / 2))
    cell = cells_of(body)[1]
    roadmap = Roadmap(service.scene, body, ends, (), cell)
    start, goal = (roadmap.place(pose) for pose in ends)
    to_go = roadmap.to_go(goal)
    assert start in to_go
    assert len(roadmap.edges) > 100
    for edge in roadmap.edges:
        rows = edge.move.rows
        along = pieces_of(np.arange(float(len(rows))), rows).along
        assert np.all(along > -1e-9)
    # a place's cost is that of its best move and what is left from there
    for node, cost in itertools.islice(to_go.items(), 50):
        after = [e.cost + to_go[e.target] for e in roadmap.out(node) if e.target in to_go]
        assert cost == pytest.approx(min(after, default=0.0)) or node == goal


@pytest.mark.parametrize("planner", ["RRT", "RRTConnect", "RRTstar", "BITstar"])
def test_planners_of_ompl_drive_ahead_or_say_that_they_cannot(planner):
    pytest.importorskip("ompl")
    body, service = Body(RING, CAR), MotionService(pocket(3.0), planner=planner, seed=1)
    report = service.plan(PathQuery(body, (IN, (13.0, 4.4, 0.1))), Deadline.after(20))
    if report.outcome is Outcome.FOUND:
        assert_ahead(body, report.trajectory)
    else:
        assert "OMPL's" in report.reason
    wheels = Body(RING, WHEELS)
    with pytest.raises(UnsupportedError, match=planner):
        service.plan(PathQuery(wheels, (IN, INSIDE)), Deadline.after(20))


class Backing:
    """A planner from outside that knows of no rule."""

    name, reversible = "backing", True

    def __init__(self, scene, seed):
        self._asked = MotionService(None)

    def leg(self, query, deadline):
        poses = (query.goal, query.start)
        body = free(query.body)
        found = self._asked.plan(PathQuery(body, poses), deadline).trajectory
        return Leg(reversed_trajectory(found), complete=True)


def test_a_planner_from_outside_that_drives_backwards_is_refused():
    with extended("planners", "backing", Backing):
        service = MotionService(hall(), planner="backing")
        ends = (12.0, 4.5, 0.0), (4.0, 4.5, 0.0)
        for body in (BODIES[0], BODIES[2]):
            assert service.plan(PathQuery(free(body), ends), Deadline.never()).trajectory
            with pytest.raises(UnsupportedError, match="backwards"):
                service.plan(PathQuery(body, ends), Deadline.never())


def movable(model=MotionModels.REEDSSHEPP, **parameters):
    return MovableObject(
        "r",
        MovableType("robot"),
        footprint=list(RING),
        motion_model=model,
        motion_parameters=parameters,
    )


def test_it_is_a_parameter_of_what_drives_along_its_heading():
    assert read_movable(movable()).body.kinematics.reverse
    for radius in (0, 1.5):
        item = movable(turning_radius=radius, reverse=False)
        assert not read_movable(item).body.kinematics.reverse
        assert limits_read(item).v_back == 0.0
    for wrong in (2, "never", None):
        for read in (read_movable, limits_read):
            with pytest.raises(ProblemError, match="reverse"):
                read(movable(reverse=wrong))
    with pytest.raises(UnsupportedError, match="reverse"):
        read_movable(movable(MotionModels.SE2, reverse=False))
    with pytest.raises(ProblemError, match="reverse"):
        limits_read(movable(MotionModels.SE2, reverse=False))


@pytest.mark.parametrize("kinematics", [CAR, WHEELS], ids=["car", "diff"])
def test_the_validator_sees_what_is_driven_backwards(kinematics):
    body = Body(RING, kinematics)
    service = MotionService(hall())
    ends = (4.0, 4.5, 0.0), (9.0, 6.0, 1.0)
    motion = service.plan(PathQuery(body, ends), Deadline.after(30)).trajectory
    back = reversed_trajectory(motion)
    kinds = [v.kind for v in motion_violations("m", limits_of("r", body), back.times, back.poses)]
    assert "backwards" in kinds
    free_limits = limits_of("r", free(body))
    assert not list(motion_violations("m", free_limits, back.times, back.poses))
    # so slowly that no piece tells
    times = np.arange(200.0) * 0.1
    poses = np.zeros((200, 3))
    poses[:, 0] = -4e-7 * np.arange(200.0)
    limits = limits_of("r", body)
    assert list(driven_backwards("m", limits, times, poses))
    poses[:, 0] *= 0.01
    assert not list(driven_backwards("m", limits, times, poses))


def test_an_obstacle_in_the_way_of_a_car_that_cannot_back_off_is_named():
    """Nose to nose in a dead end: who stands in front of the way out is what keeps it."""
    service, body = MotionService(pocket(1.0)), Body(RING, CAR)
    leaving = (12.0, 4.5, math.pi)
    parked = Placed("parked", free(body), (10.5, 4.5, 0.0))
    assert service.plan(PathQuery(body, (leaving, OUT)), Deadline.after(30)).trajectory
    report = service.plan(PathQuery(body, (leaving, OUT), (parked,)), Deadline.after(60))
    assert report.outcome is Outcome.IMPOSSIBLE
    assert report.blockers == {"parked"}
