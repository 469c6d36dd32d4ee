"""First schedules of routed problems in any listing: there is one where one is possible, and it
ends hardly later than the shortest, whether sequences of tasks say all that matters or not (who
makes way, what is carried, what is odd about a route).
"""

import random

import pytest

from tests.scheduling.cpsat import sites, styles, writer
from tests.scheduling.cpsat.carriers import carriers
from tests.scheduling.cpsat.odd_routes import odd_routes
from tests.scheduling.cpsat.random_routes import random_routes
from tests.scheduling.cpsat.routing.test_tours import RandomShop
from tests.shuffled import shuffled
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession

ALLOWED = 1.1
"""How many times as long as the shortest a first schedule may be."""


def small_site(seed):
    style = random.Random(f"style {seed}").choice([*styles.TIGHT, *styles.LOOSE])
    return writer.write(sites.small(seed), style)


SORTS = {
    "sites": small_site,
    "routes": random_routes,
    "carriers": carriers,
    "odd": odd_routes,
    "shops": lambda seed: RandomShop(seed).problem,
}


def lengths(problem):
    """Return how long the first schedule is, and the shortest (``None``: there is none)."""
    for optimal in (False, True):
        report = CpsatSession(problem, seed=0, workers=1).solve(Deadline.after(20), optimal=optimal)
        yield None if report.schedule is None else report.schedule.makespan


def poor(sort, seeds):
    found = {}
    for seed in seeds:
        first, shortest = lengths(shuffled(SORTS[sort](seed), seed).problem)
        good = (
            first == shortest if shortest is None or first is None else first <= ALLOWED * shortest
        )
        if not good:
            found[seed] = first, shortest
    return found


@pytest.mark.parametrize("sort", SORTS)
def test_first_schedules_are_short_in_any_listing(sort):
    assert poor(sort, [3, 6, 9]) == {}


@pytest.mark.long
@pytest.mark.parametrize("sort", SORTS)
def test_many_first_schedules_are_short_in_any_listing(sort):
    found = poor(sort, range(10, 40))
    assert len(found) <= 3, found
