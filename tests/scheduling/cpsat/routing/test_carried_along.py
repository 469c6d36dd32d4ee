"""Travellers that one activity moves together: what it takes of a place, it takes once for both."""

from itertools import combinations

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    LE,
    ClosedTimeInterval,
    Equals,
    IntType,
    MinimizeMakespan,
    Object,
    OneshotPlanner,
    Or,
    UserType,
)

import up_samp  # noqa: F401  (registers the engine)
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_unit_places

TRIPS = 2


def moved_together(travellers):
    """Some who go to a place for one as one, for a job of 3 units each, and home; 5 units a way."""
    problem = SchedulingProblem("together")
    place = UserType("place")
    home, there = (problem.add_object(Object(name, place)) for name in ("home", "there"))
    free = problem.add_fluent("free", IntType(0, 1), default_initial_value=1)
    names = [f"at{n}" for n in range(travellers)]
    at = [problem.add_fluent(name, place, default_initial_value=home) for name in names]
    moves, jobs = [], []
    for trip in range(TRIPS):
        for name, origin, goal in (("go", home, there), ("back", there, home)):
            move = problem.add_activity(f"{name}{trip}", duration=5, optional=True)
            moves.append(move)
            for fluent in at:
                move.add_condition(move.start, Equals(fluent(), origin))
                move.add_effect(move.end, fluent(), goal)
            if goal is there:
                move.add_decrease_effect(move.end, free(), 1)
            else:
                move.add_increase_effect(move.start, free(), 1)
    for n, fluent in enumerate(at):
        job = problem.add_activity(f"job{n}", duration=3)
        jobs.append(job)
        job.add_condition(ClosedTimeInterval(job.start, job.end), Equals(fluent(), there))
    rest = problem.add_activity("rest", duration=1)
    for job, fluent in zip(jobs, at, strict=True):
        rest.add_condition(ClosedTimeInterval(rest.start, rest.end), Equals(fluent(), home))
        problem.add_constraint(GE(rest.start, job.end))
    for job in jobs:
        for one, other in combinations([*moves, job, rest], 2):
            problem.add_constraint(Or(LE(one.end, other.start), LE(other.end, one.start)))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


@pytest.mark.parametrize("travellers", [1, 2, 3])
def test_a_unit_taken_for_several_at_once_is_no_place_for_one_of_them(travellers):
    with OneshotPlanner(name="cpsat", params={"workers": 1}) as planner:
        result = planner.solve(moved_together(travellers), timeout=20)
    assert result.status is Status.SOLVED_OPTIMALLY
    makespan = 5 + 3 + 5 + 1 + 2  # what an effect does is seen a unit later
    assert int(result.metrics["makespan"]) == makespan


@pytest.mark.parametrize("travellers", [1, 2, 3])
def test_who_takes_one_unit_for_several_makes_no_place_for_one(travellers):
    model = ScheduleModel(moved_together(travellers))
    routes = find_routes(model)
    assert len(routes) == travellers
    assert len(find_unit_places(model, routes)) == (travellers == 1)
