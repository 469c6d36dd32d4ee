"""Large problems: jobs dealt out, thinned problems, motions decided one after the other."""

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner, get_environment

from up_samp.benchmarks.warehouse import warehouse
from up_samp.search.deals import Guess, deal, decided_by
from up_samp.search.jobs import find_jobs
from up_samp.upio import read_problem
from up_samp.upio.thin import thinned
from up_samp.validation import validate_plan

SOON = {"search": {"large": {"activities": 1}}}


@pytest.fixture(scope="module")
def problem():
    return warehouse(3, 8, encoding="compact")


def test_jobs_are_dealt_out_once_each(problem):
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    # one of the two optional orders has to be done
    assert [len(options) for options in jobs.options] == [3] * 3 + [3] * 3 + [6]
    first = jobs.options[0][0]
    assert first.members == {
        f"{what}_robot0_order0" for what in ("fetch", "load", "carry", "unload")
    }
    assert first.extras == {"leave_robot0_order0"}
    dealt = deal(jobs, Guess(snapshot))
    done = sorted(j for tour in dealt.tours.values() for j, _ in tour)
    assert done == list(range(len(jobs.options)))
    ends = [dealt.end(robot, tour) for robot, tour in dealt.tours.items()]
    assert max(ends) < 0.6 * sum(ends)


def test_a_thinned_problem_has_what_was_dealt_out_and_nothing_else(problem):
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    dealt = deal(jobs, Guess(snapshot))
    names = [a.name for a in problem.activities]
    thin = thinned(problem, decided_by(dealt, names))
    kept = {a.name for a in thin.activities}
    assert dealt.leaders() <= kept < set(names)
    loads = {n for n in kept if n.startswith("load_")}
    assert loads == dealt.leaders()
    assert len([n for n in kept if n.startswith("leave_")]) == sum(map(bool, dealt.tours.values()))
    assert len(problem.activities) == len(names)


@pytest.mark.parametrize(("robots", "orders"), [(3, 5)])
def test_a_fleet_gets_a_valid_plan_by_construction(robots, orders):
    get_environment().credits_stream = None
    problem = warehouse(robots, orders, encoding="compact")
    with OneshotPlanner(name="samp-refine[cpsat]", params={"tuning": SOON}) as planner:
        result = planner.solve(problem, timeout=120)
    assert result.status is Status.SOLVED_SATISFICING
    assert validate_plan(problem, result.plan).violations == ()
    assert result.metrics["rounds"] == "0", "the first plan came from what was dealt out"
