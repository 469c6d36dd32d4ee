"""Small random problems with routes of which a part is no route, or written in rarer ways, by seed.

Beside what :mod:`random_routes` draws: moves whose origin and goal are parameters, effects at both
ends or anywhere in between, effects that depend on a state, cranes that move a traveller while it
does something else, and the problem itself, which puts it somewhere.
"""

from __future__ import annotations

import itertools
import random

from unified_planning.model import Fluent, GlobalStartTiming, Timing
from unified_planning.shortcuts import (
    GE,
    And,
    Equals,
    Implies,
    IntType,
    Not,
    Or,
)

from tests.scheduling.cpsat.random_routes import RandomRoutes, begin, finish, present, whole
from tests.shuffled import shuffled


class OddRoutes(RandomRoutes):
    """Draws one problem."""

    def _more(self, seed):
        self.o = o = random.Random(seed + 5 * 10**6)
        kinds = [self._crane, self._tow, self._via, self._maybe, self._late, self._base,
                 self._apart, self._copy, self._strange_stop]  # fmt: skip
        if o.random() < 0.3:
            self._go(o.choice(self.travellers))
        if o.random() < 0.2:
            self._transit(o.choice(self.travellers))
        for make in o.sample(kinds, o.choice([0, 1, 1, 2])):
            make(o.choice(self.travellers))

    def _activity(self, name, length):
        a = self.p.add_activity(name, length, optional=self.o.random() < 0.9)
        if self.o.random() < 0.2:
            a.set_duration_bounds(length, length + self.o.choice([1, 4]))
        return a

    def _crane(self, t):
        """Something that is not kept apart from the traveller's moves moves it."""
        o = self.o
        a = self._activity(f"crane{t}", o.choice([0, 1, 3]))
        if o.random() < 0.4:
            span = o.choice([begin, whole])(a)
            a.add_condition(span, Equals(self.at[t](), o.choice(self.spots)))
        a.add_effect(o.choice([a.start, a.end]), self.at[t](), o.choice(self.spots))
        if o.random() < 0.3:
            self.p.add_constraint(a.present if a.optional else GE(a.start, 2))

    def _tow(self, t):
        """A move from wherever the traveller is."""
        o = self.o
        a = self._activity(f"tow{t}", o.choice([1, 2, 3]))
        a.add_effect(
            o.choice([a.start, a.end, Timing(-1, a.end)]), self.at[t](), o.choice(self.spots)
        )
        self.busy[t].append(a)

    def _via(self, t):
        """A move by another place."""
        o = self.o
        a = self._activity(f"via{t}", o.choice([3, 4]))
        if o.random() < 0.8:
            a.add_condition(begin(a), Equals(self.at[t](), o.choice(self.spots)))
        a.add_effect(Timing(o.choice([0, 1, 2]), a.start), self.at[t](), o.choice(self.spots))
        a.add_effect(
            o.choice([a.end, a.end, Timing(-1, a.end)]), self.at[t](), o.choice(self.spots)
        )
        self.busy[t].append(a)

    def _maybe(self, t):
        """A move that only moves the traveller if something else is so."""
        o = self.o
        a = self._activity(f"maybe{t}", o.choice([1, 2]))
        if o.random() < 0.8:
            a.add_condition(begin(a), Equals(self.at[t](), o.choice(self.spots)))
        a.add_effect(
            a.end, self.at[t](), o.choice(self.spots), o.choice([self.flag(), Not(self.flag())])
        )
        if o.random() < 0.5:
            other = self.p.add_activity(f"sets{t}", 1, optional=True)
            other.add_effect(other.end, self.flag(), True)
        self.busy[t].append(a)

    def _late(self, t):
        """A move that is only seen later on."""
        o = self.o
        a = self._activity(f"late{t}", o.choice([1, 2]))
        a.add_condition(begin(a), Equals(self.at[t](), o.choice(self.spots)))
        a.add_effect(Timing(o.choice([1, 3]), a.end), self.at[t](), o.choice(self.spots))
        self.busy[t].append(a)

    def _base(self, t):
        o = self.o
        self.p.add_effect(GlobalStartTiming(o.randint(1, 8)), self.at[t](), o.choice(self.spots))

    def _apart(self, t):
        """One of the moves is not kept apart from the rest."""
        moves = [m for q, m, *_ in self.moves if q == t and m in self.busy[t]]
        if moves:
            self.busy[t].remove(self.o.choice(moves))

    def _copy(self, t):
        """A move to where another traveller is."""
        a = self._activity(f"copy{t}", self.o.choice([1, 2]))
        a.add_effect(a.end, self.at[t](), self.at[self.o.choice(self.travellers)]())
        self.busy[t].append(a)

    def _strange_stop(self, t):
        """A stop that needs one place in the beginning and another one in the end."""
        o = self.o
        a = self._activity(f"drawn{t}", o.choice([2, 3]))
        a.add_condition(begin(a), Equals(self.at[t](), o.choice(self.spots)))
        a.add_condition(finish(a), Equals(self.at[t](), o.choice(self.spots)))
        self.busy[t].append(a)

    def _transit(self, t):
        """While it drives, the traveller is on the road."""
        road = self.p.add_object(f"road{t}", self.spot)
        for _, m, *_ in (x for x in self.moves if x[0] == t):
            if not any(timing.is_from_start() for timing in m.effects):
                m.clear_conditions()
                m.add_condition(begin(m), Equals(self.at[t](), self.o.choice(self.spots)))
                m.add_effect(m.start, self.at[t](), road)

    def _go(self, t):
        """Moves of which parameters say from where to where."""
        o = self.o
        lengths = {p: o.choice([1, 2, 3, 5]) for p in itertools.permutations(self.spots, 2)}
        closed = o.sample(sorted(lengths, key=str), o.choice([0, 0, 1, 2]))
        how = o.choice(["inside", "scope", "fluent"])
        if how == "fluent":
            far = Fluent(f"far{t}", IntType(0, 9), a=self.spot, b=self.spot)
            self.p.add_fluent(far, default_initial_value=1)
            for (a, b), length in lengths.items():
                self.p.set_initial_value(far(a, b), length)
        fixed = o.random() < 0.3
        for n in range(o.choice([1, 2])):
            m = self.p.add_activity(f"go{t}_{n}", 1, optional=True)
            m.set_duration_bounds(1, 6)
            source = o.choice(self.spots) if fixed else m.add_parameter("source", self.spot)
            to = m.add_parameter("to", self.spot)
            if how == "fluent":
                m.set_duration_bounds(far(source, to), 9)
            m.add_condition(o.choice([begin, begin, whole])(m), Equals(self.at[t](), source))
            m.add_effect(o.choice([m.end, Timing(-1, m.end)]), self.at[t](), to)
            for (a, b), length in lengths.items():
                chosen = And(Equals(source, a), Equals(to, b))
                lasts = GE(m.end, m.start + length)
                if how == "inside":
                    m.add_constraint(Implies(chosen, lasts))
                elif how == "scope":
                    self.p.add_constraint(Or(Not(chosen), lasts), present(m))
                if (a, b) in closed:
                    m.add_constraint(Not(chosen))
            if o.random() < 0.5:
                m.add_constraint(Not(Equals(source, to)))
            self.busy[t].append(m)
            if o.random() < 0.5:
                break


def odd_routes(seed):
    """Return the problem of a seed."""
    return shuffled(OddRoutes(seed).p, seed).problem
