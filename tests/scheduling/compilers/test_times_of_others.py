"""Conditions and effects at times of other activities, which may not be there: every engine tells
the optimum that brute force does, or the problem is refused by name. (aries took them for its own
times, or for never: it called 6 optimal instead of 2.)
"""

import itertools

import pytest
from unified_planning.model import TimePointInterval
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    BoolType,
    ClosedTimeInterval,
    Equals,
    GlobalStartTiming,
    Implies,
    IntType,
    MinimizeMakespan,
    Timing,
)

from tests.oracles.brute_force_schedule import solve as brute_force
from up_samp.model import Deadline, ScheduleStatus, UnsupportedError
from up_samp.scheduling import known_engines
from up_samp.scheduling.adapters import open_scheduler
from up_samp.validation import validate_schedule

ENGINES = ("cpsat", *(name for name, _, _ in known_engines()))
SPANS = {
    "from its end": lambda x, y: ClosedTimeInterval(Timing(0, y.end), Timing(0, x.start)),
    "to its start": lambda x, y: ClosedTimeInterval(Timing(0, x.end), Timing(0, y.start)),
    "at its start": lambda x, y: TimePointInterval(Timing(0, y.start)),
    "all through": lambda x, y: ClosedTimeInterval(Timing(0, y.start), Timing(0, y.end)),
}
CASES = list(
    itertools.product(
        [*SPANS, "opens", "shuts", "asks for a number"], ("the problem", "x", "y"), (0, 1)
    )
)


def problem_with(what, owner, optional, *, swapped=False):
    """``x`` and, if it is made, ``y``; the problem itself opens the gate at 3."""
    problem = SchedulingProblem(f"{what}, of {owner}")
    made = {}
    for name in "yx" if swapped else "xy":
        lasts, may = (2, False) if name == "x" else (1, optional)
        made[name] = problem.add_activity(name, lasts, optional=may)
    x, y = made["x"], made["y"]
    gate = problem.add_fluent("gate", BoolType(), default_initial_value=what == "shuts")
    whose = made.get(owner, problem)
    if what == "asks for a number":  # no fluent: a constraint, which all engines know
        number = problem.add_variable("number", IntType(0, 1))
        span = ClosedTimeInterval(Timing(0, y.start), Timing(0, y.end))
        whose.add_condition(span, Equals(number, 1))
        problem.add_constraint(Implies(Equals(number, 1), GE(x.start, 2)))
    elif what in SPANS:
        problem.add_effect(GlobalStartTiming(3), gate, True)
        whose.add_condition(SPANS[what](x, y), gate())
    else:
        whose.add_effect(Timing(0, y.start), gate, what == "opens")
        x.add_condition(ClosedTimeInterval(Timing(0, x.start), Timing(0, x.end)), gate())
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def check(problem, schedule):
    return [str(v) for v in validate_schedule(problem, schedule).violations]


def answers(engine):
    """Yield (case, best makespan, report or why it is refused) of one engine."""
    scheduler = None
    for case in CASES:
        problem = problem_with(*case, swapped=len(str(case)) % 2)
        if scheduler is None or engine == "cpsat":
            scheduler = open_scheduler(engine, problem, check=check)
        scheduler._problem = problem  # one process for all
        try:
            found = scheduler.solve(Deadline.after(20.0))
        except UnsupportedError as error:
            found = error
        yield case, brute_force(problem, 6).makespan, found
    scheduler.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_times_of_others_are_understood_or_refused(engine):
    wrong, solved = {}, 0
    for case, best, found in answers(engine):
        if isinstance(found, UnsupportedError):
            if engine == "cpsat" or "number" in case[0] or f"of {case[1]} at " not in str(found):
                wrong[case] = found
            continue
        sure = found.status is ScheduleStatus.OPTIMAL
        if found.schedule is None or (sure and found.schedule.makespan != best):
            wrong[case] = found
        solved += 1
    assert not wrong
    assert solved >= len(CASES) / 6
