"""What happens on the floor, the rest is planned anew from the old plan on, and carried out."""

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401
from tests.execution.legs import Incident, carried_out
from up_samp.benchmarks import instance
from up_samp.execution import (
    Delays,
    Executor,
    Surprise,
    dependencies_of,
    solve_remaining,
)
from up_samp.execution.floor import draw
from up_samp.io import plan_from_dict, result_to_dict
from up_samp.validation import validate_plan

DELAYS = Delays(slow=0.3)


def solved(name):
    get_environment().credits_stream = None
    problem = instance(name).build()
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        return problem, result_to_dict(problem, planner.solve(problem, timeout=120))


@pytest.fixture(scope="module")
def open_hall():
    return solved("logistics-do-oc-r2-i2")


def check(journey):
    """All was done in the end, nobody met, and the second leg began where the first one ended."""
    (_, first), (since, second) = journey
    assert second.finished
    assert not first.contacts
    assert not second.contacts
    assert first.overruns == second.overruns == 0
    assert since > 0
    ends = {}
    for motion in first.record["motions"]:
        ends[motion["object"]] = motion["samples"][-1][1:]
    starts = {o["name"]: o["initial"] for o in second.record["objects"]}
    for name, pose in ends.items():
        assert starts[name] == pytest.approx(pose, abs=5e-3), name


def done(journey):
    return {a["name"] for _, leg in journey for a in leg.record["activities"]}


def test_late_by_more_than_a_threshold(open_hall):
    problem, plan = open_hall
    plans = []

    def solve(left):
        assert left.hint is not None
        plans.append((left.problem, solve_remaining(left, seconds=120)))
        return plans[-1][1]

    journey = carried_out(problem, plan, Delays(long_stop=30.0), 3, late=2.0, solve=solve)
    check(journey)
    for left, data in plans:
        assert validate_plan(left, plan_from_dict(left, data)).valid
    assert done(journey) >= {a["name"] for a in plan["activities"]}


def test_a_robot_breaks_down_and_others_do_its_work(open_hall):
    problem, plan = open_hall
    journey = carried_out(problem, plan, DELAYS, 1, incident=Incident(3.0, broken_down=("robot1",)))
    check(journey)
    second = {a["name"] for a in journey[1][1].record["activities"]}
    assert second
    assert not [n for n in second if "robot1" in n.split("_")]
    picked = {n.split("_")[2] for n in done(journey) if n.startswith("pick_")}
    assert picked == {"item0", "item1"}


def test_a_task_is_new(open_hall):
    problem, plan = open_hall

    def add(target):
        target.add_activity("sweep", 5)

    told = Surprise(new=[add], same_choices=True)
    journey = carried_out(problem, plan, DELAYS, 2, incident=Incident(20.0, told))
    check(journey)
    assert "sweep" in done(journey)


def test_a_task_is_cancelled(open_hall):
    problem, plan = open_hall
    gone = [a.name for a in problem.activities if a.name.startswith("pick_") and "_item1" in a.name]
    told = Surprise(cancelled=gone)
    journey = carried_out(problem, plan, DELAYS, 2, incident=Incident(2.0, told))
    check(journey)
    assert not done(journey) & set(gone)
    assert [n for n in done(journey) if n.startswith("pick_") and "_item0" in n]


def test_the_rest_waits_for_a_robot_that_is_held_up_for_long(open_hall):
    problem, plan = open_hall
    delays = Delays(long_stop=100)
    graph = dependencies_of(problem, plan)
    luck = draw(delays, graph, 2)
    ((since, seconds),) = [one.halt for one in luck.values() if one.halt]
    told = Incident(since + 1.0, Surprise(same_choices=True))
    journey = carried_out(problem, plan, delays, 2, incident=told)
    check(journey)
    assert journey[1][0] > since + seconds
    assert all(0.0 <= leg.waiting < 1.0 for _, leg in journey)


def test_nobody_is_to_stop_sooner_than_it_can(open_hall):
    """One robot brakes for a stop, the other for the end of its way, on the last centimetres."""
    problem, plan = open_hall
    delays = Delays(long_stop=100)
    luck = draw(delays, dependencies_of(problem, plan), 0)
    (since,) = [one.halt[0] for one in luck.values() if one.halt]
    told = Incident(since + 0.3, Surprise(same_choices=True))
    journey = carried_out(problem, plan, delays, 0, incident=told)
    assert [leg.overruns for _, leg in journey] == [0, 0]


def test_a_leg_in_which_nothing_ends_waits_by_a_share_of_its_time(open_hall):
    problem, plan = open_hall
    told = Incident(0.5, Surprise(same_choices=True))
    journey = carried_out(problem, plan, DELAYS, 1, incident=told)
    legs = [leg for _, leg in journey]
    assert legs[0].makespan == 0.0
    assert all(0.0 <= leg.waiting <= 1.0 for leg in legs)


def test_what_is_solved_anew_can_be_followed_by_itself(open_hall):
    problem, plan = open_hall
    executor = Executor(plan, problem)
    executor.commands(0.0)
    rest = solve_remaining(executor.remaining_problem(Surprise(same_choices=True)))
    assert Executor(rest).commands(0.0)


@pytest.mark.long
def test_a_door_stays_shut():
    """A door that nobody needs stays shut: all is fetched from outside."""
    problem, plan = solved("logistics-dc-all-r2-i2")
    told = Surprise(shut=["door0"])
    journey = carried_out(problem, plan, DELAYS, 2, incident=Incident(1.0, told))
    check(journey)
    assert not [n for n in done(journey) if n.startswith("open_door0")]
