"""Neighbourhoods: functions of a plan that say which robots are freed, and when."""

from __future__ import annotations

import itertools
import math
import random
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from unified_planning.model import FNode
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.walkers.free_vars import FreeVarsExtractor

from up_samp.model import ScheduledMotion, Trajectory, UnsupportedError
from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.scheduling.compilers.read import read_problem as read_plain
from up_samp.scheduling.partial_order import Difference, Planned, orders_of
from up_samp.scheduling.partial_order.differences import HORIZON, ZERO, Point
from up_samp.search.knowledge import Incumbent
from up_samp.upio import Relaxation, read_itinerary
from up_samp.upio.restrict import restrict


@dataclass(frozen=True)
class Owners:
    """``of``: activity -> the robots that it belongs to (none: nobody knows). ``rivals``: activity
    -> those that stand for it or cannot be present with it. ``places``: activity -> where its robot
    has to be for it, and ``ways``: motion activity -> the places that it leads from and to.
    """

    of: Mapping[str, frozenset[str]]
    rivals: Mapping[str, frozenset[str]]
    places: Mapping[str, frozenset[str]]
    ways: Mapping[str, frozenset[str]]

    @property
    def robots(self) -> list[str]:
        """All robots that something belongs to, in order."""
        return sorted({robot for some in self.of.values() for robot in some})

    def open_to(self, robots: Collection[str], present: Collection[str]) -> set[str]:
        """Return the activities that ``robots`` may do beside those ``present``: nothing that is
        excluded by these, and no ways to places where there is nothing to do any more.
        """
        mine = {n for n, own in self.of.items() if own <= set(robots)}
        barred = mine & {r for name in present for r in self.rivals.get(name, ())}
        mine -= barred
        done = [n for n in present if self.of.get(n, frozenset()) & set(robots)]
        useful = {p for n in (*mine, *done) for p in self.places.get(n, ())}
        useful |= {p for n in done for p in self.ways.get(n, ())}
        useless = {p for n in barred for p in self.places.get(n, ())} - useful
        return {n for n in mine if not self.ways.get(n, frozenset()) & useless} - set(present)


def owners_of(relaxation: Relaxation) -> Owners:
    """Return who does what in a problem."""
    problem, snapshot = relaxation.problem, relaxation.snapshot
    free = problem.environment.free_vars_extractor
    touched = {a.name: set(_touched(a, free)) for a in problem.activities}
    drivers: dict[str, set[str]] = {a.name: set() for a in problem.activities}
    for task in snapshot.tasks:
        drivers[task.activity].add(task.object)
    theirs: dict[FNode, set[str]] = defaultdict(set)
    for name, robots in drivers.items():
        for fluent in touched[name] if robots else ():
            theirs[fluent] |= robots
    private = {fluent: robots for fluent, robots in theirs.items() if len(robots) == 1}
    private |= {relaxation.state[r]: {r} for robots in drivers.values() for r in robots}
    of = {
        name: frozenset(own or {r for f in touched[name] if f in private for r in private[f]})
        for name, own in drivers.items()
    }
    places = {a.name: frozenset(_places(a)) for a in problem.activities if not drivers[a.name]}
    return Owners(of, _rivals(problem), places, _ways(snapshot))


def _touched(activity: Activity, free: FreeVarsExtractor) -> Iterator[FNode]:
    """Yield the ground fluents that an activity has to do with."""
    expressions = [c for some in activity.conditions.values() for c in some]
    for effects in activity.effects.values():
        expressions += [x for e in effects for x in (e.fluent, e.value, e.condition)]
    for expression in expressions:
        for fluent in free.get(expression):
            if all(a.is_constant() or a.is_object_exp() for a in fluent.args):
                yield fluent


def _places(activity: Activity) -> Iterator[str]:
    """Yield the objects that some fluent has to hold for an activity, or may."""
    todo = [c for conditions in activity.conditions.values() for c in conditions]
    for node in todo:
        if node.is_and() or node.is_or():
            todo += node.args
        elif node.is_equals():
            yield from (side.object().name for side in node.args if side.is_object_exp())


def _ways(snapshot: Snapshot) -> dict[str, frozenset[str]]:
    found: dict[str, set[str]] = defaultdict(set)
    for task in snapshot.tasks:
        ends = (task.terms[0], task.terms[-1])
        found[task.activity] |= {t.name for t in ends if t.kind is TermKind.CONSTANT}
    return {name: frozenset(some) for name, some in found.items()}


def _rivals(problem: SchedulingProblem) -> dict[str, frozenset[str]]:
    """Return which activities stand for each other or exclude each other, as far as unconditional
    clauses on presences say: where one of them stays, the others are not worth a look.
    """
    found: dict[str, set[str]] = defaultdict(set)
    for constraint, scope in problem._base._constraints:
        names = _clause(constraint) if not scope else ()
        for name in names:
            found[name].update(names)
    return {name: frozenset(some - {name}) for name, some in found.items()}


