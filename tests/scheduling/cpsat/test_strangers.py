"""Problems in a stranger's style: default, plain and other listings contradict each other not."""

import pytest

from tests.scheduling.cpsat.strangers import stranger
from tests.shuffled import shuffled
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule

SURE = (ScheduleStatus.OPTIMAL, ScheduleStatus.INFEASIBLE)


def answer(told, *, plain=False, optimal=True):
    """Return (status, makespan, bound); the schedule is judged by the original."""
    session = CpsatSession(told.problem, workers=1, effort=0.3, plain=plain)
    report = session.solve(Deadline.after(60), optimal=optimal)
    assert not report.refuted
    if report.schedule is None:
        return report.status, None, 0
    plan = told.back(build_schedule(told.problem, report.schedule))
    assert not validate_schedule(told.original, plan).violations
    return report.status, report.schedule.makespan, report.bound or 0


def contradicted(seed):
    """Return the answers of a seed's problem if two of them contradict each other."""
    one, other = (shuffled(stranger(seed), (seed, k)) for k in range(2))
    found = [answer(one, plain=True), answer(one), answer(other), answer(other, optimal=False)]
    plans = [makespan for _, makespan, _ in found if makespan is not None]
    sure = {(status, makespan) for status, makespan, _ in found if status in SURE}
    wrong = len(sure) > 1 or any(bound > min(plans) for *_, bound in found if plans)
    none = (ScheduleStatus.INFEASIBLE, None)
    return found if wrong or (plans and none in sure) else None


def wrong(seeds):
    return {seed: found for seed in seeds if (found := contradicted(seed)) is not None}


def test_no_answers_to_a_stranger_contradict():
    assert wrong(range(15)) == {}


def test_who_may_stay_where_it_is_need_not_go_anywhere():
    """A trip to the yard or the gate begins in the yard: it was taken for one to the gate."""
    assert wrong([1030]) == {}


@pytest.mark.long
@pytest.mark.parametrize("block", range(6))
def test_no_answers_to_many_strangers_contradict(block):
    assert wrong(range(1000 * block, 1000 * (block + 1))) == {}
