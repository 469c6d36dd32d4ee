"""Plan files keep motions within their limits: rounding does not break what was good."""

import math
import random

import numpy as np
import pytest

from tests import handmade
from up_samp.io.sampling import rows_trajectory, trajectory_rows
from up_samp.model import Trajectory
from up_samp.validation.kinematics import Limits, motion_violations

CAR = Limits("car", "REEDSSHEPP", 1.0, 2.0, 2.0, 0.5, 1.0)
A_MAX = 0.5


def with_slivers(rng, pieces):
    """A drive at the car's limits whose samples lie within a hair of others here and there, as
    they do where two curves meet.
    """
    distance = sum(length for length, _ in pieces)
    ramp = math.sqrt(distance / A_MAX)

    def gone(t):
        left = 2 * ramp - t
        return 0.5 * A_MAX * t * t if t < ramp else distance - 0.5 * A_MAX * left * left

    def when(s):
        half = distance / 2
        far = math.sqrt(2 * (s if s < half else distance - s) / A_MAX)
        return far if s < half else 2 * ramp - far

    joints = [when(s) for s in np.cumsum([length for length, _ in pieces])[:-1]]
    grid = np.linspace(0.0, 2 * ramp, math.ceil(2 * ramp / 0.05) + 1)
    hairs = [rng.choice(grid[1:-1]) + 10 ** rng.uniform(-4.5, -3) for _ in range(12)]
    times = np.unique(np.concatenate((grid, joints, hairs)))
    return Trajectory(
        times, np.array([handmade.along((3.0, 2.0, 0.4), pieces, gone(t)) for t in times])
    )


@pytest.mark.parametrize("seed", range(30))
def test_samples_within_a_hair_of_each_other_survive_the_file(seed):
    rng = random.Random(seed)
    pieces = [(rng.uniform(1, 2), rng.choice((0.0, 0.8, -0.8))) for _ in range(3)]
    good = with_slivers(rng, pieces)
    assert list(motion_violations("it", CAR, good.times, good.poses)) == []
    read = rows_trajectory(trajectory_rows(good))
    assert list(motion_violations("it", CAR, read.times, read.poses)) == []
    assert len(read.times) == len(good.times)
