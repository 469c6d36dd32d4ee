"""Listing is not meaning: in whatever order a problem is written, answers and bounds are those that
all orders of visits, looked at one by one, tell.
"""

import pytest

from tests.scheduling.cpsat.fleets import Fleet, optimum, random_fleet, write_fleet
from tests.scheduling.cpsat.truth import answer, bound_without_search
from up_samp.model import ScheduleStatus

TWO = Fleet((0, 30), (6, 21), (2, 2), ((0, 1), (0, 1)), home=True)
THREE = Fleet((0, 30, 60), (6, 21, 36, 51), (2, 3, 2, 3), ((0, 1, 2),) * 4, alone="uses")


def wrong_bounds(seed, *, listings=1, **size):
    """Return the bounds of a fleet that are greater than its optimum."""
    fleet = random_fleet(seed, **size)
    best = optimum(fleet)
    bounds = {k: bound_without_search(write_fleet(fleet, seed + k)) for k in range(listings)}
    return {k: (bound, best) for k, bound in bounds.items() if bound is not None and bound > best}


def wrong_answer(seed, **size):
    """Return (answer, optimum) where they do not agree."""
    fleet = random_fleet(seed, **size)
    best, problem = optimum(fleet), write_fleet(fleet, seed)
    told = answer(problem)
    return None if told in (None, (ScheduleStatus.OPTIMAL, best)) else (told, best)


@pytest.mark.parametrize("fleet", [TWO, THREE], ids=["two", "three"])
@pytest.mark.parametrize("listing", range(4))
def test_who_makes_a_visit_is_listed_in_any_order(fleet, listing):
    told = answer(write_fleet(fleet, listing))
    assert told == (ScheduleStatus.OPTIMAL, optimum(fleet))


def test_bounds_hold_in_any_listing():
    found = {seed: wrong_bounds(seed, robots=2, visits=2, listings=2) for seed in range(30)}
    found |= {seed: wrong_bounds(seed, robots=3, visits=3) for seed in range(150, 156)}
    assert not {seed: wrong for seed, wrong in found.items() if wrong}


def test_answers_hold_in_any_listing():
    found = {seed: wrong_answer(seed, robots=2, visits=3) for seed in range(1000, 1008)}
    assert not {seed: wrong for seed, wrong in found.items() if wrong}


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_many_listings(block):
    seeds = range(10_000 + 300 * block, 10_300 + 300 * block)
    bounds = {seed: wrong_bounds(seed, visits=3) for seed in seeds}
    assert not {seed: wrong for seed, wrong in bounds.items() if wrong}
    answers = {seed: wrong_answer(seed) for seed in seeds if seed % 6 == 0}
    assert not {seed: wrong for seed, wrong in answers.items() if wrong}
