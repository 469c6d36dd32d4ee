"""Lower bounds from jobs against optima that are found without them."""

import random
from dataclasses import replace

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from up_samp.benchmarks.warehouse import WAREHOUSE_ENCODINGS, warehouse
from up_samp.geometry import lay_out
from up_samp.search.facts import Facts
from up_samp.search.jobs import Jobs, find_jobs
from up_samp.search.jobs_bound import bound_by_jobs
from up_samp.search.params import Parameters
from up_samp.search.session import open_service
from up_samp.upio import read_problem
from up_samp.upio.relaxation import relax


def random_warehouse(seed):
    rng = random.Random(seed)
    encoding = rng.choice(WAREHOUSE_ENCODINGS)
    return warehouse(rng.choice([2, 2, 3]), rng.choice([2, 3, 4]), seed=seed, encoding=encoding)


def bound_of(problem, change=lambda jobs: jobs):
    snapshot, grid = lay_out(read_problem(problem))
    relaxation = relax(problem, snapshot)
    facts = Facts(relaxation.snapshot, relaxation.choices)
    service = open_service(snapshot, grid, Parameters())
    return bound_by_jobs(problem, facts, service, change(find_jobs(problem, snapshot)))


def check(seed):
    """Return the bound as a share of a plan's makespan, None where there is no plan."""
    get_environment().credits_stream = None
    problem = random_warehouse(seed)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"seed": seed}) as planner:
        result = planner.solve(problem, timeout=60)
    if result.plan is None:
        return None
    bound, makespan = bound_of(problem), int(result.metrics["makespan"])
    assert bound <= makespan, seed
    return bound / makespan


def test_no_plan_is_shorter_than_the_bound():
    shares = [s for s in map(check, range(3)) if s is not None]
    assert len(shares) >= 2
    assert max(shares) > 0.4


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_no_plan_of_many_is_shorter_than_the_bound(block):
    shares = [s for s in map(check, range(100 + 10 * block, 110 + 10 * block)) if s is not None]
    assert len(shares) >= 5


def test_what_is_of_use_to_two_jobs_counts_once():
    problem = warehouse(2, 2, encoding="compact")

    def twice(jobs):
        """The same work again, by other names."""
        again = tuple(
            tuple(replace(o, leader=f"other_{o.leader}") for o in options)
            for options in jobs.options
        )
        return Jobs((*jobs.options, *again), jobs.needs)

    assert bound_of(problem) == bound_of(problem, change=twice) > 0
