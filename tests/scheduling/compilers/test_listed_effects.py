"""The order in which an activity's effects are listed is none of their times."""

import itertools

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import Equals, IntType

from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling import known_engines
from up_samp.scheduling.adapters import open_scheduler

ENGINES = ("cpsat", *(name for name, _, _ in known_engines()))
EFFECTS = ("take", "half", "give")


def each():
    """Return engines with orders: of those that run in processes of their own one each, and the
    rest where the slow tests are run.
    """
    for engine, listed in itertools.product(ENGINES, itertools.permutations(EFFECTS)):
        slow = engine != "cpsat" and listed != EFFECTS[::-1]
        yield pytest.param(engine, listed, marks=[pytest.mark.long] if slow else [])


@pytest.mark.parametrize(("engine", "listed"), list(each()))
def test_effects_may_be_listed_in_any_order(engine, listed):
    problem = SchedulingProblem("listed")
    free = problem.add_fluent("free", IntType(0, 1), default_initial_value=1)
    done = problem.add_fluent("done", IntType(0, 9), default_initial_value=0)
    task = problem.add_activity("task", 1)
    task.set_duration_bounds(1, 2)
    if engine != "cpse":  # which takes no conditions on what is counted
        task.add_condition(task.start, Equals(free, 1))
    for name in listed:
        if name == "take":
            task.add_decrease_effect(task.start, free, 1)
        elif name == "give":
            task.add_increase_effect(task.end, free, 1)
        else:
            task.add_increase_effect(task.end - 1, done, 1)
    scheduler = open_scheduler(engine, problem)
    try:
        found = scheduler.solve(Deadline.after(20.0))
    finally:
        scheduler.close()
    assert found.status in (ScheduleStatus.OPTIMAL, ScheduleStatus.FOUND)
