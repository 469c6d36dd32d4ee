"""Tiny random problems of odd things: intervals that may be empty, times beside what they count
from, effects at fixed times and before others' starts, switches, static fluents, fractions.
"""

from __future__ import annotations

import contextlib
import random
from fractions import Fraction

from unified_planning.exceptions import UPConflictingEffectsException
from unified_planning.model import DurationInterval
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    LE,
    LT,
    And,
    BoolType,
    ClosedTimeInterval,
    Equals,
    Fluent,
    GlobalEndTiming,
    GlobalStartTiming,
    Iff,
    Implies,
    IntType,
    LeftOpenTimeInterval,
    MinimizeMakespan,
    Minus,
    Not,
    OpenTimeInterval,
    Or,
    Plus,
    RightOpenTimeInterval,
    Times,
    Timing,
    UserType,
    get_environment,
)

from tests.oracles import brute_force_schedule as brute
from tests.shuffled import shuffled

HORIZON = 4
"""By which brute force looks for schedules."""
SHAPES = (ClosedTimeInterval, OpenTimeInterval, LeftOpenTimeInterval, RightOpenTimeInterval)
FEATURES = (
    *("flags", "spots", "lamps", "number", "levels", "tool", "kinds", "own", "shared", "optional"),
    *("constraints", "base", "fractions", "beside", "end", "switches"),
)


