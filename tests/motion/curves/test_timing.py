import math

import numpy as np
import pytest

from tests.motion.oracle import CAR, RECTANGLE, box_map, car_faults, ends_exactly
from tests.usual import usually
from up_samp.model import Body, Deadline, Kinematics, MotionModel, PathQuery
from up_samp.motion import MotionService
from up_samp.motion.curves.reeds_shepp import nodes_of
from up_samp.motion.curves.trajectories import joined, reversed_trajectory
from up_samp.motion.curves.trapezoid import (
    distance_of_time,
    time_of_distance,
    trajectory_of,
)
from up_samp.motion.protocol import Leg
from up_samp.validation.kinematics import Limits, motion_violations


def random_path(rng):
    start = np.array([*rng.uniform(-5, 5, 2), rng.uniform(-4, 4)])
    count = int(rng.integers(1, 7))
    kappas = rng.choice([0.0, 0.9, -0.9, 0.3], count)
    arcs = np.column_stack([kappas, rng.uniform(-6, 6, count)])
    return start, arcs, nodes_of(start, arcs)[-1]


def test_trapezoids_invert():
    for length in (0.01, 3.0, 8.0, 40.0):
        s = np.linspace(0, length, 50)
        t = time_of_distance(s, length, 2.0, 0.5)
        assert np.allclose(distance_of_time(t, length, 2.0, 0.5), s, atol=1e-9)
        assert np.all(np.diff(t) > 0)


def test_every_limit_holds_between_all_samples():
    rng = np.random.default_rng(0)
    for _ in range(40):
        start, arcs, end = random_path(rng)
        trajectory = trajectory_of((tuple(start), tuple(end)), arcs, CAR)
        assert car_faults(trajectory, CAR) == []
        assert ends_exactly(trajectory, start, end)


def test_several_legs_rest_between():
    rng = np.random.default_rng(1)
    start, first, middle = random_path(rng)
    second = np.array([[0.5, 4.0]])
    end = nodes_of(middle, second)[-1]
    wrapped = (middle[0], middle[1], middle[2] + 4 * math.pi)
    legs = ((start, wrapped), first), ((wrapped, end), second)
    trajectory = joined([trajectory_of(ends, arcs, CAR) for ends, arcs in legs])
    assert car_faults(trajectory, CAR) == []
    assert ends_exactly(trajectory, start, end)
    assert np.abs(np.diff(trajectory.poses[:, 2])).max() < 0.2


def test_reversed_and_joined():
    rng = np.random.default_rng(2)
    start, arcs, end = random_path(rng)
    there = trajectory_of((tuple(start), tuple(end)), arcs, CAR)
    back = reversed_trajectory(there)
    assert ends_exactly(back, end, start)
    assert car_faults(back, CAR) == []
    both = joined([there, back])
    assert both.duration == pytest.approx(2 * there.duration)
    assert car_faults(both, CAR) == []
    assert ends_exactly(both, start, start)


def test_a_leg_driven_the_other_way_begins_with_the_heading_that_is_asked_for():
    """-pi and pi are one heading, and two numbers."""
    rng = np.random.default_rng(3)
    start, arcs, end = random_path(rng)
    leg = Leg(trajectory_of((tuple(start), tuple(end)), arcs, CAR))
    for turns in (-1, 0, 2):
        asked = (*map(float, end[:2]), float(end[2]) + 2 * math.pi * turns)
        back = leg.turned(asked).trajectory
        assert tuple(back.poses[0]) == asked
        assert car_faults(back, CAR) == []


def closed_form(length, v, a):
    """How long (s) a rest-to-rest drive of ``length`` m takes at least."""
    return length / v + v / a if length * a >= v * v else 2 * math.sqrt(length / a)


def judged(body, trajectory):
    kin = body.kinematics
    limits = Limits(
        "r", kin.model.name, kin.turning_radius, kin.v_max, kin.v_max, kin.a_max, kin.omega_max
    )
    return list(motion_violations("motion", limits, trajectory.times, trajectory.poses))


