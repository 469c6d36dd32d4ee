"""Who has to wait until something is released does so where nobody else has to be."""

import itertools
import random

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.search.fleet.test_carrying import MAP
from tests.usual import usually
from up_samp.fleet import Fleet
from up_samp.scheduling.partial_order import Earliest
from up_samp.scheduling.partial_order.differences import HORIZON, ZERO, Difference
from up_samp.validation import validate_plan


def in_time_slots(seed, robots=6, orders=14):
    """A fleet that brings orders to two docks, each within 30 s of its own, in any listing."""
    rng = random.Random(seed)
    fleet = Fleet(MAP)
    fleet.add_robot_type("agv", (0.5, 0.4), model="omni", v_max=1.5, a_max=0.5)
    places = {"a": (3, 3), "b": (3, 6), "c": (5, 6), "dock0": (8, 3), "dock1": (8, 5)}
    places |= {f"h{k}": (1.0 + 0.9 * k, 1.0) for k in range(robots)}
    for name in rng.sample([*places], len(places)):
        fleet.add_place(name, *places[name])
    for k in rng.sample(range(robots), robots):
        fleet.add_robot(f"r{k}", "agv", f"h{k}")
    for k in rng.sample(range(orders), orders):
        slot = {
            "at": rng.choice(("dock0", "dock1")),
            "service": 2,
            "window": (30 + 10 * k, 60 + 10 * k),
        }
        fleet.add_order(f"o{k}", pickup=rng.choice("abc"), delivery=slot)
    return fleet.problem


@pytest.mark.parametrize("seed", usually(1, of=range(12)))
def test_nobody_keeps_a_dock_until_its_slot_begins(seed):
    """Who came there as soon as it could would keep all others away until then."""
    get_environment().credits_stream = None
    problem, params = in_time_slots(seed), {"first_plan": True, "tuning": {"large": 1}}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=30.0)
    assert result.plan is not None
    assert validate_plan(problem, result.plan).valid


@pytest.mark.parametrize("seed", range(20))
def test_slack_moves_nothing_else(seed):
    rng = random.Random(seed)
    names = [f"a{k}" for k in range(rng.randint(2, 6))]
    points = [(side, name) for name in names for side in ("start", "end")]
    some = [Difference(("start", n), ("end", n), rng.randint(0, 5)) for n in names]
    for one, other in itertools.combinations(points, 2):
        if rng.random() < 0.4:
            some.append(Difference(one, other, rng.randint(0, 6)))
    some += [Difference(ZERO, p, rng.randint(1, 12)) for p in points if rng.random() < 0.3]
    loose = Earliest(names, some)
    latest = {p: loose.times[p] + rng.randint(0, 9) for p in points if rng.random() < 0.2}
    some += [Difference(p, ZERO, -at) for p, at in latest.items()]
    rng.shuffle(some)
    times = Earliest(names, some)
    for name in names:
        end, before, slack = ("end", name), dict(times.times), times.slack(name)
        free = {end, ("start", name), HORIZON}
        for more in (slack, slack + 1):
            state = times.state()
            if not times.raised({end: before[end] + more}):
                assert more > slack  # it would be too late
                continue
            moved = {p for p, at in times.times.items() if at != before[p]} - free
            assert not moved or more > slack
            assert moved or more <= slack or slack == 0  # nothing may hang on it at all
            times.restore(state)
    for point in times.released():
        assert times.times[point] == max(d.lag for d in some if (d.first, d.then) == (ZERO, point))
