"""One site of robots, places, doors and tasks, written as a scheduling problem in many styles.

A :class:`Site` is what is meant; a :class:`Style` is how an author writes it. Sites say nothing of
the unit that may pass between one thing and the next (``Style.units``); styles that agree on that
have the same optimum.
"""

from __future__ import annotations

import itertools
import random
from dataclasses import dataclass, field, fields

from unified_planning.model import (
    ClosedTimeInterval,
    Fluent,
    GlobalEndTiming,
    LeftOpenTimeInterval,
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
    Iff,
    Implies,
    IntType,
    MinimizeMakespan,
    Not,
    Or,
    UserType,
)


@dataclass(frozen=True)
class Task:
    """Done once, by one robot, at one of ``places``; after the tasks in ``after``."""

    places: tuple[int, ...]
    length: int
    machine: int | None = None
    after: tuple[int, ...] = ()


@dataclass(frozen=True)
class Site:
    """``roads[a, b]`` is how long a move takes; ``doors[place]`` is where its door is opened.

    ``starts`` are places. ``home``: all have to be where they started in the end. ``private``:
    nobody goes where another one starts. ``visits[robot]`` is where it has to arrive some time.
    """

    starts: tuple[int, ...]
    roads: dict[tuple[int, int], int]
    tasks: tuple[Task, ...]
    doors: dict[int, int] = field(default_factory=dict)
    home: bool = False
    private: bool = False
    visits: dict[int, int] = field(default_factory=dict)

    def ways(self, robot: int) -> list[tuple[tuple[int, int], int]]:
        """Return the roads of a robot."""
        closed = set(self.starts) - {self.starts[robot]} if self.private else set()
        return [(pair, length) for pair, length in self.roads.items() if not closed & {*pair}]

    @property
    def places(self) -> list[int]:
        """All places."""
        return sorted({*self.starts, *itertools.chain(*self.roads)})


_STRICT = ("strictly", "busy", "held")


@dataclass(frozen=True)
class Style:
    """How a site is written."""

    arrive: str = "end - 1"  # end | end - 1 | start + d
    origin: str = "start"  # start | whole | until end
    lasts: str = "fixed"  # fixed | bounds
    alone: str = "after"  # after | strictly | implies | not both | uses | level | busy | held
    machine: str = "after"
    one_of: str = "pairs"  # pairs | nested | inside | variables
    order: str = "scope"  # scope | implies | inside
    fluents: str = "own"  # own | parameter | precedences
    shuffled: int = 0
    spoiled: int = 0
    """A seed: by it some of what a pattern consists of is left out, so that it is none."""

    @property
    def units(self) -> tuple[int, ...]:
        """The units of time that pass after a move's end until its effect is seen, between what
        one robot does, between what one machine does, and until a door's opening is seen
        (and what spoils the style).
        """
        late = self.fluents != "precedences" and self.arrive == "end"
        alone, machine = (int(how in _STRICT) for how in (self.alone, self.machine))
        last = (int(self.arrive == "end"), self.spoiled)
        return max(int(late), alone), alone, machine, *last

    def __str__(self) -> str:
        base = Style()
        changed = [f.name for f in fields(self) if getattr(self, f.name) != getattr(base, f.name)]
        return ", ".join(f"{name} {getattr(self, name)}" for name in changed) or "published"


TIGHT = [
    Style(),
    Style(origin="until end"),
    Style(arrive="start + d"),
    Style(lasts="bounds"),
    Style(alone="implies", order="implies"),
    Style(alone="not both", one_of="nested"),
    Style(alone="uses", machine="uses"),
    Style(alone="level", lasts="bounds"),
    Style(one_of="inside", order="inside"),
    Style(one_of="variables", machine="uses"),
    Style(fluents="parameter", alone="uses", one_of="nested", order="inside"),
    Style(fluents="precedences"),
    Style(fluents="precedences", alone="uses", one_of="nested", order="inside", machine="uses"),
    Style(shuffled=1),
    Style(fluents="precedences", shuffled=2, lasts="bounds"),
]
LOOSE = [
    Style(arrive="end", alone="strictly", machine="strictly", origin="whole"),
    Style(arrive="end", alone="strictly", machine="busy"),
    Style(arrive="end", alone="strictly", machine="held", fluents="parameter", shuffled=3),
    Style(arrive="end", alone="busy", machine="strictly"),
    Style(alone="busy", machine="busy", order="inside", one_of="nested"),
    Style(alone="held", machine="busy", fluents="parameter"),
    Style(alone="held", machine="held", one_of="variables"),
    Style(alone="busy", machine="held", fluents="precedences"),
]
SPOILED = [
    Style(fluents="precedences", spoiled=1),
    Style(fluents="precedences", one_of="nested", spoiled=2),
    Style(fluents="precedences", spoiled=3),
    Style(alone="busy", machine="held", spoiled=4),
    Style(alone="held", machine="busy", one_of="variables", spoiled=5),
    Style(alone="uses", machine="level", one_of="inside", spoiled=6),
    Style(spoiled=7),
]


