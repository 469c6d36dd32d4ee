"""Short moves of several robots, driven at the same time."""

import itertools
import math

import numpy as np
import pytest

from tests.motion.fleet import tight_places as tight
from tests.motion.fleet.independent import limits_of
from up_samp.motion.moves import in_step, steer
from up_samp.validation.kinematics import motion_violations

GOALS = [(3.0, 0.0, 0.0), (5.0, 2.0, 0.6), (-4.0, 1.0, -0.3)]


def steady_move(body, goal):
    return next(move for move in steer(body, (0.0, 0.0, 0.0), goal) if move.steady)


@pytest.mark.parametrize("kinds", list(itertools.combinations_with_replacement(tight.BODIES, 2)))
def test_moves_in_step_end_where_each_would_and_keep_everybodys_limits(kinds):
    bodies = [tight.BODIES[kind]() for kind in kinds]
    for goals in itertools.product(GOALS, repeat=2):
        moves = [steady_move(body, goal) for body, goal in zip(bodies, goals, strict=True)]
        together = in_step(moves, [body.kinematics for body in bodies])
        assert (together[0].times == together[1].times).all()
        # nobody can do its own move sooner
        assert together[0].duration > max(move.seconds for move in moves) - 1e-6
        for body, move, found in zip(bodies, moves, together, strict=True):
            assert np.allclose(found.poses[[0, -1]], move.rows[[0, -1]], atol=1e-9)
            limits = limits_of("r", body)
            assert not list(motion_violations("r", limits, found.times, found.poses))


def test_cars_in_step_are_at_the_same_share_of_their_ways():
    body = tight.car()
    short, long = (steady_move(body, (length, 0.0, 0.0)) for length in (2.0, 6.0))
    one, other = in_step([short, long], [body.kinematics] * 2)
    assert np.allclose(3.0 * one.poses[:, 0], other.poses[:, 0])
    assert math.isclose(other.duration, long.seconds)
