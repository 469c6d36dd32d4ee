"""Compiled timings of chains of straight pieces with blended bends, against motions that are worked
out piece by piece, one instant at a time.
"""

import itertools
import math
import random

import numpy as np
import pytest

from up_samp.model import Kinematics, MotionModel, Trajectory
from up_samp.motion.curves.blending import (
    TINY,
    Chain,
    fastest_speeds,
    profile,
    settled_speeds,
    timed,
)


def chain_of(seed):
    """Return straight pieces, turns on the spot and ways back, and speeds that fit them."""
    rng = random.Random(f"blending {seed}")
    heading, nodes = rng.uniform(-3, 3), [np.array([rng.uniform(-5, 5) for _ in range(3)])]
    for _ in range(rng.randint(1, 7)):
        if rng.random() < 0.15:
            nodes.append(nodes[-1] + [0, 0, rng.uniform(-2, 2)])
            continue
        heading += rng.choice([math.pi, *[rng.uniform(-1.5, 1.5)] * 8])
        step = rng.choice([0.01, 0.1, 0.3, 1, 4, 12]) * rng.uniform(0.5, 1.5)
        turn = rng.choice([0.0, 0.0, rng.uniform(-1, 1)])
        nodes.append(nodes[-1] + [step * math.cos(heading), step * math.sin(heading), turn])
    limits = Kinematics(MotionModel.SE2, 1.0, rng.choice([0.5, 1.0]), rng.choice([0.3, 2.0]))
    chain = Chain.of(np.array(nodes), limits)
    fastest = fastest_speeds(chain.pieces)
    slower = np.array([speed * rng.choice([1.0, 1.0, 0.5]) for speed in fastest])
    return chain, fastest, settled_speeds(chain.pieces, slower)


def phases(pieces, speeds):
    """Yield what a motion is made of: how long it lasts (s), and where it is after some of that."""
    reach = [v * v * bend / (2 * pieces.a) for v, bend in zip(speeds, pieces.bends, strict=True)]
    for i, length in enumerate(pieces.lengths):
        start, way = pieces.nodes[i], pieces.nodes[i + 1] - pieces.nodes[i]
        if length < TINY:
            seconds = abs(way[2]) / pieces.omega
            yield seconds, lambda t, start=start, way=way, s=seconds: start + t / s * way
            continue
        ends, done = (speeds[i], speeds[i + 1]), reach[i]
        free = max(length - reach[i] - reach[i + 1], 0.0)
        peak, rise, cruise, fall = profile(free, *ends, pieces.tops[i], pieces.a)
        for s, v, a in (rise, ends[0], pieces.a), (cruise, peak, 0.0), (fall, peak, -pieces.a):

            def pose(t, start=start, way=way / length, done=done, v=v, a=a):
                return start + (done + v * t + a * t * t / 2) * way

            yield s, pose
            done += v * s + a * s * s / 2
        if speeds[i + 1] > 0.0:
            node, u = pieces.nodes[i + 1], way / length * speeds[i + 1]
            w = (pieces.nodes[i + 2] - node) / pieces.lengths[i + 1] * speeds[i + 1]
            s = 2 * reach[i + 1] / speeds[i + 1]
            if s > 0.0:
                yield (
                    s,
                    lambda t, p=node, u=u, w=w, s=s: (
                        p - u * s / 2 + t * u + t * t / (2 * s) * (w - u)
                    ),
                )


@pytest.mark.parametrize("seed", range(200))
def test_motions_are_where_their_pieces_lead(seed):
    chain, _, speeds = chain_of(seed)
    motion, owners = timed(chain, speeds)
    some = [phase for phase in phases(chain.pieces, speeds) if phase[0] > TINY]
    starts = [0.0, *itertools.accumulate(seconds for seconds, _ in some)]
    assert motion.duration == pytest.approx(starts[-1], abs=1e-6)
    for time, pose in zip(motion.times[1:], motion.poses[1:], strict=True):
        k = min(np.searchsorted(starts, time - 1e-9, side="right") - 1, len(some) - 1)
        assert pose == pytest.approx(some[k][1](time - starts[k]), abs=1e-6)
    assert max(np.diff(motion.times)) < Trajectory.MAX_STEP + 1e-9
    assert len(owners) == len(motion.times)
    assert owners == sorted(owners)
    assert 0 <= owners[0] <= owners[-1] < len(chain.pieces.nodes)


@pytest.mark.parametrize("seed", range(200))
def test_speeds_change_from_node_to_node_as_they_can(seed):
    chain, fastest, speeds = chain_of(seed)
    pieces = chain.pieces
    for some in (fastest, speeds):
        assert some[0] == some[-1] == 0.0
        reach = some**2 * pieces.bends / (2 * pieces.a)
        for i, length in enumerate(pieces.lengths):
            free = length - reach[i] - reach[i + 1]
            assert max(some[i : i + 2]) <= max(pieces.tops[i], TINY) + 1e-12
            if length > TINY:
                assert abs(some[i + 1] ** 2 - some[i] ** 2) <= 2 * pieces.a * free + 1e-6
    assert np.all(speeds <= fastest)
    assert np.all(fastest[1:-1][pieces.bends[1:-1] > 2.0 - TINY] == 0.0)