def write(site: Site, style: Style) -> SchedulingProblem:
    """Return a site written in a style."""
    return Writer(site, style).problem


class Writer:
    """Writes one problem."""

    def __init__(self, site: Site, style: Style) -> None:
        self.site, self.style = site, style
        self.rng = random.Random(style.shuffled)
        self.luck = random.Random(style.spoiled)
        self.robots = range(len(site.starts))
        self.problem = self._begin()
        self.at = self._fluents()
        self.open = self._doors()
        self.holds = 0
        self.moves, self.works, self.openings = [], [], []
        for make in self.shuffle([self._all_moves, self._all_tasks, self._all_openings]):
            make()
        self._where()
        for r in self.robots:
            self._alone([a for q, a, *_ in self._doings() if q == r], style.alone)
        machines = {t.machine for t in site.tasks} - {None}
        for machine in sorted(machines):
            some = [a for _, a, t in self.works if site.tasks[t].machine == machine]
            self._alone(some, style.machine, self._same_task())
        for t in range(len(site.tasks)):
            self._exactly_one(t)
            for before in site.tasks[t].after:
                self._in_order(before, t)
        for r, p in site.visits.items():
            arriving = [m.present for q, m, _, b in self.moves if (q, b) == (r, p)]
            self.problem.add_constraint(Or(arriving))
        self._finish()
        self.problem.add_quality_metric(MinimizeMakespan())

    # -- what other kinds of problems do differently ---------------------------------------------
    def _begin(self):
        """Return the problem with its places (``spots``) and robots (``bodies``)."""
        problem = SchedulingProblem(f"site in style: {self.style}")
        self.spot, self.robot = UserType("spot"), UserType("robot")
        places = self.shuffle(self.site.places)
        self.spots = {p: problem.add_object(self.name("p", p), self.spot) for p in places}
        self.bodies = [problem.add_object(self.name("r", r), self.robot) for r in self.robots]
        return problem

    def _doors(self):
        """Return the fluents that say which doors are open."""
        return {
            p: self.problem.add_fluent(f"open{p}", BoolType(), default_initial_value=False)
            for p in self.site.doors
        }

    def _road(self, r, a, b, length):
        """Return the move of a robot along a road."""
        m = self.problem.add_activity(self.name(f"move{a}to{b}by", r), length, optional=True)
        if self.style.lasts == "bounds":
            m.set_duration_bounds(length, length + 7)
        if b in self.open:
            m.add_condition(
                ClosedTimeInterval(Timing(1, m.start), Timing(0, m.end)), self.open[b]()
            )
        return m

    def _opening(self, r, p):
        """Return how a robot opens a door."""
        a = self.problem.add_activity(self.name(f"open{p}by", r), 1, optional=True)
        delay = 0 if self.style.arrive == "end" else -1
        a.add_effect(Timing(delay, a.end), self.open[p](), True)
        return a

    def _able(self, t):
        """Return who may do a task."""
        return self.robots

    def _finish(self):
        """State what else is asked for."""

    def name(self, kind, number):
        """Return the name of a thing; shuffled styles have other ones, in another order."""
        return (
            f"{kind}{number}"
            if not self.style.shuffled
            else f"{'zyxwvut'[number % 7]}{kind}{number}"
        )

    def kept(self):
        """Return whether a part of a pattern is written (it always is in a style not spoiled)."""
        return not self.style.spoiled or self.luck.random() < 0.9

    def shuffle(self, things):
        things = list(things)
        if self.style.shuffled:
            self.rng.shuffle(things)
        return things

    def _doings(self):
        moves = [(r, a) for r, a, *_ in self.moves]
        return self.shuffle([*moves, *((r, a) for r, a, _ in [*self.works, *self.openings])])

    def _same_task(self):
        return {a.name: t for _, a, t in self.works}

    # -- activities ------------------------------------------------------------------------------
    def _fluents(self):
        if self.style.fluents == "parameter":
            fluent = Fluent("at", self.spot, robot=self.robot)
            self.problem.add_fluent(fluent)
            for body, start in zip(self.bodies, self.site.starts, strict=True):
                self.problem.set_initial_value(fluent(body), self.spots[start])
            return [fluent(body) for body in self.bodies]
        if self.style.fluents == "own":
            return [
                self.problem.add_fluent(f"at{r}", self.spot, default_initial_value=self.spots[s])()
                for r, s in enumerate(self.site.starts)
            ]
        return []

    def _all_moves(self):
        for r in self.shuffle(self.robots):
            for (a, b), length in self.shuffle(self.site.ways(r)):
                self.moves.append((r, self._road(r, a, b, length), a, b))

    def _all_tasks(self):
        for t, task in self.shuffle(enumerate(self.site.tasks)):
            for r in self.shuffle(self._able(t)):
                a = self.problem.add_activity(
                    self.name(f"task{t}by", r), task.length, optional=True
                )
                self.works.append((r, a, t))

    def _all_openings(self):
        for p in self.shuffle(self.site.doors):
            for r in self.shuffle(self.robots):
                self.openings.append((r, self._opening(r, p), p))

    # -- where robots are ------------------------------------------------------------------------
    def _needs(self):
        """Return (robot, activity, places where it may start)."""
        found = [(r, m, (a,)) for r, m, a, _ in self.moves]
        found += [(r, a, self.site.tasks[t].places) for r, a, t in self.works]
        return found + [(r, a, (self.site.doors[p],)) for r, a, p in self.openings]

    def _where(self):
        if self.style.fluents == "precedences":
            for r, a, places in self._needs():
                self.problem.add_constraint(self._helped(r, a, places), [a.present])
            for r in self.robots:
                if self.site.home:
                    self._come_home(r)
            return
        for r, m, _, b in self.moves:
            m.add_effect(self._arrival(r, m), self.at[r], self.spots[b])
        for r, a, places in self._needs():
            options = [Equals(self.at[r], self.spots[p]) for p in self.shuffle(places)]
            moves = any(a is m for _, m, *_ in self.moves)
            a.add_condition(self._span(a, moves), options[0] if len(options) == 1 else Or(options))
        if self.site.home:
            for r, start in enumerate(self.site.starts):
                home = Equals(self.at[r], self.spots[start])
                self.problem.add_condition(TimePointInterval(GlobalEndTiming()), home)

    def _arrival(self, r, m):
        if self.style.arrive == "start + d":
            length = int(m.duration.lower.constant_value())
            return Timing(length - 1, m.start)
        return Timing(-1 if self.style.arrive == "end - 1" else 0, m.end)

    def _span(self, a, moves):
        if self.style.origin == "start" or (moves and self.style.arrive != "end"):
            return TimePointInterval(Timing(0, a.start))
        if self.style.origin == "whole":
            return ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end))
        return RightOpenTimeInterval(Timing(0, a.start), Timing(0, a.end))

    def _rivals(self, r, *but):
        return [m for q, m, *_ in self.moves if q == r and all(m is not b for b in but)]

    def _helped(self, r, a, places):
        """Return that some move to one of ``places`` was the last one before ``a``."""
        options = []
        for q, h, _, b in self.shuffle(self.moves):
            if q == r and b in places and h is not a:
                undone = [
                    Implies(m.present, Or(LE(m.end, h.start), GE(m.start, a.end)))
                    for m in self._rivals(r, a, h)
                    if self.kept()
                ]
                options.append(And(h.present, LE(h.end, a.start), *undone))
        if self.site.starts[r] in places:
            options.append(
                And(
                    [
                        Implies(m.present, GE(m.start, a.end))
                        for m in self._rivals(r, a)
                        if self.kept()
                    ]
                )
            )
        return Or(options)

    def _come_home(self, r):
        """State that who leaves comes back, after everything it has moved for."""
        home = self.site.starts[r]
        back = [m for q, m, _, b in self.moves if q == r and b == home]
        for q, m, _, b in self.moves:
            if q == r and b != home:
                self.problem.add_constraint(
                    Or([And(h.present, LE(m.end, h.start)) for h in back]), [m.present]
                )

    # -- one at a time ---------------------------------------------------------------------------
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

    # -- who does what ---------------------------------------------------------------------------
    def _ways(self, t):
        return [a for _, a, task in self.works if task == t]

    def _exactly_one(self, t):
        ways, how = self._ways(t), self.style.one_of
        if how == "variables":
            chosen = [self.problem.add_variable(f"chosen_{a.name}", BoolType()) for a in ways]
            for a, variable in zip(ways, chosen, strict=True):
                self.problem.add_constraint(Iff(variable, a.present))
            self.problem.add_constraint(Or([v for v in chosen]))
            for v, w in itertools.combinations(chosen, 2):
                self.problem.add_constraint(Not(And(v, w)))
            return
        self.problem.add_constraint(Or([a.present for a in ways]))
        for a in ways:
            others = [b.present for b in ways if b is not a]
            if not others:
                continue
            if how == "nested":
                self.problem.add_constraint(Implies(a.present, Not(Or(others))))
            elif how == "inside":
                a.add_constraint(Not(Or(others)))
            else:
                for other in others if self.kept() else []:
                    self.problem.add_constraint(Or(Not(a.present), Not(other)))

    def _in_order(self, before, then):
        for b in self._ways(then):
            earlier = self._ways(before)
            if self.style.order == "inside":
                b.add_constraint(And([Implies(a.present, GE(b.start, a.end)) for a in earlier]))
                continue
            for a in earlier:
                if self.style.order == "implies":
                    both = And(a.present, b.present)
                    self.problem.add_constraint(Implies(both, LE(a.end, b.start)))
                else:
                    self.problem.add_constraint(LE(a.end, b.start), [a.present, b.present])


