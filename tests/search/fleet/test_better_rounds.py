"""Better tours by changes: kept if everybody is done as soon, the same for equal seeds."""

import random
from dataclasses import replace
from types import SimpleNamespace

import pytest

from tests.search.fleet.test_whole_tours import opened
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.model import Deadline
from up_samp.search.fleet import improve, solve
from up_samp.search.fleet.improve import FleetLNS, other_ways, plan_tours
from up_samp.tuning import Tuning
from up_samp.validation import validate_plan


def first_tours(size, seed=0):
    """Return the first tours of a warehouse, decided in rounds, and what makes plans of them."""
    problem = warehouse(*size, encoding="compact", seed=seed)
    search, itinerary, build, dealt = opened(problem, seed)
    found = plan_tours(search, itinerary, Deadline.never())
    assert found is not None
    return problem, found, build, dealt


@pytest.fixture(scope="module")
def toured():
    """Tours that nobody changes."""
    return first_tours((4, 8), seed=1)


def search_of(found, dealt, *, stale=12, seed=0):
    dealt = replace(dealt, tuning=Tuning(stale=stale))
    rest = lambda *_: None, random.Random(seed)  # no others to do jobs
    return FleetLNS(dealt, *found, *rest)


@pytest.fixture(autouse=True)
def other_ways_soon(monkeypatch):
    """Look for other ways where little time is lost, too."""
    monkeypatch.setattr(improve, "DELAYED", 1.0)


@pytest.fixture(params=[name.__name__ for name, _ in improve.MOVES])
def one_move(request, monkeypatch):
    """Leave one move only."""
    move = getattr(improve, request.param)
    monkeypatch.setattr(improve, "MOVES", ((move, 1.0),))
    return move


def test_tours_get_better_and_each_change_is_a_plan():
    problem, found, build, dealt = first_tours((4, 8), seed=3)
    better = search_of(found, dealt)
    plans = list(better.improved(lambda: False, Deadline.never()))
    spans = [found[1].lean().makespan, *(plan.lean().makespan for plan in plans)]
    assert len(spans) > 1
    assert spans == sorted(set(spans), reverse=True)
    assert better.cost(better.best) <= better.cost(found[1])
    for plan in (*plans, better.best):
        whole = build(plan.schedule, plan.trajectories())
        assert validate_plan(problem, whole).violations == ()


def test_each_move_brings_plans_that_are_no_worse(one_move):
    problem, found, build, dealt = first_tours((3, 6))
    better = search_of(found, dealt, stale=4)
    for _ in better.improved(lambda: False, Deadline.never()):
        pass
    assert better.cost(better.best) <= better.cost(found[1])
    whole = build(better.best.schedule, better.best.trajectories())
    assert validate_plan(problem, whole).violations == ()


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
        _, found, _, dealt = first_tours((5, 10), seed)
        better = search_of(found, dealt, stale=30, seed=seed)
        told = [plan.ends() for plan in better.improved(lambda: False, Deadline.never())]
        ends.append([*told, better.best.ends()])
    assert ends[0] == ends[1]


def test_what_takes_longer_than_alone_looks_for_other_ways(toured, monkeypatch):
    _, found, _, dealt = toured
    tours, best = found
    delays = tours.delays(best)
    assert delays.keys() == best.runs.keys() - best.needless
    assert min(delays.values()) > -1.0
    assert max(delays.values()) > 1.0
    asked, look = [], tours.look_for_another_way

    def noted(decided, name):
        assert decided is best
        asked.append(name)
        return look(decided, name)

    monkeypatch.setattr(tours, "look_for_another_way", noted)
    better = search_of(found, dealt)
    while len(asked) < sum(delay > 1.0 for delay in delays.values()):
        before = len(asked)
        other_ways(better, Deadline.never())
        assert len(asked) > before
    # each once, those first that lose most
    assert [delays[n] for n in asked] == sorted(map(delays.get, asked), reverse=True)
    assert len(set(asked)) == len(asked)
    assert other_ways(better, Deadline.never()) is None


def test_the_search_goes_on_from_tours_that_are_plans(toured, monkeypatch):
    problem, found, _, dealt = toured
    search, *_ = opened(problem, 1)
    better = search_of(found, dealt)
    shorter = [replace(found[1], needless=frozenset([name])) for name in list(found[1].runs)[:3]]

    def improved(*_, **__):
        for tours in shorter:
            assert better.best is found[1]
            better.best = tours
            yield tours

    refused = []
    monkeypatch.setattr(better, "improved", improved)
    monkeypatch.setattr(solve, "plan_of_tours", lambda _, tours: refused.append(tours))
    large = SimpleNamespace(nearly_all=lambda share: share)
    assert list(solve.improve(search, large, better)) == []
    assert refused == shorter
    assert better.best is found[1]
