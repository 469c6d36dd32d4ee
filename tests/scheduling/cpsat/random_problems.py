"""Small random scheduling problems over every supported feature, by seed."""

from __future__ import annotations

import random

from unified_planning.environment import Environment
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
)
from unified_planning.model.metrics import (
    MaximizeExpressionOnFinalState,
    MinimizeExpressionOnFinalState,
    MinimizeMakespan,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import get_environment

from tests.shuffled import shuffled

HORIZON = 5
_INTERVALS = [ClosedTimeInterval, OpenTimeInterval, LeftOpenTimeInterval, RightOpenTimeInterval]


class Maker:
    """Draws one problem."""

    def __init__(self, seed: int) -> None:
        self.r = random.Random(seed)
        self.env: Environment = get_environment()
        self.em = self.env.expression_manager
        self.tm = self.env.type_manager
        self.p = SchedulingProblem(f"random-{seed}")
        self.activities = []
        self.parameters = {"bool": [], "int": [], "place": []}
        self.bools, self.places, self.numbers, self.resources = [], [], [], []
        self.features = {
            f
            for f in ("fluents", "numbers", "resources", "params", "constraints", "base", "typed")
            if self.r.random() < 0.55
        }

    def chance(self, probability: float) -> bool:
        return self.r.random() < probability

    def make(self) -> SchedulingProblem:
        self.objects()
        self.fluents()
        for i in range(self.r.choice([1, 2, 2, 3, 3])):
            self.activity(i)
        if "params" in self.features and self.chance(0.5):
            self.parameter(None)
        self.constraints()
        for a in self.activities:
            self.inside(a)
        if "base" in self.features:
            self.base()
        self.metric()
        if self.chance(0.3):
            self.beside()
        return self.p

    # -- vocabulary ------------------------------------------------------------------------------
    def objects(self) -> None:
        top = self.tm.UserType("place")
        self.place = top
        kinds = [top, self.tm.UserType("room", top), self.tm.UserType("dock", top)]
        typed = "typed" in self.features
        self.items = []
        for i in range(self.r.choice([2, 3])):
            item = Object(f"o{i}", kinds[i % 3] if typed else top)
            self.p.add_object(item)
            self.items.append(item)
        self.kinds = kinds if typed and len(self.items) == 3 else [top]

    def fluents(self) -> None:
        p, r = self.p, self.r
        if "fluents" in self.features:
            f = p.add_fluent("flag", self.tm.BoolType(), default_initial_value=self.chance(0.5))
            self.bools.append(f())
            at = p.add_fluent("at", self.place, default_initial_value=r.choice(self.items))
            self.places.append(at())
            if self.chance(0.5):
                g = Fluent("lit", self.tm.BoolType(), o=self.place)
                p.add_fluent(g, default_initial_value=False)
                p.set_initial_value(g(r.choice(self.items)), True)
                self.lit = g
                self.bools += [g(o) for o in self.items]
        if "numbers" in self.features:
            n = p.add_fluent("level", self.tm.IntType(0, 3), default_initial_value=r.randint(0, 3))
            self.numbers.append(n())
        if "resources" in self.features:
            for i in range(r.choice([1, 1, 2])):
                self.resources.append(p.add_resource(f"res{i}", r.choice([1, 2])))

    def parameter(self, activity) -> None:
        kind = self.r.choice(["bool", "int", "place"])
        types = {
            "bool": self.tm.BoolType(),
            "int": self.tm.IntType(0, 2),
            "place": self.r.choice(self.kinds),
        }
        owner = self.p if activity is None else activity
        add = owner.add_variable if activity is None else owner.add_parameter
        made = add(f"{kind}{len(self.parameters[kind])}", types[kind])
        self.parameters[kind].append((self.em.ParameterExp(made), activity))

    def activity(self, i: int) -> None:
        r = self.r
        a = self.p.add_activity(
            f"a{i}", duration=r.choice([0, 1, 1, 2, 2, 3]), optional=self.chance(0.6)
        )
        if self.chance(0.3):
            low = r.choice([0, 1, 2])
            a.set_duration_bounds(low, low + r.choice([1, 2]))
        a.add_deadline(r.choice([3, 4, HORIZON]))
        if self.chance(0.2):
            a.add_release_date(r.randint(1, 2))
        self.activities.append(a)
        if "params" in self.features and self.chance(0.5):
            self.parameter(a)
            if self.parameters["int"] and self.chance(0.3):
                parameter, owner = r.choice(self.parameters["int"])
                if owner in (a, None):
                    a.set_duration_bounds(parameter, self.em.Plus(parameter, 1))

    # -- constraints -----------------------------------------------------------------------------
    def timepoint_exp(self):
        return self.em.TimingExp(Timing(0, self.timepoint()))

    def timepoint(self):
        a = self.r.choice(self.activities)
        return self.r.choice([a.start, a.end])

    def atom(self):
        r, em = self.r, self.em
        kind = r.choice(["present", "before", "before", "diff", "date", "param", "eq", "end"])
        if kind == "present":
            return r.choice(self.activities).present
        if kind == "param":
            return self.parameter_atom()
        x, y = em.TimingExp(Timing(0, self.timepoint())), em.TimingExp(Timing(0, self.timepoint()))
        if kind == "before":
            return r.choice([em.LE, em.LT])(x, y)
        if kind == "diff":
            k = r.randint(0, 2)
            return r.choice(
                [em.LE(em.Plus(x, k), y), em.LE(em.Minus(x, y), k), em.GE(x, em.Plus(y, k))]
            )
        if kind == "eq":
            return em.Equals(x, r.choice([y, em.Int(r.randint(0, 4))]))
        if kind == "end":
            return em.LE(em.TimingExp(GlobalEndTiming()), r.randint(2, 5))
        return r.choice([em.LE, em.GE])(x, r.randint(0, 4))

    def parameter_atom(self):
        r, em = self.r, self.em
        kinds = [k for k, v in self.parameters.items() if v]
        if not kinds:
            return r.choice(self.activities).present
        kind = r.choice(kinds)
        parameter = r.choice(self.parameters[kind])[0]
        if kind == "bool":
            return parameter
        if kind == "int":
            return r.choice([em.Equals(parameter, r.randint(0, 2)), em.LE(parameter, 1)])
        return em.Equals(parameter, em.ObjectExp(r.choice(self.items)))

    def formula(self, depth: int = 2):
        r, em = self.r, self.em
        if depth == 0 or self.chance(0.35):
            return self.atom()
        kind = r.choice(["and", "or", "or", "not", "implies", "iff"])
        if kind == "not":
            return em.Not(self.formula(depth - 1))
        x, y = self.formula(depth - 1), self.formula(depth - 1)
        return {"and": em.And, "or": em.Or, "implies": em.Implies, "iff": em.Iff}[kind](x, y)

    def constraints(self) -> None:
        r, em = self.r, self.em
        for _ in range(
            r.choice([0, 1, 2, 3]) if "constraints" in self.features else r.choice([0, 1])
        ):
            scope = [r.choice(self.activities).present for _ in range(r.choice([0, 0, 1, 2]))]
            self.p.add_constraint(self.formula(), scope=scope)
        optional = [a.present for a in self.activities if a.optional]
        if optional and self.chance(0.5):
            self.p.add_constraint(em.Or(optional))
        if self.chance(0.4):
            strict = r.choice([em.LT, em.LE])
            for i, a in enumerate(self.activities):
                for b in self.activities[:i]:
                    apart = em.Or(strict(a.end, b.start), strict(b.end, a.start))
                    self.p.add_constraint(apart, scope=[a.present, b.present])

    # -- conditions and effects ------------------------------------------------------------------
    def condition(self, activity):
        r, em = self.r, self.em
        choices = []
        if self.bools:
            f = r.choice(self.bools)
            choices += [f, em.Not(f)]
        if self.places:
            equal = em.Equals(self.places[0], em.ObjectExp(r.choice(self.items)))
            choices += [equal, equal, em.Not(equal)]
            if len(self.bools) > 1:
                choices.append(em.Or(equal, self.bools[0]))
        if self.numbers:
            n = self.numbers[0]
            choices += [em.GE(n, r.randint(0, 3)), em.Equals(n, r.randint(0, 3))]
        own = [p for p, o in self.parameters["place"] if o in (activity, None)]
        if own and self.places:
            choices.append(em.Equals(self.places[0], r.choice(own)))
        if own and len(self.bools) > 1:
            choices.append(self.lit(r.choice(own)))
        return r.choice(choices) if choices else None

    def interval(self, a):
        r = self.r
        if self.chance(0.4):
            return TimePointInterval(Timing(r.choice([0, 0, 0, 1, -1]), r.choice([a.start, a.end])))
        shape = r.choice(_INTERVALS) if self.chance(0.5) else ClosedTimeInterval
        if self.chance(0.1):
            return shape(Timing(0, a.start), GlobalEndTiming())
        return shape(Timing(r.choice([0, 0, 1]), a.start), Timing(0, a.end))

    def effect(self, chronicle, timing, activity) -> None:
        r, em = self.r, self.em
        own = [p for p, o in self.parameters["place"] if o in (activity, None)]
        flags = [p for p, o in self.parameters["bool"] if o in (activity, None)]
        guard = r.choice(flags) if flags and self.chance(0.3) else True
        choices = []
        if self.bools:
            choices.append((r.choice(self.bools), r.choice([em.TRUE(), em.FALSE()])))
            if own and len(self.bools) > 1:
                choices.append((self.lit(r.choice(own)), em.TRUE()))
        if self.places:
            choices.append((self.places[0], em.ObjectExp(r.choice(self.items))))
            choices.append((self.places[0], r.choice(own) if own else em.ObjectExp(self.items[0])))
        if self.bools and self.places and self.chance(0.1):
            guard = r.choice(self.bools)
        if self.numbers and self.chance(0.5):
            self.change_number(chronicle, timing, guard)
        elif choices:
            fluent, value = r.choice(choices)
            chronicle.add_effect(timing, fluent, value, guard)

    def change_number(self, chronicle, timing, guard) -> None:
        r, n = self.r, self.numbers[0]
        kind = r.choice(["up", "down", "set"])
        if kind == "up":
            chronicle.add_increase_effect(timing, n, r.randint(1, 2), guard)
        elif kind == "down":
            chronicle.add_decrease_effect(timing, n, r.randint(1, 2), guard)
        else:
            chronicle.add_effect(timing, n, r.randint(0, 3), guard)

    def inside(self, a) -> None:
        r = self.r
        for _ in range(r.choice([0, 1, 1, 2])):
            condition = self.condition(a)
            if condition is not None:
                a.add_condition(self.interval(a), condition)
        for _ in range(r.choice([0, 1, 1, 2])):
            timing = Timing(r.choice([0, 0, 0, 1, -1]), r.choice([a.start, a.end, a.end]))
            try:
                self.effect(a, timing, a)
            except Exception as error:  # UP refuses contradicting effects at one timing
                if "conflict" not in str(error):
                    raise
        for resource in self.resources:
            if self.chance(0.5):
                a.uses(resource, r.choice([1, 1, resource.type.upper_bound]))

    def base(self) -> None:
        r, em = self.r, self.em
        for _ in range(r.choice([0, 1, 2])):
            try:
                self.effect(self.p, GlobalStartTiming(r.randint(0, 4)), None)
            except Exception as error:
                if "conflict" not in str(error):
                    raise
        for _ in range(r.choice([0, 1, 1])):
            condition = self.condition(None)
            if condition is None:
                continue
            span = r.choice(
                [
                    TimePointInterval(GlobalEndTiming()),
                    TimePointInterval(GlobalEndTiming()),
                    TimePointInterval(GlobalStartTiming(r.randint(0, 4))),
                    ClosedTimeInterval(GlobalStartTiming(r.randint(0, 2)), GlobalStartTiming(4)),
                    ClosedTimeInterval(GlobalStartTiming(r.randint(0, 4)), GlobalEndTiming()),
                ]
            )
            self.p.add_condition(span, condition)
        if self.resources and self.chance(0.3):
            self.p.add_decrease_effect(GlobalStartTiming(1), self.resources[0], 1)
            self.p.add_increase_effect(GlobalStartTiming(3), self.resources[0], 1)
        if self.bools and self.chance(0.1):
            self.p.add_effect(GlobalStartTiming(2), self.bools[0], em.TRUE())

    def beside(self) -> None:
        """Add what hangs on the global end, or a duration on a fluent."""
        r, em = self.r, self.em
        kind = r.choice(["least", "gap", "before", "duration"])
        end = em.TimingExp(GlobalEndTiming())
        if kind == "least":
            self.p.add_constraint(em.GE(end, r.randint(1, HORIZON)))
        elif kind == "gap":
            self.p.add_constraint(em.LE(em.Plus(self.timepoint_exp(), 1), end))
        elif kind == "before":
            condition = self.condition(None)
            if condition is not None:
                early = GlobalEndTiming() - r.randint(1, 3)
                late = r.choice([early, GlobalEndTiming()])
                self.p.add_condition(ClosedTimeInterval(early, late), condition)
        elif self.numbers:
            r.choice(self.activities).set_duration_bounds(self.numbers[0], self.numbers[0])

    def metric(self) -> None:
        roll = self.r.random()
        if roll < 0.75:
            self.p.add_quality_metric(MinimizeMakespan())
        elif roll < 0.85 and self.numbers:
            kind = self.r.choice([MinimizeExpressionOnFinalState, MaximizeExpressionOnFinalState])
            self.p.add_quality_metric(kind(self.numbers[0]))


def random_problem(seed: int) -> SchedulingProblem:
    """Return the problem of a seed; all activities end by ``HORIZON``."""
    return shuffled(Maker(seed).make(), seed).problem