def _clause(constraint: FNode) -> tuple[str, ...]:
    """Return the activities of "one of these", or of "not both of these"."""
    args = constraint.args if constraint.is_or() else ()
    if len(args) == 2 and all(a.is_not() for a in args):
        args = tuple(a.arg(0) for a in args)
    if not all(a.is_present_exp() for a in args):
        return ()
    return tuple(a.presence().container for a in args)


# ------------------ The plan that a neighbourhood is chosen in
# The plan that a neighbourhood is chosen in: who is busy when, who waits for whom, who meets.


PlanWait = tuple[int, str, str]
"""A time (units) at which somebody could do something sooner, were it not for somebody else: who,
whom."""


@dataclass(frozen=True)
class View:
    """A plan, and what is told of it by the differences that the problem asks for."""

    relaxation: Relaxation
    snapshot: Snapshot
    owners: Owners
    plan: Incumbent

    @property
    def times(self) -> Mapping[str, tuple[int, int]]:
        """Start and end (units) of what is present."""
        return self.plan.schedule.times

    @cached_property
    def robots(self) -> list[str]:
        """The robots that are busy in the plan or could be."""
        return self.owners.robots

    @cached_property
    def last_ends(self) -> dict[str, int]:
        """Robot -> when it is done (units)."""
        found = dict.fromkeys(self.robots, 0)
        for name, (_, end) in self.times.items():
            for robot in self.owners.of.get(name, ()):
                found[robot] = max(found[robot], end)
        return found

    def busy(self, since: float, until: float) -> list[str]:
        """Return the robots that do something between two times (units)."""
        found = {
            robot
            for name, (start, end) in self.times.items()
            if start < until and since < end
            for robot in self.owners.of.get(name, ())
        }
        return sorted(found)

    @cached_property
    def motions(self) -> tuple[ScheduledMotion, ...]:
        """The motions of the plan, in order of time."""
        return read_itinerary(self.relaxation, self.plan.schedule).motions

    def trajectory(self, motion: ScheduledMotion) -> Trajectory | None:
        """Return how a motion is made in the plan."""
        return self.plan.trajectories.get(motion.activity)

    @cached_property
    def tight(self) -> Sequence[Difference]:
        """The differences that leave no slack: neither end of one can shift alone. Empty where the
        problem asks for more than differences.
        """
        schedule = self.plan.schedule
        problem = restrict(self.relaxation, self.snapshot, schedule)
        try:
            planned = Planned(read_plain(problem), schedule.times, schedule.parameters)
            orders = orders_of(planned, self.snapshot)
        except UnsupportedError:
            return ()
        asked = (o.difference for o in orders)
        return [d for d in asked if _slack(planned, d) <= 0 and HORIZON not in (d.first, d.then)]

    @cached_property
    def waits(self) -> list[PlanWait]:
        """Who waits for whom, in order of time."""
        found = set()
        for d in self.tight:
            if ZERO in (d.first, d.then):
                continue
            for who in self.owners.of.get(d.then[1], ()):
                for whom in self.owners.of.get(d.first[1], ()):
                    if who != whom:
                        found.add((self._time(d.then), who, whom))
        return sorted(found)

    @cached_property
    def critical(self) -> list[str]:
        """Activities that the plan's end hangs on, the last one first."""
        before: dict[Point, list[Point]] = {}
        for d in self.tight:
            before.setdefault(d.then, []).append(d.first)
        makespan = self.plan.schedule.makespan
        todo = [("end", n) for n, (_, end) in sorted(self.times.items()) if end == makespan]
        seen: dict[Point, None] = dict.fromkeys(todo)
        while todo:
            point = todo.pop(0)
            inside = [("start", point[1])] if point[0] == "end" else []
            for first in sorted({*before.get(point, ()), *inside}):
                if first not in seen and first != ZERO:
                    seen[first] = None
                    todo.append(first)
        names = dict.fromkeys(name for _, name in seen)
        return sorted(names, key=lambda n: (-self.times[n][1], n))

    def _time(self, point: Point) -> int:
        return self.times[point[1]][0 if point[0] == "start" else 1]

    # -- who is near ---------------------------------------------------------------------------
    def near(self, motion: ScheduledMotion) -> list[str]:
        """Return the robots that move at the same time as a motion, the nearest first."""
        mine = self.trajectory(motion)
        if mine is None:
            return []
        found: dict[str, float] = {}
        for other in self.motions:
            if other.object == motion.object or not _overlap(motion, other):
                continue
            theirs = self.trajectory(other)
            if theirs is not None:
                gap = min(_gap(mine, theirs), found.get(other.object, math.inf))
                found[other.object] = gap
        return sorted(found, key=lambda name: (found[name], name))


def _slack(planned: Planned, d: Difference) -> int:
    return planned.time(d.then) - planned.time(d.first) - d.lag - d.strict


def _overlap(one: ScheduledMotion, two: ScheduledMotion) -> bool:
    return one.start < two.end and two.start < one.end


