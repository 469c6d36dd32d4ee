"""Small random problems with routes and unusual side constraints, by seed.

Travellers move between places and stop there, one thing at a time, as in the benchmark families;
beside that shape moves may have side effects, conditions of their own, variable or no durations,
dates, orders with other activities; doors change by themselves; places are for one.
"""

from __future__ import annotations

import itertools
import random

from unified_planning.model import (
    ClosedTimeInterval,
    GlobalEndTiming,
    GlobalStartTiming,
    LeftOpenTimeInterval,
    OpenTimeInterval,
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
    Implies,
    IntType,
    MinimizeMakespan,
    Not,
    Or,
    UserType,
)

from tests.shuffled import shuffled


def whole(a):
    return ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end))


def inside(a):
    return OpenTimeInterval(Timing(0, a.start), Timing(0, a.end))


def behind(a):
    return LeftOpenTimeInterval(Timing(0, a.start), Timing(0, a.end))


def begin(a):
    return TimePointInterval(Timing(0, a.start))


def finish(a):
    return TimePointInterval(Timing(0, a.end))


def late(a):
    return ClosedTimeInterval(Timing(-1, a.end), Timing(0, a.end))


def after(a):
    return TimePointInterval(Timing(2, a.end))


SPANS = [whole, whole, whole, inside, behind, begin, finish]