class Drawn:
    """One or two activities, by a seed."""

    def __init__(self, seed):
        self.r = random.Random(seed)
        self.on = {name for name in FEATURES if self.chance(0.45)}
        self.manager = get_environment().expression_manager
        self.problem = SchedulingProblem(f"odd {seed}")
        self.parameters = []
        self._objects()
        self._fluents()
        if "shared" in self.on:
            self._parameter(None)
        self.activities = [self._activity(f"a{i}") for i in range(self.one(1, 2, 2, 2))]
        for activity in self.activities:
            self._inside(activity)
        if "base" in self.on:
            self._ask(self.problem, None)
            self._change(self.problem, None)
        if "constraints" in self.on:
            for _ in range(self.one(1, 1, 2)):
                self.problem.add_constraint(self.formula(2))
        if self.chance(0.8):
            self.problem.add_quality_metric(MinimizeMakespan())

    def chance(self, p):
        return self.r.random() < p

    def one(self, *some):
        return self.r.choice(some)

    # -- what there is -----------------------------------------------------------------------
    def _objects(self):
        top = UserType("place")
        room, dock = UserType("room", top), UserType("dock", top)
        kinds = [room, dock, top] if "kinds" in self.on else [top] * 3
        self.r.shuffle(kinds)
        self.objects = [self.problem.add_object(f"o{i}", kinds[i]) for i in range(self.one(2, 3))]
        self.types = [t for t in dict.fromkeys((top, *kinds)) if self.of(t)]

    def of(self, kind):
        return [o for o in self.objects if kind in o.type.ancestors]

    def _fluents(self):
        p, top = self.problem, self.types[0]
        self.values, self.numbers, self.spots = [], [], []
        for i in range(self.one(1, 2) if "flags" in self.on else 0):
            self.values.append(p.add_fluent(f"flag{i}", BoolType(), default_initial_value=i > 0)())
        for i in range(self.one(1, 2) if "spots" in self.on else 0):
            kind = self.r.choice(self.types)
            first = self.r.choice(self.of(kind))
            self.spots.append(p.add_fluent(f"spot{i}", kind, default_initial_value=first)())
        self.lamps = []
        for name in ("lit", "static"):
            lamp = Fluent(name, BoolType(), o=top)
            if name == "static" or "lamps" in self.on:
                p.add_fluent(lamp, default_initial_value=self.chance(0.5))
                p.set_initial_value(lamp(self.objects[0]), self.chance(0.5))
                self.lamps.append(lamp)
        if "number" in self.on:
            kind = IntType(self.one(0, 0, -1, None), self.one(2, 3, None))
            self.numbers.append(
                p.add_fluent("number", kind, default_initial_value=self.one(0, 2))()
            )
        if "levels" in self.on:
            level = Fluent("level", IntType(0, 3), i=IntType(0, 1))
            p.add_fluent(level, default_initial_value=self.one(0, 1, 3))
            self.numbers += [level(0), level(1)]
        self.tools = [p.add_resource("tool", self.one(1, 2))] if "tool" in self.on else []

    def _parameter(self, owner):
        kind = self.one(BoolType(), IntType(*self.one((0, 2), (-1, 1))), self.r.choice(self.types))
        add = self.problem.add_variable if owner is None else owner.add_parameter
        made = add(f"p{len(self.parameters)}", kind)
        self.parameters.append((self.manager.ParameterExp(made), owner))

    def own(self, owner, is_kind):
        """Return the parameters that one may use of a kind."""
        return [p for p, whose in self.parameters if whose in (owner, None) and is_kind(p.type)]

    def _activity(self, name):
        optional = "optional" in self.on and self.chance(0.6)
        activity = self.problem.add_activity(name, self.one(0, 1, 1, 2, 3), optional=optional)
        if self.chance(0.4):
            low = self.one(0, 0, 1, 2)
            high = low + self.one(1, 2)
            if "fractions" in self.on:
                low, high = low + Fraction(1, 2), high + Fraction(3, 2)
            bounds = self.manager.auto_promote(low, high)
            open_ = self.one((False, False), (False, False), (True, False), (False, True))
            activity._set_duration_constraint(DurationInterval(*bounds, *open_))
        if "own" in self.on:
            self._parameter(activity)
        numbers = self.own(activity, lambda t: t.is_int_type())
        if numbers and self.chance(0.3):
            number = self.r.choice(numbers)
            activity.set_duration_bounds(number, Plus(number, self.one(0, 1)))
        return activity

    # -- conditions and effects --------------------------------------------------------------
    def _inside(self, activity):
        for _ in range(self.one(0, 1, 1, 2)):
            self._ask(activity, activity)
        for _ in range(self.one(0, 1, 1, 2)):
            self._change(activity, activity)
        for tool in self.tools:
            activity.uses(tool, self.one(1, 1, tool.type.upper_bound))

    def _ask(self, chronicle, owner):
        if owner is not None and self.chance(0.45):
            span = [Timing(self.one(0, 0, 1), owner.start), Timing(self.one(0, 0, -1), owner.end)]
        else:
            span = [self.time(owner)] * 2 if self.chance(0.4) else [self.time(owner) for _ in "ab"]
            if span[0].timepoint == span[1].timepoint:
                span.sort(key=lambda t: t.delay)
        chronicle.add_condition(self.r.choice(SHAPES)(*span), self.asked(owner))

    def time(self, owner, effect=False):
        if "end" in self.on and self.chance(0.1 if owner else 0.4):
            return Timing(0 if effect else self.one(0, 0, -1, -2), GlobalEndTiming().timepoint)
        if owner is None or self.chance(0.07):
            return GlobalStartTiming(self.one(0, 1, 2, 3, 4))
        if "beside" in self.on and self.chance(0.05):
            owner = self.r.choice(self.activities)
        delay = self.one(0, 0, 1, -1, 2, -2) if "beside" in self.on else self.one(0, 0, 1)
        return self.one(Timing(delay, owner.start), Timing(-delay, owner.end))

    def place(self, owner):
        own = self.own(owner, lambda t: t.is_user_type())
        return self.r.choice([*own, *own, *self.objects])

    def asked(self, owner, depth=1):
        """Return what may be asked of fluents and parameters."""
        if depth and self.chance(0.35):
            join = self.one(And, Or, Or, Implies, Iff)
            return join(self.asked(owner, 0), self.asked(owner, 0))
        some = [*self.values, *(lamp(self.place(owner)) for lamp in self.lamps)]
        some += [Equals(spot, self.place(owner)) for spot in self.spots]
        some += [GE(n, self.one(0, 1, 2)) for n in self.numbers]
        some += [Equals(n, self.one(0, 1)) for n in self.numbers]
        some += self.own(owner, lambda t: t.is_bool_type())
        one = self.r.choice(some)
        return Not(one) if self.chance(0.4) else one

    def _change(self, chronicle, owner):
        told = [True]
        if "switches" in self.on:
            bools = self.own(owner, lambda t: t.is_bool_type())
            told += [self.asked(owner), *bools, *map(Not, bools)]
        booleans = [*self.values, *(lamp(self.place(owner)) for lamp in self.lamps[:-1])]
        value = self.r.choice((True, False, *self.own(owner, lambda t: t.is_bool_type())))
        some = [(chronicle.add_effect, fluent, value) for fluent in booleans]
        for spot in self.spots:
            mine = self.own(
                owner, lambda t, kind=spot.type: t.is_user_type() and kind in t.ancestors
            )
            to = self.r.choice([*self.of(spot.type), *mine])
            some.append((chronicle.add_effect, spot, to))
        for n in self.numbers:
            some.append((chronicle.add_increase_effect, n, 1))
            some.append((chronicle.add_decrease_effect, n, 1))
            some.append((chronicle.add_effect, n, self.one(0, 1, 2)))
        if some:
            change, fluent, to = self.r.choice(some)
            # UP refuses two effects on one fluent at one time
            with contextlib.suppress(UPConflictingEffectsException):
                change(self.time(owner, effect=True), fluent, to, self.r.choice(told))

    # -- constraints -------------------------------------------------------------------------
    def formula(self, depth):
        if depth == 0 or self.chance(0.3):
            return self.atom()
        join = self.one(And, Or, Or, Implies, Iff, None)
        if join is None:
            return Not(self.formula(depth - 1))
        return join(self.formula(depth - 1), self.formula(depth - 1))

    def point(self):
        if self.chance(0.15):
            return self.manager.TimingExp(GlobalEndTiming())
        activity = self.r.choice(self.activities)
        return self.manager.TimingExp(
            Timing(self.one(0, 0, 1, -1), self.one(activity.start, activity.end))
        )

    def atom(self):
        x, y = self.point(), self.point()
        number = Fraction(self.r.randint(-3, 7), 2 if "fractions" in self.on else 1)
        some = [LE(x, y), LT(x, y), LE(Plus(x, number), y), LE(Minus(x, y), number), GE(x, number)]
        some += [LE(Plus(x, x), Plus(y, 2)), Equals(x, y), self.r.choice(self.activities).present]
        for p, _ in self.parameters:
            if p.type.is_bool_type():
                some += [p, p]
            elif p.type.is_int_type():
                some += [LE(Times(2, p), number), LE(Plus(x, p), y), GE(x, p)]
            else:
                some += [self.lamps[-1](p), Equals(p, self.r.choice(self.objects))]
        return self.r.choice(some)


def odd_problem(seed):
    """Return the problem of a seed, in a listing of it."""
    return shuffled(Drawn(seed).problem, seed).problem


def ways(problem, seed, tries=300):
    """Yield random choices: times by activity (None: absent), values, whether they are valid."""
    r, judge = random.Random(seed), brute._Judge(problem)
    options = {a.name: brute._options(problem, a, HORIZON) for a in problem.activities}
    shared = {v.name: brute._values(problem, v.type) for v in problem.base_variables}
    for _ in range(tries):
        drawn = {name: r.choice(some) for name, some in options.items()}
        values = {name: r.choice(some) for name, some in shared.items()}
        for _, own in drawn.values():
            values |= own
        times = {name: span for name, (span, _) in drawn.items()}
        yield times, values, judge.valid(brute.Choice(times, values)) is not None
