"""A problem without some of its optional activities has the schedules that leave these out."""

import pytest
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Schedule
from unified_planning.shortcuts import BoolType, ClosedTimeInterval, Timing

from tests.oracles import brute_force_schedule as brute
from tests.scheduling.odd_problems import odd_problem, ways
from tests.usual import usually
from up_samp.execution import Executor
from up_samp.io import plan_to_dict
from up_samp.model import UnsupportedError
from up_samp.upio.restrict import thinned


def differing(seed):
    """Return a choice that is a schedule of only one of a problem and what is left of it."""
    problem = odd_problem(seed)
    absent = [a.name for a in problem.activities if a.optional][:1]
    thin = thinned(problem, {a.name for a in problem.activities} - set(absent))
    judge = brute._Judge(thin)
    for times, values, valid in ways(problem, seed, 100 if absent else 0):
        if times[absent[0]] is None:
            left = {name: span for name, span in times.items() if name not in absent}
            if (judge.valid(brute.Choice(left, values)) is not None) != valid:
                return times, values
    return None


# 380 to 614: conditions and effects at times of what is left out
FOUND = (380, 555, 602, 614)


@pytest.mark.parametrize(
    "seeds", usually((*range(20), *FOUND), of=[(*range(20), *FOUND), range(620, 3000)])
)
def test_what_is_left_has_the_same_schedules(seeds):
    assert {seed: found for seed in seeds if (found := differing(seed)) is not None} == {}


@pytest.mark.parametrize("owner", ["the problem", "later"])
def test_times_of_what_is_over_are_refused_by_name(owner):
    """What is left does not know when it was."""
    problem = SchedulingMotionProblem("over")
    opened = problem.add_fluent("open", BoolType(), default_initial_value=True)
    first, later = problem.add_activity("first", 2), problem.add_activity("later", 3)
    whose = later if owner == "later" else problem
    whose.add_condition(ClosedTimeInterval(Timing(0, first.end), Timing(0, later.start)), opened())
    times = {first.start: 0, first.end: 2, later.start: 4, later.end: 7}
    plan = plan_to_dict(problem, Schedule([first, later], times))
    executor = Executor(plan, problem)
    executor.commands(0.0)
    executor.done("first", 2.0)
    with pytest.raises(UnsupportedError, match="'first' has begun"):
        executor.remaining_problem()
