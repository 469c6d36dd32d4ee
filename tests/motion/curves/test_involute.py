"""Bodies that turn while they set off: where they should, within limits, near the bound."""

import math

import numpy as np
import pytest

from tests.usual import usually
from up_samp.model import Body, Kinematics, MotionModel
from up_samp.motion.curves.reeds_shepp import run_time
from up_samp.motion.curves.rolling import rolled, rolling_time, swerves
from up_samp.motion.moves import corners_of, steer
from up_samp.motion.proofs.bounds import fastest_roll
from up_samp.validation.kinematics import Limits, motion_violations

RING = ((-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2))


def drawn(rng, reach, reverse=True):
    """Draw a body, a start and a goal."""
    v, a, omega = rng.choice([0.5, 1.0, 2.0]), rng.choice([0.5, 1.0]), rng.choice([0.7, 1.5])
    kin = Kinematics(
        MotionModel.PIVOT, v_max=float(v), a_max=float(a), omega_max=float(omega), reverse=reverse
    )
    start = (*rng.uniform(-5, 5, 2), rng.uniform(-7, 7))
    goal = (start[0] + rng.uniform(-reach, reach), start[1] + rng.uniform(-reach, reach))
    return Body(RING, kin), start, (*goal, rng.uniform(-7, 7))


@pytest.mark.parametrize("reverse", usually(False, of=(True, False)))
def test_it_gets_there_within_its_limits(reverse):
    rng = np.random.default_rng(0)
    for _ in range(60):
        body, start, goal = drawn(rng, rng.choice([0.5, 3.0, 15.0]), reverse)
        kin = body.kinematics
        limits = Limits(
            "r", "PIVOT", 0.0, v_max=kin.v_max, a_max=kin.a_max, omega_max=kin.omega_max,
            v_back=math.inf if reverse else 0.0,
        )  # fmt: skip
        ways = swerves(start, goal, kin)
        assert ways
        for rows in ways:
            for row, pose in ((rows[0], start), (rows[-1], goal)):
                assert np.allclose(row[:2], pose[:2])
                assert abs(math.remainder(row[2] - pose[2], 2 * math.pi)) < 1e-9
            motion = rolled(rows, kin)
            assert motion.duration == pytest.approx(rolling_time(rows, kin))
            assert not [*motion_violations("m", limits, motion.times, motion.poses)]
        assert sorted(rolling_time(w, kin) for w in ways) == [rolling_time(w, kin) for w in ways]


@pytest.mark.parametrize("turn", [1e-9, 1e-4, 0.0022, 0.01, 0.03])
def test_hardly_a_turn_is_none_of_its_own(turn):
    """Arcs as tight as if it turned on the spot would be timed as turns, and move the body."""
    for a, omega in ((0.3, 3.0), (0.7, 0.8), (0.05, 2.0)):
        kin = Kinematics(MotionModel.PIVOT, v_max=1.5, a_max=a, omega_max=omega)
        limits = Limits("r", "PIVOT", 0.0, 1.5, math.inf, a, omega)
        for rows in swerves((0.0, 0.0, turn), (4.0, 0.01, -turn), kin):
            motion = rolled(rows, kin)
            assert not [*motion_violations("m", limits, motion.times, motion.poses)]


@pytest.mark.parametrize(
    ("reach", "most", "spot"), [(6.0, 1.03, 1.29), (15.0, 1.015, 1.13)]
)  # fmt: skip
def test_half_are_near_what_nothing_beats(reach, most, spot):
    """As docs/motion.md says, with a line between turns on the spot beside it."""
    rng, turning, swerving = np.random.default_rng(1), [], []
    for _ in range(100):
        body, start, goal = drawn(rng, reach)
        kin, far = body.kinematics, math.dist(start[:2], goal[:2])
        least = fastest_roll(start, goal, kin, run_time(far, kin.v_max, kin.a_max))
        turning.append(rolling_time(corners_of(steer(body, start, goal)), kin) / least)
        swerving.append(min(rolling_time(w, kin) for w in swerves(start, goal, kin)) / least)
    assert min(swerving) >= 1.0
    assert np.median(swerving) < most
    assert np.median(turning) > spot


def test_who_speeds_up_slowly_is_looked_for_as_soon():
    kin = Kinematics(MotionModel.PIVOT, v_max=1e3, a_max=1e-6, omega_max=1e3)
    for rows in swerves((0.0, 0.0, 0.0), (5.0, 3.0, 2.0), kin):
        assert len(rows) < 200
