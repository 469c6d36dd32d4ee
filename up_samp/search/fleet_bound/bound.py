"""The lower bound of a large problem from all its jobs, and the planner's own durations of drives.

Bounds of drives know nothing of what a planner cannot do: they are quick to find and hold for any
planner. The planner's own durations are asked for only where something hangs on them. Motions of
equal bodies, and the same way back where a planner may drive it backwards in time, are one motion
to the service, which remembers them.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import Body, Deadline, OutOfTimeError, PathQuery, avoids
from up_samp.model.arrays import FloatArray
from up_samp.model.deadline import check_time, in_force
from up_samp.model.snapshot import Snapshot
from up_samp.motion import MotionService
from up_samp.search.due import SoonestEnds
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import Jobs, WorkMode
from up_samp.search.fleet_bound.work import JobMode, JobWork, Leg, items_of
from up_samp.search.search import Search

# ------------------ A lower bound from jobs: what has to be done at least, by all robots together
# Each job is done by one of its options, and a robot drives one way at a time. So no plan is
# shorter than what all jobs take their robots, assigned as evenly as can be, nor than what any one
# of them takes its quickest robot. A robot comes to a job from one of the places where it may be
# then; where whatever brings it to a place has a drive of its own away from there, no other drive
# begins there (there would be more departures than arrivals). Who comes from anywhere else begins
# there, or was brought there by another drive. Who has done its last job stays there if nobody
# else does, or drives on.


_DRIVES, _QUERY = 3000, 2.0
"""Drives at most, that the planner is asked for to raise the bound; and s at most, for each."""
ROUNDING = 1e-6
"""Units that a bound may be less than a whole number and still be it."""


_Cost = tuple[int, tuple[Leg, ...]]
"""Units, and the drives that they are made of, as far as these are of use."""


class JobsBound:
    """Bounds from the jobs of a problem."""

    def __init__(
        self, problem: SchedulingMotionProblem, facts: Facts, service: MotionService, jobs: Jobs
    ) -> None:
        counted = _counted(jobs)
        self._facts, self._service = facts, service
        self._work = JobWork(problem, facts, service, jobs)
        self._ways = self._work.ways(counted)
        self._stops: dict[Body, frozenset[str]] = {}
        self._modes, self._comings = self._ways, self._work.comings(called(self._ways))
        called_for = any(way.goal for way in self._ways)
        items = None if called_for else items_of(problem, jobs, self._work, counted)
        if items is not None:  # it may drive anywhere in between
            self._modes, self._comings = items, {}
            for body, kind in {(way.body, way.kind) for way in items}:  # kinds may have one body
                self._stops[body] = self._stops.get(body, frozenset()) | self._work.stops(kind)
        parts = (jobs, counted) if items is None else None
        self._released = _released(SoonestEnds(problem, facts, service), counted)
        self._since = 0
        self._last = final_occupancy(self._work, facts.snapshot, service, self._modes, parts)

    def absolute(self, deadline: Deadline) -> int:
        """Return units that no plan can beat."""
        return 0 if not self._ways else _rounded(self._least_units(deadline)[0])

    def relative(self, deadline: Deadline) -> Iterator[int]:
        """Yield units that no plan can beat whose drives are no faster than the planner's own: the
        planner is asked for those drives that the most even assignment is made of, again and
        again, until it is made of these.
        """
        asked: set[Leg] = set()
        while self._ways and not deadline.expired():
            units, legs = self._least_units(deadline)
            yield _rounded(units)
            todo = sorted(legs - asked, key=lambda leg: (leg[1:], repr(leg[0])))
            todo = todo[: _DRIVES - len(asked)]
            if not todo:
                return
            asked.update(todo)
            for leg in todo:
                self._ask(leg, deadline)

    def _ask(self, leg: Leg, deadline: Deadline) -> None:
        """Take a drive to last as long as the planner's fastest one, where it has one."""
        body, *ends = leg
        start, goal = (self._facts.snapshot.configurations[name] for name in ends)
        if start == goal or deadline.expired():
            return
        query = PathQuery(body, (start, goal), ())
        report = self._service.plan(query, deadline.within(_QUERY))
        if report.trajectory is not None and report.complete:
            # the planner finished its search: it is its fastest drive, not only some
            units = self._facts.units(report.trajectory.duration)
            self._work.take(leg, units, over=self._stops.get(body, frozenset()))

    def _least_units(self, deadline: Deadline) -> LoadBalance:
        """Return what no plan can beat, with the drives that this hangs on."""
        work = self._work
        balanced, drives = self._balanced(deadline)
        costs = _least((way.job, (way.least(work.units), ())) for way in self._ways)
        soonest = _least((way.job, work.alone(way)) for way in self._modes)
        even = sum(units for units, _ in costs) / len(work.robots)
        most = max(balanced, even, self._released, *(units for units, _ in (*costs, *soonest)))
        legs = {leg for units, some in soonest if units >= most - ROUNDING for leg in some}
        return most, drives | legs

    def _balanced(self, deadline: Deadline) -> LoadBalance:
        """Return what robots take at least, with all work assigned as evenly as can be, by one
        bound after the other.
        """
        known: LoadBalance | None = None
        while True:
            left, since = deadline.remaining(), self._since
            found = load_balance(
                self._work, self._modes, self._comings, left, self._last, self._since
            )
            if known is None or found[0] > known[0]:
                known = found
            self._since = max(self._since, _rounded(known[0]))
            if self._since == since or not self._last.everybody:
                return known


