"""Few facts of many, and how often a search begins anew."""

import itertools
import math
import random

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from tests.upio.hall import Hall
from up_samp.model import Deadline
from up_samp.scheduling.quirks import known_engines
from up_samp.search.budget import Budget, Restarts
from up_samp.search.proof import Prover, _fewest


@pytest.mark.parametrize("seed", range(30))
def test_the_fewest_are_a_smallest_part_that_still_fails(seed):
    rng = random.Random(seed)
    items = list(range(rng.randint(1, 12)))
    cores = [set(rng.sample(items, rng.randint(1, len(items)))) for _ in range(rng.randint(1, 3))]

    def fails(some):
        return any(core <= set(some) for core in cores)

    kept = _fewest(items, fails)
    assert fails(kept)
    assert not any(fails(part) for part in itertools.combinations(kept, len(kept) - 1))


def test_nothing_is_kept_where_nothing_is_needed():
    assert _fewest([1, 2, 3], lambda some: True) == []


@pytest.mark.parametrize("seed", range(10))
def test_answers_that_time_cut_short_make_it_larger_and_not_wrong(seed):
    rng = random.Random(seed)
    core = {2, 5}
    kept = _fewest(range(8), lambda some: core <= set(some) and rng.random() < 0.5)
    assert core <= set(kept)


class Incomparable:
    """A demand that takes so long to be compared that nobody may do it."""

    def __init__(self, number):
        self.text = f"demand {number}"

    def __eq__(self, other):
        raise AssertionError("compared")

    __hash__ = None


@pytest.mark.parametrize("seed", range(4))
def test_what_facts_run_into_is_found_without_comparing_demands(seed, monkeypatch):
    rng = random.Random(seed)
    asked = [Incomparable(number) for number in range(rng.randint(20, 200))]
    core = {one.text for one in rng.sample(asked, 3)}

    def infeasible(self, facts, lifted, deadline):
        return core.isdisjoint(demand.text for demand in lifted)

    monkeypatch.setattr(Prover, "_infeasible", infeasible)
    prover = Prover(lambda: None, Budget(Deadline.never(), 10.0), 0)
    assert set(prover._met((), asked, len(asked))) == core


def may_restart(*, restarts=0, stale=0, seconds=60.0, limit=None, planned=True):
    deadline = Deadline.after(None if math.isinf(seconds) else seconds)
    budget = Budget(deadline, 10.0)
    return Restarts(limit, done=restarts, stale=stale).may_begin(budget, planned=planned)


def test_a_search_with_time_left_begins_anew_while_that_brings_anything():
    assert may_restart(restarts=100)
    assert not may_restart(restarts=100, stale=8)
    assert may_restart(restarts=100, stale=8, planned=False)
    assert may_restart(restarts=3 - 1, seconds=math.inf)
    assert not may_restart(restarts=3, seconds=math.inf)
    assert may_restart(restarts=4, limit=5)
    assert not may_restart(restarts=5, limit=5)
    assert not may_restart(limit=0)


@pytest.mark.parametrize("engine", [name for name, _, _ in known_engines()])
def test_two_that_end_in_one_place_are_proven_for_engines_that_know_no_places(tmp_path, engine):
    hall = Hall(tmp_path, robots=2)
    for robot in range(2):
        hall.move(f"go{robot}", robot, f"left{robot}", "right0")
    with OneshotPlanner(name=f"samp-refine[{engine}]") as planner:
        result = planner.solve(hall.problem, timeout=60)
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert "right0 holds one object" in result.log_messages[0].message
    assert not result.history.rounds
