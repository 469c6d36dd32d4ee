"""Random problems that are told by counters: who is where, what is in stock and on board.

Robots change where they are at the start (the road) and at the end of what they do, each instant
and interval in any of the forms that UP has, open or closed, from one activity's times to
another's; numbers stand on either side of a comparison; who does what hangs on chains of optional
activities, ``Implies``, ``Iff`` and negated ``Or``; counters are asked for in the end. Every sort
of metric, and sums of several.
"""

from __future__ import annotations

import itertools
import random

from unified_planning.model import (
    ClosedTimeInterval,
    Fluent,
    GlobalEndTiming,
    GlobalStartTiming,
    LeftOpenTimeInterval,
    Object,
    OpenTimeInterval,
    RightOpenTimeInterval,
    TimePointInterval,
    Timing,
    Variable,
)
from unified_planning.model.metrics import (
    MaximizeExpressionOnFinalState,
    MinimizeActionCosts,
    MinimizeExpressionOnFinalState,
    MinimizeMakespan,
    Oversubscription,
    TemporalOversubscription,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    GT,
    LE,
    LT,
    And,
    BoolType,
    Equals,
    Exists,
    Forall,
    Iff,
    Implies,
    IntType,
    Minus,
    Not,
    Or,
    Plus,
    UserType,
)

from up_samp.upio.objective import Objective, ObjectivePart

SPANS = (ClosedTimeInterval, LeftOpenTimeInterval, RightOpenTimeInterval, OpenTimeInterval)
SORTS = ("makespan",) * 5 + ("least", "most", "goals", "timed", "costs", "sum", "none")
HORIZON = 7
"""Of small ones, for brute force."""


