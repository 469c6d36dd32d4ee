"""A search with workers finds the plan that it finds without."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from up_samp.benchmarks.instances import instance
from up_samp.io.plan_dict import plan_to_dict
from up_samp.model import ProblemError
from up_samp.search.params import split_parameters


class Counting(ThreadPoolExecutor):
    tasks = 0

    def submit(self, *given, **named):
        self.tasks += 1
        return super().submit(*given, **named)


def plan_of(name, **params):
    get_environment().credits_stream = None
    problem = instance(name).build()
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=120)
    assert result.status in (Status.SOLVED_OPTIMALLY, Status.SOLVED_SATISFICING)
    return plan_to_dict(problem, result.plan)


def test_the_same_plan_with_workers():
    with Counting(2) as pool:
        with_workers = plan_of("jobshop-r2-j1-m1", executor=pool)
        assert pool.tasks > 0
        pool.submit(int).result()  # the caller's executor is left as it was
    assert with_workers["activities"] == plan_of("jobshop-r2-j1-m1")["activities"]


def test_an_executor_has_to_be_one():
    with pytest.raises(ProblemError, match="'executor' must be an executor"):
        split_parameters({"executor": 4})
