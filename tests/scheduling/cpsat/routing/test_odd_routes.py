"""Routes of which a part is no route, or written in rarer ways: found, and no answer is changed."""

import itertools

import pytest
from unified_planning.model import TimePointInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    LE,
    Equals,
    GlobalStartTiming,
    Implies,
    MinimizeMakespan,
    Not,
    Or,
    UserType,
)

from tests.scheduling.cpsat.odd_routes import odd_routes
from tests.scheduling.cpsat.sites import small
from tests.scheduling.cpsat.styles import Style
from tests.scheduling.cpsat.truth import answer, bound_without_search
from tests.scheduling.cpsat.writer import write
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes

SPOTS = (0, 7, 13, 20, 26)


def disagreement(seed):
    """Return (what differs on the problem of ``seed``, whether it has odd routes)."""
    problem = odd_routes(seed)
    odd = any(route.odd for route in find_routes(ScheduleModel(problem)))
    return disagreement_of(problem), odd


def disagreement_of(problem):
    truth = answer(problem, plain=True)
    found = answer(problem)
    if truth is None or found is None:
        return None
    if found != truth:
        return f"{found}, but in truth {truth}"
    quick = bound_without_search(problem)
    if quick is not None and truth[1] is not None and quick > truth[1]:
        return f"bound by work {quick} above {truth[1]}"
    return None


def check(seeds):
    found = {seed: disagreement(seed) for seed in seeds}
    assert not {seed: wrong for seed, (wrong, _) in found.items() if wrong}
    assert sum(odd for _, odd in found.values()) > len(seeds) // 4


def test_routes_with_odd_parts():
    check(range(6))


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_many_routes_with_odd_parts(block):
    check(range(1000 + 150 * block, 1150 + 150 * block))


def test_a_task_at_a_place_without_roads_is_bounded():
    style = Style(lasts="bounds", fluents="parameter", moves="leave", way="road")
    assert disagreement_of(write(small(342), style)) is None


# -- one depot in styles of its own ------------------------------------------------------------
def start_of(a):
    return TimePointInterval(Timing(0, a.start))


class Depot:
    """Two robots on a line and three tasks; ``moves`` says how a robot's moves are written."""

    def __init__(self, moves):
        self.p = SchedulingProblem("depot")
        self.kind = UserType("spot")
        self.spots = [self.p.add_object(f"p{i}", self.kind) for i in range(len(SPOTS))]
        start = self.spots[0]
        self.at = [self.p.add_fluent(f"at{r}", self.kind, default_initial_value=start)()
                   for r in range(2)]  # fmt: skip
        self.busy = [[], []]
        for r in range(2):
            moves(self, r)
        for t in range(3):
            self._task(t)
        for some in self.busy:
            for a, b in itertools.combinations(some, 2):
                apart = Or(LE(a.end, b.start), LE(b.end, a.start))
                self.p.add_constraint(apart, [a.present, b.present])
        self.p.add_quality_metric(MinimizeMakespan())

    def _task(self, t):
        ways = []
        for r in range(2):
            a = self.add(r, f"task{t}_{r}", 3 + t)
            a.add_condition(start_of(a), Equals(self.at[r], self.spots[1 + t]))
            ways.append(a)
        self.p.add_constraint(Or([a.present for a in ways]))
        self.p.add_constraint(Or([Not(a.present) for a in ways]))

    def add(self, r, name, length):
        a = self.p.add_activity(name, length, optional=True)
        self.busy[r].append(a)
        return a

    def roads(self):
        for i, j in itertools.permutations(range(len(SPOTS)), 2):
            yield i, j, abs(SPOTS[i] - SPOTS[j])

    def plain(self, r, name="drive"):
        for i, j, length in self.roads():
            a = self.add(r, f"{name}{i}{j}_{r}", length)
            a.add_condition(start_of(a), Equals(self.at[r], self.spots[i]))
            a.add_effect(Timing(-1, a.end), self.at[r], self.spots[j])


def by_target(d, r):
    """From each place some activities with the goal as a parameter."""
    for i in range(len(SPOTS)):
        for copy in range(2):
            a = d.add(r, f"leave{i}_{copy}_{r}", 1)
            a.set_duration_bounds(1, 40)
            to = a.add_parameter("to", d.kind)
            a.add_condition(start_of(a), Equals(d.at[r], d.spots[i]))
            a.add_effect(Timing(-1, a.end), d.at[r], to)
            for here, j, length in d.roads():
                if here == i:
                    a.add_constraint(Implies(Equals(to, d.spots[j]), GE(a.end, a.start + length)))


def by_origin_and_target(d, r):
    """Activities that go from anywhere to anywhere, with a table of lengths."""
    for copy in range(4):
        a = d.add(r, f"go{copy}_{r}", 1)
        a.set_duration_bounds(1, 40)
        source, to = a.add_parameter("source", d.kind), a.add_parameter("to", d.kind)
        a.add_condition(start_of(a), Equals(d.at[r], source))
        a.add_effect(Timing(-1, a.end), d.at[r], to)
        for i, j, length in d.roads():
            other = Or(Not(Equals(source, d.spots[i])), Not(Equals(to, d.spots[j])))
            d.p.add_constraint(Or(other, GE(a.end, a.start + length)), [a.present])


def on_the_road(d, r):
    """While it drives, a robot is on the road."""
    road = d.p.add_object(f"road{r}", d.kind)
    d.plain(r)
    for a in d.busy[r]:
        a.add_effect(a.start, d.at[r], road)


def known_at_start(d, r):
    """Who leaves is known to come; how long that takes is not fixed."""
    for i, j, length in d.roads():
        a = d.add(r, f"drive{i}{j}_{r}", 1)
        a.set_duration_bounds(length, length + 3)
        a.add_condition(start_of(a), Equals(d.at[r], d.spots[i]))
        a.add_effect(a.start, d.at[r], d.spots[j])


def with_a_crane(d, r):
    d.plain(r)
    a = d.p.add_activity(f"crane{r}", 30, optional=True)
    a.add_effect(a.end, d.at[r], d.spots[4])


def with_a_stop_on_the_way(d, r):
    d.plain(r)
    a = d.add(r, f"round{r}", 30)
    a.add_condition(start_of(a), Equals(d.at[r], d.spots[0]))
    a.add_effect(a.start + 4, d.at[r], d.spots[1])
    a.add_effect(a.end, d.at[r], d.spots[2])


def set_by_the_problem(d, r):
    d.plain(r)
    d.p.add_effect(GlobalStartTiming(40), d.at[r], d.spots[4])


def with_a_loose_move(d, r):
    """One move is not kept apart from the others."""
    d.plain(r)
    d.busy[r].pop()


@pytest.mark.parametrize(
    "how",
    [
        Depot.plain,
        by_target,
        by_origin_and_target,
        on_the_road,
        known_at_start,
        with_a_crane,
        with_a_stop_on_the_way,
        set_by_the_problem,
        with_a_loose_move,
    ],
    ids=lambda how: how.__name__,
)
def test_routes_are_found_however_moves_are_written(how):
    problem = Depot(how).p
    routes = find_routes(ScheduleModel(problem))
    assert [len(route.stops) for route in routes] == [3, 3]
    assert all(route.between({0}, {3}) == 20 or route.free for route in routes)
    report = CpsatSession(problem, workers=1, effort=2.0).solve(Deadline.after(60))
    assert report.status is ScheduleStatus.OPTIMAL
    assert report.schedule.makespan == 25
