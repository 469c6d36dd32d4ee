import math

import numpy as np
import pytest

from up_samp.geometry.kernels import advance
from up_samp.motion.curves.reeds_shepp import (
    DriveLimits,
    fastest,
    merged,
    nodes_of,
    path_time,
    reversed_arcs,
    run_time,
    shortest,
)

CAR = DriveLimits(1.0, 2.0, 0.5)


def end_of(start, arcs):
    pose = start
    for kappa, s in arcs:
        pose = advance(*pose, kappa, s)
    return pose


def away(pose, goal):
    return max(
        abs(pose[0] - goal[0]),
        abs(pose[1] - goal[1]),
        abs(math.remainder(pose[2] - goal[2], 2 * math.pi)),
    )


def random_pairs(n, seed=0):
    rng = np.random.default_rng(seed)
    for i in range(n):
        scale = float(rng.choice([0.5, 2, 5, 30]))
        goal = (*map(float, rng.uniform(-scale, scale, 2)), float(rng.uniform(-4, 4)))
        start = (0.3, -0.2, float(rng.uniform(-4, 4)))
        if i % 8 == 0:  # degenerate: on a lattice, headings in quarter turns
            start = (0.0, 0.0, 0.0)
            goal = (round(goal[0]), round(goal[1]), round(goal[2]) * math.pi / 2)
            goal = tuple(float(v) for v in goal)
        yield start, goal


def test_curves_end_where_they_should():
    for start, goal in random_pairs(2000):
        for radius in (1.0, 2.5):
            _, arcs = shortest(start, goal, radius)
            assert away(end_of(start, arcs), goal) < 1e-9
            time, arcs = fastest(start, goal, DriveLimits(radius, 2.0, 0.5))
            assert away(end_of(start, arcs), goal) < 1e-9
            assert time == pytest.approx(path_time(arcs, DriveLimits(radius, 2.0, 0.5)), abs=1e-9)
            assert np.all(np.abs(arcs[:, 0]) <= 1 / radius + 1e-12)


def distances(name, seed):
    """Yield random pairs of poses with how far they are apart in one of OMPL's spaces."""
    ob = pytest.importorskip("ompl.base")
    space = getattr(ob, name)(1.0)
    bounds = ob.RealVectorBounds(2)
    bounds.setLow(-100)
    bounds.setHigh(100)
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    a, b = si.allocState(), si.allocState()
    for start, goal in random_pairs(2000, seed=seed):
        for state, pose in ((a, start), (b, goal)):
            state.setX(pose[0])
            state.setY(pose[1])
            state.setYaw(math.remainder(pose[2], 2 * math.pi))
        yield start, goal, space.distance(a, b)


def test_lengths_agree_with_ompl():
    for start, goal, apart in distances("ReedsSheppStateSpace", 1):
        length, arcs = shortest(start, goal, 1.0)
        assert length == pytest.approx(apart, abs=1e-6)
        assert length == pytest.approx(np.abs(arcs[:, 1]).sum(), abs=1e-9)


def test_lengths_ahead_only_agree_with_ompl():
    for start, goal, apart in distances("DubinsStateSpace", 4):
        length, arcs = shortest(start, goal, 1.0, 1.0)
        assert length == pytest.approx(apart, abs=1e-6)
        assert away(end_of(start, arcs), goal) < 1e-9
        assert np.all(arcs[:, 1] > 0)
        assert fastest(start, goal, DriveLimits(1.0, 2.0, 0.5, 1.0))[0] == run_time(
            length, 2.0, 0.5
        )
        assert length >= shortest(start, goal, 1.0)[0] - 1e-9
        # a search from the goal drives the same curve from its end
        back, arcs = shortest(goal, start, 1.0, -1.0)
        assert back == pytest.approx(length, abs=1e-9)
        assert np.all(arcs[:, 1] < 0)


def test_the_fastest_is_never_slower_than_the_shortest():
    for start, goal in random_pairs(500, seed=2):
        time, _ = fastest(start, goal, CAR)
        length, arcs = shortest(start, goal, 1.0)
        assert time <= path_time(arcs, CAR) + 1e-9
        assert time >= run_time(length, 2.0, 0.5) - 1e-9


def test_symmetries():
    for start, goal in random_pairs(300, seed=3):
        forth = fastest(start, goal, CAR)[0]
        assert fastest(goal, start, CAR)[0] == pytest.approx(forth, abs=1e-9)


@pytest.mark.parametrize(
    ("goal", "length"),
    [
        ((5.0, 0.0, 0.0), 5.0),
        ((-5.0, 0.0, 0.0), 5.0),
        ((1.0, 1.0, math.pi / 2), math.pi / 2),
        ((0.0, 2.0, math.pi), math.pi),
        ((0.0, 0.0, math.pi), math.pi),
        ((0.0, 0.0, 0.0), 0.0),
    ],
)
def test_known_lengths(goal, length):
    assert shortest((0.0, 0.0, 0.0), goal, 1.0)[0] == pytest.approx(length, abs=1e-9)


def test_a_detour_beats_a_stop():
    """Turning round on the spot: three cusps are shorter, a loop without a stop is faster."""
    start, goal = (0.0, 0.0, 0.0), (6.0, 1.0, math.pi)
    _, short = shortest(start, goal, 1.0)
    _, fast = fastest(start, goal, DriveLimits(1.0, 2.0, 0.1))  # a stop costs 20 s
    assert np.any(short[:, 1] < 0)
    assert len({float(s) for s in np.sign(fast[:, 1])}) == 1


def test_trapezoids():
    assert run_time(0.0, 2.0, 0.5) == 0.0
    assert run_time(8.0, 2.0, 0.5) == pytest.approx(8.0)
    assert run_time(2.0, 2.0, 0.5) == pytest.approx(4.0)
    assert run_time(18.0, 2.0, 0.5) == pytest.approx(13.0)


def test_arc_algebra():
    arcs = np.array([[0.0, 1.0], [0.0, 2.0], [1.0, 0.5], [1.0, -0.5], [1.0, 0.0]])
    assert merged(arcs).tolist() == [[0.0, 3.0], [1.0, 0.5], [1.0, -0.5]]
    start = np.array([1.0, 2.0, 3.0])
    end = nodes_of(start, arcs)[-1]
    back = nodes_of(end, reversed_arcs(arcs))[-1]
    assert np.allclose(back, start)
