"""Bounds from the jobs of errands in mixed styles, against schedules found without them."""

import random

import pytest

from tests.metamorphic.test_names_of_poses import OtherNames
from tests.search.fleet_bound.errands import errands
from tests.search.test_assumptions import Site, bound, known, soonest
from tests.shuffled import shuffled
from tests.usual import usually
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.budget import Budget
from up_samp.search.knowledge import History, Knowledge
from up_samp.search.statements import lower_bounds
from up_samp.search.world import Motions
from up_samp.upio import write_refinement
from up_samp.upio.plan import build_schedule
from up_samp.validation.schedule import judge_schedule

PROVEN = (ScheduleStatus.OPTIMAL, ScheduleStatus.INFEASIBLE)


def scheduled(problem, seconds=1.5):
    """Return what the scheduler says of errands whose drives last as long as their bounds say, with
    nothing recognised and with all that is.
    """
    relaxation, facts, service = known(problem)
    motions = Motions(facts, service, Budget(Deadline.after(60.0), 10.0))
    for refinement in lower_bounds(motions, Knowledge(relaxation, History())):
        write_refinement(relaxation, refinement)
    for plain in (False, True):
        session = CpsatSession(relaxation.problem, workers=1, plain=plain)
        report = session.solve(Deadline.after(seconds))
        if report.schedule is not None:
            plan = build_schedule(relaxation.problem, report.schedule)
            assert judge_schedule(relaxation.problem, plan)[0].valid
        yield report


def told(seed):
    """Return a bound and the least makespan that is known (None: there is no schedule)."""
    problem = errands(seed)
    reports = list(scheduled(problem))
    found = [r.schedule.makespan for r in reports if r.schedule is not None]
    for report in reports:
        assert not (report.status is ScheduleStatus.INFEASIBLE and found), seed
        assert report.bound is None or report.bound <= min(found, default=report.bound), seed
    least = bound(problem)
    assert least <= min(found, default=least), seed
    return least, min(found, default=None)


@pytest.mark.parametrize("seed", usually(35, of=(35, 95, 148)))
def test_no_errands_are_done_sooner_than_the_bound(seed):
    least, best = told(seed)
    assert 0 < least <= best


@pytest.mark.parametrize("seed", [3, 7])
def test_errands_take_no_longer_by_other_names_of_their_places(seed):
    """What fluents tell by one name, drives lead to by another, whichever of them comes first."""
    least = bound(errands(seed))
    for k in range(1, 4):
        problem = errands(seed)
        assert OtherNames(problem, random.Random(seed + k)).others
        assert bound(shuffled(problem, k).problem) <= least


@pytest.mark.long
@pytest.mark.parametrize("first", range(1000, 1400, 40))
def test_no_errands_of_many_are_done_sooner_than_the_bound(first):
    rows = [told(seed) for seed in range(first, first + 40)]
    assert sum(least > 0 and best is not None for least, best in rows) > 20


def a_way_by(place):
    """A job of one of two robots: to drive to a place, from there to the next one, and to work."""
    site, some = Site(), []
    for r in range(2):
        first = site.drive(f"first{r}", r, place, f"home{r}")
        go, do = site.drive(f"go{r}", r, "D"), site.work(f"do{r}", r, 3, "D")
        site.draw(first, go)
        site.draw(go, do)
        some.append(do)
    site.one_of(*some)
    return site.problem


@pytest.mark.parametrize("place", ["B", "C"])
def test_who_comes_by_a_drive_of_the_job_makes_it_once(place):
    assert bound(a_way_by(place)) <= soonest(a_way_by(place))
