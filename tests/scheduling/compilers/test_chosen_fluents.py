"""Conditions and effects on a fluent that a parameter chooses, against brute force: whoever chooses
one of them leaves the others alone.
"""

from __future__ import annotations

import itertools
import random

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    And,
    BoolType,
    ClosedTimeInterval,
    Equals,
    Fluent,
    Iff,
    MinimizeMakespan,
    Not,
    Or,
    TimePointInterval,
    Timing,
    UserType,
)

from tests.oracles.brute_force_schedule import solve as brute_force
from tests.scheduling.compilers.test_own_effects import ENGINES, HORIZON, INTERVALS, compare
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule


class Lamps:
    """One who needs the lamp of its choice, and one who switches one of two, in some order.

    ``said``: of the lamp that is chosen; ``idle``: what holds anyhow, but still keeps others from
    switching the chosen one; ``fixed``: of the first lamp, whatever is chosen.
    """

    def __init__(self, said="chosen", *, switched=0, others=True, span=ClosedTimeInterval):
        self.problem = SchedulingProblem(f"{said} {switched} {others} {span.__name__}")
        kind = UserType("lamp")
        self.lamps = [self.problem.add_object(f"lamp{i}", kind) for i in range(2)]
        lit, day = Fluent("lit", BoolType(), lamp=kind), Fluent("day", BoolType())
        self.problem.add_fluent(lit, default_initial_value=False)
        self.problem.add_fluent(day, default_initial_value=True)
        self.problem.set_initial_value(lit(self.lamps[1]), others)
        work, switch = self.problem.add_activity("work", 3), self.problem.add_activity("switch", 2)
        lamp = work.add_parameter("which", kind)
        asked = {
            "chosen": lit(lamp),
            "dark": Not(lit(lamp)),
            "idle": Or(day, lit(lamp)),
            "itself": Or(Equals(lamp, self.lamps[0]), lit(lamp)),
            "either": Or(Equals(lamp, self.lamps[1]), lit(self.lamps[0])),
            "fixed": Or(day, lit(self.lamps[0])),
            "alike": Or(Equals(lamp, self.lamps[1]), Iff(*map(lit, self.lamps))),
        }[said]
        ends = Timing(0, work.start), Timing(0, work.end)
        work.add_condition(span(*ends), asked)
        switch.add_effect(switch.end, lit(self.lamps[switched]), True)
        self.problem.add_quality_metric(MinimizeMakespan())


SAID = ("chosen", "dark", "idle", "itself", "either", "fixed", "alike")


class _Drawn:
    """Two who ask of lamps, and where they hang, and change that: of certain ones, or of those that
    a parameter of theirs or a variable names.
    """

    def __init__(self, seed):
        self.r = r = random.Random(seed)
        self.problem = SchedulingProblem(f"drawn {seed}")
        kind = UserType("lamp")
        self.lamps = [self.problem.add_object(f"lamp{i}", kind) for i in range(2)]
        self.lit, self.at = Fluent("lit", BoolType(), lamp=kind), Fluent("at", kind, lamp=kind)
        self.problem.add_fluent(self.lit, default_initial_value=False)
        self.problem.add_fluent(self.at, default_initial_value=r.choice(self.lamps))
        for lamp in self.lamps:
            if r.random() < 0.5:
                self.problem.set_initial_value(self.lit(lamp), True)
        self.known = [self.problem.add_variable("which", kind)] if r.random() < 0.4 else []
        for name in ("a", "b"):
            activity = self.problem.add_activity(name, r.choice((1, 2, 3)), r.random() < 0.25)
            own = [activity.add_parameter("own", kind)] if r.random() < 0.7 else []
            if activity.optional and r.random() < 0.7:
                self.problem.add_constraint(activity.present)
            self.ask(activity, own)
            self.change(activity, own)
        self.problem.add_quality_metric(MinimizeMakespan())

    def lamp(self, own):
        return self.r.choice([*self.lamps, *own, *own, *self.known])

    def ask(self, a, own):
        r = self.r
        for _ in range(r.choice((0, 1, 1, 2))):
            ends = Timing(r.choice((0, 0, 1)), a.start), Timing(-r.choice((0, 0, 1)), a.end)
            instant = TimePointInterval(r.choice(ends))
            one, other = self.lit(self.lamp(own)), Equals(self.at(self.lamp(own)), self.lamps[0])
            said = [one, Not(one), other, Not(other), Or(one, other), And(one, Not(other))]
            said += [Or(Equals(p, r.choice(self.lamps)), r.choice((one, other))) for p in own]
            span = r.choice(INTERVALS)(*ends) if r.random() < 0.7 else instant
            a.add_condition(span, r.choice(said))

    def change(self, a, own):
        r = self.r
        time = r.choice((Timing(r.choice((0, 1)), a.start), Timing(-r.choice((0, 1)), a.end)))
        if r.random() < 0.5:
            chosen = [Equals(p, r.choice(self.lamps)) for p in own if r.random() < 0.3]
            a.add_effect(time, self.lit(self.lamp(own)), r.random() < 0.7, *chosen)
        elif r.random() < 0.6:
            a.add_effect(time, self.at(self.lamp(own)), self.lamp(own))


def drawn(seed):
    return _Drawn(seed).problem


@pytest.mark.parametrize("engine", [e for e in ENGINES if e != "aries"])
def test_who_chooses_one_fluent_leaves_others_alone(engine):
    wrong, solved = compare(
        engine, [*(Lamps(s).problem for s in SAID), *map(drawn, (115, *range(20)))]
    )
    assert wrong == {}
    assert all(solved[: len(SAID)])


@pytest.mark.long
@pytest.mark.parametrize("engine", ENGINES)
def test_who_chooses_one_fluent_leaves_others_alone_in_many(engine):
    r = random.Random(0)
    some = [
        Lamps(said, switched=k, others=lit, span=r.choice(INTERVALS)).problem
        for said in SAID
        for k in range(2)
        for lit in (True, False)
    ]
    wrong, _ = compare(engine, [*some, *map(drawn, range(1000, 1300))])
    assert wrong == {}


def disagreements(seeds):
    """Return by seed where our own scheduler and brute force differ."""
    wrong = {}
    for seed, plain in itertools.product(seeds, (False, True)):
        problem = drawn(seed)
        best = brute_force(problem, HORIZON)
        found = CpsatSession(problem, workers=1, plain=plain).solve(Deadline.after(20)).schedule
        if (found and found.makespan) != (best and best.makespan):
            wrong[seed, plain] = f"{found}, but {best}"
        elif found and validate_schedule(problem, build_schedule(problem, found)).violations:
            wrong[seed, plain] = f"{found} is wrong"
    return wrong


def test_our_own_scheduler_leaves_others_alone():
    assert disagreements((96, *range(20))) == {}


@pytest.mark.long
def test_our_own_scheduler_leaves_others_alone_in_many():
    assert disagreements(range(1000, 1400)) == {}
