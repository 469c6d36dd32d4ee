"""Small random fleets that pick loads up and deliver them: what a robot carries is its own affair.

Who picks a load up delivers it, which is written in several ways, or left out; a fork that is taken
holds nothing more, told by a fluent of each robot that is read and set at various points in time.
Whatever can be listed is listed in a random order.
"""

from __future__ import annotations

import random

from unified_planning.model import (
    ClosedTimeInterval,
    GlobalStartTiming,
    LeftOpenTimeInterval,
    RightOpenTimeInterval,
    TimePointInterval,
    Timing,
)
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.shortcuts import (
    LE,
    LT,
    And,
    BoolType,
    Equals,
    Iff,
    Implies,
    IntType,
    Minus,
    Not,
    Or,
)

from tests.scheduling.cpsat.fleets import Fleet, FleetWriter

READ = {
    "start": lambda a: TimePointInterval(Timing(0, a.start)),
    "whole": lambda a: ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end)),
    "behind": lambda a: LeftOpenTimeInterval(Timing(0, a.start), Timing(0, a.end)),
    "before": lambda a: RightOpenTimeInterval(Timing(0, a.start), Timing(0, a.end)),
    "end": lambda a: TimePointInterval(Timing(0, a.end)),
    "later": lambda a: TimePointInterval(Timing(1, a.end)),
    "sooner": lambda a: TimePointInterval(Timing(-1, a.start)),
}
SET = {
    "end": lambda a: Timing(0, a.end),
    "end - 1": lambda a: Timing(-1, a.end),
    "start": lambda a: Timing(0, a.start),
    "later": lambda a: Timing(1, a.end),
    "much later": lambda a: Timing(3, a.end),
}


def random_loads(seed: int) -> Fleet:
    """Return a fleet whose visits come in pairs: 2 k picks load k up, 2 k + 1 delivers it."""
    r = random.Random(seed)
    robots = range(r.choice([1, 2, 2]))
    loads = range(r.choice([1, 2, 2]))
    spots = tuple(r.choice(range(0, 30, 3)) for _ in range(2 * len(loads)))
    able = []
    for _ in loads:
        some = tuple(q for q in robots if r.random() < 0.8) or (r.choice(robots),)
        able += [some, some]
    return Fleet(
        tuple(r.sample(range(1, 31, 3), len(robots))),
        spots,
        tuple(r.randint(1, 3) for _ in spots),
        tuple(able),
        home=r.random() < 0.3,
        alone=r.choice(["strictly", "after", "implies", "not both", "uses"]),
        one_of=r.choice(["not and", "not or", "implies"]),
    )


