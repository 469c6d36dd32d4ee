"""What a session keeps of bounds from one solve to the next holds when the problem is tightened.

Between two solves durations get longer, some activities are stated never to happen, and cuts are
learned.
"""

import random

import pytest
from unified_planning.shortcuts import LE, LT, Not, Or

from tests.scheduling.cpsat.routing.test_sequences import Still, gated
from tests.scheduling.cpsat.sites import shop
from tests.scheduling.cpsat.styles import Style
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession

SETTLED = (ScheduleStatus.OPTIMAL, ScheduleStatus.INFEASIBLE)


def tighten(problem, rng):
    """Ask more of a problem: of its durations, of who is there, of who comes first."""
    activities = list(problem.activities)
    for activity in rng.sample(activities, max(1, len(activities) // 3)):
        low = activity.duration.lower.constant_value() + rng.choice([1, 2, 5])
        high = max(low, activity.duration.upper.constant_value())
        activity.set_duration_bounds(low, high)
    optional = [a for a in activities if a.optional]
    for activity in rng.sample(optional, min(len(optional), rng.choice([0, 0, 1]))):
        problem.add_constraint(Not(activity.present))
    for _ in range(rng.choice([0, 1, 3])):
        one, other = rng.sample(activities, 2)
        gap = rng.choice([0, 2, 4])
        apart = Or(LE(one.end + gap, other.start), LT(other.end, one.start))
        problem.add_constraint(apart, [a.present for a in (one, other) if a.optional])


def solve(session):
    return session.solve(Deadline.after(60.0), optimal=True)


def followed(problem, seed, times=3):
    """Tighten a problem again and again, solve it in one session and afresh, and compare."""
    rng = random.Random(seed)
    session = CpsatSession(problem, workers=1)
    for turn in range(times):
        mine = solve(session)
        truth = solve(CpsatSession(problem, workers=1))
        case = f"seed {seed}, turn {turn}"
        assert mine.status is truth.status, case
        assert mine.status in SETTLED, case
        if truth.schedule is None:
            break
        best = truth.schedule.makespan
        assert mine.schedule.makespan == best, case
        assert session.bound <= best, case
        tighten(problem, rng)


@pytest.mark.parametrize("seed", range(2))
def test_what_is_remembered_holds_for_what_is_tightened(seed):
    followed(Still(*gated(4000 + seed)).problem, seed)


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_what_is_remembered_holds_for_much_that_is_tightened(block):
    for seed in range(4100 + 6 * block, 4106 + 6 * block):
        followed(Still(*gated(seed)).problem, seed, times=4)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
def test_what_is_remembered_holds_for_shops_that_are_tightened(seed):
    shops = Still(shop(2, 2, 2, seed=seed), Style(), seed % 3, narrow=True)
    followed(shops.problem, seed)
