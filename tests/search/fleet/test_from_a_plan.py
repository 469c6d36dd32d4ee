"""Large fleets from a plan: it is kept as it is driven, mended where something has changed, and the
search for a better one goes on from it.
"""

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.search.fleet.test_carrying import fleet as carrying
from tests.search.fleet.test_doors_beside import halls
from tests.search.fleet.test_drives_home import homely, site
from tests.shuffled import shuffled
from tests.usual import usually
from up_samp import Fleet
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.io.plan_dict import plan_to_dict
from up_samp.io.restore import plan_from_dict
from up_samp.search.fleet import improve
from up_samp.validation import validate_plan

LARGE = {"tuning": {"large": 1}}
FIRST = {**LARGE, "first_plan": True}


def solved(problem, start=None, **params):
    """Return a valid plan, as read from a file, and its makespan."""
    get_environment().credits_stream = None
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=300, warm_start_plan=start)
    assert validate_plan(problem, result.plan).violations == ()
    assert result.metrics["rounds"] == "0"  # of the usual search
    told = plan_to_dict(problem, result.plan, seconds_per_unit=1.0)
    return plan_from_dict(problem, told), int(result.metrics["makespan"])


def names(plan):
    return {activity.name for activity in plan.activities}


@pytest.fixture
def rounds(monkeypatch):
    """How often tours are decided in rounds."""
    calls, real = [], improve.squeaky_wheel
    monkeypatch.setattr(improve, "squeaky_wheel", lambda *given: calls.append(0) or real(*given))
    return calls


DRAWN = {
    "one station": lambda _: site(0),
    **{f"warehouse {seed}": lambda _, seed=seed: homely(seed)[0] for seed in range(6)},
    "doors": lambda at: halls(at, 1, battery=False, opened_from="button").problem,
    "doors and batteries": lambda at: halls(at, 2, battery=True, opened_from="button").problem,
    "one load": lambda _: carrying().problem,
}


@pytest.mark.parametrize("name", usually("one load", "warehouse 0", of=DRAWN))
def test_a_plan_that_holds_is_kept_as_it_is_driven(name, tmp_path, rounds):
    """All of it listed in any order."""
    problem = shuffled(DRAWN[name](tmp_path), 3, rename=False).problem
    plan, makespan = solved(problem, **FIRST)
    assert len(rounds) == 1
    again, same = solved(problem, plan, **LARGE, seed=5)
    assert len(rounds) == 1
    assert (names(again), same) == (names(plan), makespan)


def test_tours_of_several_loads_at_once_may_be_decided_anew(tmp_path):
    problem = carrying(capacity={"item": 2}).problem
    plan, makespan = solved(problem, **FIRST)
    assert solved(problem, plan, **LARGE)[1] <= 1.2 * makespan


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_a_better_plan_is_sought_from_there(seed):
    """By counted work: what ends the search is no clock."""
    problem = warehouse(3, 5, encoding="compact", seed=seed)
    problem = shuffled(problem, seed, rename=False).problem
    plan, makespan = solved(problem, **FIRST, seed=seed)
    tuning = {**LARGE["tuning"], "exchanges": 30}
    more = {"tuning": tuning, "optimal": True, "reproducible": True, "runtime": 1.0}
    found = [solved(problem, plan, **more, seed=7) for _ in range(2)]
    assert found[0][1] == found[1][1] <= makespan
    assert names(found[0][0]) == names(found[1][0])


@pytest.mark.parametrize(("orders", "moved"), [(4, 0.0), (3, 0.5)], ids=["an order", "a place"])
def test_what_has_changed_is_dealt_out_and_decided_anew(orders, moved, rounds):
    def problem(orders, moved):
        fleet = Fleet("examples/maps/two_rooms.yaml")
        fleet.add_robot_type("amr", (0.8, 0.6), model="omni")
        for k, (x, y) in enumerate([(3, 3), (3, 8), (3, 11), (12, 3), (12, 8), (12, 11 - moved)]):
            fleet.add_place(f"p{k}", x, y)
        for k in range(2):
            fleet.add_robot(f"r{k}", "amr", start=f"p{k}", end=f"p{k}")
        for k in range(orders):
            fleet.add_order(f"o{k}", f"p{2 + k % 3}", f"p{5 - k % 2}")
        return fleet.problem

    plan, _ = solved(problem(3, 0.0), **FIRST)
    again, _ = solved(problem(orders, moved), plan, **LARGE)
    assert len(rounds) == 2
    assert {name for name in names(plan) if "pick" in name} <= names(again)
