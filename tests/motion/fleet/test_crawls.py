"""Paths with pieces on which a body hardly gets on while it turns: they must not set the length of
all cells of their stretch, whatever can drive.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.motion.fleet import tight_places as tight
from up_samp.model import Trajectory
from up_samp.motion.fleet.paths import path_of, safe_intervals
from up_samp.motion.fleet.speed import tune

PIECE = st.tuples(st.floats(-5.0, 0.0), st.floats(-1.0, 1.0), st.floats(-0.6, 0.6))
"""Step length (m, a power of ten), how far it turns meanwhile, how its way bends (rad)."""


def driven(kind, pieces):
    """Return what moves so, for a while each, between two straight stretches of 9 m."""
    body = tight.BODIES[kind]()
    kin = body.kinematics
    pose, way, time = np.array([0.0, 0.0, 0.0]), 0.0, 0.0
    poses, times = [pose], [time]
    straight = [(math.log10(0.25), 0.0, 0.0, 36)]
    steps = [*straight, *((*piece, 4) for piece in pieces), *straight]
    for power, turn, bend, often in steps:
        length = 10.0**power
        for _ in range(often):
            turned = 0.08 * turn
            if kind == "omni":
                way += bend
            else:  # it drives along its heading: in arcs
                way = pose[2] + 0.5 * turned
            if kind == "car":
                turned = math.copysign(min(abs(turned), length / kin.turning_radius), turned)
                way = pose[2] + 0.5 * turned
            gone = length * np.array([math.cos(way), math.sin(way)])
            pose = pose + np.array([*gone, turned])
            time += max(length / kin.v_max, abs(turned) / kin.omega_max)
            poses.append(pose)
            times.append(time)
    return Trajectory(np.array(times), np.array(poses)), body


@pytest.mark.parametrize("kind", ["omni", "differential", "car"])
@settings(max_examples=30, deadline=None)
@given(pieces=st.lists(PIECE, min_size=1, max_size=6))
def test_what_crawls_does_not_cut_its_whole_way_small(kind, pieces):
    trajectory, body = driven(kind, pieces)
    path = path_of(trajectory, body)
    assert path.cells < 20_000
    assert path.natural.duration >= trajectory.duration - 1e-9
    free = safe_intervals(np.empty((0, 3)), path.cells)
    timing = tune(path, free, 1.0, -math.inf)
    if timing is not None:
        assert timing.trajectory.start == pytest.approx(1.0)
        ends = timing.trajectory.poses[[0, -1]]
        assert ends == pytest.approx(trajectory.poses[[0, -1]], abs=1e-6)


def test_an_omnidirectional_body_is_tuned_past_a_turn_in_which_it_hardly_gets_on():
    trajectory, body = driven("omni", [(-3.5, 0.8, 0.0)])
    path = path_of(trajectory, body)
    assert path.cells < 1_500
    timing = tune(path, safe_intervals(np.empty((0, 3)), path.cells), 0.0, -math.inf)
    assert timing is not None
    assert timing.trajectory.duration < trajectory.duration + 8.0