def _rounded(units: float) -> int:
    return math.ceil(units - ROUNDING)


def _least(costs: Iterable[tuple[int, _Cost]]) -> list[_Cost]:
    """Return the least cost of each job."""
    found: dict[int, _Cost] = {}
    for job, cost in costs:
        check_time()
        if job not in found or cost[0] < found[job][0]:
            found[job] = cost
    return list(found.values())


def _released(soonest: SoonestEnds, counted: Sequence[Sequence[WorkMode]]) -> int:
    """Return units by when the job that is released last may be done at the soonest."""

    def release(options: Sequence[WorkMode]) -> int:
        return min(option.release for option in options)

    last = max(filter(release, counted), key=release, default=())
    ends = (max(soonest.of(name)[1] for name in option.members) for option in last)
    return min(ends, default=0)


def _counted(jobs: Jobs) -> list[tuple[WorkMode, ...]]:
    """Return jobs of which no two share an activity: it may be of use to both.

    Assumes: an activity may be of use to two jobs, so jobs that are counted share none.
    """
    done: set[str] = set()
    counted: list[tuple[WorkMode, ...]] = []
    for options in jobs.options:
        members = set[str]().union(*(o.members for o in options))
        if not members & done:
            done |= members
            counted.append(options)
    return counted


# ------------------ The lower bound of a large problem, in the books of its search


def state_bounds(
    search: Search, problem: SchedulingMotionProblem, jobs: Jobs, *, relative: bool
) -> None:
    """Raise the lower bound to what the jobs take at least, as far as there is time.

    :param relative: also by the planner's own durations, where that gives more.
    """
    bounds, service = search.bounds, search.motions.service
    try:
        deadline = search.budget.part("bounds of large problems")
        with in_force(deadline):
            bound = JobsBound(problem, search.facts, service, jobs.bounding)
            bounds.beside = max(bounds.beside, bound.absolute(deadline))
            bounds.raise_lower(bounds.beside, relative=False)
            if not relative:
                return
            with search.budget.motion_time():
                for units in bound.relative(deadline):
                    bounds.beside = max(bounds.beside, units)
                    bounds.raise_lower(units, relative=True)
    except OutOfTimeError:
        return  # what was found holds


# ------------------ Who stays where in the end: no more robots at a place than there is room for
# A robot that has done its last job stays where that ends, or drives on. Where two bodies overlap
# if both stand at a place, and every drive that ends there heeds all other robots, only one of all
# robots can be there when all is over. So a fleet that ends its jobs at fewer places than it has
# robots has some drives more to make.
#
# Robots at a place in the end are those that came there and did not leave. What comes and goes for
# jobs is told by the ways to do them; a drive that is no part of a counted job is one *away* from
# there, and takes its time beside all jobs. Where a drive is made only if one certain job is done
# in one certain way, it is never such a drive; then a job may be done by several robots, each of
# which takes its time.


