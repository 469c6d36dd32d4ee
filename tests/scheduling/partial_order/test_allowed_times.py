"""Whatever times a plan's partial order allows are those of a valid schedule: by brute force, of
tiny problems of odd things.
"""

from __future__ import annotations

import itertools

import pytest

from tests.oracles import brute_force_schedule as brute
from tests.scheduling.odd_problems import HORIZON, odd_problem, ways
from tests.usual import usually
from up_samp.model import UnsupportedError
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling.compilers.translate import read_plain
from up_samp.scheduling.partial_order import Earliest, Planned, orders_of
from up_samp.scheduling.partial_order.differences import HORIZON as PLANS_END
from up_samp.scheduling.partial_order.differences import ZERO

STILL = Snapshot("nothing moves", (), {}, {}, {}, (), ())
LATER = 2
"""Units beyond ``HORIZON`` that times may be late."""


def keeps(times, differences):
    def at(point):
        if point in (ZERO, PLANS_END):
            return 0 if point == ZERO else max(end for _, end in times.values())
        return times[point[1]][point[0] == "end"]

    return all(at(d.then) >= at(d.first) + d.lag + d.strict for d in differences)


def turned(orders):
    """Yield the differences, and these with one of the orders the other way round."""
    told = [order.difference for order in orders]
    yield told
    for k, order in enumerate(orders):
        if order.instead is not None:
            yield [*told[:k], order.instead, *told[k + 1 :]]


def retimed(problem, plain, times, values):
    """Return how many other times are valid, and allowed, and one that is allowed and not valid."""
    here = {name: span for name, span in times.items() if span is not None}
    try:
        orders = orders_of(Planned(plain, here, values), STILL)
    except UnsupportedError:
        return 0, 0, None
    told = list(turned(orders))
    if not keeps(here, told[0]) or not Earliest(here, told[0]).feasible:
        return 0, 0, f"{here} is not allowed itself"
    judge, right, allowed = brute._Judge(problem), 0, 0
    grid = range(HORIZON + LATER + 1)
    spans = list(itertools.combinations_with_replacement(grid, 2))
    for some in itertools.product(spans, repeat=len(here)):
        other = dict(zip(here, some, strict=True))
        valid = judge.valid(brute.Choice({**times, **other}, values)) is not None
        right += valid
        allowed += keeps(other, told[0])
        if not valid and any(keeps(other, way) for way in told):
            return 0, 0, f"{times} {values} may not become {other}"
    return right, allowed, None


def of_plans(seeds):
    """Return how many other times are valid, and allowed, of all plans; and what is wrong."""
    right, allowed, wrong = 0, 0, {}
    for seed in seeds:
        problem = odd_problem(seed)
        try:
            plain = read_plain(problem, objective=False)
        except UnsupportedError:
            continue
        plans = (w for w in ways(problem, seed) if w[2] and any(w[0].values()))
        for times, values, _ in itertools.islice(plans, 3):
            one, other, why = retimed(problem, plain, times, values)
            right, allowed = right + one, allowed + other
            if why is not None:
                wrong[seed] = why
    return right, allowed, wrong


@pytest.mark.parametrize("seeds", usually(range(80), of=[range(80), range(1000, 3000)]))
def test_whatever_times_are_allowed_are_valid(seeds):
    right, allowed, wrong = of_plans(seeds)
    assert wrong == {}
    assert allowed > 0.7 * right  # of two orders that would both do, one is kept
