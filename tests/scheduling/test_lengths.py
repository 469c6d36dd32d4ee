"""Lengths told by parameters, variables and fluents, in sums and products."""

import itertools

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    IntType,
    MinimizeMakespan,
    Minus,
    OneshotPlanner,
    Plus,
    Times,
)

import up_samp  # noqa: F401  (registers the engines)
from up_samp.model import UnsupportedError

LENGTHS = {
    "the parameter": (lambda n, v, f: n, 3),
    "more": (lambda n, v, f: Plus(n, v, 1), 6),
    "less": (lambda n, v, f: Minus(20, Times(3, n)), 2),
    "a multiple": (lambda n, v, f: Times(2, n), 6),
    "multiples": (lambda n, v, f: Plus(Times(2, 2, n), Times(v, 3)), 18),
    "nothing and two": (lambda n, v, f: Plus(Times(0, n), 2), 2),
    "a fluent": (lambda n, v, f: Times(f, n), 12),
}

# a kind does not tell whether lengths of parameters can be told to an engine: it is asked by name
pytestmark = pytest.mark.filterwarnings("ignore:We cannot establish whether")


def work(length, stated):
    """Return an activity of that length, which its duration or a constraint tells."""
    problem = SchedulingProblem("work")
    activity = problem.add_activity("work")
    n = activity.add_parameter("n", IntType(1, 6))
    v = problem.add_variable("v", IntType(2, 5))
    f = problem.add_fluent("f", IntType(0, 9), default_initial_value=4)
    activity.add_constraint(GE(n, 3))
    least = length(n, v, f())
    if stated:
        activity.set_duration_bounds(0, 99)
        problem.add_constraint(GE(activity.end, Plus(activity.start, least)))
    else:
        activity.set_duration_bounds(least, 99)
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def each():
    """Return engines, lengths and ways to tell them; aries takes a second to start."""
    for i, (length, stated) in enumerate(itertools.product(LENGTHS, (False, True))):
        yield pytest.param("cpsat", length, stated)
        slow = [] if i % 4 == 1 else [pytest.mark.long]
        yield pytest.param("samp-refine[aries-opt]", length, stated, marks=slow)


@pytest.mark.parametrize(("engine", "length", "stated"), list(each()))
def test_lengths_may_be_sums_and_products(engine, length, stated):
    said, least = LENGTHS[length]
    with OneshotPlanner(name=engine) as planner:
        result = planner.solve(work(said, stated), timeout=30)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert int(result.metrics["makespan"]) == least


@pytest.mark.parametrize("stated", [False, True])
def test_aries_is_not_given_products_of_variables(stated):
    problem = work(lambda n, v, f: Times(n, v), stated)
    with (
        OneshotPlanner(name="samp-refine[aries-opt]") as planner,
        pytest.raises(UnsupportedError, match="product"),
    ):
        planner.solve(problem, timeout=30)
