"""Who comes to a job before it is released waits for it, and is told to."""

import itertools
import random
from dataclasses import replace

import pytest

from tests.search.fleet.test_carrying import evaluator_of, fleet
from tests.search.limits import WRITINGS, releases
from tests.shuffled import shuffled
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.evaluator_kernel import CostWeights
from up_samp.search.fleet.jobs import Jobs, find_jobs
from up_samp.upio import read_problem


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("at_once", [False, True])
def test_a_tour_waits_for_what_is_released(seed, at_once):
    rng, usual = random.Random(seed), evaluator_of(1, seed)
    released = [
        tuple(replace(o, release=since) for o in some)
        for some in usual.jobs.options
        for since in [rng.choice((0, 5, 20, 60))]
    ]
    jobs, rules = Jobs(tuple(released), usual.jobs.needs), CostWeights(at_once=at_once)
    told = AssignmentEvaluator(usual.guess, jobs, rules)
    snapshot, unit = usual.guess.snapshot, usual.guess.snapshot.seconds_per_unit
    mine = [next(k for k, o in enumerate(some) if o.robot == "r0") for some in released]
    for order in itertools.permutations(range(4)):
        here, end = snapshot.configurations[snapshot.initial["r0"]], 0.0
        for option in (released[j][mine[j]] for j in order):
            end = max(end + usual.guess.ride("r0", here, option.entry), option.release * unit)
            end += option.work + sum(usual.guess.ride("r0", *leg) for leg in option.legs)
            here = option.exit
        assert told.ends({"r0": [(j, mine[j]) for j in order]})["r0"][0] == pytest.approx(end)


@pytest.mark.parametrize("seed", range(3))
def test_jobs_are_told_when_they_are_released(seed):
    rng, problem = random.Random(seed), fleet().problem
    since = {f"o{k}": rng.choice((0, 30, 70)) for k in range(6)}
    for activity in problem.activities:
        kind, order, *_ = [*activity.name.split("_"), ""]
        if kind in ("pick", "deliver") and since.get(order):
            limit = rng.choice(releases(activity.start, since[order]))
            rng.choice(WRITINGS)(problem, activity, limit)
    problem = shuffled(problem, seed, rename=False).problem
    jobs = find_jobs(problem, read_problem(problem, 1.0))
    assert len(jobs.options) == len(since)
    for options in jobs.options:
        assert {o.release for o in options} == {since[options[0].leader.split("_")[1]]}
