"""Exists, forall and effects for all objects mean what they say when written out."""

from __future__ import annotations

import random

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.walkers import ExpressionQuantifiersRemover
from unified_planning.shortcuts import (
    And,
    BoolType,
    ClosedTimeInterval,
    Equals,
    Exists,
    Forall,
    IntType,
    MinimizeMakespan,
    Not,
    Object,
    OneshotPlanner,
    Or,
    Oversubscription,
    TemporalOversubscription,
    Timing,
    UserType,
    Variable,
)

import up_samp  # noqa: F401 - registers the engines

BAYS = 3


class Yard:
    """A random problem about bays; ``written_out`` has no quantifiers."""

    def __init__(self, seed: int, *, written_out: bool) -> None:
        self.rng, self.written_out = random.Random(seed), written_out
        self.problem = SchedulingProblem("yard")
        self.bay = UserType("bay")
        self.bays = [Object(f"bay{k}", self.bay) for k in range(BAYS)]
        self.problem.add_objects(self.bays)
        self.free = self.problem.add_fluent("free", BoolType(), b=self.bay)
        for bay in self.bays:
            self.problem.set_initial_value(self.free(bay), self.rng.random() < 0.5)
        for k in range(4):
            self.activity(k)
        self.problem.add_quality_metric(MinimizeMakespan())

    def activity(self, k: int) -> None:
        rng = self.rng
        activity = self.problem.add_activity(f"a{k}", rng.randint(1, 4))
        place = activity.add_parameter("to", self.bay)
        if rng.random() < 0.7:
            when = rng.choice((activity.start, ClosedTimeInterval(activity.start, activity.end)))
            activity.add_condition(when, self.put(self.condition(place)))
        if rng.random() < 0.4:
            v = Variable("v", self.bay)
            self.for_all(activity, v, self.free(v), rng.random() < 0.7)
        elif rng.random() < 0.7:
            fluent, value = self.free(rng.choice(self.bays)), rng.random() < 0.6
            condition = self.put(self.condition(place)) if rng.random() < 0.5 else True
            activity.add_effect(activity.end, fluent, value, condition)
        if rng.random() < 0.5:
            x = Variable("x", self.bay)
            said = Or(Not(Equals(x, place)), Equals(x, rng.choice(self.bays)))
            self.problem.add_constraint(self.put(Forall(said, x)))

    def condition(self, place):
        x, y = Variable("x", self.bay), Variable("y", self.bay)
        some = self.rng.choice(
            (
                Exists(self.free(x), x),
                Forall(self.free(x), x),
                Not(Exists(And(self.free(x), Not(Equals(x, place))), x)),
                Exists(Forall(Or(self.free(y), Equals(x, y)), y), x),
                Exists(And(self.free(x), Not(self.free(y))), x, y),
            )
        )
        return some if self.rng.random() < 0.8 else Not(some)

    def for_all(self, activity, variable, fluent, value) -> None:
        if not self.written_out:
            activity.add_effect(activity.end, fluent, value, forall=[variable])
            return
        for bay in self.bays:
            activity.add_effect(activity.end, self.free(bay), value)

    def put(self, expression):
        if not self.written_out:
            return expression
        remover = ExpressionQuantifiersRemover(self.problem.environment)
        return remover.remove_quantifiers(expression, self.problem)


def solve(problem):
    with OneshotPlanner(name="cpsat", params={"workers": 1}) as planner:
        result = planner.solve(problem, timeout=20)
    ends = (
        ()
        if result.plan is None
        else (int(result.plan.get(a.end).constant_value()) for a in result.plan.activities)
    )
    return result.status, max(ends, default=None)


def test_it_is_the_same_written_out():
    found = [
        (solve(Yard(seed, written_out=False).problem), solve(Yard(seed, written_out=True).problem))
        for seed in range(6)
    ]
    assert all(short == long for short, long in found), found
    assert {short[0] for short, _ in found} == {Status.SOLVED_OPTIMALLY, Status.UNSOLVABLE_PROVEN}


def test_numbers_are_not_quantified_over():
    yard = Yard(0, written_out=False)
    n = Variable("n", IntType(0, 3))
    yard.problem.add_constraint(Exists(Equals(n, 2), n))
    with OneshotPlanner(name="cpsat") as planner:
        result = planner.solve(yard.problem, timeout=20)
    assert result.status is Status.UNSUPPORTED_PROBLEM
    assert "quantifies over objects only" in result.log_messages[-1].message


@pytest.mark.parametrize("engine", ["cpsat", "samp-refine[cpsat]"])
@pytest.mark.parametrize("timed", [False, True])
def test_what_is_wished_for_may_quantify(engine, timed):
    """Two of three bays are free at first; whoever works takes one and frees all in the end."""
    problem = SchedulingProblem("wishes")
    bay = UserType("bay")
    bays = [problem.add_object(f"bay{k}", bay) for k in range(BAYS)]
    free = problem.add_fluent("free", BoolType(), default_initial_value=False, b=bay)
    for one in bays[1:]:
        problem.set_initial_value(free(one), True)
    work = problem.add_activity("work", 2, optional=True)
    v = Variable("v", bay)
    work.add_effect(work.end, free(v), True, forall=[v])
    all_free, none = Forall(free(v), v), Not(Exists(free(v), v))
    span = ClosedTimeInterval(Timing(1, work.end), Timing(1, work.end))
    if timed:
        metric = TemporalOversubscription({(span, all_free): 3, (span, none): 5})
    else:
        metric = Oversubscription({all_free: 3, none: 5, Not(all_free): 1})
    problem.add_quality_metric(metric)
    with OneshotPlanner(name=engine, params={"workers": 1}) as planner:
        result = planner.solve(problem, timeout=20)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert int(result.metrics["value"]) == 3


@pytest.mark.parametrize("written_out", [False, True])
def test_samp_refine_takes_them(written_out):
    problem = Yard(3, written_out=written_out).problem
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(problem, timeout=20)
    assert result.status in (Status.SOLVED_OPTIMALLY, Status.UNSOLVABLE_PROVEN)
