import math

import numpy as np
import pytest
from oracle import CAR, car_faults, ends_exactly

from up_samp.model import Kinematics, MotionModel
from up_samp.motion.curves.arcs import nodes_of
from up_samp.motion.curves.trajectories import joined, reversed_trajectory
from up_samp.motion.curves.trapezoid import (
    distance_of_time,
    relaxed,
    time_of_distance,
    trajectory_of,
)


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
        trajectory = trajectory_of((tuple(start), tuple(end)), (arcs,), CAR)
        assert car_faults(trajectory, CAR) == []
        assert ends_exactly(trajectory, start, end)


def test_several_legs_rest_between():
    rng = np.random.default_rng(1)
    start, first, middle = random_path(rng)
    second = np.array([[0.5, 4.0]])
    end = nodes_of(middle, second)[-1]
    wrapped = (middle[0], middle[1], middle[2] + 4 * math.pi)
    trajectory = trajectory_of((tuple(start), wrapped, tuple(end)), (first, second), CAR)
    assert car_faults(trajectory, CAR) == []
    assert ends_exactly(trajectory, start, end)
    assert np.abs(np.diff(trajectory.poses[:, 2])).max() < 0.2


def test_reversed_and_joined():
    rng = np.random.default_rng(2)
    start, arcs, end = random_path(rng)
    there = trajectory_of((tuple(start), tuple(end)), (arcs,), CAR)
    back = reversed_trajectory(there)
    assert ends_exactly(back, end, start)
    assert car_faults(back, CAR) == []
    both = joined([there, back])
    assert both.duration == pytest.approx(2 * there.duration)
    assert car_faults(both, CAR) == []
    assert ends_exactly(both, start, start)


def test_limits_are_left_a_little():
    radius, v, a = relaxed(Kinematics(MotionModel.REEDSSHEPP, 1.0, 2.0, 0.5))
    assert radius > 1.0
    assert v < 2.0
    assert a < 0.5
