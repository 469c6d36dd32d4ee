"""Small scheduling problems with known answers, shared by the tests of this folder."""

from __future__ import annotations

from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    ClosedTimeInterval,
    Equals,
    GlobalEndTiming,
    MinimizeMakespan,
    TimePointInterval,
    Timing,
    UserType,
)


def at(point, delay=0):
    return Timing(delay, point)


def over(low, high):
    return ClosedTimeInterval(low, high)


def fetch_and_return(metric: bool = True) -> SchedulingProblem:
    """There (5), pick (2), back (5), all optional, with a fluent: optimum 11 (effects are seen one
    unit later)."""
    problem = SchedulingProblem("fetch")
    place = UserType("Place")
    home, shelf = (problem.add_object(n, place) for n in ("home", "shelf"))
    robot_at = problem.add_fluent("robot_at", place, default_initial_value=home)
    for name, origin, goal in (("go", home, shelf), ("back", shelf, home)):
        move = problem.add_activity(name, optional=True)
        move.set_duration_bounds(5, 9)
        move.add_condition(TimePointInterval(at(move.start)), Equals(robot_at, origin))
        move.add_effect(move.end, robot_at, goal)
    pick = problem.add_activity("pick", 2, optional=True)
    pick.add_condition(over(at(pick.start), at(pick.end)), Equals(robot_at, shelf))
    problem.add_constraint(pick.present)
    problem.add_condition(TimePointInterval(GlobalEndTiming()), Equals(robot_at, home))
    if metric:
        problem.add_quality_metric(MinimizeMakespan())
    return problem
