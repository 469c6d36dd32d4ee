"""Portfolios: the best plan of all members, whoever is first and whoever is lost."""

import math
import pickle

import pytest
from distributed import Client, LocalCluster
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.environment import get_environment
from unified_planning.shortcuts import OneshotPlanner

from tests.oracles.fresh import fresh_environment
from tests.oracles.odd_executors import Backwards
from up_samp import portfolio
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.benchmarks.instances import instance
from up_samp.model import ProblemError
from up_samp.portfolio import Member, Said, seeds, solve_portfolio
from up_samp.validation import validate_plan


@pytest.fixture(scope="module")
def small():
    with fresh_environment():
        return instance("jobshop-r1-j1-m1").build()


@pytest.mark.parametrize(
    "name", ["jobshop-r1-j1-m1", "logistics-do-all-r1-i1", "warehouse-compact-r2-o2"]
)
def test_a_problem_has_an_environment_of_its_own(name):
    """What a worker gets lives in another environment than the global one; so does what the search
    adds to it: what a drive begins at by a fluent is a parameter of an activity.
    """
    get_environment().credits_stream = None
    with fresh_environment():
        problem = pickle.loads(pickle.dumps(instance(name).build()))
    assert problem.environment is not get_environment()
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=60)
    assert validate_plan(problem, result.plan).valid


@pytest.mark.parametrize("lost", [(), (0,)], ids=["all there", "one lost"])
def test_the_best_plan_wins(small, lost):
    members = [Member(params={"first_plan": True}), Member(params={"optimal": True})]
    result = solve_portfolio(small, members, executor=Backwards(lost), timeout=120)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert validate_plan(small, result.plan).valid
    assert result.metrics["lost"] == str(len(lost))
    assert result.metrics["makespan"] == result.metrics["lower_bound"]
    assert {a.name for a in result.plan.activities} <= {a.name for a in small.activities}


def test_where_all_are_lost_it_is_said(small, caplog):
    result = solve_portfolio(small, seeds(2), executor=Backwards((0, 1)), timeout=120)
    assert (result.plan, result.status) == (None, Status.INTERNAL_ERROR)
    assert result.metrics["lost"] == "2"
    assert "worker is lost" in result.metrics["why"]
    assert "worker is lost" in caplog.text


class Closed(Backwards):
    def submit(self, do, *given):
        raise RuntimeError("cannot schedule new futures")


def test_a_pool_that_takes_nothing_is_lost_and_a_wrong_parameter_is_said(small):
    assert solve_portfolio(small, seeds(1), executor=Closed()).metrics["lost"] == "1"
    with pytest.raises(ProblemError, match="margin"):
        solve_portfolio(small, [Member(params={"margin": -1.0})], executor=Backwards())


@pytest.fixture
def told(monkeypatch):
    """Let members say what they are told to, round by round; return what they begin from."""
    begun = []

    def tell(*said):
        def run(data, number, each, ends, begin):
            begun.append((number, begin))
            return said[number]

        monkeypatch.setattr(portfolio, "run_member", run)
        begun.clear()
        return begun

    monkeypatch.setattr(portfolio, "_judged", lambda problem, said: said.plan.get("valid"))
    return tell


FOUND, OPTIMAL = Status.SOLVED_SATISFICING.name, Status.SOLVED_OPTIMALLY.name


def test_the_first_of_equals_wins(small, told):
    plans = [{"valid": f"plan {k}"} for k in range(4)]
    spans = (30, 20, 20, 25)
    told(*(Said(FOUND, p, s, 10, "absolute") for p, s in zip(plans, spans, strict=True)))
    result = solve_portfolio(small, seeds(4), executor=Backwards())
    assert (result.plan, result.metrics["member"]) == ("plan 1", "1")
    assert result.status is Status.SOLVED_SATISFICING


def test_a_bound_of_one_proves_the_plan_of_another(small, told):
    told(
        Said(FOUND, {"valid": "short"}, 20, 5, "absolute"),
        Said("TIMEOUT", None, None, 20, "absolute"),
    )
    result = solve_portfolio(small, seeds(2), executor=Backwards())
    assert (result.plan, result.status) == ("short", Status.SOLVED_OPTIMALLY)


def test_a_relative_bound_holds_for_its_own_member_alone(small, told):
    relative = "relative to the motion planner's durations"
    said = [Said(FOUND, {"valid": "a"}, 20, 5, relative), Said("TIMEOUT", None, None, 20, relative)]
    told(*said)
    result = solve_portfolio(small, seeds(2), executor=Backwards())
    assert (result.status, result.metrics["lower_bound"]) == (Status.SOLVED_SATISFICING, "5")
    told(Said(OPTIMAL, {"valid": None}, 10, 10, relative), Said("TIMEOUT"))
    result = solve_portfolio(small, seeds(2), executor=Backwards())
    assert (result.plan, result.status) == (None, Status.INTERNAL_ERROR)


def test_a_plan_that_is_not_valid_here_does_not_count(small, told):
    told(Said(OPTIMAL, {"valid": None}, 10, 10), Said(FOUND, {"valid": "long"}, 30, 5))
    result = solve_portfolio(small, seeds(2), executor=Backwards())
    assert (result.plan, result.status) == ("long", Status.SOLVED_SATISFICING)


