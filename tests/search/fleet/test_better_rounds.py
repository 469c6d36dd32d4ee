"""Better tours by changes: kept if everybody is done as soon, the same for equal seeds."""

import itertools
import random
from dataclasses import replace

import pytest

from tests.search.fleet.test_whole_tours import opened
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.model import Deadline
from up_samp.search.fleet import improve
from up_samp.search.fleet.improve import FleetLNS, other_ways, plan_tours
from up_samp.search.fleet.tours import Priorities
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
def no_other_shares(monkeypatch):
    """Change tours at once, and look for other ways where little time is lost, too."""
    monkeypatch.setattr(improve, "AGAIN_DEALT", 0)
    monkeypatch.setattr(improve, "DELAYED", 1.0)


@pytest.fixture(params=[name.__name__ for name, _ in improve.MOVES])
def one_move(request, monkeypatch):
    """Leave one move only."""
    move = getattr(improve, request.param)
    monkeypatch.setattr(improve, "MOVES", ((move, 1.0),))
    return move


def test_tours_get_better_and_each_change_is_a_plan():
    problem, found, build, dealt = first_tours((4, 8), seed=1)
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


def test_tours_decided_in_the_same_turns_are_the_same():
    """From any moment on; and what one change leaves behind does not show in the next one."""
    _, found, _, dealt = first_tours((4, 8), seed=1)
    better, tours = search_of(found, dealt), found[0]
    heads = [piece[0] for robot in tours.robots for piece in tours.pieces(robot)]
    moments = sorted(found[1].turns[head] for head in heads)
    for moment in (moments[-1], moments[len(moments) // 2], moments[0]):
        kept = better.since(tours.robots, moment)
        assert tours.adopt(found[1], kept)
        assert len(tours._waiting) == sum(len(tours._chains[r]) - kept[r] for r in tours.robots) > 0
        turns = Priorities(turns=found[1].turns)
        assert tours.decide_in_turns(turns, Deadline.never()) is None
        assert tours.decided().ends() == found[1].ends()


def test_the_next_one_comes_when_the_former_has_left(toured):
    _, found, _, _ = toured
    gaps = found[0].changeovers(found[1])
    assert 0.0 < gaps[0] <= gaps[-1] < 15.0
    assert gaps == sorted(gaps)
    for robot in found[0].robots:
        pieces = found[0].pieces(robot)
        assert [name for piece in pieces for name in piece] == found[0]._chains[robot]
        assert robot not in found[0].sharing(robot)


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


def test_the_last_end_hangs_on_who_was_at_a_place_before(toured):
    _, found, _, _ = toured
    tours, decided = found[0], found[1]
    critical, ends = tours.critical(decided), decided.ends()
    assert ends[tours.robot_of(critical[0])] == max(ends.values())
    assert critical[-1] in {tours._chains[robot][0] for robot in tours.robots}
    for name, before in itertools.pairwise(critical):
        chain = tours._chains[tours.robot_of(name)]
        same = before in chain and chain.index(before) == chain.index(name) - 1
        assert same or tours._motions[before].poses[-1] == tours._motions[name].poses[-1]
        assert decided.pins[before][1] <= decided.pins[name][1]


def test_a_round_is_given_up_once_somebody_is_too_late():
    _, found, _, _ = first_tours((3, 6))
    tours, makespan = found[0], found[1].lean().makespan
    tours.reset()
    late = tours.decide_in_turns(Priorities(latest=makespan // 2), Deadline.never())
    assert late in tours.robots
    # others had not been decided by then
    assert tours._waiting
    tours.reset()
    assert tours.decide_in_turns(Priorities(), Deadline.never()) is None


def test_what_takes_longer_than_alone_looks_for_other_ways(toured):
    _, found, _, dealt = toured
    delays = {r: found[0].delays(found[1], r) for r in found[0].robots}
    assert all(delay > -1.0 for some in delays.values() for delay in some.values())
    assert max(delay for some in delays.values() for delay in some.values()) > 1.0
    last = max(found[1].ends(), key=found[1].ends().get)
    better = search_of(found, dealt)
    asked = []
    better.anew = lambda kept, given, deadline: asked.append(given)
    for _ in range(10):
        other_ways(better, Deadline.never())
    looking = {name for given in asked for name in given.looking}
    told = {name for some in delays.values() for name, delay in some.items() if delay > 1.0}
    assert looking
    assert looking <= told
    assert looking & delays[last].keys()
