"""That activities do not overlap, in the ways in which authors say it."""

from __future__ import annotations

import itertools

from unified_planning.model import (
    LeftOpenTimeInterval,
    TimePointInterval,
    Timing,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    LE,
    LT,
    And,
    BoolType,
    Equals,
    Implies,
    IntType,
    Not,
    Or,
    UserType,
)


class OneAtATime:
    """Writes into ``problem``; ``holds`` counts what has been written so far. ``kept()`` tells, by
    chance, whether some part of a pattern is written at all.
    """

    problem: SchedulingProblem
    holds: int

    def kept(self) -> bool:
        """Return whether the next part of a pattern is written."""
        raise NotImplementedError

    def _alone(self, activities, how, same=None):
        self.holds += 1
        if how in ("after", "strictly", "implies", "not both"):
            for a, b in itertools.combinations(activities, 2):
                if (same is None or same[a.name] != same[b.name]) and self.kept():
                    self._apart(a, b, how)
            return
        kind = IntType(0, 1) if how in ("uses", "level") else BoolType()
        first = 1 if how in ("uses", "level") else False
        if how == "held":
            holder = UserType(f"holder{self.holds}")
            names = [self.problem.add_object(f"{a.name}_{self.holds}", holder) for a in activities]
            nobody = self.problem.add_object(f"nobody_{self.holds}", holder)
            fluent = self.problem.add_fluent(
                f"held{self.holds}", holder, default_initial_value=nobody
            )
            for a, name in zip(activities, names, strict=True):
                if self.kept():
                    a.add_effect(a.start, fluent(), name)
                span = LeftOpenTimeInterval(Timing(0, a.start), Timing(0, a.end))
                a.add_condition(span, Equals(fluent(), name))
            return
        fluent = self.problem.add_fluent(f"free{self.holds}", kind, default_initial_value=first)
        for a in activities:
            if how == "uses":
                if self.kept():
                    a.uses(fluent())
            elif how == "level":
                a.add_decrease_effect(a.start, fluent(), 1)
                if self.kept():
                    a.add_increase_effect(a.end, fluent(), 1)
            else:
                if self.kept():
                    a.add_condition(TimePointInterval(Timing(0, a.start)), Not(fluent()))
                if self.kept():
                    a.add_effect(a.start, fluent(), True)
                a.add_effect(a.end, fluent(), False)

    def _apart(self, a, b, how):
        both = [a.present, b.present]
        if how == "strictly":
            self.problem.add_constraint(Or(LT(a.end, b.start), LT(b.end, a.start)), both)
        elif how == "after":
            self.problem.add_constraint(Or(LE(a.end, b.start), GE(a.start, b.end)), both)
        elif how == "implies":
            apart = Or(LE(a.end, b.start), LE(b.end, a.start))
            self.problem.add_constraint(Implies(And(both), apart))
        else:
            self.problem.add_constraint(Not(And(*both, LT(a.start, b.end), LT(b.start, a.end))))
