"""What is due too soon is told at once; what a plan keeps is never told to be too soon."""

import random
import re
import time

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, LE, LT, And, Implies, Not, OneshotPlanner, Or

from tests.metamorphic.motions import ALIKE, OTHERS, write
from tests.metamorphic.sites import FAMILIES
from tests.shuffled import shuffled
from up_samp.benchmarks.instances import instance
from up_samp.model import Deadline
from up_samp.scheduling.cpsat.encode.terms import least
from up_samp.search import loop
from up_samp.search.due import SoonestEnds, due_too_soon
from up_samp.search.params import Parameters
from up_samp.search.search import Wrapped
from up_samp.search.session import open_search

STYLES = [*ALIKE, *OTHERS]
INSTANCES = (
    "logistics-do-oc-r1-i1", "logistics-do-all-r2-i2", "jobshop-r2-j1-m1",
    "kitting-r2-k1-p3-d2", "doors-r2-d1", "warehouse-r2-o3", "warehouse-compact-r2-o3",
)  # fmt: skip


def by_scope(problem, activity: Activity, limit):
    problem.add_constraint(limit, scope=[activity.present] if activity.optional else [])


def by_implication(problem, activity: Activity, limit):
    there = activity.present if activity.optional else True
    problem.add_constraint(Implies(there, limit))


def of_the_activity(problem, activity: Activity, limit):
    activity.add_constraint(limit)


WRITINGS = (by_scope, by_implication, of_the_activity)


def limits(point, units):
    """Return that a time is so many units at most, as one may write it."""
    return LE(point, units), LT(point, units + 1), GE(units, point), LE(point - 2, units - 2)


def plan_of(problem, **params):
    params = {"first_plan": True, "seed": 0, **params}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        return planner.solve(problem, timeout=20.0)


def motions_of(problem):
    wrapped = Wrapped("cpsat", {"workers": 1}, lambda *_: [], lambda *_: [], native=True)
    search = open_search(problem, wrapped, Parameters(), Deadline.after(600.0))
    search.scheduler.close()
    return search.motions


def tell_when(problem, seed):
    """Return how much later than its least duration says each activity of a plan is known to end,
    where everything has to begin and end by when it does in that plan: nothing of it is refuted.
    """
    rng, plan = random.Random(seed), plan_of(problem).plan
    assert plan is not None
    there = {a.name for a in plan.activities}
    activities = [a for a in problem.activities if a.name in there]

    def units(point) -> int:
        return int(plan.get(point).constant_value())

    times = {a.name: (units(a.start), units(a.end)) for a in activities}
    for activity in activities:
        for point, latest in zip((activity.start, activity.end), times[activity.name], strict=True):
            rng.choice(WRITINGS)(problem, activity, rng.choice(limits(point, latest)))
    motions = motions_of(problem)
    told = due_too_soon(problem, motions)
    assert told == [], seed
    soonest, later = SoonestEnds(problem, motions), []
    for name, (start, end) in times.items():
        known = soonest.of(name)
        assert known[0] <= start, (seed, name)
        assert known[1] <= end, (seed, name)
        later.append(known[1] - least(problem.get_activity(name).duration))
    return later


@pytest.mark.parametrize("name", INSTANCES)
def test_what_an_instance_has_a_plan_for_is_not_due_too_soon(name):
    assert max(tell_when(shuffled(instance(name).build(), name).problem, name)) > 0


@pytest.mark.parametrize("family", FAMILIES)
def test_what_a_site_has_a_plan_for_is_not_due_too_soon(family, tmp_path):
    style = random.Random(family).choice(STYLES)
    tell_when(write(FAMILIES[family](0), style, tmp_path), 0)


@pytest.mark.long
@pytest.mark.parametrize("family", FAMILIES)
def test_what_many_sites_have_plans_for_is_not_due_too_soon(family, tmp_path):
    for seed, style in enumerate(STYLES):
        tell_when(write(FAMILIES[family](seed), style, tmp_path), seed)


@pytest.mark.parametrize("writing", WRITINGS)
@pytest.mark.parametrize("sort", range(3))
def test_it_is_told_who_would_come_from_where(writing, sort):
    problem = shuffled(instance("warehouse-compact-r3-o5").build(), sort, rename=False).problem
    motions = motions_of(problem)
    some = [a for a in problem.activities if re.fullmatch(r"unload_robot\d_order2", a.name)]
    soonest = min(SoonestEnds(problem, motions).of(a.name)[1] for a in some)
    for activity in some:
        writing(problem, activity, limits(activity.end, soonest - 1)[sort])
    assert len(due_too_soon(problem, motions)) == len(some) == 3
    result = plan_of(problem)
    assert result.status is Status.UNSOLVABLE_PROVEN
    (message,) = [m.message for m in result.log_messages]
    assert f"due at {soonest - 1}, {soonest} at the soonest: robot" in message
    assert "begins at dock" in message


def test_what_others_have_to_be_present_for_is_not_due_without_them():
    problem = instance("warehouse-compact-r2-o3").build()
    unload, other = map(problem.get_activity, ("unload_robot0_order0", "leave_robot0_order1"))
    problem.add_constraint(LE(unload.end, 1), scope=[unload.present, other.present])
    problem.add_constraint(Implies(And(unload.present, Not(other.present)), LE(unload.end, 1)))
    problem.add_constraint(Or(LE(unload.end, 1), LE(other.end, 1)), scope=[unload.present])
    assert due_too_soon(problem, motions_of(problem)) == []
    problem.add_constraint(Implies(And(unload.present, unload.present), LE(unload.end, 1)))
    assert len(due_too_soon(problem, motions_of(problem))) == 1


def test_a_large_fleet_is_told_in_seconds():
    """Not by way of assignments that cannot be scheduled, and a model of everything."""
    problem = instance("warehouse-compact-r10-o30").build()
    for activity in problem.activities:
        if re.fullmatch(r"unload_robot\d_order6", activity.name):
            by_scope(problem, activity, LE(activity.end, 3))
    began = time.process_time()
    result = plan_of(problem)
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert result.metrics["rounds"] == "0"
    assert time.process_time() - began < 60


def test_what_nobody_can_reach_is_told_without_a_scheduler(monkeypatch):
    """What proofs leave nobody to do, whatever they are about, ends the search."""
    problem = instance("warehouse-compact-r2-o3").build()
    for activity in problem.activities:
        if activity.name.startswith("carry_") and activity.name.endswith("order1"):
            by_scope(problem, activity, LT(activity.start, 1))
    monkeypatch.setattr(loop, "get_schedule", None)
    result = plan_of(problem)
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert "has to be there" in result.log_messages[0].message
