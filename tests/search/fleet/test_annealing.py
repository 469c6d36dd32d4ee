"""Annealing of assignments: what changes leave as it was, and the exchange of ends against
the same by hand."""

import random
from collections import Counter

import numpy as np
import pytest

from tests.search.fleet.guesses import assigned
from tests.usual import usually
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.search.fleet.evaluator_kernel import anneal, drawn
from up_samp.search.fleet.jobs import Jobs, find_jobs
from up_samp.upio import read_problem


@pytest.fixture(scope="module")
def read():
    problem = warehouse(6, 18, encoding="compact")
    snapshot = read_problem(problem)
    return find_jobs(problem, snapshot), snapshot


def shuffled(jobs, rng):
    """Return jobs and their options in any order, some of which not everybody can do."""
    some = [list(options) for options in jobs.options]
    rng.shuffle(some)
    for options in some:
        rng.shuffle(options)
        if rng.random() < 0.2:
            del options[max(2, rng.randrange(len(options))) :]
    return Jobs(tuple(map(tuple, some)), jobs.needs)


@pytest.mark.parametrize("seed", usually(1, 2, 3, of=range(4)))
def test_each_job_is_done_once_by_who_can(read, seed):
    jobs, snapshot = read
    rng = random.Random(seed)
    assignment = assigned(shuffled(jobs, rng), snapshot, seed=seed, exchanges=0)
    evaluator, chance = assignment.evaluator, np.random.default_rng(seed)
    now, best = evaluator.arrays(assignment.tours), evaluator.arrays(assignment.tours)
    for warm in np.linspace(1.0, 0.0, 20):
        anneal(evaluator.work(), evaluator.rules, now, best, drawn(chance, 50), np.full(50, warm))
        for tours in (evaluator.tours(now), evaluator.tours(best)):
            assert Counter(j for tour in tours.values() for j, _ in tour) == Counter(
                range(len(jobs.options))
            )
            for robot, tour in tours.items():
                assert {assignment.jobs.options[j][k].robot for j, k in tour} <= {robot}
    assert evaluator.length(evaluator.tours(best)) <= evaluator.length(assignment.tours)
    assert evaluator.tours(best) != assignment.tours


def as_done_by(options, robot, tour):
    """Return how a robot does the jobs of a tour, ending where they end; None where it cannot."""
    found = []
    for j, k in tour:
        alike = [n for n, o in enumerate(options[j]) if o.robot == robot]
        alike = [n for n in alike if options[j][n].exit == options[j][k].exit]
        if not alike:
            return None
        found.append((j, alike[-1]))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_two_robots_exchange_what_they_do_from_some_job_on(read, seed):
    jobs, snapshot = read
    rng = random.Random(seed)
    assignment = assigned(shuffled(jobs, rng), snapshot, seed=seed, exchanges=0)
    evaluator, options, told = assignment.evaluator, assignment.jobs.options, Counter()
    robots = evaluator.robots
    full = [r for r in evaluator.robots if assignment.tours[r]]
    for number in range(400):
        draws, whole = np.array([rng.random() for _ in range(10)]), number % 4 == 0
        draws[[4, 9]] = (0.0 if whole else 0.99), 0.0
        now, best = evaluator.arrays(assignment.tours), evaluator.arrays(assignment.tours)
        # whatever comes of it is accepted
        anneal(evaluator.work(), evaluator.rules, now, best, draws[None], np.full(1, np.inf))
        a, b = full[int(draws[0] * len(full))], evaluator.robots[int(draws[1] * len(robots))]
        mine, theirs = assignment.tours[a], assignment.tours[b]
        i = 0 if whole else int(draws[2] * (len(mine) + 1))
        j = 0 if whole else int(draws[3] * (len(theirs) + 1))
        later, sooner = as_done_by(options, a, theirs[j:]), as_done_by(options, b, mine[i:])
        can = a != b and later is not None and sooner is not None
        expected = {a: mine[:i] + later, b: theirs[:j] + sooner} if can else {}
        assert evaluator.tours(now) == {**assignment.tours, **expected}
        told[can, whole] += 1
    assert min(told[True, True], told[True, False], told[False, True], told[False, False]) > 5


@pytest.mark.parametrize("seed", usually(2, of=range(3)))
def test_what_is_accepted_costs_what_it_costs(read, seed):
    """Changes are refused by what their tours cost alone: that is never more than they cost."""
    jobs, snapshot = read
    assignment = assigned(shuffled(jobs, random.Random(seed)), snapshot, seed=seed, exchanges=0)
    evaluator, chance = assignment.evaluator, np.random.default_rng(seed)
    now, best = evaluator.arrays(assignment.tours), evaluator.arrays(assignment.tours)
    accepted = 0
    for draws in drawn(chance, 1000):
        before = evaluator.tours(now)
        free, any_best = evaluator.arrays(before), evaluator.arrays(before)
        one = draws[None], np.full(1, np.inf)  # the same change, whatever it costs
        anneal(evaluator.work(), evaluator.rules, free, any_best, *one)
        anneal(evaluator.work(), evaluator.rules, now, best, draws[None], np.zeros(1))
        told = [evaluator.tours(arrays) for arrays in (free, now)]
        no_worse = evaluator.length(told[0]) <= evaluator.length(before) * (1 - 1e-12)
        worse = evaluator.length(told[0]) > evaluator.length(before) * (1 + 1e-12)
        assert told[1] == (told[0] if no_worse else before) or not (worse or no_worse)
        accepted += told[1] != before
    assert 3 < accepted < 590