class CarrierWriter(FleetWriter):
    """Writes one; ``odd``: also at points in time, and in ways, at which nothing can be told."""

    def __init__(self, fleet: Fleet, seed: int, *, odd: bool = False) -> None:
        self.draw, self.odd = random.Random(seed + 10**6), odd
        self.optional = [odd and self.draw.random() < 0.3 for _ in fleet.able[::2]]
        self.forks = self.draw.random() < 0.8
        self.by_variable = self.draw.random() < 0.3
        pairs = [(2 * k, q) for k, some in enumerate(fleet.able[::2]) for q in some]
        self.driven = [p for p in pairs if self.draw.random() < 0.4]
        """(pickup, robot) of loads that are brought by a drive of their own."""
        self.drives: dict[tuple[int, int], Activity] = {}
        super().__init__(fleet, seed)

    def _activities(self):
        yield from (made for made in super()._activities() if len(made) < 4 or made[2] != made[3])
        for visit, q in self.driven:
            yield self._drive, visit, q

    def _drive(self, visit, q):
        a, b = self.fleet.spots[visit : visit + 2]
        length = max(1, abs(a - b))
        m = self._here(q, a, f"bring{visit}with{q}", length)
        m.set_duration_bounds(length, length + 3)
        m.add_effect(m.end, self.at[q](), self.places[b])
        self.drives[visit, q] = m

    def _statements(self):
        yield from super()._statements()
        for load in range(len(self.fleet.able) // 2):
            pairs = zip(self.by_robot(2 * load), self.by_robot(2 * load + 1), strict=True)
            for pick, deliver in pairs:
                yield lambda a=pick, b=deliver: self._same(a, b)
                drive = self.drives.get((2 * load, int(pick.name.split("by")[1].split("_")[0])))
                if drive is None:
                    yield lambda a=pick, b=deliver: self._before(a, b)
                    continue
                yield lambda a=pick, b=drive: self._same(a, b)
                for one, other in ((pick, drive), (drive, deliver)):
                    yield lambda a=one, b=other: self._after_it(a, b)
        for q in self.at if self.forks else ():
            yield lambda q=q: self.draw.choice([self._fork, self._fork, self._room])(q)

    def by_robot(self, visit):
        return sorted(self.visits[visit], key=lambda a: int(a.name.split("by")[1].split("_")[0]))

    def _exactly_one(self, some):
        visit = next(v for v, found in self.visits.items() if found is some)
        load = visit // 2
        if self.by_variable and not self.optional[load]:
            self._told_by_a_variable(visit, some)
        elif self.optional[load]:
            for i, a in enumerate(some):
                for b in some[:i]:
                    self.problem.add_constraint(Not(And(a.present, b.present)))
        else:
            super()._exactly_one(some)

    def _told_by_a_variable(self, visit, some):
        """Say it of who picks up alone, where who delivers is the same."""
        if visit % 2 == 0:
            who = self.problem.add_variable(f"{self.names.pop()}_who", IntType(0, 5))
            self.problem.add_constraint(Or([a.present for a in some]))
            for q, a in enumerate(self.by_robot(visit)):
                # odd: two have the same number
                number = 0 if self.odd and self.draw.random() < 0.2 else q
                self.problem.add_constraint(Equals(who, number), [a.present])
        elif self.odd:
            super()._exactly_one(some)

    def _same(self, pick, deliver):
        """Say that who picks a load up delivers it (odd: or only one half of that)."""
        a, b = pick.present, deliver.present
        how = self.draw.choice(["iff", "implies", "or", *(["half", "none"] if self.odd else [])])
        for part in {
            "iff": [Iff(a, b)],
            "implies": [Implies(a, b), Implies(b, a)],
            "or": [Or(Not(a), b), Or(a, Not(b))],
            "half": [self.draw.choice([Implies(a, b), Implies(b, a)])],
            "none": [],
        }[how]:
            self.problem.add_constraint(part)

    def _before(self, a, b):
        if self.odd and self.draw.random() < 0.2:
            self.problem.add_constraint(LE(a.start, b.start), [a.present, b.present])
        elif not self.odd or self.draw.random() < 0.9:
            super()._before(a, b)

    def _after_it(self, a, b):
        """Say that one comes after another (odd: not long before it)."""
        soon = self.draw.choice([4, 9]) if self.odd and self.draw.random() < 0.4 else 0
        said = LE(Minus(a.end, soon), b.start) if soon else LT(a.end, b.start)
        self.problem.add_constraint(said, self.listed([a.present, b.present]))

    def _room(self, q):
        """Room for one or two loads; some take it all."""
        room = self.problem.add_fluent(
            f"{self.names.pop()}_room{q}", IntType(0, 2), default_initial_value=2
        )
        for visit, some in self.visits.items():
            a = next((a for a in some if f"by{q}_" in a.name), None)
            if a is None or (self.odd and self.draw.random() < 0.1):
                continue
            odd = self.draw.choice(list(SET)) if self.odd else ""
            amount = random.Random(visit // 2).choice([1, 2, 2])
            if visit % 2 == 0:
                a.add_decrease_effect(SET[odd or "start"](a), room(), amount)
            else:
                a.add_increase_effect(SET[odd or "end"](a), room(), amount)
        if self.odd and self.draw.random() < 0.15:
            self.problem.add_increase_effect(GlobalStartTiming(self.draw.randint(1, 20)), room(), 1)

    def _fork(self, q):
        holds = self.problem.add_fluent(
            f"{self.names.pop()}_free{q}", BoolType(), default_initial_value=True
        )
        for visit, some in self.visits.items():
            a = next((a for a in some if f"by{q}_" in a.name), None)
            if a is None or (self.odd and self.draw.random() < 0.1):
                continue
            pick = visit % 2 == 0
            if pick or (self.odd and self.draw.random() < 0.3):
                span = READ[self.draw.choice(list(READ) if self.odd else ["start"])]
                a.add_condition(span(a), holds() if pick else Not(holds()))
            instant = SET[self.draw.choice(list(SET) if self.odd else ["end", "end - 1"])]
            a.add_effect(instant(a), holds(), not pick)
        if self.odd and self.draw.random() < 0.15:
            self.problem.add_effect(GlobalStartTiming(self.draw.randint(1, 20)), holds(), True)


def carriers(seed: int, *, odd: bool = False) -> SchedulingProblem:
    """Return a random problem."""
    return CarrierWriter(random_loads(seed), seed, odd=odd).problem
