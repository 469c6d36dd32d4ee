"""Random problems with each sort of metric, to compare with brute force."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

from unified_planning.model import ClosedTimeInterval, GlobalEndTiming, GlobalStartTiming, Timing
from unified_planning.model.metrics import (
    MaximizeExpressionOnFinalState,
    MinimizeActionCosts,
    MinimizeExpressionOnFinalState,
    Oversubscription,
    TemporalOversubscription,
)
from unified_planning.model.scheduling import SchedulingProblem

from tests.scheduling.cpsat.random_problems import _INTERVALS, HORIZON, Maker
from tests.shuffled import shuffled
from up_samp.model.objective import Cost, MinimizeCosts

SORTS = ("least", "most", "goals", "timed", "costs", "weighted", "fractions", "sum")
ORDER = "order"
"""Costs of several ranks: which of them come first is drawn, too."""


class MetricMaker(Maker):
    """Draws a problem with a metric of one sort."""

    def __init__(self, seed: int, sort: str) -> None:
        super().__init__(seed)
        self.sort = sort
        self.features |= {"fluents", "numbers", "params"}

    def fluents(self) -> None:
        super().fluents()
        if self.sort == "fractions":
            tpe, first = self.tm.RealType(0, 9), self.r.choice([Fraction(1, 2), Fraction(2)])
        else:
            tpe, first = self.tm.IntType(0, 30), 0
        self.done = self.p.add_fluent("done", tpe, default_initial_value=first)

    def inside(self, a) -> None:
        super().inside(a)
        amount = self.r.randint(1, 5)
        if self.sort == "fractions":
            amount = self.em.Real(Fraction(amount, self.r.choice([2, 3])))
        if self.chance(0.8):
            a.add_increase_effect(a.end, self.done(), amount)
        if self.sort == "fractions" and self.chance(0.4):
            least = self.em.Real(Fraction(self.r.randint(1, 4), 2))
            a.add_condition(self.interval(a), self.em.LE(self.done(), self.em.Plus(least, 1)))

    def gain(self):
        return self.r.choice([1, 2, 3, Fraction(1, 2), -1, 4])

    def goal(self):
        condition = self.condition(None)
        return condition if condition is not None and self.chance(0.6) else self.formula(1)

    def span(self):
        r = self.r
        if self.chance(0.5):
            return self.interval(r.choice(self.activities))
        shape, first = r.choice(_INTERVALS), r.randint(0, 3)
        last = GlobalStartTiming(first + r.randint(0, 3))
        if self.chance(0.3):
            return ClosedTimeInterval(GlobalStartTiming(first), GlobalEndTiming())
        return shape(GlobalStartTiming(first), last)

    def costs(self):
        """Yield what plans of a fleet cost: how late, how long and whether activities are done."""
        r, em = self.r, self.em
        yield Cost("all", r.choice([0, 1, Fraction(1, 2)]), em.TimingExp(GlobalEndTiming()))
        yield Cost("goal", self.gain(), self.goal())
        for a in self.activities:
            end, start = (em.TimingExp(Timing(0, t)) for t in (a.end, a.start))
            late = em.Minus(end, r.randint(0, 6))
            name = a.name if a.optional else None
            yield Cost("late", r.choice([1, 2, Fraction(1, 3)]), late, name, positive=True)
            if self.chance(0.4):
                yield Cost("long", r.choice([1, 2]), em.Minus(end, start), name)
            share = ("one", "other")[self.activities.index(a) % 2]
            yield Cost("most", Fraction(1, 2), late, name, share=share)
            if a.optional and self.chance(0.4):
                yield Cost("there", r.choice([-3, 1, 2]), em.Int(1), a.name)

    def metric(self) -> None:
        r, em, n = self.r, self.em, self.numbers[0]
        if self.sort == "goals":
            goals = {self.goal(): self.gain() for _ in range(r.randint(2, 4))}
            self.p.add_quality_metric(Oversubscription(goals))
        elif self.sort == "timed":
            timed = {(self.span(), self.condition(None)): self.gain() for _ in range(3)}
            self.p.add_quality_metric(TemporalOversubscription(timed))
        elif self.sort == "costs":
            default = r.choice([1, em.Real(Fraction(3, 2)), -2])
            self.p.add_quality_metric(MinimizeActionCosts({}, default))
        elif self.sort == "sum":
            self.p.add_quality_metric(MinimizeCosts(self.costs(), self.p.environment))
        elif self.sort == ORDER:
            first = {t: r.randint(0, 2) for t in ("all", "goal", "late", "long", "most", "there")}
            costs = [replace(cost, rank=first[cost.term]) for cost in self.costs()]
            self.p.add_quality_metric(MinimizeCosts(costs, self.p.environment))
        elif self.sort == "weighted":
            # times are no numbers to UP, but variables are
            latest = em.ParameterExp(self.p.add_variable("latest", self.tm.IntType(0, HORIZON)))
            self.p.add_constraint(em.LE(em.TimingExp(GlobalEndTiming()), latest))
            both = em.Times(r.choice([1, 2]), self.done())
            told = em.Minus(em.Plus(em.Times(2, latest), n), both)
            self.p.add_quality_metric(MinimizeExpressionOnFinalState(told))
        else:
            kind = {"least": MinimizeExpressionOnFinalState, "most": MaximizeExpressionOnFinalState}
            told = em.Minus(em.Times(2, n), self.done())
            sort = self.sort if self.sort in kind else r.choice(sorted(kind))
            self.p.add_quality_metric(kind[sort](told))


def problem_with(sort: str, seed: int) -> SchedulingProblem:
    """Return the problem of a seed with a metric of a sort."""
    return shuffled(MetricMaker(seed, sort).make(), seed).problem
