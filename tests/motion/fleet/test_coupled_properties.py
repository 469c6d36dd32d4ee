"""Robots that are moved together, judged by the package's independent validator."""

import itertools
import math
import random

import numpy as np
import pytest

from tests.motion.fleet.spacetime_oracle import CAR, motion, room
from tests.usual import usually
from up_samp.geometry import load_map, write_map
from up_samp.model import Deadline, GroupQuery, Outcome
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.coordination import one_after_another
from up_samp.motion.fleet.neighbourhoods import MovingGroup
from up_samp.motion.fleet.timed_path import natural_timing, run_of
from up_samp.motion.fleet.together import couple
from up_samp.motion.fleet.workspace import workspace_of
from up_samp.motion.protocol import WorkBudget
from up_samp.motion.service import MotionService
from up_samp.validation.collisions import BlockedMap, JudgedShape, Track, hits_body, hits_map
from up_samp.validation.kinematics import Limits, motion_violations

KIN = CAR.kinematics
LIMITS = Limits("robot", "REEDSSHEPP", KIN.turning_radius, KIN.v_max, KIN.v_max, KIN.a_max, 1.0)
SHAPE = JudgedShape("robot", np.array(CAR.footprint))


def judged(path, motions, trajectories):
    """Assert what the validator asks for: limits, ends, the map, and each other, swept."""
    blocked = BlockedMap(path)
    end = max(t.end for t in trajectories.values())
    tracks = {}
    for m in motions:
        trajectory = trajectories[m.name]
        times, poses = trajectory.times.copy(), trajectory.poses.copy()
        assert list(motion_violations(m.name, LIMITS, times, poses)) == []
        assert times[0] >= m.release
        assert tuple(poses[0]) == m.poses[0]
        assert np.allclose(poses[-1, :2], m.poses[-1][:2], rtol=0, atol=0)
        tracks[m.name] = Track(times, poses, SHAPE.radius)
        assert hits_map(SHAPE, tracks[m.name], blocked, 0.0, end) is None
    for a, b in itertools.combinations(tracks.values(), 2):
        assert hits_body(SHAPE, a, SHAPE, b, 0.0, end) is None


def drawn(folder, length, bays):
    """A corridor one robot wide with bays beside it, as a map on disk."""
    free = [(1, 1, length - 1, 3), *((x, 1, x + 3, 6.5) for x in bays)]
    return write_map(folder, "corridor", room(length, 8, free).occupied, 0.1)


def coupled(service, motions):
    workspace = workspace_of(service)
    runs = {}
    for m in motions:
        path = workspace.path(m.body, m.poses, (), Deadline.after(60))
        runs[m.name] = run_of(m, path, natural_timing(path, m.release))
    return couple(workspace, motions, runs, [], Deadline.after(60))


def random_group(rng, length, count):
    """Robots in a row in the corridor, some facing left, and where each of them is to go."""
    xs = [3.0 + (length - 6.0) * (k + 0.3 * rng.random()) / count for k in range(count)]
    goals = xs[:]
    while any(a == b for a, b in zip(xs, goals, strict=True)):
        rng.shuffle(goals)
    turns = [rng.choice((0.0, math.pi)) for _ in xs]
    return [
        motion(f"m{k}", (xs[k], 2.0, turns[k]), (goals[k], 2.0, turns[k]), rng.choice((0.0, 4.0)))
        for k in range(count)
    ]


def check_random(tmp_path, seed):
    """Return whether the robots of a random corridor could be moved together, after judging."""
    rng = random.Random(seed)
    length = rng.randrange(36, 60, 4)
    bays = sorted(rng.sample(range(6, length - 8, 6), rng.choice((1, 2))))
    path = drawn(tmp_path, length, bays)
    service = MotionService(load_map(path))
    motions = random_group(rng, length, 2 + seed % 2)
    runs = coupled(service, motions)
    if runs is None:
        return False
    judged(path, motions, {name: run.timing.trajectory for name, run in runs.items()})
    return True


@pytest.mark.parametrize("seed", usually(2, of=(0, 2, 5)))
def test_random_corridors_are_judged_valid(tmp_path, seed):
    assert check_random(tmp_path, seed)


@pytest.mark.long
def test_many_random_corridors_are_judged_valid(tmp_path):
    found = sum(check_random(tmp_path, seed) for seed in range(100, 140))
    assert found > 20  # the rest is not proven impossible, only not found


def test_no_order_of_two_works_but_together_they_pass(tmp_path):
    """Whoever goes first cannot come past the other: the bay is beside the second one's way."""
    path = drawn(tmp_path, 50, [24])
    service = MotionService(load_map(path))
    motions = [
        motion("a", (3, 2, 0), (47, 2, 0)),
        motion("b", (43, 2, math.pi), (3, 2, math.pi)),
        motion("c", (46.8, 2, math.pi), (6, 2, math.pi)),
    ]
    budget = WorkBudget(Deadline.after(60))
    group = MovingGroup(workspace_of(service), {m.name: m for m in motions}, [], budget)
    one_after_another(group)
    assert group.best is None  # every order of priorities, without moving them together
    report = coordinate(service, GroupQuery(tuple(motions)), Deadline.after(120))
    assert report.outcome is Outcome.FOUND
    judged(path, motions, report.trajectories)
