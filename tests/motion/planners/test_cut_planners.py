"""Planners that are cut at random instants: what they then call finished is what they find with all
the time that they need, also in the cache on disk.
"""

import random
from types import SimpleNamespace

import numpy as np
import pytest

from tests.oracles.clocks import JumpingClock
from tests.usual import usually
from up_samp.geometry import OccupancyGrid
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    Placed,
    TimedMotion,
    deadline,
)
from up_samp.motion import MotionService
from up_samp.motion.protocol import MotionCache

pytestmark = pytest.mark.usefixtures("on_the_clock")

BOX = ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3))
CRATE = ((-0.6, -0.6), (0.6, -0.6), (0.6, 0.6), (-0.6, 0.6))
MODELS = (MotionModel.REEDSSHEPP, MotionModel.PIVOT, MotionModel.SE2)
LIMIT = 3.0
JUMPS = (0.2, 1.0, 2.0, 4.0)


def floor():
    cells = np.zeros((80, 120), dtype=bool)
    cells[:1] = cells[-1:] = True
    cells[:, :1] = cells[:, -1:] = True
    cells[:32, 58:62] = cells[50:, 58:62] = True
    return OccupancyGrid(cells, 0.1)


GRID = floor()


def body(rng):
    return Body(BOX, Kinematics(rng.choice(MODELS), 0.7, 1.0, 0.5, 1.0))


def pose(rng, side):
    x = rng.uniform(1.2, 4.8) if side else rng.uniform(7.2, 10.8)
    return (round(x, 2), round(rng.uniform(1.2, 6.8), 2), rng.choice((0.0, 1.5, 3.0, -1.5)))


def queries(rng):
    """Return a query for one body among crates, and one for two of them at once."""
    one = body(rng)
    crates = tuple(
        Placed(f"crate{k}", Body(CRATE, one.kinematics), pose(rng, rng.random() < 0.5))
        for k in range(rng.choice((0, 1, 1, 2)))
    )
    alone = PathQuery(one, (pose(rng, True), pose(rng, False)), crates)
    motions = tuple(
        TimedMotion(f"m{k}", f"r{k}", body(rng), (pose(rng, k != 1), pose(rng, k == 1)), 0.0, 30.0)
        for k in range(2)
    )
    return alone, GroupQuery(motions)


def asked(alone, group, cache):
    """Return what a service of its own says to both queries."""
    service = MotionService(GRID, cache=cache)
    path = service.plan(alone, Deadline.after(LIMIT))
    return path, service.coordinate(group, Deadline.after(LIMIT))


def differing(seed, monkeypatch, every):
    """Return what is called finished and is not what is found with all the time, and how much was
    cut, and finished.
    """
    alone, group = queries(random.Random(seed))
    time = SimpleNamespace(monotonic=lambda: 1000.0)
    monkeypatch.setattr(deadline, "time", time)
    path, together = asked(alone, group, MotionCache())
    assert path.complete or path.outcome is Outcome.IMPOSSIBLE
    time.monotonic = JumpingClock(random.Random(seed), every, JUMPS).monotonic
    wrong, counts = [], [0, 0]
    left = MotionCache()
    for again in (False, True):  # the second finds what the first has left
        cut, cut_together = asked(alone, group, left)
        counts[cut.complete and cut_together.complete] += 1
        if cut.outcome is Outcome.IMPOSSIBLE and path.outcome is Outcome.FOUND:
            wrong.append((seed, again, "false proof"))
        if cut.complete and not same(cut, path):
            wrong.append((seed, again, "path"))
        if cut_together.complete and not same_group(cut_together, together):
            wrong.append((seed, again, "group"))
    return wrong, counts


def same(cut, whole):
    if cut.trajectory is None or whole.trajectory is None:
        return cut.trajectory is whole.trajectory
    return abs(cut.trajectory.duration - whole.trajectory.duration) < 1e-9


def same_group(cut, whole):
    arrivals = [{n: round(t.end, 6) for n, t in r.trajectories.items()} for r in (cut, whole)]
    return cut.outcome is whole.outcome and arrivals[0] == arrivals[1]


def told(seeds, monkeypatch, every):
    wrong, total = [], [0, 0]
    for seed in seeds:
        found, counts = differing(seed, monkeypatch, every)
        wrong += found
        total = [x + y for x, y in zip(total, counts, strict=True)]
    assert min(total) > 0, "some are cut, some are not"
    return wrong


@pytest.mark.parametrize("every", usually(30, of=(30, 300)))
def test_what_is_called_finished_is_what_is_found_with_all_the_time(every, monkeypatch):
    assert told((1, 3, 6, 10, 15), monkeypatch, every) == []


@pytest.mark.long
@pytest.mark.parametrize("every", [10, 30, 300, 3000])
def test_the_same_of_many(every, monkeypatch):
    assert told(range(100, 160), monkeypatch, every) == []
