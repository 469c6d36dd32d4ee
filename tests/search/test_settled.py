"""What surely rests where: doors that stay open behind who has come through them."""

import random

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from up_samp.benchmarks.instances import instance
from up_samp.search import cuts
from up_samp.search import world as settled


def reached_while_shut(first, ways, shut):
    """Independent judge: all (place, door is open) that may come about, step by step.

    The door opens at any time; a shut way may be begun while the door is shut, and ends when it is
    open only. Returns the places at which somebody may be while the door is shut.
    """
    states, todo = {(first, False)}, [(first, False)]
    while todo:
        place, ajar = todo.pop()
        after = [(place, True)]
        for a, b in ways:
            if a == place:
                after += [(b, True)] + ([] if ajar or (a, b) in shut else [(b, False)])
        for state in after:
            if state not in states:
                states.add(state)
                todo.append(state)
    return {place for place, ajar in states if not ajar}


@pytest.mark.parametrize("seed", range(8))
def test_places_are_sealed_only_if_nobody_comes_there_before_the_door_opens(seed):
    rng = random.Random(seed)
    some = 0
    for _ in range(200):
        places = [f"p{n}" for n in range(rng.randint(2, 7))]
        pairs = [(a, b) for a in places for b in places if a != b and rng.random() < 0.5]
        shut = {pair for pair in pairs if rng.random() < 0.6}
        found = settled.sealed("p0", pairs, shut)
        possible = reached_while_shut("p0", pairs, shut)
        assert found <= set(places) - possible
        # the largest such set: whatever is reached at all, and only while the door is open
        assert {b for _, b in pairs} - possible <= found
        some += bool(found)
    assert some > 20


SLOW_PAST_DOORS = "jobshop-r1-j1-m4"
"""Its best schedule before any motion ends at 117; open doors in the way cost two units."""


def optimum(name, timeout=120):
    problem = instance(name).build("fluents")
    with OneshotPlanner(name="samp-refine[cpsat]", params={"optimal": True}) as planner:
        result = planner.solve(problem, timeout=timeout)
    return result.status, result.metrics


def test_what_an_open_door_costs_is_a_bound_for_who_has_come_through_it():
    status, metrics = optimum(SLOW_PAST_DOORS)
    assert status is Status.SOLVED_OPTIMALLY
    assert int(metrics["makespan"]) == int(metrics["lower_bound"]) == 119
    assert int(metrics["rounds"]) <= 5


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [f"jobshop-r{r}-j{j}-m{m}" for r in (1, 2) for j in (1, 2) for m in (1, 2)]
    + ["logistics-dc-oc-r2-i2", "logistics-dc-all-r2-i2"],
)
def test_optima_are_the_same_with_all_that_a_cut_may_name(name, monkeypatch):
    """With every blocker named, as it was met, cuts are the weakest: the same optimum follows."""
    few = optimum(name)
    monkeypatch.setattr(cuts, "_that_delay", lambda motions, alone, units: dict(alone.places))
    monkeypatch.setattr(cuts, "remaining", lambda places, case, there: dict(places))
    every = optimum(name)
    assert few[0] is every[0] is Status.SOLVED_OPTIMALLY
    assert few[1]["makespan"] == every[1]["makespan"]
