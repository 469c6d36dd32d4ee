"""The lower bound of a large problem from all its jobs, and the planner's own durations of drives.

Bounds of drives know nothing of what a planner cannot do: they are quick to find and hold for any
planner. The planner's own durations are asked for only where something hangs on them. Motions of
equal bodies, and the same way back where a planner may drive it backwards in time, are one motion
to the service, which remembers them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import Body, Deadline, OutOfTimeError, PathQuery
from up_samp.model.deadline import check_time, in_force
from up_samp.motion import MotionService
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import Jobs, WorkMode
from up_samp.search.fleet_bound.load_balance import (
    LoadBalance,
    called,
    final_occupancy,
    least_share,
)
from up_samp.search.fleet_bound.work import JobWork, Leg, items_of
from up_samp.search.search import Search

# ------------------ A lower bound from jobs: what has to be done at least, shared by all robots
# Each job is done by one of its options, and a robot drives one way at a time. So no plan is
# shorter than what all jobs take their robots, shared as evenly as can be, nor than what any one
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
        self._shared, self._comings = self._ways, self._work.comings(called(self._ways))
        called_for = any(way.goal for way in self._ways)
        items = None if called_for else items_of(problem, jobs, self._work, counted)
        if items is not None:  # it may drive anywhere in between
            self._shared, self._comings = items, {}
            self._stops = {way.body: self._work.stops(way.kind) for way in items}
        parts = (jobs, counted) if items is None else None
        self._since = 0
        self._last = final_occupancy(self._work, facts.snapshot, service, self._shared, parts)

    def absolute(self, deadline: Deadline) -> int:
        """Return units that no plan can beat."""
        return 0 if not self._ways else _rounded(self._share(deadline)[0])

    def relative(self, deadline: Deadline) -> Iterator[int]:
        """Yield units that no plan can beat whose drives are no faster than the planner's own: the
        planner is asked for those drives that the best share of the jobs is made of, again and
        again, until it is made of these.
        """
        asked: set[Leg] = set()
        while self._ways and not deadline.expired():
            units, legs = self._share(deadline)
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

    def _share(self, deadline: Deadline) -> LoadBalance:
        """Return what no plan can beat, with the drives that this hangs on."""
        work = self._work
        shared, drives = self._even(deadline)
        costs = _least((way.job, (way.least(work.units), ())) for way in self._ways)
        soonest = _least((way.job, work.alone(way)) for way in self._shared)
        even = sum(units for units, _ in costs) / len(work.robots)
        most = max(shared, even, *(units for units, _ in (*costs, *soonest)))
        legs = {leg for units, some in soonest if units >= most - ROUNDING for leg in some}
        return most, drives | legs

    def _even(self, deadline: Deadline) -> LoadBalance:
        """Return what robots that share all work as evenly as they can take at least, by one bound
        after the other.
        """
        known: LoadBalance | None = None
        while True:
            left, since = deadline.remaining(), self._since
            found = least_share(
                self._work, self._shared, self._comings, left, self._last, self._since
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
            bound = JobsBound(problem, search.facts, service, jobs)
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
