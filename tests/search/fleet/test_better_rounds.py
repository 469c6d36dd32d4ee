"""Rounds with other turns: kept if everybody is done sooner, the same for equal seeds."""

import random

import pytest

from tests.search.fleet.test_whole_tours import opened
from up_samp.benchmarks.warehouse import warehouse
from up_samp.model import Deadline
from up_samp.search.fleet.improve import PriorityLocalSearch, plan_tours
from up_samp.search.fleet.tours import Priorities
from up_samp.search.fleet.tuning import RoundsTuning
from up_samp.validation import validate_plan

STEEP = 6


def first_rounds(size, seed=0):
    """Return the first tours of a warehouse, in rounds, and what makes plans of them."""
    problem = warehouse(*size, encoding="compact", seed=seed)
    search, itinerary, build = opened(problem, seed)
    found = plan_tours(search, itinerary, Deadline.never())
    assert found is not None
    assert found.ahead is not None
    return problem, found, build


def rounds_of(found, *, stale=12, seed=0):
    tuning = RoundsTuning(stale=stale, delayed=1.0)
    return PriorityLocalSearch(
        found.tours, found.decided, found.ahead, tuning, STEEP, random.Random(seed)
    )


def test_rounds_get_better_and_each_is_a_plan():
    problem, found, build = first_rounds((4, 8), seed=1)
    rounds = rounds_of(found)
    plans = list(rounds.improved(lambda: False, Deadline.never()))
    spans = [found.decided.lean().makespan, *(plan.lean().makespan for plan in plans)]
    assert len(spans) > 1
    assert spans == sorted(set(spans), reverse=True)
    assert rounds.best.cost(STEEP) <= found.decided.cost(STEEP)
    for plan in (*plans, rounds.best):
        whole = build(plan.schedule, plan.trajectories())
        assert validate_plan(problem, whole).violations == ()
    # what a round leaves behind does not change the next one
    found.tours.reset()
    again = Priorities(ahead=rounds.ahead)
    assert found.tours.decide_in_turns(again, Deadline.never()) is None
    assert found.tours.decided().ends() == rounds.best.ends()


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_equal_seeds_bring_equal_rounds(seed):
    ends = []
    for _ in range(2):
        _, found, _ = first_rounds((5, 10), seed)
        rounds = rounds_of(found, stale=30, seed=seed)
        told = [plan.ends() for plan in rounds.improved(lambda: False, Deadline.never())]
        ends.append([*told, rounds.best.ends()])
    assert ends[0] == ends[1]


def test_a_round_is_given_up_once_somebody_is_too_late():
    _, found, _ = first_rounds((3, 6))
    tours, makespan = found.tours, found.decided.lean().makespan
    tours.reset()
    late = tours.decide_in_turns(Priorities(latest=makespan // 2), Deadline.never())
    assert late in tours.robots
    # others had not been decided by then
    assert tours._waiting
    tours.reset()
    assert tours.decide_in_turns(Priorities(), Deadline.never()) is None


def test_what_takes_longer_than_alone_is_told_with_by_how_much():
    _, found, _ = first_rounds((4, 8), seed=1)
    delays = {r: found.tours.delays(found.decided, r) for r in found.tours.robots}
    assert all(delay > -1.0 for some in delays.values() for delay in some.values())
    assert max(delay for some in delays.values() for delay in some.values()) > 1.0
    last = max(found.decided.ends(), key=found.decided.ends().get)
    rounds = rounds_of(found)
    looking = {name for _ in range(10) for name in rounds._looking()}
    told = {name for some in delays.values() for name, delay in some.items() if delay > 1.0}
    assert looking
    assert looking <= told
    assert looking & delays[last].keys()
