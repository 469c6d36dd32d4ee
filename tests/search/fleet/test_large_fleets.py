"""Large problems: jobs assigned, thinned problems, motions decided one after the other."""

from dataclasses import replace

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import AnytimePlanner, OneshotPlanner, get_environment

from tests.search.fleet.guesses import along_the_axes, assigned
from tests.search.fleet_bound.store_fleet import fleet_of
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.search.fleet import assignment, tours
from up_samp.search.fleet.assignment import decided_by
from up_samp.search.fleet.jobs import find_jobs
from up_samp.upio import read_problem
from up_samp.upio.restrict import thinned
from up_samp.validation import validate_plan

SOON = {"large": 1}
FIRST = {"tuning": SOON, "first_plan": True}


@pytest.fixture(scope="module")
def problem():
    return warehouse(3, 8, encoding="compact")


@pytest.mark.parametrize(("warm", "cold"), [(0.03, 0.0003), (0.03, 0.0), (0.0, 0.0)])
def test_work_that_takes_no_time_is_assigned(problem, warm, cold, monkeypatch):
    monkeypatch.setattr(assignment, "_WARM", warm)
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    options = tuple(tuple(replace(o, work=0.0) for o in some) for some in jobs.options)
    for lasts in (lambda body, a, b: 0.0, along_the_axes):
        found = assigned(replace(jobs, options=options), snapshot, lasts, cold=cold)
        done = sorted(j for tour in found.tours.values() for j, _ in tour)
        assert done == list(range(len(jobs.options)))


def test_jobs_are_assigned_once_each(problem):
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    # one of the two optional orders has to be done
    assert [len(options) for options in jobs.options] == [3] * 3 + [3] * 3 + [6]
    first = jobs.options[0][0]
    assert first.members == {
        f"{what}_robot0_order0" for what in ("fetch", "load", "carry", "unload")
    }
    assert first.extras == {"leave_robot0_order0"}
    assignment = assigned(jobs, snapshot)
    done = sorted(j for tour in assignment.tours.values() for j, _ in tour)
    assert done == list(range(len(jobs.options)))
    ends = [end for end, _ in assignment.evaluator.ends(assignment.tours).values()]
    assert max(ends) < 0.6 * sum(ends)


def test_a_thinned_problem_has_what_was_dealt_out_and_nothing_else(problem):
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    assignment = assigned(jobs, snapshot)
    names = [a.name for a in problem.activities]
    thin = thinned(problem, decided_by(assignment, problem.activities))
    kept = {a.name for a in thin.activities}
    leaders = {jobs.options[j][k].leader for tour in assignment.tours.values() for j, k in tour}
    assert leaders <= kept < set(names)
    loads = {n for n in kept if n.startswith("load_")}
    assert loads == leaders
    assert len([n for n in kept if n.startswith("leave_")]) == sum(
        map(bool, assignment.tours.values())
    )
    assert len(problem.activities) == len(names)


@pytest.mark.parametrize(("robots", "orders"), [(3, 5)])
def test_a_fleet_gets_a_valid_plan_by_construction(robots, orders):
    get_environment().credits_stream = None
    problem = warehouse(robots, orders, encoding="compact")
    with OneshotPlanner(name="samp-refine[cpsat]", params=FIRST) as planner:
        result = planner.solve(problem, timeout=120)
    assert result.status is Status.SOLVED_SATISFICING
    assert validate_plan(problem, result.plan).violations == ()
    assert result.metrics["rounds"] == "0", "the first plan came from what was assigned"


@pytest.mark.usefixtures("no_second_opinions")
def test_a_fleets_problem_file_is_dealt_out_too():
    get_environment().credits_stream = None
    problem = fleet_of(2, 3).problem
    jobs = find_jobs(problem, read_problem(problem))
    assert [len(options) for options in jobs.options] == [2] * 3
    assert all(len(o.members) == 2 and len(o.legs) == 1 for os in jobs.options for o in os)
    with OneshotPlanner(name="samp-refine[cpsat]", params=FIRST) as planner:
        result = planner.solve(problem, timeout=120)
    assert result.status is Status.SOLVED_SATISFICING
    assert validate_plan(problem, result.plan).violations == ()
    assert result.metrics["rounds"] == "0", "the first plan came from what was assigned"


def test_plans_of_large_fleets_get_better(monkeypatch):
    get_environment().credits_stream = None
    problem = warehouse(2, 4, encoding="compact")
    # a first plan that leaves something to be done better: poorly assigned, whole tours, best ways
    monkeypatch.setattr(tours, "_PAST", 0)
    tuning = {"large": 1, "stale": 30, "exchanges": 0}
    with AnytimePlanner(name="samp-refine[cpsat]", params={"tuning": tuning}) as planner:
        found = []
        for result in planner.get_solutions(problem, timeout=300):
            if result.plan is None:
                break
            found.append(int(result.metrics["makespan"]))
            assert validate_plan(problem, result.plan).violations == ()
            if len(found) == 2:
                break
    assert len(found) > 1
    assert found[0] > found[-1]


def test_a_criterion_ends_the_search_after_the_first_plan(problem):
    """Tours are not made better for as long as there is time."""
    plans = []
    stop = {"stop": lambda state: state.upper_bound is not None, "tuning": SOON}
    with AnytimePlanner(name="samp-refine[cpsat]", params=stop) as planner:
        plans += [r for r in planner.get_solutions(problem, timeout=120) if r.plan is not None]
    assert plans
    assert float(plans[-1].metrics["seconds_total"]) < 60
    assert {r.metrics["makespan"] for r in plans} == {plans[0].metrics["makespan"]}
