"""Problems told by counters, in every form of interval, comparison, chain and metric: default and
optimal answers, in two listings, against the plain model, and small ones against brute force.
"""

import random

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import BoolType, IntType, MinimizeMakespan, Not

from tests.oracles.brute_force_schedule import solve as brute_force
from tests.scheduling.cpsat.ledgers import HORIZON, ledger
from tests.shuffled import shuffled
from tests.usual import usually
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio.objective import Objective
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule, value_of

SURE = (ScheduleStatus.OPTIMAL, ScheduleStatus.INFEASIBLE)
GIVEN_UP = (ScheduleStatus.OUT_OF_TIME, ScheduleStatus.NOT_FOUND)


def cost_of(told, schedule, report):
    """Return what a schedule costs, by the validator where that knows the metric."""
    problem = told.original
    if not problem.quality_metrics:
        return None
    (metric,) = problem.quality_metrics
    if metric.is_minimize_makespan():
        return report.schedule.makespan
    if isinstance(metric, Objective):
        return report.cost
    sign = 1 if "minimize" in str(metric) else -1
    return sign * value_of(problem, schedule)


def answer(told, *, plain=False, optimal=True):
    """Return (status, cost, bound, what is wrong with it)."""
    session = CpsatSession(told.problem, workers=1, effort=0.3, plain=plain)
    report = session.solve(Deadline.after(60), optimal=optimal)
    wrong = [report.refuted, report.message if report.status is ScheduleStatus.ERROR else ""]
    if report.schedule is None:
        return report.status, None, report.bound, "".join(wrong)
    plan = told.back(build_schedule(told.problem, report.schedule))
    wrong += map(str, validate_schedule(told.original, plan).violations)
    cost = None if any(wrong) else cost_of(told, plan, report)
    if told.original.quality_metrics and not any(wrong) and cost != report.cost:
        wrong.append(f"costs {cost}, not {report.cost}")
    return report.status, cost, report.bound, "".join(wrong)


def contradicted(seed, *, small=False):
    """Return the answers to a seed's problem if they contradict each other, or brute force."""
    problem = ledger(seed, small=small)
    one, other = (shuffled(problem, (seed, k)) for k in range(2))
    found = [answer(one, plain=True), answer(one), answer(other), answer(other, optimal=False)]
    return found if wrong_answers(found) else small and beside_brute_force(problem, found)


def wrong_answers(found):
    if any(wrong for *_, wrong in found):
        return True
    costs = [cost for status, cost, *_ in found if cost is not None]
    planned = any(status in (ScheduleStatus.OPTIMAL, ScheduleStatus.FOUND) for status, *_ in found)
    none = any(status is ScheduleStatus.INFEASIBLE for status, *_ in found)
    optima = {cost for status, cost, *_ in found if status is ScheduleStatus.OPTIMAL}
    high = any(b is not None and b > min(costs) for *_, b, _ in found) if costs else False
    return (planned and none) or len(optima) > 1 or high


def beside_brute_force(problem, found):
    """Return what brute force says to the contrary (a tuple), or False."""
    if problem.quality_metrics and isinstance(problem.quality_metrics[0], Objective):
        return False
    best = brute_force(problem, HORIZON)
    for status, cost, bound, _ in found:
        if best is None:
            wrong = status not in (ScheduleStatus.INFEASIBLE, *GIVEN_UP)
        elif status is ScheduleStatus.INFEASIBLE:
            wrong = True
        elif not problem.quality_metrics:
            wrong = False
        else:
            wrong = status is ScheduleStatus.OPTIMAL and cost != best.value
            wrong |= cost is not None and cost < best.value
            wrong |= bound is not None and bound > best.value
        if wrong:
            return found, best and best.value, best
    return False


def wrong(seeds, **size):
    return {seed: found for seed in seeds if (found := contradicted(seed, **size))}


def switched(seed):
    """Return a problem of a level that two raise and lower if a switch of theirs is on, or off."""
    r, problem = random.Random(seed), SchedulingProblem(f"switched {seed}")
    level = problem.add_fluent("level", IntType(0, 2), default_initial_value=r.choice((0, 1)))
    for name in "ab":
        activity = problem.add_activity(name, r.choice((1, 2)))
        switch = activity.add_parameter("switch", BoolType())
        for time in (activity.start, activity.end):
            change = r.choice((activity.add_increase_effect, activity.add_decrease_effect))
            change(time, level, 1, *r.choice(((), (switch,), (Not(switch),), (Not(switch),))))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


@pytest.mark.parametrize("seeds", usually(range(6), of=[range(6), range(200, 400)]))
def test_amounts_that_hang_on_what_is_not_so(seeds):
    """OR-Tools ended the process over reservoirs with negated literals."""
    for seed in seeds:
        problem = switched(seed)
        found = [answer(shuffled(problem, seed), plain=plain) for plain in (False, True)]
        assert not wrong_answers(found), found
        assert not beside_brute_force(problem, found)


def test_answers_to_ledgers_agree():
    assert wrong(range(25)) == {}


def test_answers_to_small_ledgers_are_those_of_brute_force():
    assert wrong(range(10), small=True) == {}


@pytest.mark.long
@pytest.mark.parametrize("block", range(5))
def test_answers_to_many_ledgers_agree(block):
    assert wrong(range(1000 + 300 * block, 1300 + 300 * block)) == {}


@pytest.mark.long
@pytest.mark.parametrize("block", range(5))
def test_answers_to_many_small_ledgers_are_those_of_brute_force(block):
    assert wrong(range(1000 + 200 * block, 1200 + 200 * block), small=True) == {}