Away = tuple[int, str, str | None]
"""A kind of robots, the place that they drive away from, and where to (None: anywhere)."""


@dataclass(frozen=True)
class FinalOccupancy:
    """The ``places`` at each of which one robot stays in the end at most.

    ``aways``: drives from there that belong to no job that is counted (any of them may be the
    least), ``often``: how often there are such. ``repeated``: jobs that may be done several
    times, and how often at most. ``everybody``: whoever did a job stays at one of the places, or
    drove away from one.
    """

    places: frozenset[str] = frozenset()
    aways: Mapping[Away, tuple[Leg, ...]] = field(default_factory=dict)
    often: Mapping[Away, int] = field(default_factory=dict)
    repeated: Mapping[int, int] = field(default_factory=dict)
    everybody: bool = False


def final_occupancy(
    work: JobWork,
    snapshot: Snapshot,
    service: MotionService,
    ways: Sequence[JobMode],
    parts: tuple[Jobs, Sequence[Sequence[WorkMode]]] | None,
) -> FinalOccupancy:
    """Return where one robot at most stays in the end.

    Assumes: a robot comes to places by the drives of its jobs alone, and a place holds one in the
    end.

    :param parts: all jobs and those that are counted, by the numbers of the ``ways``; None where
        ways are not made of drives of their own, so that robots may drive anywhere in between.
    """
    robots = work.robots
    if not all(work.traced(r) for r in robots) or any(way.leaves is None for way in ways):
        return FinalOccupancy()
    staying = {p for way in ways for p in way.ends if _stays(way, p)}
    places = {p for p in sorted(staying) if _one_at_most(p, work, snapshot, service)}
    if parts is None:
        aways, often = _anywhere(work, places)
        told = all(places.issuperset(way.ends) for way in ways)
        return FinalOccupancy(frozenset(places), aways, often, everybody=told)
    repeated = _repeated(parts[1])
    inside = _inside(parts, repeated)
    found = defaultdict[Away, list[Leg]](list)
    drives = [t for robot in robots for t in work.drives(robot) if t.activity not in inside]
    for task in drives:
        begins, kind, goal = work.origins(task), work.kind_of[task.object], task.terms[-1].name
        if len(task.terms) > 2:  # nothing is known of what it takes from there
            places.difference_update(begins)
        else:
            for place in sorted(set(begins) - {goal}):
                found[kind, place, goal].append((work.body_of(task), place, goal))
    kept = {away: some for away, some in sorted(found.items(), key=_ends) if away[1] in places}
    aways = {away: tuple(dict.fromkeys(some)) for away, some in kept.items()}
    often = {away: len(some) for away, some in kept.items()}
    told = all(_ends_there(way, places) for way in ways)
    return FinalOccupancy(frozenset(places), aways, often, repeated, told)


def _ends_there(way: JobMode, places: set[str]) -> bool:
    """Return whether a robot that came to a job from one of some places, or did it at all, is at
    one of them later.
    """
    assert way.leaves is not None
    staying = {p for p in way.ends if _stays(way, p)} & places
    later = {p for p in staying if p == way.goal or p in way.after}
    return bool(later) and not places.intersection(way.leaves)


def _ends(item: tuple[Away, object]) -> tuple[int, str, str]:
    kind, start, goal = item[0]
    return kind, start, goal or ""


def _stays(way: JobMode, place: str) -> bool:
    """Return whether a way comes to a place more often than it leaves it."""
    assert way.leaves is not None
    return way.ends.count(place) > way.leaves.count(place)


