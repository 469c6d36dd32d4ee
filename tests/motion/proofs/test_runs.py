"""What no car beats, against curves that are the fastest and against random drives."""

import math
import random

import numpy as np
import pytest

from up_samp.geometry.kernels import advance
from up_samp.model import Kinematics, MotionModel
from up_samp.motion.curves.reeds_shepp import DriveLimits, fastest, run_time, shortest
from up_samp.motion.proofs.bounds import ahead, fastest_roll, fastest_runs


def drawn(rng, wide=8.0):
    return rng.uniform(-wide, wide), rng.uniform(-wide, wide), rng.uniform(-math.pi, math.pi)


def driven(rng, pose, radius, length):
    """Return where arcs of some curvature lead that are ``length`` m long together, signed."""
    parts = np.array([rng.random() + 0.05 for _ in range(rng.randint(1, 4))])
    for share in parts / parts.sum():
        bend = rng.choice((-1, 0, 1, rng.uniform(-1, 1))) / radius
        pose = advance(*pose, bend, share * length)
    return pose


def test_it_is_dubins_where_nothing_moves():
    for seed in range(300):
        rng = random.Random(seed)
        start, goal, radius = drawn(rng), drawn(rng, 3.0), rng.uniform(0.2, 3.0)
        told = ahead(start, goal, radius, 0.0)
        assert told == pytest.approx(shortest(start, goal, radius, 1.0)[0], rel=1e-6), seed


def beside(seed):
    """What is told of two poses is no more than the curve between any that are so near to them."""
    rng = random.Random(seed)
    start, goal, radius = drawn(rng), drawn(rng, 3.0), rng.uniform(0.2, 3.0)
    for _ in range(20):
        moved = rng.choice((1e-3, 1e-2, 0.1, 0.5, 2.0))
        part = rng.random()
        left = driven(rng, start, radius, rng.choice((-1, 1)) * part * moved)
        came = driven(rng, goal, radius, rng.choice((-1, 1)) * (1 - part) * moved)
        told = ahead(start, goal, radius, moved)
        assert told <= shortest(left, came, radius, 1.0)[0] + 1e-9, seed


def test_no_curve_between_poses_that_near_is_shorter():
    for seed in range(300):
        beside(seed)


def to_and_fro(seed):
    """Runs to and fro, most of them with short ones at their ends, are ways to where they lead."""
    rng = random.Random(seed)
    radius, a = rng.uniform(0.2, 3.0), rng.uniform(0.2, 2.0)
    v = rng.choice((rng.uniform(0.3, 2.0), 1e6))
    car = DriveLimits(radius, v, a)
    start = goal = drawn(rng)
    seconds, sign = 0.0, rng.choice((-1, 1))
    for _ in range(rng.randint(1, 4)):
        length = rng.choice((1e-4, 1e-3, 0.01, 0.1, 1.0, 4.0)) * rng.uniform(0.5, 2.0)
        goal = driven(rng, goal, radius, sign * length)
        seconds, sign = seconds + run_time(length, v, a), -sign
    told = fastest_runs(start, goal, car, shortest(start, goal, radius)[0])
    assert told <= seconds + 1e-9, seed
    assert told <= fastest(start, goal, car)[0] + 1e-9, seed
    assert told >= run_time(shortest(start, goal, radius)[0], v, a), seed


def test_no_drive_is_faster():
    for seed in range(300):
        to_and_fro(seed)


def test_a_turn_in_one_run_is_known_to_be_fastest():
    """Back to where it came from beside: the shortest curve has a cusp, and takes longer."""
    start, goal, car = (
        (25.0, 29.0, math.pi / 2),
        (29.55, 35.72, -math.pi / 2),
        DriveLimits(1.28, 20, 1),
    )
    length = shortest(start, goal, 1.28)[0]
    best = fastest(start, goal, car)[0]
    assert run_time(length, 20, 1) < 0.94 * best
    assert fastest_runs(start, goal, car, length) > 0.97 * best


def rolling(v=1.0, a=0.5, omega=1.0, **more):
    return Kinematics(MotionModel.PIVOT, v_max=v, a_max=a, omega_max=omega, **more)


def turning_at_will(seed, reverse):
    rng = random.Random(seed)
    v, a, omega = rng.uniform(0.3, 2), rng.uniform(0.2, 2), rng.uniform(0.3, 2)
    seconds, steps = rng.uniform(0.5, 10), 1000
    times, step = np.linspace(0, seconds, steps), seconds / steps
    speed, heading = np.minimum(v, a * np.minimum(times, seconds - times)), rng.uniform(-3, 3)
    if reverse and rng.random() < 0.5:
        half = min(v, a * seconds / 4)
        speed = np.minimum(half, np.minimum(speed, a * abs(times - seconds / 2)))
        speed *= np.sign(times - rng.choice((0, seconds / 2)))
    rates = [rng.choice((-omega, 0, omega, rng.uniform(-omega, omega))) for _ in range(5)]
    turned = heading + np.cumsum(np.repeat(rates, steps // 5)) * step
    x, y = (speed * np.cos(turned)).sum() * step, (speed * np.sin(turned)).sum() * step
    goal = x, y, turned[-1]
    told = fastest_roll((0, 0, heading), goal, rolling(v, a, omega, reverse=reverse), 0.0)
    assert told <= seconds * (1 + 4 / steps), seed


@pytest.mark.parametrize("reverse", [True, False])
def test_no_drive_of_who_turns_at_will_is_faster(reverse):
    for seed in range(200):
        turning_at_will(seed, reverse)


def test_who_looks_away_has_to_turn():
    start, goal = (0, 0, math.pi / 2), (5, 0, math.pi / 2)
    told = fastest_roll(start, goal, rolling(), run_time(5, 1, 0.5))
    assert run_time(5, 1, 0.5) + 0.2 < told < run_time(5, 1, 0.5) + math.pi
    ahead_of_it = fastest_roll((0, 0, 0), (5, 0, 0), rolling(), 7.0)
    assert ahead_of_it == 7.0