class RandomRoutes:
    """Draws one problem."""

    def __init__(self, seed: int, *, touching: bool = False) -> None:
        self.r = r = random.Random(seed)
        self.origins = [behind, behind, begin] if touching else [whole, whole, begin]
        self.p = SchedulingProblem(f"routes{seed}")
        self.spot, self.leaf = UserType("spot"), UserType("leaf")
        self.spots = [
            self.p.add_object(f"s{i}", self.spot) for i in range(r.choice([2, 2, 3, 3, 4]))
        ]
        self.shut, self.ajar, self.open = (
            self.p.add_object(n, self.leaf) for n in ("shut", "ajar", "open")
        )
        self.door = self.p.add_fluent("door", self.leaf, default_initial_value=self.shut)
        self.flag = self.p.add_fluent("flag", BoolType(), default_initial_value=False)
        self.level = self.p.add_fluent("level", IntType(0, 4), default_initial_value=2)
        lit = Fluent("lit", BoolType(), x=self.spot)
        self.lit = self.p.add_fluent(lit, default_initial_value=False)
        self.travellers = range(r.choice([1, 1, 2]))
        self.at, self.moves, self.stops = [], [], []
        self.busy = [[] for _ in self.travellers]
        self.inner = r.choice(self.spots)
        for t in self.travellers:
            start = r.choice(self.spots[:2])
            self.at.append(self.p.add_fluent(f"at{t}", self.spot, default_initial_value=start))
        still, guarded = self.chance(0.5), self.chance(0.5)
        for t in self.travellers:
            self._graph(t, still, guarded)
        self._tasks()
        self._doors()
        extras = (self._side_effects, self._dates, self._orders, self._unit, self._ends, self._meet)
        for extra in extras:
            if self.chance(0.3):
                extra()
        if self.chance(0.2):
            self._by_state()
        own = random.Random(seed + 10**6)  # so that what else is drawn does not change
        if own.random() < 0.5:
            self._openings(own)
        if own.random() < 0.4:
            self._from_anywhere(own)
        self._more(seed)
        for t in self.travellers:
            self._one_at_a_time(self.busy[t])
        self.p.add_quality_metric(MinimizeMakespan())

    def _more(self, seed):
        """Add what other kinds of these problems have."""

    def chance(self, probability):
        return self.r.random() < probability

    # -- moves ---------------------------------------------------------------------------------
    def _graph(self, t, still, guarded):
        r = self.r
        pairs = list(itertools.permutations(self.spots, 2))
        pairs = r.sample(pairs, min(len(pairs), r.choice([4, 5, 6])))
        for a, b in pairs:
            for copy in range(r.choice([1, 1, 1, 1, 2])):
                self._move(t, f"m{t}_{a.name}_{b.name}_{copy}", a, b, still, guarded)

    def _move(self, t, name, a, b, still, guarded):
        r = self.r
        m = self.p.add_activity(name, r.choice([0, 1, 2, 3, 3, 4, 6]), optional=self.chance(0.97))
        if self.chance(0.1):
            low = r.choice([0, 1, 3])
            m.set_duration_bounds(low, low + r.choice([2, 5]))
        at = self.at[t]
        origin = Equals(at(), a)
        if self.chance(0.1):
            origin = Or(origin, Equals(at(), r.choice([s for s in self.spots if s is not b])))
        m.add_condition(r.choice(self.origins)(m), origin)
        m.add_effect(m.end, at(), b)
        if still and self.chance(0.95):
            m.add_condition(inside(m), Equals(self.door(), self.door()))
        if guarded and b is self.inner and self.chance(0.95):
            m.add_condition(r.choice([late, late, whole, after])(m), self._opened())
        self.moves.append((t, m, a, b))
        self.busy[t].append(m)

    def _opened(self):
        return self.r.choice([Not(Equals(self.door(), self.shut)), Equals(self.door(), self.open)])

    # -- stops ---------------------------------------------------------------------------------
    def _stop(self, name, t, length, places, span, optional):
        a = self.p.add_activity(name, length, optional=optional)
        at = self.at[t]
        options = [Equals(at(), place) for place in places]
        a.add_condition(span(a), options[0] if len(options) == 1 else Or(options))
        self.stops.append(a)
        self.busy[t].append(a)
        return a

    def _tasks(self):
        r, ways = self.r, []
        for n in range(r.choice([1, 2, 2])):
            places = r.sample(self.spots, 2 if self.chance(0.2) else 1)
            length, span = r.choice([0, 1, 2, 2, 4]), r.choice(SPANS)
            if self.chance(0.1):
                # wanted by nobody, or only if something else is there
                a = self._stop(f"t{n}", r.choice(self.travellers), length, places, span, True)
                if self.chance(0.5):
                    self.p.add_constraint(Implies(r.choice(self.moves)[1].present, a.present))
                continue
            if self.chance(0.3):
                t = r.choice(self.travellers)
                ways.append([self._stop(f"t{n}", t, length, places, span, False)])
                continue
            ways.append(
                [self._stop(f"t{n}_{t}", t, length, places, span, True) for t in self.travellers]
            )
            self._exactly_one(ways[-1])
        for some, others in itertools.combinations(ways, 2):
            if self.chance(0.3):
                for a, b in itertools.product(some, others):
                    self.p.add_constraint(r.choice([LT, LE])(a.end, b.start), present(a, b))

    def _meet(self):
        """Let two travellers do something together, at the same place or at two."""
        r = self.r
        if len(self.travellers) < 2:
            return
        a = self._stop(
            "meet", 0, r.choice([0, 1, 3]), [r.choice(self.spots)], r.choice(SPANS), False
        )
        a.add_condition(r.choice(SPANS)(a), Equals(self.at[1](), r.choice(self.spots)))
        self.busy[1].append(a)

    def _exactly_one(self, activities):
        self.p.add_constraint(Or([a.present for a in activities]))
        for a, b in itertools.combinations(activities, 2):
            self.p.add_constraint(Or(Not(a.present), Not(b.present)))

    def _one_at_a_time(self, activities):
        before = self.r.choice([LT, LT, LE])
        for a, b in itertools.combinations(activities, 2):
            apart = Or(before(a.end, b.start), before(b.end, a.start))
            self.p.add_constraint(apart, present(a, b))

    def _doors(self):
        """Let stops, activities beside the routes, or the problem itself change the door."""
        r = self.r
        for n in range(r.choice([0, 1, 1, 2])):
            kind = r.choice(["stop", "free", "base"])
            value = r.choice([self.ajar, self.open, self.open, self.shut])
            if kind == "base":
                self.p.add_effect(GlobalStartTiming(5 * n + r.randint(1, 5)), self.door(), value)
                continue
            if kind == "free":
                a = self.p.add_activity(f"door{n}", r.choice([1, 3, 5]), optional=self.chance(0.5))
            else:
                t = r.choice(self.travellers)
                place = [r.choice(self.spots)]
                a = self._stop(f"door{n}", t, r.choice([1, 2]), place, r.choice(SPANS), True)
            if self.chance(0.7):
                a.add_condition(begin(a), Equals(self.door(), self.shut))
            a.add_effect(a.end, self.door(), value)

    def _openings(self, r):
        """Let everybody open the door from one place, again and again; seldom also shut it."""
        place, length = r.choice(self.spots), r.choice([1, 1, 2])
        value = r.choice([self.open, self.open, self.ajar])
        early = r.choice([0, 0, 1])
        for n, t in itertools.product(range(r.choice([1, 1, 2])), self.travellers):
            longer = r.random() < 0.1
            a = self._stop(f"open{n}_{t}", t, length + longer, [place], begin, True)
            shuts = r.random() < 0.1
            a.add_effect(Timing(-early, a.end), self.door(), self.shut if shuts else value)
            kind = r.random()
            if kind < 0.1:
                a.add_effect(a.end, self.flag(), True)
            elif kind < 0.2:
                self.p.add_constraint(Implies(r.choice(self.stops).present, a.present))
            elif kind < 0.3:
                self.p.add_constraint(LE(a.end, r.choice(self.stops).start), present(a))
            elif kind < 0.4:
                a.add_condition(begin(a), Equals(self.door(), self.shut))

    def _from_anywhere(self, r):
        """Add moves that start wherever their traveller is: how long they last hangs on that."""
        for t in self.travellers:
            for n, to in enumerate(r.sample(self.spots, r.choice([1, 1, 2]))):
                m = self.p.add_activity(f"f{t}_{n}", 1, optional=True)
                m.set_duration_bounds(r.choice([0, 1, 2]), 7)
                origin = m.add_parameter("origin", self.spot)
                span = r.choice([whole, whole, begin])(m)
                m.add_condition(span, Equals(self.at[t](), origin))
                m.add_effect(m.end, self.at[t](), to)
                for a in r.sample(self.spots, 2):
                    lasts = And(m.present, LE(m.start + r.choice([2, 4, 5]), m.end))
                    elsewhere = Not(Equals(origin, a))
                    self.p.add_constraint(Or(Not(m.present), lasts, elsewhere))
                self.busy[t].append(m)

    # -- what is beside the shape ----------------------------------------------------------------
    def _side_effects(self):
        r = self.r
        for _, m, a, b in r.sample(self.moves, min(3, len(self.moves))):
            kind = r.choice(["flag", "level", "lit", "door", "both"])
            if kind == "flag":
                m.add_effect(r.choice([m.start, m.end]), self.flag(), True)
            elif kind == "level":
                m.add_decrease_effect(r.choice([m.start, m.end]), self.level(), r.choice([1, 2]))
            elif kind == "lit":
                m.add_effect(m.end, self.lit(a), True)
            elif kind == "door":
                m.add_effect(m.start, self.door(), self.open)
            elif len(self.at) > 1 and m.effects and b is not a:
                other = self.at[1] if m.name.startswith("m0") else self.at[0]
                m.add_condition(begin(m), Equals(other(), a))
                m.add_effect(m.end, other(), b)
        for s in self.stops:
            kind = r.choice(["none", "none", "flag", "level", "lit", "sets"])
            if kind == "flag":
                s.add_condition(begin(s), r.choice([self.flag(), Not(self.flag())]))
            elif kind == "level":
                s.add_condition(begin(s), LE(self.level(), r.choice([0, 1])))
            elif kind == "lit":
                s.add_condition(begin(s), self.lit(r.choice(self.spots)))
            elif kind == "sets":
                s.add_effect(s.end, self.lit(r.choice(self.spots)), True)

    def _by_state(self):
        """Let effects and durations of stops hang on where a traveller is."""
        r = self.r
        if self.stops and self.chance(0.5):
            s = r.choice(self.stops)
            here = Equals(r.choice(self.at)(), r.choice(self.spots))
            s.add_effect(Timing(0, s.start), self.flag(), True, here)
            r.choice(self.stops).add_condition(finish(s), self.flag())
        elif self.stops:
            s, (_, m, _, _) = r.choice(self.stops), r.choice(self.moves)
            s.set_duration_bounds(self.level(), self.level())
            m.add_decrease_effect(m.end, self.level(), 1)

    def _dates(self):
        r = self.r
        for _, m, _, _ in r.sample(self.moves, min(2, len(self.moves))):
            if self.chance(0.6):
                m.add_release_date(r.randint(1, 9))
            else:
                m.add_deadline(r.randint(4, 12))

    def _orders(self):
        r, p = self.r, self.p
        for _ in range(r.choice([1, 2])):
            _, m, _, _ = r.choice(self.moves)
            s = r.choice([*self.stops, r.choice(self.moves)[1]])
            if s is m:
                continue
            kind = r.choice(["before", "apart", "together", "wanted", "window"])
            if kind == "before":
                p.add_constraint(LT(m.end, s.start), present(m, s))
            elif kind == "apart":
                p.add_constraint(Or(LT(m.end + 3, s.start), LT(s.end, m.start)), present(m, s))
            elif kind == "together" and m.optional and s.optional:
                p.add_constraint(Implies(s.present, m.present))
            elif kind == "wanted" and m.optional:
                p.add_constraint(m.present)
            elif kind == "window":
                p.add_constraint(LE(s.start, m.end + 2), present(m, s))

    def _unit(self):
        r = self.r
        places = r.sample(self.spots, r.choice([1, 1, 2]))
        free = self.p.add_fluent("free", IntType(0, 1), default_initial_value=r.choice([0, 1, 1]))
        for _, m, a, b in self.moves:
            if b in places:
                m.add_decrease_effect(m.end, free(), 1)
            if a in places:
                m.add_increase_effect(m.start, free(), 1)

    def _ends(self):
        r, p = self.r, self.p
        at = r.choice(self.at)
        home = Equals(at(), r.choice(self.spots))
        kind = r.choice(["home", "home", "then", "long", "within", "late"])
        if kind == "home":
            p.add_condition(TimePointInterval(GlobalEndTiming()), home)
        elif kind == "then":
            p.add_condition(TimePointInterval(GlobalEndTiming() - r.choice([1, 3])), home)
        elif kind == "long":
            p.add_constraint(GE(GlobalEndTiming(), r.choice([9, 15])))
        elif kind == "within":
            p.add_condition(TimePointInterval(GlobalEndTiming()), home)
            p.add_constraint(LE(GlobalEndTiming(), 60))
        elif self.stops:
            s = r.choice(self.stops)
            p.add_constraint(LE(s.end + r.choice([2, 5]), GlobalEndTiming()), present(s))