# -- sites ---------------------------------------------------------------------------------------
def shop(robots: int, jobs: int, machines: int, seed: int = 0) -> Site:
    """Return a job shop like the published ones: every machine in a room with a door."""
    rng = random.Random(seed)
    spots = [(30 + 25 * m + rng.randint(-4, 4), 41) for m in range(machines)]
    spots += [(30 + 25 * m, 29) for m in range(machines)]
    starts = tuple(range(2 * machines, 2 * machines + robots))
    spots += [(rng.randint(5, 25 * machines + 30), rng.choice([20, 25])) for _ in range(robots)]
    tasks: list[Task] = []
    for _ in range(jobs):
        order = rng.sample(range(machines), machines)
        for i, m in enumerate(order):
            after = (len(tasks) - 1,) if i else ()
            tasks.append(Task((m,), rng.randint(1, 10), m, after))
    places = [*range(2 * machines), *starts]
    roads = {pair: _length(spots, *pair) for pair in itertools.permutations(places, 2)}
    return Site(starts, roads, tuple(tasks), {m: machines + m for m in range(machines)})


def store(robots: int, items: int, seed: int = 0) -> Site:
    """Return logistics like the published one: out to an item and home, items on two sides."""
    rng = random.Random(seed)
    spots = [(60 + 12 * (i % 4), 32 - 5 * (i // 4)) for i in range(items)]
    spots += [(60 + 12 * (i % 4), 42 - 25 * (i // 4)) for i in range(items)]
    spots += [(46, 30)]
    spots += [(15 + 10 * r, 59) for r in range(robots)]
    button, starts = 2 * items, tuple(range(2 * items + 1, 2 * items + 1 + robots))
    roads = {}
    for place in (*range(2 * items), button):
        for home in starts:
            roads[home, place] = roads[place, home] = _length(spots, home, place)
        if place != button:
            roads[button, place] = _length(spots, button, place)
    tasks = tuple(Task((i, items + i), rng.randint(1, 2)) for i in range(items))
    return Site(starts, roads, tasks, dict.fromkeys(range(items), button), True, True)


def _length(spots, a, b):
    (x, y), (u, v) = spots[a], spots[b]
    return max(1, int(((x - u) ** 2 + (y - v) ** 2) ** 0.5 / 2))


def small(seed: int) -> Site:
    """Return a random site that is small enough to be solved constraint by constraint."""
    rng = random.Random(seed)
    places = range(rng.choice([2, 3, 3]))
    starts = tuple(rng.choice(places) for _ in range(rng.choice([1, 1, 2])))
    pairs = list(itertools.permutations(places, 2))
    roads = {
        p: rng.randint(1, 4) for p in rng.sample(pairs, rng.randint(len(pairs) // 2, len(pairs)))
    }
    tasks = []
    for t in range(rng.choice([1, 2, 2, 3])):
        spots = tuple(rng.sample(list(places), rng.choice([1, 1, 2])))
        after = (rng.randrange(t),) if t and rng.random() < 0.4 else ()
        tasks.append(Task(spots, rng.randint(1, 3), rng.choice([None, 0, 1]), after))
    doors = {rng.choice(places): rng.choice(places)} if rng.random() < 0.4 else {}
    home = rng.random() < 0.3
    visits = {r: rng.choice(places) for r in range(len(starts)) if rng.random() < 0.4}
    return Site(starts, roads, tuple(tasks), doors, home, visits=visits)
