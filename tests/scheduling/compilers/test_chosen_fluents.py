"""Conditions and effects on a fluent that a parameter chooses, against brute force: whoever chooses
one of them leaves the others alone.
"""

from __future__ import annotations

import random

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    BoolType,
    ClosedTimeInterval,
    Equals,
    Fluent,
    Iff,
    MinimizeMakespan,
    Not,
    Or,
    Timing,
    UserType,
)

from tests.scheduling.compilers.test_own_effects import ENGINES, INTERVALS, compare


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


@pytest.mark.parametrize("engine", [e for e in ENGINES if e != "aries"])
def test_who_chooses_one_fluent_leaves_others_alone(engine):
    wrong, solved = compare(engine, [Lamps(said).problem for said in SAID])
    assert wrong == {}
    assert all(solved)


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
    wrong, _ = compare(engine, some)
    assert wrong == {}
