"""The lower bound by all the work there is."""

import itertools
import math
import random

import numpy as np
import pytest
from unified_planning.shortcuts import IntType

from tests.scheduling.cpsat.sites import Site, Task, shop, store
from tests.scheduling.cpsat.styles import Style
from tests.scheduling.cpsat.truth import bound_without_search
from tests.scheduling.cpsat.writer import write
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing import workload
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work
from up_samp.scheduling.cpsat.routing.sequences import LabelTable
from up_samp.scheduling.cpsat.routing.workload import (
    TaskShare,
    bound_by_assignment,
    bound_by_work,
    shares,
)


def optimum(problem):
    return CpsatSession(problem, workers=1).solve(Deadline.after(60)).schedule.makespan


def line(robots=1):
    """Three places in a row, 10 apart; from the first, work at the last, then the first again."""
    roads = {(a, b): 10 * abs(a - b) for a in range(3) for b in range(3) if a != b}
    return Site((0,) * robots, roads, (Task((2,), 5), Task((0,), 5, after=(0,))))


def test_one_robot_needs_all_the_time_that_its_work_takes():
    problem = write(line(), Style())
    assert bound_without_search(problem) == 20 + 5 + 20 + 5 == optimum(problem)


def test_robots_share_the_work_but_wait_for_each_other():
    """The total, 30, might be 15 each; but the second task begins after the first one's end."""
    problem = write(line(2), Style())
    assert bound_without_search(problem) == 30 == optimum(problem)


def test_robots_that_take_turns_share_nothing():
    problem = write(line(2), Style())
    queue = problem.add_fluent("queue", IntType(0, 1), default_initial_value=1)
    for activity in problem.activities:
        activity.uses(queue())
    assert bound_without_search(problem) == 30 == optimum(problem)


def test_doors_cost_what_it_takes_to_squeeze_them_in():
    site = line()
    behind = Site(site.starts, site.roads, site.tasks, {2: 1})
    problem = write(behind, Style())
    assert bound_without_search(problem) == 51 == optimum(problem)


def test_doors_may_stay_shut_where_others_do_the_work():
    site = Site((0,), line().roads, (Task((2,), 5, helped=True),), {2: 1})
    problem = write(site, Style())
    assert bound_without_search(problem) <= 5 == optimum(problem)


def test_coming_home_counts():
    site = line()
    problem = write(Site(site.starts, site.roads, site.tasks[:1], home=True), Style())
    assert bound_without_search(problem) == 45 == optimum(problem)


@pytest.mark.parametrize("robots", [1, 2])
def test_a_shop_is_bounded_to_three_quarters_of_its_best_plan(robots):
    problem = write(shop(robots, 2, 3), Style(alone="uses"))
    report = CpsatSession(problem, workers=1, effort=2.0).solve(Deadline.after(60))
    assert report.schedule is not None
    assert bound_without_search(problem) >= 0.75 * report.schedule.makespan


def test_a_large_fleet_is_bounded_by_who_does_what():
    """Four robots and six items: somebody has to go twice."""
    problem = write(store(4, 6), Style())
    model = ScheduleModel(problem)
    work = find_work(model, find_routes(model))
    once = max(min(s.first + s.back for s in mine.values()) for mine in shares(work))
    bound = bound_by_assignment(work, 0)
    assert once < bound <= 2.5 * once
    report = CpsatSession(problem, workers=1, effort=1.0).solve(Deadline.after(60), optimal=False)
    assert 0.6 * report.schedule.makespan <= bound <= report.schedule.makespan


class Looks:
    """A clock on which the time is over after so many looks."""

    work = None

    def __init__(self, most):
        self.most, self.done = most, 0

    def remaining(self):
        return math.inf

    def spend(self, seconds):
        """Time passes by looks alone."""

    def expired(self):
        self.done += 1
        return self.done > self.most


@pytest.mark.parametrize("site", [line(2), shop(2, 2, 2)], ids=["line", "shop"])
def test_a_bound_whose_time_is_over_ends_soon_and_claims_no_more(site):
    model = ScheduleModel(write(site, Style()))
    work = find_work(model, find_routes(model))
    whole = Looks(10**9)
    best = bound_by_work(work, 0, whole).value
    last = 0
    for most in (*range(0, whole.done, max(1, whole.done // 12)), whole.done):
        looks = Looks(most)
        bound = bound_by_work(work, 0, looks).value
        assert last <= bound <= best
        assert looks.done <= most + 6  # each stage looks once more
        last = bound
    assert last == best


def test_a_large_fleets_bound_ends_soon_when_its_time_is_over():
    model = ScheduleModel(write(store(4, 6), Style()))
    work = find_work(model, find_routes(model))
    best, soon = bound_by_assignment(work, 0), bound_by_assignment(work, 0, Deadline.after(0.0))
    assert 0 < soon < best


def test_labels_that_are_compared_for_long_look_at_the_clock():
    """A thousand labels, each worse than the one before: all but the first fall away in time."""
    some = LabelTable.first(np.zeros((1, 1), dtype=np.int32)).rows([0] * 1000)
    for row in range(1000):
        some.free[row] = row
    assert len(some.undominated()) == 1
    looks = Looks(0)
    assert len(some.undominated(looks)) == 1000
    assert looks.done == 1


@pytest.mark.parametrize("seed", range(20))
def test_who_does_what_is_bounded_by_the_best_deal(seed, monkeypatch):
    """All deals of a few tasks, and who may do one as well, tell the same."""
    rng = random.Random(seed)
    robots, tasks = rng.choice([(1, 4), (2, 5), (3, 4)])
    costs = [
        {
            robot: TaskShare(*(rng.randint(0, 30) for _ in range(3)))
            for robot in rng.sample(range(robots), rng.randint(1, robots))
        }
        for _ in range(tasks)
    ]

    def end(robot, mine):
        own = [costs[task][robot] for task in mine]
        least = min((s.start for s in own), default=0) + min((s.back for s in own), default=0)
        return sum(s.base for s in own) + least

    some = [subset(t for t in range(tasks) if robot in costs[t]) for robot in range(robots)]
    ends = {
        max(end(robot, mine) for robot, mine in enumerate(deal))
        for deal in itertools.product(*some)
        if set(range(tasks)) <= set().union(*deal)
    }
    least = max(min(s.least for s in mine.values()) for mine in costs)
    monkeypatch.setattr(workload, "shares", lambda _: costs)
    assert bound_by_assignment(None, 0) == max(least, min(ends))


def subset(tasks):
    tasks = list(tasks)
    return [c for k in range(len(tasks) + 1) for c in itertools.combinations(tasks, k)]
