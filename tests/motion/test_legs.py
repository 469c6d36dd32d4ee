"""Legs strung together rest where a car changes its direction, whatever lies between."""

import math

import numpy as np
import pytest

from up_samp.model import Kinematics, MotionModel, Trajectory
from up_samp.motion.legs import driven_through
from up_samp.validation.kinematics import Limits, motion_violations

CAR = Kinematics(MotionModel.REEDSSHEPP, 1.0, 1.0, 0.5, 1.0)


def leg(start, end):
    """Return a straight leg along x, from rest to rest, as fast as it can be."""
    half = math.sqrt(abs(end - start) / CAR.a_max)
    times = np.linspace(0.0, 2 * half, 81)
    rest = np.minimum(times, 2 * half - times)
    way = 0.5 * CAR.a_max * rest**2
    x = start + np.where(times <= half, way, abs(end - start) - way) * np.sign(end - start)
    return Trajectory(times, np.column_stack([x, 0 * x, 0 * x]))


@pytest.mark.parametrize("gaps", [(), (0.0,), (0.0, 0.0)])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_cusp_is_rested_at_whatever_has_no_length_there(gaps, way):
    stay = [Trajectory(np.array([0.0, 0.1]), np.array([[way, 0.0, 0.0]] * 2)) for _ in gaps]
    motion = driven_through([leg(0.0, way), *stay, leg(way, 0.0)], CAR)
    assert motion.duration == pytest.approx(4 * np.sqrt(1.0 / CAR.a_max), rel=1e-3)
    limits = Limits("r", "REEDSSHEPP", 1.0, CAR.v_max, CAR.v_max, CAR.a_max, CAR.omega_max)
    assert not list(motion_violations("m", limits, motion.times, motion.poses))
    assert np.abs(motion.poses[:, 0]).max() == pytest.approx(1.0)


def test_who_stays_where_it_is_has_no_wait():
    stay = Trajectory(np.array([0.0, 0.1]), np.zeros((2, 3)))
    assert driven_through([stay, stay], CAR).duration == 0.0