class Ledger:
    """One problem, drawn by its seed; ``small``: two or three activities, all within HORIZON."""

    def __init__(self, seed, *, small=False, sort=None):
        self.r = r = random.Random(f"ledger {seed}")
        self.small, self.sort = small, r.choice(SORTS) if sort is None else sort
        self.p = SchedulingProblem(f"ledger-{seed}")
        self.spot = UserType("Spot")
        names = ("depot", "field", "mill")[: 2 if small else r.choice((2, 3))]
        self.spots = [Object(n, self.spot) for n in names]
        self.road = Object("road", self.spot)
        self.p.add_objects([*self.spots, *([self.road] if r.random() < 0.5 else [])])
        self.robots = range(1 if small else r.choice((1, 1, 2)))
        start = self.spots[0]
        self.at = [
            self.p.add_fluent(f"where{k}", self.spot, default_initial_value=start)
            for k in self.robots
        ]
        self.load = [
            self.p.add_fluent(f"load{k}", IntType(0, 3), default_initial_value=1)
            for k in self.robots
        ]
        self.stock = self.p.add_fluent(
            Fluent("stock", IntType(0, 4), spot=self.spot), default_initial_value=1
        )
        self.p.set_initial_value(self.stock(start), r.choice((1, 2, 3)))
        self.count = self.p.add_fluent("count", IntType(0, 9), default_initial_value=0)
        self.gate = self.p.add_fluent("gate", BoolType(), default_initial_value=r.random() < 0.7)
        self.idle = [
            self.p.add_fluent(f"idle{k}", IntType(0, 1), default_initial_value=1)
            for k in self.robots
        ]
        self.far = self.p.add_fluent(
            Fluent("far", IntType(0, 9), spot=self.spot), default_initial_value=9
        )
        for one in self.spots:
            self.p.set_initial_value(self.far(one), r.choice((1, 2, 3)))
        self.how = r.choice(("idle", "idle", "uses", "apart", "none"))
        self.made, self.busy = [], [[] for _ in self.robots]
        kinds = [self.go, self.go, self.fetch, self.bring, self.turn, self.mill]
        size = r.choice((2, 3, 3)) if small else r.choice((3, 4, 5, 6))
        while len(self.made) < size:
            r.choice(kinds)(r.choice(self.robots))
        self.apart()
        self.beside()
        self.metric()

    # -- words -----------------------------------------------------------------------------------
    def new(self, name, who=None, lasts=None):
        r = self.r
        a = self.p.add_activity(
            f"{name}{len(self.made)}", lasts or r.choice((1, 1, 2)), r.random() < 0.75
        )
        if lasts is None and r.random() < 0.2:
            a.set_duration_bounds(1, r.choice((2, 3)))
        self.made.append(a)
        if who is not None:
            self.busy[who].append(a)
        return a

    def is_(self, left, right):
        """Return an equality, either side first."""
        return Equals(left, right) if self.r.random() < 0.5 else Equals(right, left)

    def at_least(self, what, number):
        r = self.r
        return r.choice(
            [
                GE(what, number),
                LE(number, what),
                GT(what, number - 1),
                LT(number - 1, what),
                Not(LT(what, number)),
                Not(LE(what, number - 1)),
                GE(Plus(what, 1), number + 1),
                LE(Minus(number, what), 0),
            ]
        )

    def here(self, who, *spots):
        """Return that a robot is at one of some places, in one form or another."""
        at, r = self.at[who](), self.r
        some = [self.is_(at, s) for s in spots]
        others = [s for s in self.p.all_objects if s not in spots]
        roll = r.random()
        if roll < 0.15:
            return And([Not(self.is_(at, s)) for s in others]) if others else Or(some)
        if roll < 0.3 and others:
            return Not(Or([self.is_(at, s) for s in others]))
        if roll < 0.4 and not self.small:
            v = Variable("v", self.spot)
            return Exists(And(self.is_(at, v), Or([self.is_(v, s) for s in spots])), v)
        return Or(some) if len(some) > 1 else some[0]

    def span(self, a):
        r, roll = self.r, self.r.random()
        if roll < 0.3:
            return TimePointInterval(Timing(0, a.start))
        if roll < 0.4:
            return TimePointInterval(Timing(r.choice((0, -1)), a.end))
        first, last = Timing(r.choice((0, 0, 0, 1)), a.start), Timing(0, a.end)
        if roll < 0.5:
            last = Timing(r.choice((-1, 1)), a.end)
        return r.choice(SPANS)(first, last)

    def now(self, a, last=False):
        """Return when something changes: at the end, the start, or nearby."""
        roll = self.r.random()
        if last or roll < 0.6:
            return Timing(0 if roll < 0.5 else -1, a.end)
        return Timing(0 if roll < 0.9 else 1, a.start)

    def some(self):
        """Return a condition of anything."""
        r = self.r
        who, spot = r.choice(self.robots), r.choice(self.spots)
        return r.choice(
            [
                lambda: self.here(who, spot),
                lambda: self.at_least(self.stock(spot), r.choice((1, 1, 2))),
                lambda: self.at_least(self.load[who](), 1),
                lambda: Not(self.at_least(self.count(), 2)),
                lambda: self.is_(self.count(), 1),
                lambda: self.gate(),
                lambda: Not(self.gate()),
                lambda: Implies(self.gate(), self.here(who, spot)),
                lambda: Iff(self.gate(), self.at_least(self.load[who](), 1)),
                lambda: Not(Or(self.gate(), self.at_least(self.count(), 1))),
                lambda: Equals(self.load[who](), self.stock(spot)),
                lambda: self.everywhere(),
            ]
        )()

    def everywhere(self):
        if self.small:  # brute force knows no quantifiers
            return And([LE(self.stock(s), 2) for s in self.p.all_objects])
        v = Variable("v", self.spot)
        return Forall(LE(self.stock(v), 2), v)

    # -- activities ------------------------------------------------------------------------------
    def go(self, who):
        r, roll = self.r, self.r.random()
        a, at = self.new("go", who), self.at[who]
        left = r.choice(self.spots)
        if roll < 0.4 and not (self.small and len(self.made) > 2):
            to = a.add_parameter("to", self.spot)
            if self.road in self.p.all_objects and r.random() < 0.8:
                a.add_constraint(Not(self.is_(to, self.road)))
            if r.random() < 0.5:
                a.add_constraint(Not(self.is_(to, left)))
            if r.random() < 0.6:
                a.set_duration_bounds(self.far(to), r.choice((3, Plus(self.far(to), 1))))
        else:
            to = r.choice(self.spots)
        if roll < 0.15 and not self.small:
            left = a.add_parameter("left", self.spot)
            if r.random() < 0.6:
                a.add_constraint(Not(self.is_(left, to)))
        if r.random() < 0.85:
            a.add_condition(self.span(a), self.is_(at(), left))
        if self.road in self.p.all_objects and r.random() < 0.5:
            a.add_effect(Timing(0, a.start), at, self.road)
        when = self.some() if r.random() < 0.1 else True
        a.add_effect(Timing(r.choice((0, 0, -1)), a.end), at, to, when)
        if r.random() < 0.25:
            a.add_condition(self.span(a), self.some())

    def fetch(self, who):
        a, spot = self.new("fetch", who), self.r.choice(self.spots)
        if self.r.random() < 0.3:
            spot = a.add_parameter("at", self.spot)
        a.add_condition(self.span(a), self.is_(self.at[who](), spot))
        if self.r.random() < 0.6:
            a.add_condition(self.span(a), self.at_least(self.stock(spot), 1))
        a.add_decrease_effect(self.now(a), self.stock(spot), 1)
        a.add_increase_effect(self.now(a, last=True), self.load[who](), 1)

    def bring(self, who):
        a, spot = self.new("bring", who), self.r.choice(self.spots)
        a.add_condition(self.span(a), self.here(who, spot))
        if self.r.random() < 0.6:
            a.add_condition(
                TimePointInterval(Timing(0, a.start)), self.at_least(self.load[who](), 1)
            )
        a.add_decrease_effect(self.now(a), self.load[who](), 1)
        a.add_increase_effect(self.now(a, last=True), self.stock(spot), 1)
        a.add_increase_effect(a.end, self.count(), self.r.choice((1, 2)))

    def turn(self, who):
        """Somebody opens or shuts the gate, or both, one at each end."""
        a, r = self.new("turn", who if self.r.random() < 0.7 else None), self.r
        first = r.random() < 0.5
        if r.random() < 0.5:
            a.add_effect(Timing(0, a.start), self.gate, first)
        a.add_effect(Timing(r.choice((0, -1)), a.end), self.gate, not first)
        if r.random() < 0.5:
            a.add_condition(self.span(a), self.some())

    def mill(self, who):
        """Work that nobody drives to, or somebody."""
        a, r = self.new("mill", who if self.r.random() < 0.5 else None), self.r
        a.add_condition(self.span(a), self.some())
        if r.random() < 0.5:
            when = self.some() if r.random() < 0.3 else True
            a.add_increase_effect(self.now(a), self.count(), 1, when)
        elif r.random() < 0.6:
            a.add_effect(self.now(a), self.count(), r.choice((0, 1, 2)))

    def apart(self):
        """A robot does one thing at a time, in one of several forms."""
        r, p = self.r, self.p
        rooms = [p.add_resource(f"hands{k}", 1) for k in self.robots] if self.how == "uses" else []
        for who, some in enumerate(self.busy):
            idle = self.idle[who]
            for k, a in enumerate(some):
                if self.how == "uses":
                    a.uses(rooms[who])
                elif self.how == "idle":
                    a.add_condition(TimePointInterval(Timing(0, a.start)), self.is_(1, idle()))
                    a.add_decrease_effect(a.start, idle(), 1)
                    a.add_increase_effect(a.end, idle(), 1)
                elif self.how == "apart":
                    for b in some[k + 1 :]:
                        before = r.choice((LE, LE, LT))
                        both = [x.present for x in (a, b) if x.optional]
                        ways = [before(a.end, b.start), before(b.end, a.start)]
                        form = r.choice((Or, lambda w: Implies(Not(w[1]), w[0]),
                                         lambda w: Not(And(Not(w[0]), Not(w[1])))))  # fmt: skip
                        p.add_constraint(form(ways), both)

    # -- beside ----------------------------------------------------------------------------------
    def beside(self):
        r, p = self.r, self.p
        chain = [a for a in self.made if a.optional]
        r.shuffle(chain)
        for a, b in itertools.pairwise(chain):
            if r.random() < 0.35:
                p.add_constraint(Implies(a.present, b.present))
                if r.random() < 0.5:
                    order = r.choice([LE(b.end, a.start), LE(a.end, b.start), LT(b.end, a.start)])
                    p.add_constraint(order, r.choice([[a.present], [a.present, b.present]]))
        if len(chain) > 1:
            a, b, *more = chain
            wish = [
                Or([x.present for x in chain]),
                Or(b.present, a.present),
                Not(Or(Not(a.present), Not(b.present))),
                Iff(Not(b.present), a.present),
                Not(Iff(a.present, b.present)),
                Not(Implies(a.present, Or(Not(b.present), LE(a.start, b.start)))),
                Or(And(a.present, LE(a.end, 4)), And(GE(b.start, 2), b.present)),
            ]
            for one in r.sample(wish, r.choice((0, 1, 1))):
                p.add_constraint(one)
            if more and r.random() < 0.3:
                p.add_constraint(Not(And(more[0].present, a.present)))
        elif chain and r.random() < 0.7:
            p.add_constraint(chain[0].present)
        self.pairs()
        self.by_the_problem()
        if self.small:
            for a in self.made:
                p.add_constraint(LE(a.end, HORIZON), [a.present] if a.optional else [])

    def pairs(self):
        r, p = self.r, self.p
        if len(self.made) > 1 and r.random() < 0.3:
            a, b = r.sample(self.made, 2)
            told = r.choice(
                [
                    Not(Or(LT(b.start, a.end), Not(LE(a.end, b.start)))),
                    Implies(LE(a.start, b.start), LE(a.end, b.end)),
                    GE(b.start, a.start + 1),
                    Not(Or(GT(a.start, 3), GT(b.end, 6))),
                    Equals(a.end, b.start),
                ]
            )
            p.add_constraint(told, [x.present for x in (a, b) if x.optional])
        if len(self.made) > 1 and r.random() < 0.25:
            a, b = r.sample(self.made, 2)
            span = r.choice(SPANS)(Timing(0, a.end), Timing(0, b.start))
            owner = r.choice((p, a, b))
            owner.add_condition(span, self.some())

    def by_the_problem(self):
        """What the problem itself changes and asks for."""
        r, p = self.r, self.p
        if r.random() < 0.25:
            t = r.choice((1, 2, 3))
            p.add_effect(GlobalStartTiming(t), self.gate, r.random() < 0.5)
            if r.random() < 0.3:
                p.add_increase_effect(GlobalStartTiming(t), self.stock(self.spots[-1]), 1)
        if r.random() < 0.5:
            wish = [self.at_least(self.count(), 1), self.here(0, self.spots[0]), self.some()]
            p.add_condition(TimePointInterval(GlobalEndTiming()), r.choice(wish))
        if r.random() < 0.1:
            t = r.choice((0, 1, 2))
            span = r.choice(SPANS)(GlobalStartTiming(t), GlobalStartTiming(t + 2))
            p.add_condition(span, self.some())

    def metric(self):
        p, r, sort = self.p, self.r, self.sort
        gains = (1, 2, 3, -1)
        if sort == "makespan":
            p.add_quality_metric(MinimizeMakespan())
        elif sort == "least":
            told = Minus(self.stock(self.spots[0]), self.count())
            p.add_quality_metric(MinimizeExpressionOnFinalState(told))
        elif sort == "most":
            told = Plus(self.count(), self.stock(self.spots[-1]))
            p.add_quality_metric(MaximizeExpressionOnFinalState(told))
        elif sort == "goals":
            goals = {self.some(): r.choice(gains) for _ in range(3)}
            p.add_quality_metric(Oversubscription(goals))
        elif sort == "timed":
            goals = {(self.span(r.choice(self.made)), self.some()): r.choice(gains) for _ in "12"}
            p.add_quality_metric(TemporalOversubscription(goals))
        elif sort == "costs":
            p.add_quality_metric(MinimizeActionCosts({}, r.choice((1, -1, 2))))
        elif sort == "sum":
            em = p.environment.expression_manager
            parts = [ObjectivePart(r.choice((1, 2)), em.TimingExp(GlobalEndTiming()))]
            parts += [ObjectivePart(-r.choice((1, 3, 5)), self.some())]
            parts += [
                ObjectivePart(r.choice((1, -2, -3)), em.TRUE(), activity=a.name)
                for a in self.made
                if a.optional
            ]
            p.add_quality_metric(Objective("all of it", 1, parts, p.environment))


def ledger(seed, **more):
    return Ledger(seed, **more).p
