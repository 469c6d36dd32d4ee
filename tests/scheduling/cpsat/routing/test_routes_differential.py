"""Routes with unusual side constraints: taking them out changes no answer.

Each random problem is solved with everything that is recognised in it, and constraint by
constraint with nothing recognised; the collapsed problem's optimum must be a lower bound.
"""

import random

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import Not

from tests.scheduling.cpsat.random_routes import random_routes
from tests.scheduling.cpsat.truth import disagreement

FEW = 9
MANY = 1500


def state_some_absent(problem: SchedulingProblem, seed: int) -> None:
    """State of some optional activities that they never happen."""
    r = random.Random(seed + 2 * 10**6)
    optional = [a for a in problem.activities if a.optional]
    for a in r.sample(optional, min(len(optional), r.choice([1, 2, 4]))):
        problem.add_constraint(Not(a.present))


def drawn_wrong(seed, *, absent=False, **drawn):
    """Return what differs on the problem of ``seed``, and whether it has routes."""
    problem = random_routes(seed, **drawn)
    if absent:
        state_some_absent(problem, seed)
    return disagreement(problem)


def check(seeds, **more):
    found = {seed: drawn_wrong(seed, **more) for seed in seeds}
    assert not {seed: wrong for seed, (wrong, _) in found.items() if wrong}
    assert sum(routes for _, routes in found.values()) > len(seeds) // 3


def test_routes_with_side_constraints():
    check(range(FEW))


def test_routes_without_what_never_happens():
    check(range(20_000, 20_000 + FEW // 2), absent=True)


def test_routes_with_batteries():
    check(range(30_000, 30_000 + FEW // 2), batteries=True)


def test_routes_whose_moves_may_touch():
    check(range(40_000, 40_000 + FEW // 3), touching=True)


def test_tasks_that_are_apart_by_other_gaps_for_other_travellers():
    assert drawn_wrong(10_170) == (None, True)


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_many_routes_with_side_constraints(block):
    size = MANY // 10
    check(range(10_000 + block * size, 10_000 + (block + 1) * size))


@pytest.mark.long
@pytest.mark.parametrize("block", range(4))
def test_many_routes_without_what_never_happens(block):
    check(range(21_000 + block * 100, 21_100 + block * 100), absent=True)


@pytest.mark.long
@pytest.mark.parametrize("block", range(6))
def test_many_routes_with_batteries(block):
    check(range(31_000 + block * 100, 31_100 + block * 100), batteries=True)


@pytest.mark.long
@pytest.mark.parametrize("block", range(4))
def test_many_routes_whose_moves_may_touch(block):
    check(range(41_000 + block * 100, 41_100 + block * 100), touching=True)
