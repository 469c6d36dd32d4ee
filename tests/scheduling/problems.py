"""Small scheduling problems with known answers, shared by the tests of this folder."""

from __future__ import annotations

from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LE,
    And,
    ClosedTimeInterval,
    Equals,
    GlobalEndTiming,
    MinimizeMakespan,
    Not,
    Or,
    TimePointInterval,
    Timing,
    UserType,
)


def at(point, delay=0):
    return Timing(delay, point)


def over(low, high):
    return ClosedTimeInterval(low, high)


def fetch_and_return(metric: bool = True, times: int = 1) -> SchedulingProblem:
    """There (5), pick (2), back (5), all optional, with a fluent: optimum 11 (effects are seen one
    unit later), or 10 ``times`` and 1 where all lasts so many times as long."""
    problem = SchedulingProblem("fetch")
    place = UserType("Place")
    home, shelf = (problem.add_object(n, place) for n in ("home", "shelf"))
    robot_at = problem.add_fluent("robot_at", place, default_initial_value=home)
    for name, origin, goal in (("go", home, shelf), ("back", shelf, home)):
        move = problem.add_activity(name, optional=True)
        move.set_duration_bounds(5 * times, 9 * times)
        move.add_condition(TimePointInterval(at(move.start)), Equals(robot_at, origin))
        move.add_effect(move.end, robot_at, goal)
    pick = problem.add_activity("pick", 2 * times, optional=True)
    pick.add_condition(over(at(pick.start), at(pick.end)), Equals(robot_at, shelf))
    problem.add_constraint(pick.present)
    problem.add_condition(TimePointInterval(GlobalEndTiming()), Equals(robot_at, home))
    if metric:
        problem.add_quality_metric(MinimizeMakespan())
    return problem


def two_after_each_other() -> SchedulingProblem:
    """Two mandatory activities (3 and 4) that must not overlap: optimum 7."""
    problem = SchedulingProblem("two")
    a, b = problem.add_activity("a", 3), problem.add_activity("b", 4)
    problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def flexible(machines: int = 2, jobs: int = 3) -> SchedulingProblem:
    """Each job (2 units) on exactly one of the machines, one at a time: 3 on 2 take 4."""
    problem = SchedulingProblem("flexible")
    for j in range(jobs):
        ways = [problem.add_activity(f"job {j} on {m}", 2, optional=True) for m in range(machines)]
        problem.add_constraint(Or([w.present for w in ways]))
        for i, a in enumerate(ways):
            for b in ways[:i]:
                problem.add_constraint(Not(And(a.present, b.present)))
    for m in range(machines):
        here = [a for a in problem.activities if a.name.endswith(f"on {m}")]
        for i, a in enumerate(here):
            for b in here[:i]:
                problem.add_constraint(
                    Or(LE(a.end, b.start), LE(b.end, a.start)), scope=[a.present, b.present]
                )
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def crew(capacity: int = 2, uses: tuple[int, ...] = (1, 1, 2, 1)) -> SchedulingProblem:
    """Activities of 3 to 5 units that need some of a crew of 2: optimum 9."""
    problem = SchedulingProblem("crew")
    resource = problem.add_resource("crew", capacity)
    for i, amount in enumerate(uses):
        activity = problem.add_activity(f"a{i}", 3)
        activity.set_duration_bounds(3, 5)
        activity.uses(resource, amount)
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def sealed() -> SchedulingProblem:
    """A door that nobody opens in time: no schedule."""
    problem = SchedulingProblem("sealed")
    door = problem.add_fluent("open", default_initial_value=False)
    opener = problem.add_activity("opener", 3)
    opener.add_effect(opener.end, door, True)
    walk = problem.add_activity("walk", 4)
    walk.add_condition(over(at(walk.start), at(walk.end)), door())
    walk.add_deadline(7)
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def garages() -> SchedulingProblem:
    """Types below types: the car needs a garage, of the two only one is a garage."""
    problem = SchedulingProblem("garages")
    place = UserType("Place")
    garage = UserType("Garage", place)
    problem.add_object("yard", place)
    problem.add_object("box", garage)
    park = problem.add_activity("park", 2)
    park.add_parameter("where", garage)
    problem.add_quality_metric(MinimizeMakespan())
    return problem
