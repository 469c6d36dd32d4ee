"""Random problems in the manner of somebody who knows UP and none of our styles.

Robots with several state variables each (a place, what is mounted, a charge), tools that are taken,
handed over and put back, benches for so many (``uses``), durations that hang on parameters, on the
state or on who else is there, alternatives as ``Or`` with ``Not(And)`` or as a parameter that says
who, timed changes by the problem itself, conditions on the plan's end. Three to six activities.
"""

from __future__ import annotations

import random

from unified_planning.model import (
    ClosedTimeInterval,
    GlobalEndTiming,
    GlobalStartTiming,
    LeftOpenTimeInterval,
    OpenTimeInterval,
    RightOpenTimeInterval,
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
    Fluent,
    Iff,
    Implies,
    IntType,
    MinimizeMakespan,
    Not,
    Object,
    Or,
    Plus,
    UserType,
)

SPANS = (ClosedTimeInterval, LeftOpenTimeInterval, RightOpenTimeInterval, OpenTimeInterval)


class Stranger:
    """One problem, drawn by its seed."""

    def __init__(self, seed):
        self.r = random.Random(f"stranger {seed}")
        self.p = SchedulingProblem(f"stranger-{seed}")
        spot, holder = UserType("Spot"), UserType("Holder")
        robot = UserType("Robot", holder)
        self.robot_type = robot
        self.spots = [Object(n, spot) for n in ("yard", "bench", "gate")[: self.r.choice((2, 3))]]
        self.robots = [Object(f"rob{k}", robot) for k in range(self.r.choice((1, 2)))]
        self.rack = Object("rack", holder)
        self.p.add_objects([*self.spots, *self.robots, self.rack])
        self.at = self.p.add_fluent(
            Fluent("at", spot, robot=robot), default_initial_value=self.spots[0]
        )
        self.holds = self.p.add_fluent("tool", holder, default_initial_value=self.rack)
        self.charge = self.p.add_fluent(
            Fluent("charge", IntType(0, 3), robot=robot), default_initial_value=2
        )
        self.open = self.p.add_fluent("open", BoolType(), default_initial_value=True)
        self.bench = self.p.add_resource("bench_room", self.r.choice((1, 1, 2)))
        self.hands = {o.name: self.p.add_resource(f"hands_{o.name}", 1) for o in self.robots}
        self.made = []
        kinds = [self.trip, self.take, self.hand_over, self.work, self.fill, self.choice]
        self.take()
        while len(self.made) < self.r.choice((3, 4, 5, 6)):
            self.r.choice(kinds)()
        self.beside()
        self.p.add_quality_metric(MinimizeMakespan())

    # -- activities ------------------------------------------------------------------------------
    def new(self, name, optional=None):
        optional = self.r.random() < 0.65 if optional is None else optional
        a = self.p.add_activity(f"{name}{len(self.made)}", self.r.choice((1, 2)), optional)
        self.made.append(a)
        return a

    def span(self, a):
        """Return an interval of an activity, with bare timepoints now and then."""
        roll = self.r.random()
        if roll < 0.35:
            return TimePointInterval(a.start)
        if roll < 0.45:
            return TimePointInterval(Timing(0, a.end))
        return self.r.choice(SPANS)(Timing(0, a.start), Timing(0, a.end))

    def ask(self, a, *conditions):
        for c in conditions:
            a.add_condition(self.span(a), c)

    def busy(self, a, who):
        if self.r.random() < 0.8:
            a.uses(self.hands[who.name])

    def somebody(self):
        return self.r.choice(self.robots)

    def trip(self):
        who, to = self.somebody(), self.r.choice(self.spots)
        a = self.new("trip")
        if self.r.random() < 0.4:  # where to is left open
            to = a.add_parameter("to", to.type)
            a.set_duration_bounds(1, 3)
            far = Equals(to, self.spots[-1])
            self.p.add_constraint(Implies(far, GE(a.end, a.start + 3)), [a.present])
            a.add_constraint(Not(Equals(to, self.r.choice(self.spots))))
        if self.r.random() < 0.5:
            self.ask(a, Equals(self.at(who), self.r.choice(self.spots)))
        if self.r.random() < 0.5:
            a.add_condition(TimePointInterval(a.start), self.open())
        if self.r.random() < 0.4:
            a.add_condition(TimePointInterval(a.start), GE(self.charge(who), 1))
            a.add_decrease_effect(a.end, self.charge(who), 1)
        a.add_effect(Timing(self.r.choice((0, 0, -1)), a.end), self.at(who), to)
        self.busy(a, who)

    def take(self):
        a = self.new("take")
        if self.r.random() < 0.5:
            who = a.add_parameter("who", self.robot_type)
            self.ask(a, Equals(self.at(who), self.r.choice(self.spots)))
        else:
            who = self.somebody()
            self.busy(a, who)
        a.add_condition(TimePointInterval(a.start), Equals(self.holds(), self.rack))
        a.add_effect(a.end, self.holds(), who)

    def hand_over(self):
        giver = self.somebody()
        to = self.r.choice([*self.robots, self.rack])
        a = self.new("hand")
        self.ask(a, Equals(self.holds(), giver))
        if to in self.robots and to is not giver:
            self.ask(a, Equals(self.at(giver), self.at(to)))
            self.busy(a, to)
        a.add_effect(a.end, self.holds(), to)
        self.busy(a, giver)

    def work(self):
        a, who = self.new("work", optional=self.r.random() < 0.4), self.somebody()
        held = [Equals(self.holds(), o) for o in self.robots]
        self.ask(a, self.r.choice([Or(held), held[0], Not(Equals(self.holds(), self.rack))]))
        if self.r.random() < 0.5:
            a.add_condition(self.span(a), Equals(self.at(who), self.r.choice(self.spots)))
        a.uses(self.bench)
        if self.r.random() < 0.3:
            n = a.add_parameter("n", IntType(1, 2))
            a.set_duration_bounds(1, 4)
            self.p.add_constraint(Equals(a.end, Plus(a.start, n)), [a.present])
            self.p.add_constraint(GE(n, self.r.choice((1, 2))), [a.present])
        self.busy(a, who)

    def fill(self):
        a, who = self.new("fill"), self.somebody()
        a.add_condition(TimePointInterval(a.start), LE(self.charge(who), 2))
        a.add_increase_effect(a.end, self.charge(who), 1)
        if self.r.random() < 0.5:
            self.ask(a, Equals(self.at(who), self.spots[0]))
        self.busy(a, who)

    def choice(self):
        """One of two ways, by presences."""
        some = [self.new("way", optional=True) for _ in range(2)]
        for k, a in enumerate(some):
            a.set_fixed_duration(1 + k)
            who = self.robots[k % len(self.robots)]
            if self.r.random() < 0.6:
                a.uses(self.hands[who.name])
            if self.r.random() < 0.5:
                self.ask(a, Equals(self.at(who), self.r.choice(self.spots)))
            if self.r.random() < 0.4:
                a.add_effect(a.end, self.at(who), self.r.choice(self.spots))
            if self.r.random() < 0.3:
                a.uses(self.bench)
        self.p.add_constraint(Or([a.present for a in some]))
        roll = self.r.random()
        if roll < 0.6:
            self.p.add_constraint(Not(And([a.present for a in some])))
        elif roll < 0.8:
            self.p.add_constraint(Iff(some[0].present, Not(some[1].present)))

    # -- beside ----------------------------------------------------------------------------------
    def beside(self):
        r, p = self.r, self.p
        for _ in range(r.choice((0, 1, 1, 2))):
            a, b = r.sample(self.made, 2)
            told = r.choice(
                [
                    LE(a.end, b.start),
                    LT(a.end + r.choice((0, 1)), b.start),
                    Or(LE(a.end, b.start), LE(b.end, a.start)),
                    Implies(a.present, b.present),
                    LE(b.end, a.start + 6),
                    Or(Not(a.present), And(b.present, LE(b.end, a.start))),
                ]
            )
            p.add_constraint(told, r.choice([[], [a.present], [a.present, b.present]]))
        if r.random() < 0.4:
            t = r.choice((1, 2, 3))
            p.add_effect(GlobalStartTiming(t), self.open(), False)
            if r.random() < 0.6:
                p.add_effect(GlobalStartTiming(t + 2), self.open(), True)
        if r.random() < 0.35:
            who = self.somebody()
            wish = r.choice(
                [
                    Equals(self.at(who), r.choice(self.spots)),
                    Equals(self.holds(), self.rack),
                    Equals(self.holds(), who),
                    LE(self.charge(who), 2),
                ]
            )
            p.add_condition(TimePointInterval(GlobalEndTiming()), wish)


def stranger(seed):
    return Stranger(seed).p
