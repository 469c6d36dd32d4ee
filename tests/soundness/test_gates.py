"""Plans that are found with nothing stated keep all that is proven where everything is."""

import random

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import LE, LT, Not, OneshotPlanner, get_environment

from tests.shuffled import shuffled
from tests.soundness.gates import gates
from tests.soundness.worlds import SECONDS
from tests.usual import usually
from up_samp.model import Deadline, ScheduleStatus
from up_samp.model.refinement import ABSOLUTE, Layer, Strength
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio import read_problem, relax, write_refinement
from up_samp.validation import validate_plan

BLIND = ("bounds_first", "certificates", "handovers", "small_cuts")
SEEDS = (8, 13, 16)

get_environment().credits_stream = None


def solve(problem, timeout, **params):
    params = {"seconds_per_unit": SECONDS, "query_seconds": 1.0, **params}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        return planner.solve(problem, timeout=timeout)


def ends_of(plan):
    """Return when the activities of a plan start and end, and the objects that it chooses."""
    times = {
        a.name: tuple(plan.get(t).constant_value() for t in (a.start, a.end))
        for a in plan.activities
    }
    chosen = [(p.name, v.object().name) for p, v in plan.assignment.items() if v.is_object_exp()]
    return times, dict(chosen)


def proven_bound(result):
    """Return the lower bound that does not rest on the planner's motions."""
    told = result.metrics or {}
    absolute = told.get("lower_bound", 0) if told.get("bound_kind") == ABSOLUTE else 0
    return float(told.get("absolute_bound", absolute))


def admits(problem, plan, refinements):
    """Return whether a relaxation with some refinements has the schedule of a plan."""
    relaxation = relax(problem, read_problem(problem, SECONDS))
    for refinement in refinements:
        write_refinement(relaxation, refinement)
    times, chosen = ends_of(plan)
    manager, own = relaxation.manager, relaxation.problem
    for name, activity in relaxation.activities.items():
        if name not in times:
            own.add_constraint(manager.Not(activity.present))
            continue
        if activity.optional:
            own.add_constraint(activity.present)
        for told, time in zip((activity.start, activity.end), times[name], strict=True):
            own.add_constraint(manager.And(manager.LE(told, time), manager.LE(time, told)))
        for parameter in activity.parameters:
            if parameter.name in chosen:
                value = own.object(chosen[parameter.name])
                activity.add_constraint(manager.Equals(parameter, value))
    session = CpsatSession(own, workers=1, plain=True)
    return session.solve(Deadline.after(20.0), optimal=False).status is not (
        ScheduleStatus.INFEASIBLE
    )


def wrong(seed, folder, timeout=15.0):
    """Return what is wrong with what is proven of a world, and against how many plans."""
    problem = gates(seed, folder)
    told = solve(problem, timeout, optimal=True)
    blind = solve(problem, timeout, without=BLIND, optimal=seed % 2 == 0, seed=seed + 1)
    proven = [r for r in told.history.refinements if r.strength is Strength.PROVEN]
    learned = (*told.history.refinements, *blind.history.refinements)
    sure = [r for r in learned if r.layer is Layer.GROUP and r.strength is not Strength.HEURISTIC]
    plans = [result.plan for result in (told, blind) if result.plan is not None]
    found = [f"{r.log_messages}" for r in (told, blind) if r.status is Status.INTERNAL_ERROR]
    found += [f"what is found of robots that meet is a guess: {r}" for r in sure]
    if plans and Status.UNSOLVABLE_PROVEN in (told.status, blind.status):
        found.append("unsolvable, and a plan")
    least = min((max((e for _, e in ends_of(p)[0].values()), default=0) for p in plans), default=0)
    for result in (told, blind):
        if plans and proven_bound(result) > least:
            found.append(f"at least {proven_bound(result)}, and {least}")
    for plan in plans:
        if not admits(problem, plan, proven):
            broken = [str(r) for r in proven if not admits(problem, plan, [r])]
            found.append(f"{ends_of(plan)[0]} breaks {broken}")
    return found, len(plans)


@pytest.mark.parametrize("seed", usually(8, 13, of=SEEDS))
def test_what_is_proven_of_gates_holds_for_all_plans(seed, tmp_path):
    assert wrong(seed, tmp_path) == ([], 2)


def narrow(problem, plan, rng):
    """Ask for some of what is so in a plan: who is there, when it ends, what comes before what."""
    times, _ = ends_of(plan)
    points = {}
    for activity in sorted(problem.activities, key=lambda a: a.name):
        there = activity.name in times
        if activity.optional and rng.random() < 0.6:
            problem.add_constraint(activity.present if there else Not(activity.present))
        if there:
            scope = [activity.present] if activity.optional else []
            start, end = times[activity.name]
            points |= {(activity.name, 0): (activity.start, start, scope)}
            points |= {(activity.name, 1): (activity.end, end, scope)}
            if rng.random() < 0.5:
                problem.add_constraint(LE(activity.end, end + rng.choice([0, 1])), scope)
    for _ in range(rng.choice([1, 3, 6]) if points else 0):
        few = rng.sample(sorted(points), 2)
        (x, at, some), (y, then, others) = sorted((points[k] for k in few), key=lambda p: p[1])
        problem.add_constraint((LT if at < then else LE)(x, y), [*dict.fromkeys([*some, *others])])


def lost(seed, folder, timeout=5.0):
    """Return what is claimed of a world, and of narrower ones, that a plan of theirs refutes."""
    rng, problem = random.Random(seed), gates(seed, folder)
    plan = solve(problem, timeout, without=BLIND[:3], first_plan=True).plan
    found = []
    for number in range(3 if plan is not None else 0):
        narrow(problem, plan, rng)
        assert validate_plan(problem, plan, seconds_per_unit=SECONDS).valid
        other = shuffled(problem, (seed, number), rename=False).problem
        told = solve(other, timeout, optimal=True, seed=number)
        makespan = max(end for _, end in ends_of(plan)[0].values())
        if told.status is Status.UNSOLVABLE_PROVEN:
            found.append("unsolvable")
        if proven_bound(told) > makespan:
            found.append(f"at least {proven_bound(told)}, and {makespan}")
        proven = [r for r in told.history.refinements if r.strength is Strength.PROVEN]
        if not admits(problem, plan, proven):
            broken = [str(r) for r in proven if not admits(problem, plan, [r])]
            found.append(f"{ends_of(plan)[0]} breaks {broken}")
    return found, plan is not None


@pytest.mark.parametrize("seed", usually(11, 13, of=(7, 8, 11, 13)))
def test_a_plan_refutes_nothing_of_narrower_worlds(seed, tmp_path):
    assert lost(seed, tmp_path) == ([], True)


@pytest.mark.long
@pytest.mark.parametrize("first", range(2000, 2200, 20))
def test_plans_refute_nothing_of_many_narrower_worlds(first, tmp_path):
    found = {seed: lost(seed, tmp_path) for seed in range(first, first + 20)}
    assert {seed: row for seed, (row, _) in found.items() if row} == {}
    assert sum(known for _, known in found.values()) > 10


@pytest.mark.long
@pytest.mark.parametrize("first", range(1000, 1200, 20))
def test_what_is_proven_of_many_gates_holds_for_all_plans(first, tmp_path):
    found = {seed: wrong(seed, tmp_path) for seed in range(first, first + 20)}
    assert {seed: row for seed, (row, _) in found.items() if row} == {}
    assert sum(plans for _, plans in found.values()) > 20
