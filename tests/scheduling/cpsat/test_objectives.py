"""Metrics other than the makespan: proven values are those that brute force finds."""

import math
import re
from fractions import Fraction

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import Int, Minus, OneshotPlanner, get_environment

from tests.oracles.brute_force_schedule import solve as brute_force
from tests.scheduling.cpsat.objectives import ORDER, SORTS, problem_with
from tests.scheduling.cpsat.random_problems import HORIZON
from up_samp.model import ProblemError
from up_samp.model.objective import Cost
from up_samp.upio.objective import objective_of
from up_samp.validation import ranked, validate_schedule, value_of

OPTIMALLY = "SOLVED_OPTIMALLY"


def disagreement(sort, seed):
    """Return what differs from brute force on one problem (None: nothing)."""
    problem = problem_with(sort, seed)
    metric = problem.quality_metrics[0]
    best = brute_force(problem, HORIZON)
    planner = OneshotPlanner(problem_kind=problem.kind, optimality_guarantee=OPTIMALLY)
    with planner:
        assert planner.name in ("cpsat", "samp-refine[cpsat]")
        result = planner.solve(problem, timeout=60)
    if best is None:
        proven = result.status is Status.UNSOLVABLE_PROVEN
        return None if proven else f"{result.status}, but there is no schedule"
    if result.status is not Status.SOLVED_OPTIMALLY:
        return f"{result.status} {result.metrics} {result.log_messages}, best {best}"
    if not validate_schedule(problem, result.plan).valid:
        return "invalid"
    maximal = "minimize" not in str(metric)
    wanted = -best.value if maximal else best.value
    value = value_of(problem, result.plan)
    told = Fraction(result.metrics["value"]), Fraction(result.metrics["value_bound"])
    return None if (value, *told) == (wanted,) * 3 else f"{value}, told {told}, best {wanted}"


@pytest.fixture(autouse=True)
def _silent(monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)


@pytest.mark.parametrize("sort", SORTS)
def test_proven_values_are_those_of_brute_force(sort):
    found = {seed: disagreement(sort, seed) for seed in range(2)}
    assert not {seed: why for seed, why in found.items() if why is not None}


@pytest.mark.long
@pytest.mark.parametrize("sort", SORTS)
def test_proven_values_are_those_of_brute_force_on_many(sort):
    found = {seed: disagreement(sort, seed) for seed in range(1000, 1300)}
    assert not {seed: why for seed, why in found.items() if why is not None}


def wrong_order(seed):
    """Return what differs from brute force, where costs have an order (None: nothing)."""
    problem = problem_with(ORDER, seed)
    metric = problem.quality_metrics[0]
    best = brute_force(problem, HORIZON)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"optimal": True}) as planner:
        result = planner.solve(problem, timeout=60)
    assert problem.quality_metrics == [metric]  # as it was
    if best is None:
        proven = result.status is Status.UNSOLVABLE_PROVEN
        return None if proven else f"{result.status}, but there is no schedule"
    if result.status is not Status.SOLVED_OPTIMALLY:
        return f"{result.status} {result.metrics} {result.log_messages}, best {best}"
    if not validate_schedule(problem, result.plan).valid:
        return "invalid"
    wanted = list(best.value) if isinstance(best.value, tuple) else [best.value]
    found = ranked(problem, result.plan)
    return None if found == wanted else f"{found}, best {wanted}"


def test_objectives_in_an_order_are_those_of_brute_force():
    found = {seed: wrong_order(seed) for seed in range(6)}
    assert not {seed: why for seed, why in found.items() if why is not None}


@pytest.mark.long
def test_objectives_in_an_order_are_those_of_brute_force_on_many():
    found = {seed: wrong_order(seed) for seed in range(1000, 1300)}
    assert not {seed: why for seed, why in found.items() if why is not None}


def test_an_engine_that_minimises_one_sum_refuses_an_order():
    problem = problem_with(ORDER, 1)
    assert problem.quality_metrics[0].in_order
    with OneshotPlanner(name="cpsat") as planner:
        result = planner.solve(problem, timeout=60)
    assert result.status is Status.UNSUPPORTED_PROBLEM
    assert "then late + all, then most' in this order: samp-refine" in str(result.log_messages)


@pytest.mark.parametrize("weight", [Minus(0, 1), Int(2), math.inf])
def test_a_weight_that_is_no_number_is_refused_by_name(weight):
    with pytest.raises(ProblemError, match=re.escape(f"'late' has the weight '{weight}'")):
        Cost("late", weight, Int(3))
    problem = problem_with("goals", 1)
    goals = problem.quality_metrics[0].goals
    goal = next(iter(goals))
    goals[goal] = weight  # UP itself refuses expressions, and says not where
    with pytest.raises(ProblemError, match=re.escape(f"'{goal}' has the weight '{weight}'")):
        objective_of(problem)