def test_without_a_plan_a_proof_counts(small, told):
    told(Said("TIMEOUT"), Said("UNSOLVABLE_PROVEN", message="no door"))
    result = solve_portfolio(small, seeds(2), executor=Backwards())
    assert (result.status, result.metrics["why"]) == (Status.UNSOLVABLE_PROVEN, "no door")
    told(Said("TIMEOUT"), Said("INTERNAL_ERROR"))
    assert solve_portfolio(small, seeds(2), executor=Backwards()).status is Status.TIMEOUT


TWICE = {"rounds": 2, "timeout": 1e6}


def test_each_round_begins_from_the_best_plan_so_far(small, told):
    plans = [{"valid": f"plan {k}"} for k in range(4)]
    spans = (30, 20, 20, 15)
    begun = told(*(Said(FOUND, p, s, 10, "absolute") for p, s in zip(plans, spans, strict=True)))
    result = solve_portfolio(small, seeds(2), executor=Backwards(), **TWICE)
    assert sorted(begun, key=str) == [(0, None), (1, None), (2, plans[1]), (3, plans[1])]
    assert (result.plan, result.metrics["member"]) == ("plan 3", "1")
    assert result.metrics["statuses"] == ", ".join([FOUND] * 4)


def test_a_lost_worker_costs_its_round_only(small, told):
    plan = {"valid": "plan"}
    begun = told(*[Said(FOUND, plan, 20, 10, "absolute")] * 4)
    result = solve_portfolio(small, seeds(2), executor=Backwards((1,)), **TWICE)
    assert sorted(begun, key=str) == [(0, None), (2, plan), (3, plan)]
    assert (result.plan, result.metrics["lost"]) == ("plan", "1")


def test_there_is_no_other_round_after_a_proof(small, told):
    begun = told(Said(OPTIMAL, {"valid": "plan"}, 20, 20, "absolute"), Said("TIMEOUT"))
    result = solve_portfolio(small, seeds(2), executor=Backwards(), **TWICE)
    assert len(begun) == 2
    assert result.status is Status.SOLVED_OPTIMALLY


def test_other_rounds_have_other_random_numbers_and_ask_for_better_plans(small, monkeypatch):
    asked, real = [], OneshotPlanner

    def planner(name, params):
        asked.append(params)
        return real(name=name, params=params)

    monkeypatch.setattr("unified_planning.shortcuts.OneshotPlanner", planner)
    data = pickle.dumps((small, tuple(seeds(2, first_plan=True))))
    first = portfolio.run_member(data, 1, math.inf, math.inf)
    again = portfolio.run_member(data, 5, math.inf, math.inf, first.plan)
    assert again.makespan <= first.makespan
    other = {"first_plan": False, "optimal": True, "seed": 5}
    assert asked == [{"first_plan": True, "seed": 1}, other]


@pytest.fixture(scope="module")
def two_workers():
    """The executor of a cluster on this machine."""
    with (
        LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        yield client.get_executor()


@pytest.mark.parametrize(
    ("size", "seed", "seconds", "tuning"),
    [
        ((3, 4), 1, 1.0, {"exchanges": 1}),
        # too little for any plan by the first random numbers
        pytest.param((4, 6), 0, 1.0, {"exchanges": 1}, marks=pytest.mark.long),
    ],
    ids=["a better plan", "a plan"],
)
def test_two_workers_find_more_than_one_in_the_same_time(size, seed, seconds, tuning, two_workers):
    """Of which each counts what it does: no clock has a say."""
    with fresh_environment():
        fleet = warehouse(*size, encoding="compact", seed=seed)
    spans = []
    for count in (1, 2):
        shared = {"reproducible": True, "runtime": seconds, "tuning": {"large": 1, **tuning}}
        result = solve_portfolio(fleet, seeds(count, **shared), executor=two_workers, rounds=2)
        assert result.plan is None or validate_plan(fleet, result.plan).valid
        assert result.metrics["lost"] == "0"
        spans.append(float(result.metrics.get("makespan", "inf")))
    assert spans[1] < spans[0]


def test_what_cannot_be_is_said(small):
    with pytest.raises(ProblemError, match="need a time limit"):
        solve_portfolio(small, [Member(params={"runtime": 1.0}), Member()], rounds=2)
    with pytest.raises(ProblemError, match="one round"):
        solve_portfolio(small, [Member()], rounds=0)
    with pytest.raises(ProblemError, match="at least one member"):
        solve_portfolio(small, [])
    with pytest.raises(ProblemError, match="the same 'seconds_per_unit'"):
        solve_portfolio(small, [Member(), Member(params={"seconds_per_unit": 0.5})])
    with pytest.raises(ProblemError, match="the same 'margin'"):
        solve_portfolio(small, [Member(), Member(params={"margin": 0.2})])
    with pytest.raises(ProblemError, match="cannot be sent"):
        solve_portfolio(small, [Member(params={"progress": lambda event: None})])


@pytest.mark.long
def test_processes_of_this_machine(small):
    result = solve_portfolio(small, seeds(2), timeout=240)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert validate_plan(small, result.plan).valid