def _one_at_most(place: str, work: JobWork, snapshot: Snapshot, service: MotionService) -> bool:
    """Return whether two robots can never stay at a place at once, whoever comes there later."""
    pose = snapshot.configurations[place]
    bodies = {work.kind_of[r]: snapshot.objects[r].body for r in work.robots}
    if any(body.flies for body in bodies.values()):
        return False
    pairs = itertools.combinations_with_replacement(sorted(bodies), 2)
    if not all(service.overlap(bodies[a], pose, bodies[b], pose) for a, b in pairs):
        return False
    coming = (t for r in work.robots for t in work.drives(r) if t.terms[-1].name == place)
    return all(avoids(t.avoid, *(set(work.robots) - {t.object})) for t in coming)


def _anywhere(
    work: JobWork, places: set[str]
) -> tuple[dict[Away, tuple[Leg, ...]], dict[Away, int]]:
    """Return drives away from places to wherever robots of a kind may stop."""
    aways: dict[Away, tuple[Leg, ...]] = {}
    for kind, robot in sorted({k: r for r, k in work.kind_of.items()}.items()):
        stops = sorted(work.stops(kind))
        for place in sorted(places):
            legs = tuple((work.body(robot), place, goal) for goal in stops if goal != place)
            if legs:
                aways[kind, place, None] = legs
    # each robot drives away once at most after all of its jobs
    return aways, {away: work.sizes[away[0]] for away in aways}


def _repeated(counted: Sequence[Sequence[WorkMode]]) -> dict[int, int]:
    """Return the jobs whose options have no activities in common, and how many options."""
    found = {}
    for job, options in enumerate(counted):
        names = Counter(name for option in options for name in option.members)
        if max(names.values()) == 1:
            found[job] = len(options)
    return found


def _inside(
    parts: tuple[Jobs, Sequence[Sequence[WorkMode]]], repeated: Mapping[int, int]
) -> frozenset[str]:
    """Return the activities that are present only if the one option is, whose they are, of a job
    that is counted however often it is done.
    """
    jobs, counted = parts
    mine = {
        name: option.leader
        for job in sorted(repeated)
        for option in counted[job]
        for name in option.members
    }
    return frozenset(name for name, leader in mine.items() if leader in jobs.drawn(name))


def least(legs: Sequence[Leg], units: Callable[[Leg], int]) -> tuple[int, Leg]:
    """Return units of the shortest of some drives, and which one that is."""
    return min(((units(leg), leg) for leg in legs), key=lambda found: (found[0], found[1][1:]))


# ------------------ How soon all jobs are done if assigned evenly: a linear relaxation
# Each job is done in one way. Robots of a kind leave a place as often as they come there, and
# once more for each that begins there (the relaxation of routes as a flow); in the end no more of
# them are at a place than there is room for. All that robots of a kind do takes no longer than the
# makespan for each of them. Jobs may be cut in pieces, so no plan is better.
#
# Who has no part in the work has none in the time either: that is told by a bound that holds
# already (``since``). Work <= T robots <= since robots + (T - since) size for every T >= since,
# so each bound makes way for a better one.
#
# The value is what the solver's multipliers prove (Lagrange): whatever its tolerances, it is a
# bound.


LoadBalance = tuple[float, frozenset[Leg]]
"""Units that no plan is shorter than, and the drives that the assignment is made of."""
Comings = Mapping[tuple[int, str], int]
"""What it takes a kind of robots at least to come to a place otherwise than for jobs (units)."""


def called(ways: Sequence[JobMode]) -> set[tuple[int, str]]:
    """Return from where (kind, place) robots may come to jobs."""
    return {(w.kind, p) for w in ways if w.goal is not None for p in w.origins}


def load_balance(
    work: JobWork,
    ways: Sequence[JobMode],
    comings: Comings,
    seconds: float,
    last: FinalOccupancy = FinalOccupancy(),
    since: int = 0,
) -> LoadBalance:
    """Return a bound on the makespan of all jobs, 0 where there is no time for it.

    :param seconds: limit of the solver.
    :param since: no plan is shorter, that is known.
    """
    from scipy.optimize import linprog  # half a second, for those who have many jobs

    model = _Model(work, ways, comings, last, since)
    found = linprog(
        model.costs,
        A_ub=model.less.matrix(len(model.costs)),
        b_ub=np.array(model.less.limits),
        A_eq=model.equal.matrix(len(model.costs)),
        b_eq=np.array(model.equal.limits),
        method="highs",
        options={"time_limit": max(seconds, 0.01)},
    )
    if found.status != 0:
        return 0.0, frozenset()
    proven = model.proven(found.eqlin.marginals, found.ineqlin.marginals)
    # beyond the limit of a column nothing is proven of it, but of the makespan that it is more
    return min(proven, model.most), model.legs(found.x)


