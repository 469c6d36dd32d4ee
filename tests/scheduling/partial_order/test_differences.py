"""What a plan makes of a problem's expressions: fluents that hang on numbers and truth values."""

import pytest
from unified_planning.model import ClosedTimeInterval, Fluent, Timing
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Schedule
from unified_planning.shortcuts import GE, BoolType, Equals, Iff, IntType

from up_samp.execution import At, Event, Executor, dependencies_of, solve_remaining
from up_samp.io import plan_to_dict
from up_samp.validation import validate_schedule


def shelf(cell, kind):
    """Two that use ``cell`` one after the other: it has room for one, and others for nobody; using
    it takes 3 there, and 7 elsewhere.
    """
    problem = SchedulingMotionProblem("shelf")
    room = problem.add_fluent(Fluent("room", IntType(0, 1), cell=kind), default_initial_value=0)
    long = problem.add_fluent(Fluent("long", IntType(0, 9), cell=kind), default_initial_value=7)
    problem.set_initial_value(room(cell), 1)
    problem.set_initial_value(long(cell), 3)
    tasks, values = [], {}
    for k in range(2):
        task = problem.add_activity(f"use{k}", 1)
        chosen = task.add_parameter("cell", kind)
        task.set_fixed_duration(long(chosen))
        task.add_constraint((Iff if isinstance(cell, bool) else Equals)(chosen, cell))
        task.add_decrease_effect(task.start, room(chosen), 1)
        task.add_increase_effect(task.end, room(chosen), 1)
        tasks.append(task)
        values |= {task.start: 3 * k, task.end: 3 * k + 3, chosen: cell}
    return problem, Schedule(tasks, values)


CELLS = [*((k, IntType(0, 3)) for k in range(4)), (True, BoolType()), (False, BoolType())]


@pytest.mark.parametrize(("cell", "kind"), CELLS)
def test_fluents_hang_on_numbers_and_on_truth_values(cell, kind):
    problem, plan = shelf(cell, kind)
    assert validate_schedule(problem, plan).valid
    graph = dependencies_of(problem, plan_to_dict(problem, plan)).graph
    assert {e.lag for e in graph.edges if e.kind == "duration"} == {3.0}
    handed = {(e.first, e.then) for e in graph.edges}
    assert (Event(At.END, "use0"), Event(At.START, "use1")) in handed


@pytest.mark.parametrize(("cell", "kind"), CELLS)
def test_what_is_left_of_them(cell, kind):
    """After ``use0`` the rest is one use; while it is under way, its place is taken."""
    problem, plan = shelf(cell, kind)
    for now, least in ((1.0, 5), (4.0, 3)):
        executor = Executor(plan_to_dict(problem, plan), problem)
        executor.commands(0.0)
        if now > 3.0:
            executor.done("use0", 3.5)
        executor.commands(now)
        left = executor.remaining_problem()
        assert solve_remaining(left, seconds=20.0)["makespan"] == least


@pytest.mark.parametrize("late", [0, 2])
@pytest.mark.parametrize("now", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("cell", [0, 1, 2])
def test_what_is_asked_for_a_while_is_asked_for_the_rest_of_it(cell, now, late):
    """``watch`` wants something in its cell until 4 units after its start, from ``late`` on, and
    who takes it away may come then, whenever the rest is planned anew.
    """
    problem = SchedulingMotionProblem("watch")
    level = problem.add_fluent(
        Fluent("level", IntType(0, 2), cell=IntType(0, 3)), default_initial_value=0
    )
    problem.set_initial_value(level(cell), 2)
    watch, drain = problem.add_activity("watch", 6), problem.add_activity("drain", 6)
    span = ClosedTimeInterval(Timing(late, watch.start), Timing(4, watch.start))
    watch.add_condition(span, GE(level(cell), 1))
    drain.add_effect(drain.start, level(cell), 0)
    times = {watch.start: 0, watch.end: 6, drain.start: 5, drain.end: 11}
    plan = Schedule([watch, drain], times)
    assert validate_schedule(problem, plan).valid
    executor = Executor(plan_to_dict(problem, plan), problem)
    executor.commands(0.0)
    executor.commands(now)
    left = executor.remaining_problem()
    (task,) = [a for a in solve_remaining(left, seconds=20.0)["activities"] if a["name"] == "drain"]
    times |= {drain.start: task["start"] + left.since, drain.end: task["end"] + left.since}
    assert validate_schedule(problem, Schedule([watch, drain], times)).valid
    assert task["start"] + left.since >= 5
