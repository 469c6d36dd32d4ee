"""What moves in any direction keeps to its acceleration in bends, however its way was sampled."""

import itertools
import math
import random

import numpy as np
import pytest

from tests.motion.oracle import RECTANGLE
from up_samp.model import Body, Kinematics, MotionModel
from up_samp.motion.curves.blending import Chain, fastest_speeds, timed
from up_samp.motion.fleet.one_robot import _timed_slide
from up_samp.motion.fleet.paths import path_of, safe_intervals
from up_samp.motion.fleet.speed import tune
from up_samp.validation.kinematics import Limits, motion_violations

FREE = np.empty((0, 3))


def omni(v, a):
    return Body(RECTANGLE, Kinematics(MotionModel.SE2, 1.0, v, a))


def broken(body, timing):
    """Return which of its limits a body breaks."""
    kin, motion = body.kinematics, timing.trajectory
    limits = Limits("robot", kin.model.name, 1.0, kin.v_max, kin.v_max, kin.a_max, kin.omega_max)
    return list(map(str, motion_violations("motion", limits, motion.times, motion.poses)))


def blended(seed):
    """Yield timings of a chain of straight pieces with blends between, alone and past others."""
    rng = random.Random(f"blended {seed}")
    heading, nodes = rng.uniform(-3, 3), [np.zeros(3)]
    for _ in range(rng.choice([2, 3, 4, 5])):
        step = rng.choice([0.1, 0.3, 0.6, 1, 2, 4]) * rng.uniform(0.5, 1.5)
        turn = rng.choice([0.0, 0.0, rng.uniform(-1, 1)])
        nodes.append(nodes[-1] + [step * math.cos(heading), step * math.sin(heading), turn])
        heading += rng.uniform(-1.5, 1.5)
    body = omni(rng.choice([0.5, 1.0, 2.0]), rng.choice([0.3, 0.5, 1.0, 2.0]))
    chain = Chain.of(np.array(nodes), body.kinematics)
    motion, _ = timed(chain, fastest_speeds(chain.pieces))
    path = path_of(motion, body, (tuple(nodes[0]), tuple(nodes[-1])))
    for others in (0, 1, 2):
        held = [(rng.randint(1, path.cells), t, t + 2.0) for t in range(others)]
        safe = safe_intervals(np.array(held, dtype=float).reshape(-1, 3), path.cells)
        timing = tune(path, safe, 0.0, -math.inf)
        if timing is not None:
            yield body, timing


def bent_twice(seed):
    """Yield the timing of a way with two arcs, and a short straight piece in between."""
    rng = random.Random(f"bent {seed}")
    body = omni(rng.choice([1.0, 2.0]), rng.choice([0.05, 0.1, 0.2, 0.5, 1.0, 2.0]))
    radius, count = rng.uniform(0.3, 2.0), rng.randint(6, 20)
    step = min(0.05, 0.08 * radius) * rng.uniform(0.7, 1.0)
    bend = step / radius
    back = rng.choice([1, -1]) * bend
    ways = [(0.0, rng.uniform(0.05, 1.0))]
    ways += [((i + 0.5) * bend, step) for i in range(count)]
    ways += [(count * bend, rng.uniform(0.01, 0.06))]
    ways += [(count * bend + (i + 0.5) * back, step) for i in range(count)]
    ways += [(count * (bend + back), rng.uniform(0.05, 1.0))]
    points = [np.zeros(3)]
    for way, length in ways:
        for _ in range(parts := math.ceil(length / 0.06)):
            points.append(
                points[-1] + length / parts * np.array([math.cos(way), math.sin(way), 0.0])
            )
    path = _timed_slide(body, (tuple(points[0]), tuple(points[-1])), np.array(points))
    if path is not None:
        yield body, tune(path, safe_intervals(FREE, path.cells), 0.0, -math.inf)


@pytest.mark.parametrize(
    ("way", "first"),
    [
        (blended, 400),
        (bent_twice, 600),
        *(
            pytest.param(way, first, marks=pytest.mark.long)
            for way in (blended, bent_twice)
            for first in range(1000, 2500, 120)
        ),
    ],
)
def test_bends_are_driven_within_the_limits(way, first):
    driven = list(itertools.chain.from_iterable(map(way, range(first, first + 120))))
    assert len(driven) > 90
    assert [found for found in itertools.starmap(broken, driven) if found] == []
