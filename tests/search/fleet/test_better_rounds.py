"""Better tours by changes: kept if everybody is done as soon, the same for equal seeds."""

import random
from dataclasses import replace
from types import SimpleNamespace

import pytest

from tests.search.fleet.test_whole_tours import opened
from tests.usual import usually
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.model import Deadline
from up_samp.search.fleet import improve, solve
from up_samp.search.fleet.improve import FleetLNS, plan_tours, right_of_way, ways_past
from up_samp.search.fleet.tours import TourPlanner
from up_samp.tuning import Tuning
from up_samp.validation import validate_plan


def first_tours(size, seed=0):
    """Return the first tours of a warehouse, decided in rounds, and what makes plans of them."""
    problem = warehouse(*size, encoding="compact", seed=seed)
    search, itinerary, build, assignment = opened(problem, seed)
    found = plan_tours(search, itinerary, Deadline.never())
    assert found is not None
    return problem, found, build, assignment


@pytest.fixture(scope="module")
def toured():
    """Tours that nobody changes."""
    return first_tours((4, 8), seed=1)


def search_of(found, assignment, *, stale=12, seed=0):
    assignment = replace(assignment, tuning=Tuning(stale=stale))
    rest = lambda *_: None, random.Random(seed)  # no others to do jobs
    return FleetLNS(assignment, *found, *rest)


@pytest.fixture(params=[move.__name__ for move in improve.MOVES])
def one_move(request, monkeypatch):
    """Leave one move only."""
    move = getattr(improve, request.param)
    monkeypatch.setattr(improve, "MOVES", (move,))
    return move


def test_tours_get_better_and_each_change_is_a_plan():
    problem, found, build, assignment = first_tours((4, 8), seed=3)
    better = search_of(found, assignment)
    plans = list(better.improved(lambda: False, Deadline.never()))
    spans = [found[1].lean().makespan, *(plan.lean().makespan for plan in plans)]
    assert len(spans) > 1
    assert spans == sorted(set(spans), reverse=True)
    assert better.cost(better.best) <= better.cost(found[1])
    for plan in (*plans, better.best):
        whole = build(plan.schedule, plan.trajectories())
        assert validate_plan(problem, whole).violations == ()


def test_each_move_brings_plans_that_are_no_worse(one_move):
    problem, found, build, assignment = first_tours((3, 6))
    better = search_of(found, assignment, stale=4)
    for _ in better.improved(lambda: False, Deadline.never()):
        pass
    assert better.cost(better.best) <= better.cost(found[1])
    whole = build(better.best.schedule, better.best.trajectories())
    assert validate_plan(problem, whole).violations == ()


@pytest.mark.parametrize("hoped", usually(0.01, 9.0, of=(0.01, 1.0, 9.0)))
def test_right_of_way_is_decided_whatever_is_hoped_for(monkeypatch, hoped):
    """What cannot be is asked first, then what can: it is as good as without any hope."""
    _, found, _, assignment = first_tours((4, 8), seed=3)
    usual = right_of_way(search_of(found, assignment), Deadline.never())
    limits, decide = [], TourPlanner.coordinated
    monkeypatch.setattr(
        TourPlanner,
        "coordinated",
        lambda self, known, limit, by: limits.append(limit) or decide(self, known, limit, by),
    )
    monkeypatch.setattr(improve, "_HOPED", hoped)
    again = right_of_way(search_of(found, assignment), Deadline.never())
    assert again.lean().makespan == usual.lean().makespan < found[1].lean().makespan
    assert limits == sorted(set(limits))
    assert max(limits) <= found[1].lean().makespan
    assert len(limits) == (1 if hoped == 9.0 else 2)


def test_the_next_one_comes_when_the_former_has_left(toured):
    _, found, _, _ = toured
    gaps = found[0].handovers(found[1])
    assert 0.0 < gaps[0] <= gaps[-1] < 15.0
    assert gaps == sorted(gaps)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_equal_seeds_bring_equal_changes(seed):
    ends = []
    for _ in range(2):
        _, found, _, assignment = first_tours((5, 10), seed)
        better = search_of(found, assignment, stale=30, seed=seed)
        told = [plan.ends() for plan in better.improved(lambda: False, Deadline.never())]
        ends.append([*told, better.best.ends()])
    assert ends[0] == ends[1]


def test_motions_look_for_ways_past_each_other():
    problem, found, build, assignment = first_tours((8, 12), seed=4)
    better, tours = search_of(found, assignment), found[0]

    def known():
        ways = tours.crossings(better.makespan).ways
        return {(name, path) for name, some in ways.items() for path in some}

    better.best = right_of_way(better, Deadline.never())
    first, before = better.best, known()
    again = ways_past(better, Deadline.never())
    assert better.looked is first
    assert again.lean().makespan < first.lean().makespan
    # of the new ways those are kept that are driven
    driven = {(name, path) for name, (path, _) in again.driven().items()}
    assert known() == before | driven
    assert driven - before
    whole = build(again.schedule, again.trajectories())
    assert validate_plan(problem, whole).violations == ()
    # the same tours are looked at once
    assert ways_past(better, Deadline.never()) is None


def test_the_search_goes_on_from_tours_that_are_plans(toured, monkeypatch):
    problem, found, _, assignment = toured
    search, *_ = opened(problem, 1)
    better = search_of(found, assignment)
    shorter = [replace(found[1], needless=frozenset([name])) for name in list(found[1].runs)[:3]]

    def improved(*_, **__):
        for tours in shorter:
            assert better.best is found[1]
            better.best = tours
            yield tours

    refused = []
    monkeypatch.setattr(better, "improved", improved)
    monkeypatch.setattr(solve, "plan_of_tours", lambda _, tours: refused.append(tours))
    large = SimpleNamespace(part=lambda deadline, name: deadline.share(0.6))
    assert list(solve.improve(search, large, better)) == []
    assert refused == shorter
    assert better.best is found[1]
