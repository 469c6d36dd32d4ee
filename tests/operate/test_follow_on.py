"""From one plan to the next in the midst of driving: whatever robots may drive at a moment by the
new one, no two of them can meet on it; also where it has them go first the other way round.
"""

import random
from dataclasses import replace

import numpy as np
import pytest

from tests.execution import floors
from up_samp.execution import Executor, dependencies_of
from up_samp.execution.build import with_sides
from up_samp.execution.meetings import moving
from up_samp.execution.reorder import planned_sides
from up_samp.execution.state import TaskPhase
from up_samp.model import ProblemError
from up_samp.motion.fleet.conflicts import conflicting_cells
from up_samp.operate.horizon import Cut
from up_samp.operate.stitch import follow_on


def free(executor, way, edges, first, last):
    """Whether a robot stands in some cells of its path, or may drive into them now."""
    here, most = way.told - 1e-6, executor.state.until(way) - 1e-6
    return edges[first] < most and edges[last + 1] > here


def meets(executor):
    """Two robots that may meet by what they may drive now (None: there are none)."""
    ways = sorted(executor.state.of_object.values(), key=lambda w: w.object)
    for k, one in enumerate(ways):
        for other in ways[k + 1 :]:
            p, q = (executor.drives[w.activity, w.object].path for w in (one, other))
            for i, first, last in np.asarray(conflicting_cells(moving(p), moving(q), 0.0)):
                mine = free(executor, one, p.edges, i, i)
                if mine and free(executor, other, q.edges, first, last):
                    return one.object, other.object
    return None


def step(executor, rng, now):
    """Drive some robots on, as far as they may, and do what is to be done."""
    state = executor.state
    for way in [*state.of_object.values()]:
        at = min(state.until(way), way.told + rng.uniform(0.0, 0.4))
        if rng.random() < 0.8 and at > way.told:
            executor.update(way.object, progress=at, now=now)
    for name, phase in [*state.phase.items()]:
        if phase is TaskPhase.RUNNING and not state.ways_of[name]:
            executor.done(name, now=now)
    executor.commands(now)


def followed(seed, yaml):
    """A plan half done, and another one of the same motions that goes on with it: of a greater
    error, and some who go first the other way round. None where nobody drives, or it cannot be.
    """
    rng = random.Random(f"follow on {seed}")
    problem, plan = floors.rounds(seed, yaml)
    old = Executor(plan, dependencies=dependencies_of(problem, plan))
    old.commands(0.0)
    moments = [0.25 * k for k in range(1, rng.randint(20, 200))]
    for now in moments:
        step(old, rng, now)
    assert meets(old) is None
    for way in old.state.of_object.values():
        way.let = old.state.until(way)
    told = dependencies_of(problem, plan, localisation=rng.choice((0.05, 0.08, 0.12)))
    sides = planned_sides(told)
    turned = {
        k: not sides[k] for k in rng.sample(sorted(sides), min(len(sides), rng.randint(0, 3)))
    }
    begun = {n: 1.0 for n, p in old.state.phase.items() if p is not TaskPhase.WAITING}
    names = [*old.state.phase]
    rng.shuffle(names)
    try:
        new = Executor(plan, dependencies=replace(told, graph=with_sides(told, turned)))
        follow_on(new, old, Cut(0.0, kept=tuple(names), begun=begun), 0.0)
    except ProblemError:
        return None
    return rng, new, moments[-1]


@pytest.fixture(scope="module")
def yaml(tmp_path_factory):
    return floors.hall(tmp_path_factory.mktemp("hall"))


FAST = (0, 8, 29, 47, 56)
"""Gates are moved; in all but 8 two met when every gate was."""
SEEDS = [*FAST, *(pytest.param(k, marks=pytest.mark.long) for k in range(400) if k not in FAST)]


@pytest.mark.parametrize("seed", SEEDS)
def test_nobody_meets_by_what_a_plan_that_follows_another_lets_them_drive(seed, yaml):
    found = followed(seed, yaml)
    if found is None:
        return
    rng, new, now = found
    for k in range(1, 60):
        assert meets(new) is None, (seed, k, new.state.moved_on)
        step(new, rng, now + 0.25 * k)


def test_some_of_them_wait_later_than_the_new_plan_has_it(yaml):
    every = [followed(seed, yaml) for seed in (2, 5, 25)]
    assert all(one and one[1].state.moved_on for one in every)
