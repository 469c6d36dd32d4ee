"""Bounds by sequences of tasks, where doors hold still while others move."""

import itertools
import random
from unittest import mock

import pytest
from unified_planning.model import ClosedTimeInterval, RightOpenTimeInterval, Timing
from unified_planning.shortcuts import Equals, IntType, Not, UserType

from tests.scheduling.cpsat.sites import Site, Task, shop
from tests.scheduling.cpsat.styles import Style
from tests.scheduling.cpsat.truth import bound_without_search
from tests.scheduling.cpsat.writer import Writer
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work
from up_samp.scheduling.cpsat.routing.list_scheduling import decode, steps_of, times_of
from up_samp.scheduling.cpsat.routing.sequences import Sequences, raised
from up_samp.scheduling.cpsat.routing.workload import WorkBound, bound_by_work
from up_samp.scheduling.cpsat.solve import strategy
from up_samp.tuning import Tuning
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule

STILL = [
    lambda m: RightOpenTimeInterval(Timing(0, m.start), Timing(-1, m.end)),
    lambda m: ClosedTimeInterval(Timing(1, m.start), Timing(0, m.end)),
    lambda m: ClosedTimeInterval(Timing(2, m.start), Timing(-1, m.end)),
]


class Still(Writer):
    """Writes a site in which nobody moves while a door moves. ``narrow``: where nobody is at first,
    there is room for one.
    """

    def __init__(self, site, style, span, narrow=False):
        self.span = STILL[span]
        self.narrow = narrow
        super().__init__(site, style)

    def _doors(self):
        places = [p for p in self.site.places if self.narrow and p not in self.site.starts]
        self.room = {
            p: self.problem.add_fluent(f"room{p}", IntType(0, 1), default_initial_value=1)
            for p in places
        }
        leaf = UserType("leaf")
        self.closed, self.ajar = (self.problem.add_object(n, leaf) for n in ("closed", "ajar"))
        return {
            p: self.problem.add_fluent(f"door{p}", leaf, default_initial_value=self.closed)
            for p in self.site.doors
        }

    def _road(self, r, a, b, length):
        m = self.problem.add_activity(f"move{a}to{b}by{r}", length, optional=True)
        if self.style.lasts == "bounds":
            m.set_duration_bounds(length, length + 7)
        for door in self.open.values():
            m.add_condition(self.span(m), Equals(door(), door()))
        if b in self.open:
            m.add_condition(self.span(m), Not(Equals(self.open[b](), self.closed)))
        if b in self.room:
            m.add_decrease_effect(m.end, self.room[b](), 1)
        if a in self.room:
            m.add_increase_effect(m.start, self.room[a](), 1)
        return m

    def _opening(self, r, p):
        a = self.problem.add_activity(f"open{p}by{r}", 1, optional=True)
        delay = 0 if self.style.arrive == "end" else -1
        a.add_effect(Timing(delay, a.end), self.open[p](), self.ajar)
        return a


def gated(seed):
    """Return (a small random site with doors, a style, how long doors hold still, whether places
    hold one).
    """
    rng = random.Random(seed)
    places = range(rng.choice([3, 4, 4]))
    robots = rng.choice([1, 2, 2, 2, 3])
    roads = {p: rng.randint(1, 6) for p in itertools.permutations(places, 2)}
    for pair in rng.sample(sorted(roads), rng.choice([0, 0, 1, 3])):
        del roads[pair]
    tasks = [
        Task(
            tuple(rng.sample(list(places), rng.choice([1, 1, 1, 2]))),
            rng.randint(1, 4),
            rng.choice([None, 0, 1]),
            (rng.randrange(t),) if t and rng.random() < 0.5 else (),
        )
        for t in range(rng.choice([2, 3, 4]))
    ]
    doors = {
        place: rng.choice([p for p in places if p != place])
        for place in rng.sample(list(places), rng.choice([1, 1, 2]))
    }
    starts = tuple(rng.choice([p for p in places if p not in doors]) for _ in range(robots))
    site = Site(starts, roads, tuple(tasks), doors, home=rng.random() < 0.2)
    style = Style(
        arrive=rng.choice(["end", "end - 1", "end - 1"]),
        lasts=rng.choice(["fixed", "bounds"]),
        alone=rng.choice(["after", "strictly", "uses"]),
    )
    span = rng.randrange(len(STILL))
    return site, style, span, rng.random() < 0.5


def gates(seeds):
    return ((seed, Still(*gated(seed)).problem) for seed in seeds)


def no_bound(_work, known, *_, **__):
    return WorkBound(known)


def optimum(problem):
    """Return the makespan that CP-SAT proves without bounds by work (None: there is none)."""
    with mock.patch.object(strategy, "bound_by_work", no_bound):
        report = CpsatSession(problem, workers=1).solve(Deadline.after(120))
    if report.status is ScheduleStatus.INFEASIBLE:
        return None
    assert report.status is ScheduleStatus.OPTIMAL
    return report.schedule.makespan


def compare(problems):
    """Assert that no bound of problems, each with its seed, is above the optimum; return for how
    many it is the optimum, of how many.
    """
    met = count = 0
    for seed, problem in problems:
        bound, best = bound_without_search(problem), optimum(problem)
        if best is not None and bound is not None:
            assert bound <= best, f"seed {seed}: bound {bound}, but {best} is possible"
            count, met = count + 1, met + (bound == best)
    return met, count


