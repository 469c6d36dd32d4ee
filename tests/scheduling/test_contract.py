"""What every scheduler must solve, prove and refuse."""

from __future__ import annotations

import pytest
from unified_planning.shortcuts import LE, IntType, MinimizeActionCosts, Not, RealType

from tests.scheduling import problems
from up_samp.model import Deadline, ScheduleStatus, UnsupportedError
from up_samp.scheduling import known_engines, open_scheduler
from up_samp.upio.plan import build_schedule, to_candidate
from up_samp.validation import validate_schedule

ENGINES = ("cpsat", *(name for name, _, _ in known_engines()))
PROVING = ("cpsat", "aries-opt", "cpse")
SOLVED = (ScheduleStatus.FOUND, ScheduleStatus.OPTIMAL)
OPTIMA = {
    "fetch_and_return": 11,
    "two_after_each_other": 7,
    "flexible": 4,
    "crew": 9,
    "garages": 2,
}


def check(problem, schedule):
    return [str(v) for v in validate_schedule(problem, schedule).violations]


class Solve:
    """Opens schedulers of one engine; those in processes share one worker, to save time."""

    def __init__(self, engine):
        self.engine = engine
        self.shared = None

    def open(self, problem):
        if self.shared is None:
            scheduler = open_scheduler(self.engine, problem, check=check)
            if self.engine == "cpsat":
                return scheduler
            self.shared = scheduler
        self.shared._problem = problem
        return self.shared

    def __call__(self, problem, seconds=30.0, **arguments):
        return self.open(problem).solve(Deadline.after(seconds), **arguments)


@pytest.fixture(params=ENGINES, scope="module")
def solve(request):
    solving = Solve(request.param)
    yield solving
    if solving.shared is not None:
        solving.shared.close()


@pytest.mark.parametrize("name", OPTIMA)
def test_solves_and_proves(solve, name):
    problem = getattr(problems, name)()
    report = solve(problem)
    assert report.status in SOLVED, report.message
    assert not check(problem, build_schedule(problem, report.schedule))
    assert report.schedule.makespan >= OPTIMA[name]
    if solve.engine in PROVING:
        assert report.status is ScheduleStatus.OPTIMAL
        assert report.bound == report.schedule.makespan == OPTIMA[name]


def test_a_first_schedule_where_no_optimum_is_wanted(solve):
    report = solve(problems.flexible(), optimal=False)
    assert report.status in SOLVED, report.message


def test_without_a_metric_nothing_is_called_optimal(solve):
    report = solve(problems.fetch_and_return(metric=False))
    assert report.status is ScheduleStatus.FOUND


def test_unsolvable_is_proven_or_at_least_not_solved(solve):
    report = solve(problems.sealed())
    proven = solve.engine in ("cpsat", "cpse")
    assert report.status is (ScheduleStatus.INFEASIBLE if proven else ScheduleStatus.NOT_FOUND)
    assert report.schedule is None


def test_a_problem_that_grows_between_calls(solve):
    problem = problems.fetch_and_return()
    scheduler = solve.open(problem)
    first = scheduler.solve(Deadline.after(30.0))
    go, pick = problem.get_activity("go"), problem.get_activity("pick")
    problem.add_constraint(LE(20, pick.start), scope=[pick.present])
    second = scheduler.solve(Deadline.after(30.0), hint=first.schedule, lower_bound=first.bound)
    assert second.status in SOLVED, second.message
    assert second.schedule.times["pick"][0] >= 20
    problem.add_constraint(Not(go.present))
    third = scheduler.solve(Deadline.after(30.0))
    assert third.status in (ScheduleStatus.INFEASIBLE, ScheduleStatus.NOT_FOUND)


@pytest.mark.parametrize("times", [1_000, 100_000])
def test_what_takes_long_is_solved_too(solve, times):
    """Times in small units: aries has a horizon, and calls what takes longer unsolvable."""
    report = solve(problems.fetch_and_return(times=times))
    assert report.status in SOLVED, report.message
    assert report.schedule.makespan >= 10 * times + 1
    if solve.engine in PROVING:
        assert report.schedule.makespan == 10 * times + 1


def test_a_lower_bound_that_is_met_is_a_proof(solve):
    report = solve(problems.two_after_each_other(), lower_bound=7)
    if report.schedule.makespan == 7:
        assert report.status is ScheduleStatus.OPTIMAL


def test_unsupported_features_are_named(solve):
    real = problems.two_after_each_other()
    real.add_variable("share", RealType())
    with pytest.raises(UnsupportedError, match="real"):
        solve(real)


def test_other_metrics_are_refused(solve):
    if solve.engine == "cpsat":
        pytest.skip("has metrics of its own")
    problem = problems.two_after_each_other()
    problem.clear_quality_metrics()
    problem.add_quality_metric(MinimizeActionCosts({}))
    with pytest.raises(UnsupportedError, match="only the makespan"):
        solve(problem)


def test_schedules_travel_both_ways():
    problem = problems.garages()
    problem.add_variable("level", IntType(2, 4))
    with open_scheduler("aries", problem) as scheduler:
        candidate = scheduler.solve(Deadline.after(20.0)).schedule
    assert candidate.parameters["park.where"] == "box"
    assert 2 <= candidate.parameters["level"] <= 4
    assert to_candidate(build_schedule(problem, candidate)) == candidate