@pytest.mark.parametrize("model", [MotionModel.REEDSSHEPP, MotionModel.SE2])
def test_straight_motions_last_as_long_as_the_closed_form_says(model):
    rng = np.random.default_rng(3)
    service = MotionService(None)
    for _ in range(60):
        v, a = float(rng.uniform(0.2, 4)), float(rng.uniform(0.1, 3))
        length, heading = float(10 ** rng.uniform(-1, 2.3)), float(rng.uniform(-3, 3))
        start = (float(rng.uniform(-50, 50)), float(rng.uniform(-50, 50)), heading)
        goal = (
            start[0] + length * math.cos(heading),
            start[1] + length * math.sin(heading),
            heading,
        )
        body = Body(RECTANGLE, Kinematics(model, 1.0, v, a, 1.0))
        report = service.plan(PathQuery(body, (start, goal)), Deadline.never())
        expected = closed_form(length, v, a)
        assert report.trajectory.duration == pytest.approx(expected, rel=1e-9)
        assert judged(body, report.trajectory) == []
        assert service.lower_bound(body, (start, goal)) <= report.trajectory.duration + 1e-9


MODELS = (MotionModel.REEDSSHEPP, MotionModel.SE2)


@pytest.mark.parametrize("model", usually(MODELS[0], of=MODELS))
def test_whole_seconds_stay_whole(model):
    service = MotionService(None)
    for length in range(1, 200):
        body = Body(RECTANGLE, Kinematics(model, 1.0, 1.0, 1.0, 1.0))
        for heading in (0.0, math.pi / 2, 2.0):
            end = (length * math.cos(heading), length * math.sin(heading), heading)
            query = PathQuery(body, ((0.0, 0.0, heading), end))
            duration = service.plan(query, Deadline.never()).trajectory.duration
            assert math.ceil(duration - 1e-9) == length + 1


def test_turns_on_the_spot_are_exact():
    body = Body(RECTANGLE, Kinematics(MotionModel.SE2, 1.0, 1.0, 1.0, 0.5))
    query = PathQuery(body, ((0.0, 0.0, 0.0), (0.0, 0.0, 1.5)))
    report = MotionService(None).plan(query, Deadline.never())
    assert report.trajectory.duration == pytest.approx(3.0, rel=1e-9)
    assert judged(body, report.trajectory) == []


@pytest.mark.parametrize("hair", [2e-10, 9e-7, 1.1e-6])
def test_arcs_that_are_too_short_to_be_sampled_turn_all_the_same(hair):
    # before a long straight: the end lies where the arcs lead, not 0.1 mm beside it
    arcs = np.array([[0.0, 1.0], [-0.78, hair], [0.0, 90.0], [0.78, hair], [0.78, 2.0]])
    start = np.zeros(3)
    end = nodes_of(start, arcs)[-1]
    trajectory = trajectory_of((tuple(start), tuple(end)), arcs, CAR)
    assert judged(Body(RECTANGLE, CAR), trajectory) == []


@pytest.mark.parametrize("radius", [1e-4, 1e-3, 0.01, 0.05])
def test_cars_that_turn_round_on_a_coin_are_driven_round_a_wall(radius):
    limits = Kinematics(MotionModel.REEDSSHEPP, turning_radius=radius, v_max=5.0, a_max=50.0)
    body = Body(RECTANGLE, limits)
    poses = ((3.0, 3.0, 0.0), (17.0, 3.0, 2.0))
    service = MotionService(box_map(20, 10, [(9.9, 0, 10.1, 7)]))
    report = service.plan(PathQuery(body, poses), Deadline.after(60))
    assert report.trajectory is not None, report.reason
    assert judged(body, report.trajectory) == []
    # round the wall's end, as a point would go
    way = 2 * math.hypot(7, 4)
    assert way / 5 < report.trajectory.duration < way / 5 + 1