def present(*activities):
    return [a.present for a in activities if a.optional]


def random_routes(
    seed: int, *, batteries: bool = False, touching: bool = False
) -> SchedulingProblem:
    """Return the problem of a seed, with levels that moves take from if ``batteries``, and mostly
    with moves that need their origin right after their start only if ``touching``.
    """
    drawn = RandomRoutes(seed, touching=touching)
    for t in drawn.travellers if batteries else ():
        add_battery(drawn, t, random.Random(seed + (3 + t) * 10**6))
    return shuffled(drawn.p, seed).problem


def add_battery(drawn: RandomRoutes, t: int, r: random.Random) -> None:
    """Let a traveller's moves take from a level to which stops add (seldom also others do)."""
    capacity = r.choice([3, 5, 8])
    first = r.randint(1, capacity)
    level = drawn.p.add_fluent(f"battery{t}", IntType(0, capacity), default_initial_value=first)
    for who, m, _, _ in drawn.moves:
        if who == t and r.random() < 0.9:
            m.add_decrease_effect(r.choice([m.start, m.start, m.end]), level(), r.choice([1, 1, 2]))
    for n in range(r.choice([0, 1, 2])):
        place = [r.choice(drawn.spots)]
        a = drawn._stop(f"charge{n}_{t}", t, r.choice([0, 1, 2, 3]), place, r.choice(SPANS), True)
        a.add_increase_effect(r.choice([a.end, a.end, a.start]), level(), r.choice([1, 2, 3]))
        for b in drawn.busy[t][:-1]:
            apart = Or(LE(a.end, b.start), LE(b.end, a.start))
            drawn.p.add_constraint(apart, present(a, b))
    kind = r.random()
    if kind < 0.1 and drawn.stops:
        a = r.choice(drawn.stops)
        a.add_decrease_effect(a.end, level(), 1)
    elif kind < 0.2:
        a = drawn.p.add_activity(f"swap{t}", 1, optional=True)
        a.add_increase_effect(a.end, level(), 1)