@dataclass
class _Rows:
    """Rows of a linear program."""

    limits: list[float] = field(default_factory=list)
    _entries: list[tuple[int, int, float]] = field(default_factory=list)

    def add(self, entries: Sequence[tuple[int, float]], limit: float) -> None:
        """Add a row: (column, coefficient)s and the right-hand side."""
        self._entries += [(len(self.limits), column, value) for column, value in entries]
        self.limits.append(float(limit))

    def matrix(self, columns: int) -> Any:
        """Return all rows, sparse; coefficients of the same place add up."""
        from scipy.sparse import csr_array

        rows, cols, values = zip(*self._entries, strict=True) if self._entries else ((), (), ())
        return csr_array((values, (rows, cols)), shape=(len(self.limits), columns))


class _Model:
    """The linear program: least T such that the jobs fit. Column 0 is T."""

    def __init__(
        self,
        work: JobWork,
        ways: Sequence[JobMode],
        comings: Comings,
        last: FinalOccupancy,
        since: int,
    ) -> None:
        self._work, self._ways, self._last, self._since = work, ways, last, since
        self.less, self.equal = _Rows(), _Rows()
        self._columns = [(i, p) for i, w in enumerate(ways) for p in w.froms]
        self._first = {pair: 1 + n for n, pair in enumerate(self._columns)}
        self._called = sorted(called(ways))
        self._comings = sorted(comings.items())
        self._others = {at: 1 + len(self._columns) + n for n, (at, _) in enumerate(self._comings)}
        known = 1 + len(self._columns) + len(self._others)
        self._aways = {away: known + n for n, away in enumerate(sorted(last.aways, key=str))}
        self._left = {away: least(legs, work.units) for away, legs in last.aways.items()}
        known += len(self._aways)
        kinds = sorted(work.sizes)
        stays = [*itertools.product(kinds, sorted(last.places))]
        self._staying = {stay: known + n for n, stay in enumerate(stays)}
        known += len(stays)
        self._working = {kind: known + n for n, kind in enumerate(kinds)}
        self.costs = np.zeros(known + len(kinds))
        self.costs[0] = 1.0
        self._units = [ways[i].units(p, work.units) for i, p in self._columns]
        jobs = {w.job for w in ways}
        self._most = self._limits(jobs)
        self._state_jobs(jobs)
        self._state_places()
        self._state_ends()
        self._state_time()

    @property
    def most(self) -> float:
        """The makespan up to which something is proven."""
        return float(self._most[0])

    def _limits(self, jobs: set[int]) -> FloatArray:
        """Return what each column is at most, in plans that are no longer than one robot would take
        for all jobs, each in the worst way.
        """
        found = np.ones(len(self.costs))
        worst = defaultdict[int, int](int)
        for (i, p), units in zip(self._columns, self._units, strict=True):
            way = self._ways[i]
            worst[way.job] = max(worst[way.job], units)
            if way.job in self._last.repeated:
                found[self._first[i, p]] = self._last.repeated[way.job]
        times = [self._last.repeated.get(job, 1) for job in jobs]
        found[list(self._others.values())] = sum(times)
        for away, column in self._aways.items():
            found[column] = self._last.often[away]
        for kind, column in self._working.items():
            found[column] = self._work.sizes[kind]
        longest = max((units for units, _ in self._left.values()), default=0)
        found[0] = sum(worst.values()) + longest * len(jobs)
        return found

    def _state_jobs(self, jobs: set[int]) -> None:
        """Each job is done once, or several times where that makes no difference to others."""
        by_job = defaultdict[int, list[int]](list)
        for pair, column in self._first.items():
            by_job[self._ways[pair[0]].job].append(column)
        for job in sorted(jobs):
            if job in self._last.repeated:
                self.less.add([(column, -1.0) for column in by_job[job]], -1.0)
            else:
                self.equal.add([(column, 1.0) for column in by_job[job]], 1.0)

    def _state_places(self) -> None:
        """Nobody leaves a place more often than somebody came there or began there, whether for
        these jobs or otherwise.
        """
        leaving = defaultdict[tuple[int, str | None], list[int]](list)
        coming = defaultdict[tuple[int, str], list[tuple[int, float]]](list)
        for (i, p), column in self._first.items():
            way = self._ways[i]
            leaving[way.kind, p].append(column)
            for end in way.ends:
                coming[way.kind, end].append((column, -1.0))
        for at in self._called:
            starts, out, came = self._work.starts[at], leaving[at], coming[at]
            other = [(self._others[at], -1.0)] if at in self._others else []
            other += [(c, -1.0) for away, c in self._aways.items() if (away[0], away[2]) == at]
            self.less.add([*((c, 1.0) for c in out), *came, *other], starts)

    def _state_ends(self) -> None:
        """No more than one of all robots is at a place in the end, and those that worked are there,
        or drove away.
        """
        staying = defaultdict[tuple[int, str | None], list[tuple[int, float]]](list)
        for (i, origin), column in self._first.items():
            way = self._ways[i]
            for place in way.ends:
                staying[way.kind, place].append((column, 1.0))
            for begin in (*(way.leaves or ()), origin):
                staying[way.kind, begin].append((column, -1.0))
        for (kind, start, goal), column in self._aways.items():
            staying[kind, start].append((column, -1.0))
            staying[kind, goal].append((column, 1.0))
        for at, column in self._staying.items():
            self.less.add([*staying[at], (column, -1.0)], 0.0)
        for place in sorted(self._last.places):
            self.less.add([(c, 1.0) for (_, p), c in self._staying.items() if p == place], 1.0)
        for kind, column in self._working.items():
            self.less.add([(column, 1.0)], self._work.sizes[kind])
            if self._last.everybody:
                columns: Mapping[tuple[Any, ...], int] = {**self._staying, **self._aways}
                some = [c for (k, *_), c in columns.items() if k == kind]
                self.less.add([(column, 1.0), *((c, -1.0) for c in some)], 0.0)

    def _state_time(self) -> None:
        """Robots of a kind that work have time until T, each (see the module)."""
        for kind, size in sorted(self._work.sizes.items()):
            entries = [(0, -float(size)), (self._working[kind], -float(self._since))]
            first = zip(self._first.items(), self._units, strict=True)
            entries += [(c, float(u)) for ((j, *_), c), u in first if self._ways[j].kind == kind]
            entries += [(self._others[at], float(u)) for at, u in self._comings if at[0] == kind]
            left = self._left.items()
            entries += [(self._aways[at], float(u)) for at, (u, _) in left if at[0] == kind]
            self.less.add(entries, -float(size * self._since))

    def proven(self, equal: FloatArray, less: FloatArray) -> float:
        """Return what multipliers prove: no choice of all columns within their limits that keeps
        the rows costs less.
        """
        less = np.minimum(less, 0.0)
        columns = len(self.costs)
        reduced = self.costs - equal @ self.equal.matrix(columns)
        reduced = reduced - less @ self.less.matrix(columns)
        parts = [*(equal * self.equal.limits), *(less * self.less.limits)]
        parts += list(np.minimum(reduced, 0.0) * self._most)
        return math.fsum(parts)

    def legs(self, values: FloatArray) -> frozenset[Leg]:
        """Return the drives of what is used."""
        used = {
            leg
            for (i, p), column in self._first.items()
            if values[column] > 1e-7
            for leg in self._ways[i].drives(p)
        }
        aways = {self._left[away][1] for away, c in self._aways.items() if values[c] > 1e-7}
        return frozenset(used | aways)
