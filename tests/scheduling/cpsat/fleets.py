"""Small random fleets of which each visit is made by exactly one robot, with the optimum found by
looking at all orders; whatever can be listed is listed in a random order.
"""

from __future__ import annotations

import itertools
import random
from dataclasses import dataclass

from unified_planning.model import ClosedTimeInterval, GlobalEndTiming, TimePointInterval
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    LE,
    And,
    BoolType,
    Equals,
    Iff,
    Implies,
    MinimizeMakespan,
    Not,
    Or,
    UserType,
)

from tests.scheduling.cpsat.one_at_a_time import OneAtATime


@dataclass(frozen=True)
class Fleet:
    """Robots at spots on a line, visits at others. ``able[v]`` are who may make a visit, ``after``
    pairs (before, then); ``extra`` is how much longer it takes each robot after the first.
    ``alone`` is how it is written that a robot does one thing at a time.
    """

    starts: tuple[int, ...]
    spots: tuple[int, ...]
    lengths: tuple[int, ...]
    able: tuple[tuple[int, ...], ...]
    after: tuple[tuple[int, int], ...] = ()
    home: bool = False
    alone: str = "strictly"
    one_of: str = "not and"
    extra: int = 0

    @property
    def gap(self) -> int:
        """Time between a visit and what its robot does next."""
        return int(self.alone == "strictly")

    def length(self, visit: int, robot: int) -> int:
        return self.lengths[visit] + self.extra * robot


def random_fleet(seed: int, *, robots: int = 3, visits: int = 4) -> Fleet:
    """Return a fleet of at most so many robots and visits."""
    r = random.Random(seed)
    some = range(r.randint(1, robots))
    spots = tuple(r.sample(range(0, 40, 3), r.randint(1, visits)))
    numbers = range(len(spots))
    able = [tuple(q for q in some if r.random() < 0.8) or (r.choice(some),) for _ in spots]
    pairs = [p for p in itertools.combinations(numbers, 2) if r.random() < 0.2]
    return Fleet(
        tuple(r.sample(range(1, 40, 3), len(some))),
        spots,
        tuple(r.randint(1, 4) for _ in spots),
        tuple(able),
        tuple(pairs),
        r.random() < 0.5,
        r.choice(["strictly", "after", "implies", "not both", "uses", "uses"]),
        r.choice(["not and", "not or", "implies", "variables"]),
        r.choice([0, 0, 0, 0, 2]),
    )


def optimum(fleet: Fleet) -> int:
    """Return the least makespan, from all ways to share and order the visits."""
    best = 10**9
    for who in itertools.product(*fleet.able):
        shares = [[v for v, q in enumerate(who) if q == r] for r in range(len(fleet.starts))]
        for tours in itertools.product(*(itertools.permutations(some) for some in shares)):
            best = min(best, _makespan(fleet, who, tours, best))
    return best


def _makespan(fleet: Fleet, who, tours, best: int) -> int:
    starts = [0] * len(fleet.spots)
    for _ in range(len(starts) + 1):
        before, last = list(starts), 0
        for robot, tour in enumerate(tours):
            here, free = fleet.starts[robot], 0
            for visit in tour:
                free += abs(fleet.spots[visit] - here) + 1
                starts[visit] = max(starts[visit], free)
                here, end = fleet.spots[visit], starts[visit] + fleet.length(visit, robot)
                free, last = end + fleet.gap, max(last, end)
            if fleet.home and tour:
                last = max(last, free + abs(fleet.starts[robot] - here))
        for one, then in fleet.after:
            end = starts[one] + fleet.length(one, who[one])
            starts[then] = max(starts[then], end)
        if last >= best:
            return best
        if starts == before:
            return last
    return best  # they wait for each other