def _gap(one: Trajectory, two: Trajectory, moments: int = 16) -> float:
    """Return how far (m) two bodies are from each other at the nearest of some ``moments``: it only
    says who is worth a look.
    """
    since, until = max(one.start, two.start), min(one.end, two.end)
    if since > until:
        return math.inf
    times = np.linspace(since, until, moments)
    apart = [
        np.interp(times, one.times, one.poses[:, k]) - np.interp(times, two.times, two.poses[:, k])
        for k in (0, 1)
    ]
    return float(np.hypot(*apart).min())


# ------------------ Neighbourhoods
# Neighbourhoods: which robots are freed, and when. Each is one function of a plan. Each takes the
# plan, random numbers and how many robots to free, and returns them; the rest of the plan is
# kept.


@dataclass(frozen=True)
class Freed:
    """Robots that are freed between two times (units): what they do then is decided anew."""

    robots: frozenset[str]
    since: float = -math.inf
    until: float = math.inf

    def within(self, other: Freed) -> bool:
        """Return whether ``other`` frees all of this, too."""
        inside = other.since <= self.since and self.until <= other.until
        return inside and self.robots <= other.robots


Choice = Callable[[View, random.Random, int], Freed]


def random_robots(view: View, chance: random.Random, size: int) -> Freed:
    """Free some robots, whichever."""
    return Freed(frozenset(chance.sample(view.robots, min(size, len(view.robots)))))


def last_robots(view: View, chance: random.Random, size: int) -> Freed:
    """Free a robot that is done late, and those that are done first: they could help."""
    ends = view.last_ends
    by_end = sorted(view.robots, key=lambda r: (ends[r], r))
    late = [r for r in by_end if ends[r] == ends[by_end[-1]]]
    chosen = {chance.choice(late)}
    others = _by_rank([r for r in by_end if r not in chosen], chance)
    chosen.update(itertools.islice(others, max(0, size - len(chosen))))
    return Freed(frozenset(chosen))


def time_window(view: View, chance: random.Random, size: int) -> Freed:
    """Free twice as many robots in a part of the time."""
    makespan = view.plan.schedule.makespan
    length = makespan * chance.uniform(0.25, 0.6)
    since = chance.uniform(-0.1 * makespan, makespan - 0.8 * length)
    busy = view.busy(since, since + length)
    chosen = frozenset(chance.sample(busy, min(2 * size, len(busy))))
    return Freed(chosen, math.floor(since), math.ceil(since + length))


def critical_path(view: View, chance: random.Random, size: int) -> Freed:
    """Free robots that the plan's end hangs on, from a place on that path on; others with them,
    if these are few.
    """
    path = view.critical
    if not path:
        return last_robots(view, chance, size)
    first = chance.randrange(len(path))
    line = path[first:] if chance.random() < 0.5 else path[: first + 1]
    chosen = _first_of((r for n in line for r in sorted(view.owners.of.get(n, ()))), size)
    return Freed(frozenset(_filled(chosen, view.robots, chance, size)))


def waiting_robots(view: View, chance: random.Random, size: int) -> Freed:
    """Free a robot that waits for another one, that one, and those that wait for them."""
    waits = view.waits
    if not waits:
        return meeting_robots(view, chance, size)
    time, *both = chance.choice(waits)
    chosen = dict.fromkeys(both)
    near = sorted(waits, key=lambda wait: (abs(wait[0] - time), *wait[1:]))
    grown = True
    while grown and len(chosen) < size:
        grown = False
        for _, *pair in near:
            if len(chosen.keys() & pair) == 1:
                chosen |= dict.fromkeys(pair)
                grown = True
                break
    return Freed(frozenset(_filled(list(chosen), view.robots, chance, size)))


def meeting_robots(view: View, chance: random.Random, size: int) -> Freed:
    """Free a robot that takes long for a motion, and those that come nearest to it meanwhile."""
    if not view.motions:
        return random_robots(view, chance, size)
    motion = chance.choice(view.motions)
    chosen = [motion.object, *view.near(motion)][:size]
    return Freed(frozenset(_filled(chosen, view.robots, chance, size)))


CHOICES: tuple[Choice, ...] = (
    random_robots,
    last_robots,
    time_window,
    critical_path,
    waiting_robots,
    meeting_robots,
)


def _first_of(some: Iterable[str], size: int) -> list[str]:
    return list(dict.fromkeys(some))[:size]


def _filled(chosen: list[str], robots: list[str], chance: random.Random, size: int) -> list[str]:
    """Return ``size`` robots: those chosen, and others at random."""
    others = [r for r in robots if r not in chosen]
    more = max(0, min(size - len(chosen), len(others)))
    return chosen[:size] + chance.sample(others, more)


def _by_rank(ranked: list[str], chance: random.Random) -> Iterable[str]:
    """Yield all, those in front mostly sooner (as Ropke and Pisinger draw removals)."""
    left = list(ranked)
    while left:
        yield left.pop(int(len(left) * chance.random() ** 3))
