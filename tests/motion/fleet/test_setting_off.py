"""Ways that turn while they set off, as they are kept and timed again among others."""

import numpy as np
import pytest

from tests.motion.curves.test_involute import drawn
from up_samp.model import Trajectory
from up_samp.motion.curves.rolling import rolled, swerves
from up_samp.motion.fleet.paths import path_of


@pytest.mark.parametrize("digits", [5, 6, 12])
def test_their_tight_bends_do_not_make_cells_tiny(digits):
    """Plans keep samples of so many digits; a path of a few metres has a few hundred cells."""
    rng = np.random.default_rng(digits)
    for _ in range(40):
        body, start, goal = drawn(rng, 8.0)
        motion = rolled(swerves(start, goal, body.kinematics)[0], body.kinematics)
        kept = Trajectory(motion.times, np.round(motion.poses, digits))
        for one in (motion, kept):
            assert path_of(one, body).cells < 1000
            assert path_of(one, body, decided=True).cells < 1000