class FleetWriter(OneAtATime):
    """Writes a fleet; ``seed`` of the order in which everything is listed, and of all names."""

    def __init__(self, fleet: Fleet, seed: int) -> None:
        self.fleet, self.holds = fleet, 0
        self.r = random.Random(seed)
        self.problem = SchedulingProblem("fleet")
        self.spot = UserType("spot")
        self.names = self.listed(f"x{k}" for k in range(60))
        places = [*fleet.spots, *fleet.starts]
        self.places = {
            p: self.problem.add_object(f"{self.names.pop()}_p{p}", self.spot)
            for p in self.listed(places)
        }
        self.at = {
            q: self.problem.add_fluent(
                f"{self.names.pop()}_at{q}", self.spot, default_initial_value=self.places[s]
            )
            for q, s in self.listed(enumerate(fleet.starts))
        }
        self.visits = {}
        self.busy = {q: [] for q in self.at}
        for make, *what in self.listed(self._activities()):
            make(*what)
        for state in self.listed(self._statements()):
            state()
        self.problem.add_quality_metric(MinimizeMakespan())

    def listed(self, things):
        things = list(things)
        self.r.shuffle(things)
        return things

    def kept(self):
        return True

    def _activities(self):
        fleet = self.fleet
        for q, start in enumerate(fleet.starts):
            for a, b in itertools.permutations([start, *fleet.spots], 2):
                yield self._move, q, a, b
        for v, some in enumerate(fleet.able):
            for q in some:
                yield self._visit, v, q

    def _move(self, q, a, b):
        m = self._here(q, a, f"move{q}", abs(a - b))
        m.add_effect(m.end, self.at[q](), self.places[b])

    def _visit(self, v, q):
        made = self._here(q, self.fleet.spots[v], f"visit{v}by{q}", self.fleet.length(v, q))
        self.visits.setdefault(v, []).append(made)

    def _here(self, q, place, name, length):
        name = f"{self.r.choice('abc')}{name}_{len(self.busy[q])}"
        made = self.problem.add_activity(name, length, optional=True)
        here = self.listed([self.at[q](), self.places[place]])
        made.add_condition(ClosedTimeInterval(made.start, made.end), Equals(*here))
        self.busy[q].append(made)
        return made

    def _statements(self):
        for q, at in self.at.items():
            yield lambda q=q: self._alone(self.listed(self.busy[q]), self.fleet.alone)
            if self.fleet.home:
                home = Equals(at(), self.places[self.fleet.starts[q]])
                yield lambda home=home: self.problem.add_condition(
                    TimePointInterval(GlobalEndTiming()), home
                )
        for some in self.visits.values():
            yield lambda some=some: self._exactly_one(some)
        for one, then in self.fleet.after:
            for a, b in itertools.product(self.visits[one], self.visits[then]):
                yield lambda a=a, b=b: self._before(a, b)

    def _before(self, a, b):
        both = self.listed([a.present, b.present])
        if self.r.random() < 0.5:
            self.problem.add_constraint(LE(a.end, b.start), both)
        else:
            self.problem.add_constraint(Implies(And(both), GE(b.start, a.end)))

    def _exactly_one(self, some):
        how, said = self.fleet.one_of, [a.present for a in some]
        if how == "variables":
            said = [
                self.problem.add_variable(f"{self.names.pop()}_chosen", BoolType()) for _ in some
            ]
            pairs = self.listed(zip(said, some, strict=True))
            for variable, a in pairs:
                self.problem.add_constraint(Iff(*self.listed([variable, a.present])))
        parts = [Or(self.listed(said))]
        for one, other in itertools.combinations(self.listed(said), 2):
            parts.append(
                {
                    "not or": lambda a, b: Or(Not(a), Not(b)),
                    "implies": lambda a, b: Implies(a, Not(b)),
                }.get(how, lambda a, b: Not(And(a, b)))(one, other)
            )
        for part in self.listed(parts):
            self.problem.add_constraint(part)


def write_fleet(fleet: Fleet, seed: int) -> SchedulingProblem:
    """Return a fleet as a problem, listed in the order of ``seed``."""
    return FleetWriter(fleet, seed).problem
