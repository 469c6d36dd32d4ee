"""An exhaustive search over a coarse model of a world: every schedule up to a horizon.

The schedule's rules are written down here anew, for worlds as plain values; whether trajectories
exist for a schedule is asked of the motion layer, with nothing learned. So the best makespan found
is one that the search, with all that it learns, must not be blind to.
"""

from __future__ import annotations

import itertools
import math
import random
import time
from collections.abc import Iterator
from dataclasses import replace

from tests.soundness.worlds import SECONDS, Change, Drive, World
from up_samp.geometry import load_map
from up_samp.model import CandidateSchedule, Deadline, GroupQuery, Outcome
from up_samp.motion import MotionService
from up_samp.search.facts import Facts
from up_samp.search.world import group_query, groups_of, places_between
from up_samp.upio import read_itinerary, read_problem, relax

Times = dict[str, tuple[int, int]]
QUERY_SECONDS = 1.0


class Coarse:
    """The coarse model of one world."""

    def __init__(self, world: World, problem, *, spare: int = 2) -> None:
        self.world, self.problem, self.spare = world, problem, spare
        self.snapshot = read_problem(problem, SECONDS)
        self.relaxation = relax(problem, self.snapshot)
        self.service = MotionService(load_map(self.snapshot.map_file), margin=0.01, seed=0)
        self.facts = Facts(self.snapshot, self.relaxation.choices)
        self.groups: dict[GroupQuery, tuple[dict, bool]] = {}
        self.alone = {d.name: self._alone(d) for d in world.drives}

    # ------------------------------------------------------------------------ schedules
    def schedules(self, horizon: int) -> Iterator[Times]:
        """Yield every schedule with a makespan of at most ``horizon`` that breaks no rule.

        Drives last at least as long as the motion layer needs on an empty map, and ``spare`` units
        more at most.
        """
        names = [a.name for a in self.world.activities]
        optional = [a.name for a in self.world.activities if a.optional]
        for absent in itertools.product((False, True), repeat=len(optional)):
            gone = {n for n, out in zip(optional, absent, strict=True) if out}
            if any(x in gone and y in gone for x, y in self.world.either):
                continue
            todo = [a for a in self.world.activities if a.name not in gone]
            if self._connected(todo):
                yield from self._place(todo, {}, horizon)
        assert len(set(names)) == len(names)

    def _connected(self, todo) -> bool:
        """Return whether each robot's drives may form a chain at all (a quick filter)."""
        for robot, start in self.world.robots:
            own = [d for d in todo if isinstance(d, Drive) and d.robot == robot]
            if not any(_chains(order, start) for order in itertools.permutations(own)):
                return False
        return True

    def _place(self, todo, times: Times, horizon: int) -> Iterator[Times]:
        if not todo:
            if self._fits(times):
                yield dict(times)
            return
        a, *rest = todo
        for duration in self._durations(a):
            last = min(horizon, horizon if a.deadline is None else a.deadline)
            for start in range(a.release, last - duration + 1):
                times[a.name] = (start, start + duration)
                if self._agrees(a, times):
                    yield from self._place(rest, times, horizon)
        times.pop(a.name, None)

    def _durations(self, a) -> range:
        if isinstance(a, Change):
            return range(1, 2)
        least = self.alone[a.name]
        return range(least, least + self.spare + 1) if least is not None else range(0)

    def _agrees(self, a, times: Times) -> bool:
        """Return whether the newest activity agrees with those placed before."""
        for x, y in self.world.before:
            if a.name in (x, y) and x in times and y in times and times[x][1] >= times[y][0]:
                return False
        start, end = times[a.name]
        for b in self.world.activities:
            if b.name == a.name or b.name not in times:
                continue
            first, last = times[b.name]
            if isinstance(a, Change) and isinstance(b, Change) and end == last:
                return False
            same = isinstance(a, Drive) and isinstance(b, Drive) and a.robot == b.robot
            if same and not (end < first or last < start):
                return False
            if _disturbs(a, b, times) or _disturbs(b, a, times):
                return False
        return True

    def _fits(self, times: Times) -> bool:
        for robot, place in self.world.robots:
            own = [d for d in self.world.drives if d.robot == robot and d.name in times]
            own.sort(key=lambda d: times[d.name])
            if not _chains(own, place):
                return False
        return True

    # -------------------------------------------------------------------------- motions
    def _alone(self, drive: Drive) -> int | None:
        """Return the units that a drive takes on the map alone, None if the layer finds none."""
        times = {drive.name: (0, 1000)}
        itinerary = read_itinerary(self.relaxation, CandidateSchedule(times))
        query = group_query(self.facts, itinerary, itinerary.motions)
        motion = replace(query.motions[0], due=0.0)
        # there are few of these, and the first loads the kernels: a busy machine may take its time
        report = self.service.coordinate(GroupQuery((motion,)), Deadline.after(20.0))
        if report.outcome is not Outcome.FOUND:
            return None
        return int(-(-(report.trajectories[drive.name].end - 1e-6) // SECONDS))

    def trajectories(self, times: Times):
        """Return trajectories (plan time) for a schedule, or None where none are found."""
        itinerary = read_itinerary(self.relaxation, CandidateSchedule(times))
        found = {}
        for group in groups_of(itinerary.motions):
            start = min(m.start for m in group) * SECONDS
            key = _shifted(group_query(self.facts, itinerary, group), start)
            if key not in self.groups:
                report = self.service.coordinate(key, Deadline.after(QUERY_SECONDS))
                good = report.outcome is Outcome.FOUND and not report.late
                self.groups[key] = (dict(report.trajectories), good)
            trajectories, good = self.groups[key]
            if not good:
                return None
            found |= {name: t.shifted(start) for name, t in trajectories.items()}
        return found

    def places(self, times: Times):
        """Return what ``holds`` asks for: where an object's state is, under a schedule."""
        itinerary = read_itinerary(self.relaxation, CandidateSchedule(times))
        return lambda name, first, last: places_between(itinerary, self.snapshot, name, first, last)

    def better_than(self, makespan: int, deadline: Deadline) -> tuple[Times, dict] | None:
        """Return the best schedule that has trajectories and ends before ``makespan``."""
        ordered = sorted(self.schedules(makespan - 1), key=lambda t: makespan_of(t))
        for times in ordered:
            if deadline.expired():
                raise TimeoutError(f"{len(ordered)} schedules are too many")
            found = self.trajectories(times)
            if found is not None:
                return times, found
        return None

    def sample(self, horizon: int, count: int, seconds: float) -> list[tuple[Times, dict]]:
        """Return up to ``count`` random schedules that have trajectories."""
        rng = random.Random(self.world.seed)
        found = []
        candidates = list(self.schedules(horizon))
        rng.shuffle(candidates)
        stop = math.inf
        for times in candidates:
            if len(found) >= count or time.process_time() > stop:
                break
            trajectories = self.trajectories(times)
            if stop == math.inf:  # the first loads the kernels
                stop = time.process_time() + seconds
            if trajectories is not None:
                found.append((times, trajectories))
        return found


def makespan_of(times: Times) -> int:
    return max((end for _, end in times.values()), default=0)


def _disturbs(change, drive, times: Times) -> bool:
    """Return whether a change of the door comes while a drive needs it to rest."""
    if not isinstance(change, Change) or not isinstance(drive, Drive) or "door" not in drive.static:
        return False
    return times[drive.name][0] < times[change.name][1] < times[drive.name][1]


def _chains(drives, place: str) -> bool:
    for drive in drives:
        if drive.start != place:
            return False
        place = drive.goal
    return True


def _shifted(query: GroupQuery, start: float) -> GroupQuery:
    """Return the same question with time counted from ``start``, so that equal ones are asked
    once; rests that begin before it or end after all dues are as good as endless.
    """
    due = max(m.due for m in query.motions) - start
    motions = tuple(
        replace(
            m,
            release=m.release - start,
            due=m.due - start,
            present_from=m.present_from - start,
            present_until=m.present_until - start,
        )
        for m in query.motions
    )
    rests = []
    for rest in query.rests:
        since, until = rest.since - start, rest.until - start
        if until <= 0:
            continue
        since = since if since > 0 else float("-inf")
        until = until if until <= due else float("inf")
        rests.append(replace(rest, since=since, until=until))
    return GroupQuery(motions, tuple(rests))