def test_no_bound_is_above_the_optimum():
    met, count = compare(gates(range(7)))
    assert count > 4
    assert met >= 0.6 * count


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_many_bounds_are_not_above_the_optimum(block):
    compare(gates(range(1000 + 100 * block, 1100 + 100 * block)))


def crossing(tasks):
    """A button 5 from the start, its room next to it, and another place 8 from the start."""
    roads = {(0, 1): 5, (1, 2): 2, (0, 3): 8, (0, 2): 7, (1, 3): 13, (3, 1): 13, (3, 2): 15}
    return Site((0, 0), roads, tuple(Task((p,), 1) for p in tasks), {2: 1})


def test_a_door_opens_when_nobody_is_on_the_way():
    """Where one goes to the button and the other elsewhere, the door waits until that one has
    come; it opens at the start of what opens it, which may be the last unit of a move.
    """
    alone = Still(crossing([2]), Style(), 0).problem
    assert bound_without_search(alone) == 5 + 1 + 2 + 1 == optimum(alone)
    both = Still(crossing([2, 3]), Style(), 0).problem
    assert bound_without_search(both) == 7 + 1 + 2 + 1 == optimum(both)


def test_a_shop_with_doors_is_bounded_by_its_optimum():
    """The bound is met without search; robots' moves and doors are in each other's way."""
    problem = Still(shop(2, 2, 2, seed=3), Style(), 0).problem
    assert bound_without_search(problem) == optimum(problem)


def test_what_needs_too_much_effort_is_not_proven():
    problem = Still(shop(2, 2, 2, seed=3), Style(), 0).problem
    model = ScheduleModel(problem)
    work = find_work(model, find_routes(model))
    none, few, many = (bound_by_work(work, tuning=Tuning(labels=n)).value for n in (0, 10, 10**6))
    assert none < few < many


def test_what_a_bound_is_met_by_is_tried_as_a_schedule():
    """One robot's best tour is found with the bound, without CP-SAT's search."""
    problem = Still(shop(1, 3, 3, seed=1), Style(), 0).problem
    model = ScheduleModel(problem)
    work = find_work(model, find_routes(model))
    found = bound_by_work(work)
    path = found.sequences.found[0]
    assert decode(work, steps_of(work, found.sequences, path)).schedule.makespan == found.value
    assert times_of(model, work, found.sequences, path).makespan == found.value
    report = CpsatSession(problem, workers=1, effort=0.2).solve(Deadline.after(60))
    assert (report.status, report.bound) == (ScheduleStatus.OPTIMAL, found.value)


def test_sequences_among_few_beginnings_become_schedules():
    """The best beginnings lead to a schedule that ends when the bound says, and to none before."""
    for seed in range(3):
        problem = Still(shop(2, 2, 2, seed=seed), Style(), 0, narrow=True).problem
        model = ScheduleModel(problem)
        work = find_work(model, find_routes(model))
        bound = bound_by_work(work)
        some = Sequences(bound.sequences.rules, 10**6)
        assert not some.sought(bound.value - 1, 100, Deadline.never())
        assert some.sought(bound.value + 3, 100, Deadline.never())
        schedule = times_of(model, work, some, some.found[0])
        assert bound.value <= schedule.makespan <= bound.value + 3
        assert not validate_schedule(problem, build_schedule(problem, schedule)).violations


def test_a_known_schedule_ends_the_search_for_a_bound():
    problem = Still(shop(2, 2, 2, seed=3), Style(), 0).problem
    model = ScheduleModel(problem)
    work = find_work(model, find_routes(model))
    best = bound_by_work(work).value
    found = bound_by_work(work, value=best)
    assert found.value == best
    assert not found.sequences.found
    assert bound_by_work(work, value=best - 3).value == best - 3


def test_what_is_found_can_be_travelled():
    problem = Still(shop(3, 2, 2, seed=2), Style(), 0, narrow=True).problem
    model = ScheduleModel(problem)
    found = bound_by_work(find_work(model, find_routes(model)))
    some = Sequences(found.sequences.rules, 10**6)
    assert some.refuted(found.value - 1, Deadline.never())
    assert not some.refuted(found.value + 2, Deadline.never())
    for path in some.found:
        assert can_be_travelled(some.rules, path)


def can_be_travelled(rules, path):
    """Return whether everybody has the time to come to what it does next."""
    for axis, ways in enumerate(rules.ways):
        here, free = ways.number[ways.route.initial], 0
        for number, start in path:
            choice = rules.choices[number]
            if choice.traveller == axis:
                moves = here != choice.place
                if start < free + ways.travel[here, choice.place] - moves * choice.late:
                    return False
                here, free = choice.place, start + rules.lengths[number] + rules.gaps[axis]
    return sorted(rules.choices[n].task for n, _ in path) == list(range(len(path)))


def test_leaps_end_where_steps_of_one_do():
    """However far a proof leaps ahead, the bound is the first end that is not refuted."""
    sites = [Still(*gated(seed)) for seed in range(2000, 2008)]
    for still in (*sites, Still(shop(2, 2, 2, seed=1), Style(), 0, narrow=True)):
        model = ScheduleModel(still.problem)
        rules = bound_by_work(find_work(model, find_routes(model))).sequences.rules
        found = raised(Sequences(rules, 10**6), 0, Deadline.never())
        one_by_one = Sequences(rules, 10**6)
        assert one_by_one.refuted(found - 1, Deadline.never())
        assert not one_by_one.refuted(found, Deadline.never())
        assert one_by_one.end() == found
