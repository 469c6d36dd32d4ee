"""One site of robots, places, doors and tasks, written as a scheduling problem in a style."""

from __future__ import annotations

import itertools
import random

from unified_planning.model import (
    ClosedTimeInterval,
    Fluent,
    GlobalEndTiming,
    RightOpenTimeInterval,
    TimePointInterval,
    Timing,
)
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
from tests.scheduling.cpsat.sites import Site
from tests.scheduling.cpsat.styles import Style
from tests.shuffled import shuffled


def write(site: Site, style: Style) -> SchedulingProblem:
    """Return a site written in a style."""
    return listed(Writer(site, style).problem, style)


def listed(problem: SchedulingProblem, style: Style) -> SchedulingProblem:
    """Return a problem in the listing that its style says."""
    return shuffled(problem, style.shuffled).problem if style.shuffled else problem


class Writer(OneAtATime):
    """Writes one problem."""

    def __init__(self, site: Site, style: Style) -> None:
        self.site, self.style = site, style
        self.luck = random.Random(style.spoiled)
        self.robots = range(len(site.starts))
        self.problem = self._begin()
        self.at = self._fluents()
        self.open = self._doors()
        self.holds = 0
        self.moves, self.works, self.openings = [], [], []
        self.ends = {}
        self._all_moves()
        self._all_tasks()
        self._all_openings()
        self._where()
        for r in self.robots:
            self._alone([a for q, a, *_ in self._doings() if q == r], style.alone)
        machines = {t.machine for t in site.tasks} - {None}
        for machine in sorted(machines):
            some = [a for _, a, t in self.works if site.tasks[t].machine == machine]
            self._alone(some, style.machine, self._same_task())
        for t in range(len(site.tasks)):
            self._exactly_one(t)
            self._release(t)
            for before in site.tasks[t].after:
                self._in_order(before, t)
        for r, p in site.visits.items():
            self.problem.add_constraint(Or(self._arriving(r, p)))
        self._finish()
        self.problem.add_quality_metric(MinimizeMakespan())

    # -- what other kinds of problems do differently ---------------------------------------------
    def _begin(self):
        """Return the problem with its places (``spots``) and robots (``bodies``)."""
        problem = SchedulingProblem(f"site in style: {self.style}")
        self.spot, self.robot = UserType("spot"), UserType("robot")
        self.spots = {p: problem.add_object(f"p{p}", self.spot) for p in self.site.places}
        self.bodies = [problem.add_object(f"r{r}", self.robot) for r in self.robots]
        if self.style.way == "road":
            self.roads = [problem.add_object(f"road{r}", self.spot) for r in self.robots]
        return problem

    def _doors(self):
        """Return the fluents that say which doors are open."""
        return {
            p: self.problem.add_fluent(f"open{p}", BoolType(), default_initial_value=False)
            for p in self.site.doors
        }

    def _road(self, r, a, b, length):
        """Return the move of a robot along a road."""
        m = self.problem.add_activity(f"move{a}to{b}by{r}", length, optional=True)
        if self.style.lasts == "bounds":
            m.set_duration_bounds(length, length + 7)
        if b in self.open:
            m.add_condition(
                ClosedTimeInterval(Timing(1, m.start), Timing(0, m.end)), self.open[b]()
            )
        return m

    def _opening(self, r, p):
        """Return how a robot opens a door."""
        a = self.problem.add_activity(f"open{p}by{r}", 1, optional=True)
        delay = 0 if self.style.arrive == "end" else -1
        a.add_effect(Timing(delay, a.end), self.open[p](), True)
        return a

    def _able(self, t):
        """Return who may do a task."""
        return self.robots

    def _finish(self):
        """State what else is asked for."""

    def kept(self):
        """Return whether a part of a pattern is written (it always is in a style not spoiled)."""
        return not self.style.spoiled or self.luck.random() < 0.9

    def _doings(self):
        moves = [(r, a) for r, a, *_ in self.moves]
        return [*moves, *((r, a) for r, a, _ in [*self.works, *self.openings])]

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
        for r in self.robots:
            roads = dict(self.site.ways(r))
            if self.style.moves == "each":
                for (a, b), length in roads.items():
                    self.moves.append((r, self._road(r, a, b, length), a, b))
            elif self.style.moves == "go":
                self._guided(r, None, roads)
            else:
                for origin in dict.fromkeys(a for a, _ in roads):
                    self._guided(r, origin, {w: n for w, n in roads.items() if w[0] == origin})

    def _guided(self, r, origin, roads):
        """Write as many moves as there are roads; parameters say which roads they take."""
        some = []
        for copy in range(len(roads)):
            m = self._guide(r, origin, roads, copy)
            m.add_constraint(Or([self._takes(m, a, b) for a, b in roads]))
            for other in some:
                same = [And(self._takes(m, *w), self._takes(other, *w)) for w in roads]
                both = [m.present, other.present]
                for way in same:
                    self.problem.add_constraint(Not(way), both)
            some.append(m)
            self.moves.append((r, m, origin, None))

    def _guide(self, r, origin, roads, copy):
        """Return a move of a robot along one of some roads."""
        name = "go" if origin is None else f"leave{origin}"
        m = self.problem.add_activity(f"{name}copy{copy}by{r}", 1, optional=True)
        more = 7 if self.style.lasts == "bounds" else 0
        m.set_duration_bounds(min(roads.values()), max(roads.values()) + more)
        self._decide(m, origin)
        for (a, b), length in roads.items():
            lasts = And(GE(m.end, m.start + length), LE(m.end, m.start + (length + more)))
            m.add_constraint(Or(Not(self._takes(m, a, b)), lasts))
        for b in self.open:
            if any(goal == b for _, goal in roads):
                span = ClosedTimeInterval(Timing(1, m.start), Timing(0, m.end))
                m.add_condition(span, Or(Not(Equals(self.goal(m), self.spots[b])), self.open[b]()))
        return m

    def _decide(self, m, origin):
        """Give a move the parameters that say from where to where it goes."""
        to = m.add_parameter("to", self.spot)
        source = self.spots[origin] if origin is not None else m.add_parameter("source", self.spot)
        self.ends[m.name] = (source, to)

    def _takes(self, m, a, b):
        """Return that a guided move takes a road."""
        source, to = self.ends[m.name]
        goal = Equals(to, self.spots[b])
        return goal if source is self.spots[a] else And(Equals(source, self.spots[a]), goal)

    def goal(self, m):
        return self.ends[m.name][1]

    def _arriving(self, r, p):
        """Return the moves of a robot to a place."""
        found = []
        for q, m, _, b in self.moves:
            if q == r and b is None:
                found.append(And(m.present, Equals(self.goal(m), self.spots[p])))
            elif (q, b) == (r, p):
                found.append(m.present)
        return found

    def _all_tasks(self):
        for t, task in enumerate(self.site.tasks):
            for r in self._able(t):
                a = self.problem.add_activity(f"task{t}by{r}", task.length, optional=True)
                self.works.append((r, a, t))

    def _all_openings(self):
        for p in self.site.doors:
            for r in self.robots:
                self.openings.append((r, self._opening(r, p), p))

    # -- where robots are ------------------------------------------------------------------------
    def _needs(self):
        """Return (robot, activity, places where it may start)."""
        found = [(r, m, (a,)) for r, m, a, _ in self.moves if a is not None]
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
        for r, m, a, b in self.moves:
            goal = self.goal(m) if b is None else self.spots[b]
            m.add_effect(self._arrival(r, m), self.at[r], goal)
            if a is None:
                here = Equals(self.at[r], self.ends[m.name][0])
                m.add_condition(self._span(m, True), here)
            # who takes no longer has arrived by then
            if self.style.way == "road" and int(m.duration.lower.constant_value()) > 1:
                m.add_effect(m.start, self.at[r], self.roads[r])
        for r, a, places in self._needs():
            options = [Equals(self.at[r], self.spots[p]) for p in places]
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
        changed = self.style.arrive != "end" or self.style.way == "road"
        if self.style.origin == "start" or (moves and changed):
            return TimePointInterval(Timing(0, a.start))
        if self.style.origin == "whole":
            return ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end))
        return RightOpenTimeInterval(Timing(0, a.start), Timing(0, a.end))

    def _rivals(self, r, place, *but):
        """Return who may take a robot away from a place, as far as the style names them."""
        all_of_them = self.style.rivals == "all"
        return [
            m
            for q, m, a, _ in self.moves
            if q == r and all(m is not b for b in but) and (all_of_them or a == place)
        ]

    def _helped(self, r, a, places):
        """Return that some move to one of ``places`` was the last one before ``a``."""
        options = []
        for q, h, _, b in self.moves:
            if q == r and b in places and h is not a:
                undone = [
                    Implies(m.present, Or(LE(m.end, h.start), GE(m.start, a.end)))
                    for m in self._rivals(r, b, a, h)
                    if self.kept()
                ]
                options.append(And(h.present, LE(h.end, a.start), *undone))
        if self.site.starts[r] in places:
            options.append(
                And(
                    [
                        Implies(m.present, GE(m.start, a.end))
                        for m in self._rivals(r, self.site.starts[r], a)
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

    # -- who does what ---------------------------------------------------------------------------
    def _ways(self, t):
        return [a for _, a, task in self.works if task == t]

    def _exactly_one(self, t):
        if self.site.tasks[t].helped:
            length = self.site.tasks[t].length
            helper = self.problem.add_activity(f"help{t}", length, optional=True)
            self.works.append((len(self.robots), helper, t))
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

    def _release(self, t):
        """State before when a task does not start, as one may write it."""
        task, problem = self.site.tasks[t], self.problem
        for k, a in enumerate(self._ways(t)[task.early :] if task.released else ()):
            since = task.released
            limits = GE(a.start, since), LE(since, a.start), GE(a.end, since + task.length)
            limit = limits[(t + k + self.style.shuffled) % 3]
            if self.style.order == "inside":
                a.add_constraint(limit)
            elif self.style.order == "implies":
                problem.add_constraint(Implies(a.present, limit))
            else:
                problem.add_constraint(limit, [a.present])

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
