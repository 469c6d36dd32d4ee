"""Sequential (prioritised) planning: the motions of a candidate, decided one after the other.

A candidate says who does what, and in which order. Its times are a guess: how long robots wait for
each other is known only when their motions are. So its motions are decided among those decided
before (a reservation table), and the times of everything that depends on one follow what it really
takes, through the candidate's partial order of activities (right shift; a POS as of Policella et
al. 2004). :class:`EarliestStartPlanner` decides in the order of starts; whole tours of robots are
decided by :mod:`up_samp.search.fleet.tours`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from up_samp.model import (
    CandidateSchedule,
    Deadline,
    Rest,
    TimedMotion,
    Trajectory,
    UnsupportedError,
    avoids,
)
from up_samp.motion.fleet.reservations import ReservationTable
from up_samp.motion.fleet.timed_path import TimedPath
from up_samp.scheduling.compilers.read import read_problem as read_plain
from up_samp.scheduling.partial_order import Difference, Earliest, Planned, orders_of
from up_samp.scheduling.partial_order.differences import HORIZON, ZERO
from up_samp.search.events import Phase
from up_samp.search.fleet.tuning import InOrderTuning
from up_samp.search.knowledge import Incumbent
from up_samp.search.search import Search
from up_samp.search.world import groups_of, motion_key, others_first
from up_samp.upio import Itinerary
from up_samp.upio.restrict import restrict

QUICK = 0
"""The effort with which a motion is tried first: its best path, by waiting, speeds and lanes."""
USUAL = 1
"""The effort with which other ways are sought: detours, too."""
_HARDER = 2
"""The effort where nobody finds a way: the plane."""
_TURNS = 4
"""Of each motion, before more effort is made for one of them."""
_PATIENCE = 1.3
"""Over a motion's time alone, up to which no other way is sought..."""
GRACE = 3.0
"""...and s more than that."""
_TOGETHER = 4
"""Motions at most, that are decided at once where they wait for each other."""


def can_decide(search: Search, itinerary: Itinerary) -> bool:
    """Return whether motions are decided one by one for such a candidate: each activity drives one
    body that stays the same, and nothing is in the air, not even at rest.
    """
    snapshot = search.facts.snapshot
    names = [m.activity for m in itinerary.motions]
    flat = not any(o.body.flies for o in snapshot.objects.values())
    return flat and not snapshot.rides and len(set(names)) == len(names)


def alone(search: Search, itinerary: Itinerary) -> dict[str, int]:
    """Return how long (units) the motions of a candidate take on their best paths, each alone on
    the floor, as far as there are such paths.
    """
    facts, floor = search.facts, ReservationTable(search.motions.service, ())
    found = {}
    for motion in itinerary.motions:
        seconds = floor.alone(facts.body(motion), motion.poses, search.budget.query())
        if seconds < math.inf:
            found[motion.activity] = facts.units(seconds)
    return found


def times_of(
    search: Search, itinerary: Itinerary, lengths: Mapping[str, int] | None = None
) -> Earliest | None:
    """Return the earliest times of a candidate's activities in its partial order; None where it is
    none.

    :param lengths: units that activities are to take at least, beside what the problem asks.
    """
    schedule, facts = itinerary.schedule, search.facts
    problem = restrict(search.own_relaxation(), facts.snapshot, schedule)
    try:
        planned = Planned(read_plain(problem), schedule.times, schedule.parameters)
        differences = [o.difference for o in orders_of(planned, facts.snapshot)]
    except UnsupportedError:
        return None
    differences += _beside_changes(itinerary)
    for name, units in (lengths or {}).items():
        differences.append(Difference(("start", name), ("end", name), units))
    times = Earliest(schedule.times, differences)
    return times if times.feasible else None


def _beside_changes(itinerary: Itinerary) -> Iterable[Difference]:
    """State that motions stay before or after the changes (of doors) that they may meet, as they
    are in the candidate; those that have one in their midst come after it.
    """
    for motion in itinerary.motions:
        for change in itinerary.changes:
            if not avoids(motion.avoid, change.object):
                continue
            if change.time >= motion.end:
                yield Difference(("end", motion.activity), ("end", change.activity), 0)
            else:
                yield Difference(("end", change.activity), ("start", motion.activity), 0)


def ancestors(motions: Collection[str], times: Earliest) -> dict[str, set[str]]:
    """Return for each motion those that the problem has begin before it starts."""
    found: dict[str, set[str]] = {m: set() for m in motions}
    for name in motions:
        todo, seen = [("start", name)], {("start", name), ZERO, HORIZON}
        while todo:
            for point in times.after(todo.pop()):
                if point in seen:
                    continue
                seen.add(point)
                todo.append(point)
                anchor, then = point
                if anchor == "start" and then in found and then != name:
                    found[then].add(name)
    return found


class SequentialPlanner:
    """Motions that wait to be decided, and those that are."""

    def __init__(self, search: Search, itinerary: Itinerary, times: Earliest) -> None:
        self._facts, self._service = search.facts, search.motions.service
        self._itinerary, self._times = itinerary, times
        self._motions = {m.activity: m for m in itinerary.motions}
        self._waiting = dict(self._motions)
        self._must = ancestors(self._waiting, times)
        self._leave = others_first(self._facts, self._service, itinerary)
        self._floor = ReservationTable(self._service, self._rests())

    def schedule(self) -> CandidateSchedule:
        """Return the candidate with the times that its motions need."""
        old = self._itinerary.schedule
        at = self._times.times
        times = {name: (at["start", name], at["end", name]) for name in old.times}
        return CandidateSchedule(times, old.parameters)

    def trajectories(self) -> dict[str, Trajectory]:
        """Return the decided motions by their names in a plan."""
        names = {m.activity: motion_key(m) for m in self._itinerary.motions}
        runs = self._floor.trajectories()
        return {names[name]: run.timing.trajectory for name, run in runs.items()}

    def _take(self, name: str, run: TimedPath) -> bool:
        """Decide a run, if its times keep what the problem asks."""
        facts = self._facts
        unit = facts.seconds(1)
        end = facts.units(run.arrival)
        start = max(self._start(name), int((run.timing.trajectory.start + 1e-6) // unit))
        for begin in (min(start, end), self._start(name)):
            pins = {("start", name): begin, ("end", name): max(end, self._end(name))}
            if self._times.raised(pins, pin=True):
                break
        else:
            return False
        self._floor.add(run)
        del self._waiting[name]
        return True

    def _start(self, name: str) -> int:
        return self._times.times["start", name]

    def _end(self, name: str) -> int:
        return self._times.times["end", name]

    def _timed(self, name: str) -> TimedMotion:
        """Return a motion as it is asked for now: good if it takes little more than alone."""
        return self._timed_as(name, self._facts.seconds(self._start(name)))

    def _timed_as(self, name: str, release: float) -> TimedMotion:
        """Return a motion as it is asked for from ``release`` (s) on."""
        facts, motion = self._facts, self._motions[name]
        least = facts.seconds(self._end(name) - self._start(name))
        return TimedMotion(
            name=name,
            object=motion.object,
            body=facts.body(motion),
            poses=motion.poses,
            release=release,
            due=release + _PATIENCE * least + GRACE,
            avoid=motion.avoid,
        )

    def _rests(self) -> list[Rest]:
        """Return everything that nobody changes on the way, where it is at first."""
        snapshot = self._facts.snapshot
        return [
            Rest(name, snapshot.objects[name].body, snapshot.configurations[place])
            for name, place in sorted(snapshot.initial.items())
            if name not in self._facts.instant
        ]

    def _place_changed(self, name: str) -> None:
        """Put doors where they are during a motion (see :func:`_beside_changes`)."""
        snapshot, motion = self._facts.snapshot, self._waiting[name]
        found = []
        for door in sorted(self._facts.instant):
            place = snapshot.initial[door]
            for change in self._itinerary.changes:
                if change.object == door and change.time < motion.end:
                    place = change.configuration
            found.append(Rest(door, snapshot.objects[door].body, snapshot.configurations[place]))
        self._floor.place(found)


def sooner(one: TimedPath | None, other: TimedPath | None) -> TimedPath | None:
    """Return the run that arrives first, of those that there are."""
    if one is None or other is None:
        return one or other
    return one if one.arrival <= other.arrival else other


# ------------------ Tours that are decided: their motions, and when everything happens


@dataclass(frozen=True)
class FleetSolution:
    """All tours of a candidate: its ``schedule`` and, by activity, ``runs``, when they are (start,
    end; units), and whose turn was when (s). ``needless`` are last motions that nobody needs: their
    robots are in nobody's way where they stand before.
    """

    schedule: CandidateSchedule
    runs: Mapping[str, TimedPath]
    pins: Mapping[str, tuple[int, int]]
    keys: Mapping[str, str]
    """What their trajectories are called in a plan."""
    turns: Mapping[str, float]
    needless: frozenset[str] = frozenset()

    def ends(self) -> dict[str, float]:
        """Return when each robot's last motion that is needed ends (s)."""
        found: dict[str, float] = defaultdict(float)
        for name, run in self.runs.items():
            arrival = 0.0 if name in self.needless else run.arrival
            found[run.object] = max(found[run.object], arrival)
        return dict(found)

    def cost(self, steep: int) -> tuple[int, float]:
        """Return the makespan of what is needed and the sum of its ends to the power ``steep``:
        less is better.
        """
        ends = self.ends()
        return self.lean().makespan, math.fsum(end**steep for end in ends.values())

    def lean(self) -> CandidateSchedule:
        """Return the schedule without what is needless."""
        times = {n: t for n, t in self.schedule.times.items() if n not in self.needless}
        return CandidateSchedule(times, self.schedule.parameters)

    def trajectories(self) -> dict[str, Trajectory]:
        """Return all motions that are needed by their names in a plan."""
        return {
            self.keys[name]: run.timing.trajectory
            for name, run in self.runs.items()
            if name not in self.needless
        }


@dataclass(frozen=True)
class InOrder:
    """The component: see the module. It is for candidates with many motions at once."""

    tuning: InOrderTuning = field(default_factory=InOrderTuning)

    def __call__(self, search: Search, itinerary: Itinerary) -> Incumbent | None:
        """Return a plan with the activities of a candidate, or None where none is found."""
        most = max((len(g) for g in groups_of(itinerary.motions)), default=0)
        if most < self.tuning.motions or not can_decide(search, itinerary):
            return None
        search.tell.stage(Phase.GROUP, count=len(itinerary.motions))
        deadline = search.budget.share(self.tuning.share, float("inf"))
        with search.budget.motion_time():
            times = times_of(search, itinerary)
            if times is None:
                return None
            line = EarliestStartPlanner(search, itinerary, times)
            if not line.decide(deadline):
                return None
        return search.plan_of(line.schedule(), line.trajectories())


class EarliestStartPlanner(SequentialPlanner):
    """Motions that wait to be decided, and those that are."""

    def __init__(self, search: Search, itinerary: Itinerary, times: Earliest) -> None:
        super().__init__(search, itinerary, times)
        self._turns: dict[str, int] = {}
        """When those that found no way are asked again (units)."""
        self._failed: dict[str, tuple[int, dict[str, int]]] = {}
        """Motions that found no way: at which effort, and how much was decided of whom then."""

    # -- deciding ------------------------------------------------------------------------------
    def decide(self, deadline: Deadline) -> bool:
        """Decide all motions; return whether that was possible."""
        while self._waiting:
            if deadline.expired():
                return False
            ready = self._ready()
            decided = self._decide_next(ready, deadline) if ready else self._decide_ring(deadline)
            if not decided:
                return False
        return True

    def _decide_next(self, ready: Sequence[str], deadline: Deadline) -> bool:
        """Decide the motion that can begin first; who finds no way is asked again once one of those
        in its way can have left. So all is decided in the order of time, and nobody far ahead.
        """
        for _ in range(_TURNS * len(ready)):
            name = min(ready, key=lambda m: (self._turn(m), m))
            blockers = self._decide_one(name, deadline)
            if blockers is None:
                return True
            if deadline.expired():
                return False
            turns = (self._turn(m) for m in self._heads() if self._waiting[m].object in blockers)
            self._turns[name] = 1 + max(self._turn(name), min(turns, default=0))
        return self._try_harder(ready, deadline)

    def _turn(self, name: str) -> int:
        """Return when it is a motion's turn to be decided (units)."""
        return max(self._start(name), self._turns.get(name, 0))

    def _decide_one(self, name: str, deadline: Deadline) -> frozenset[str] | None:
        """Decide a motion and return None; or return who is in its way if it has to wait."""
        effort, known = self._failed.get(name, (USUAL, {}))
        if known and all(self._floor.decided(o) == count for o, count in known.items()):
            return frozenset(known)
        motion = self._timed(name)
        self._place_changed(name)
        attempt = self._floor.plan(motion, deadline, min(effort, QUICK))
        late = attempt.run is not None and attempt.run.arrival > motion.due
        if effort > QUICK and (late or effort == _HARDER):
            other = self._floor.plan(motion, deadline, effort)
            attempt = other if other.run is not None else attempt
        met = attempt.met | (attempt.report.blockers if attempt.report else frozenset())
        if attempt.run is not None and self._take(name, attempt.run):
            return None
        # those that rest for good cannot be waited for
        moving = {m.object for m in self._waiting.values()}
        self._failed[name] = effort, {o: self._floor.decided(o) for o in sorted(met & moving)}
        return met

    def _decide_ring(self, deadline: Deadline) -> bool:
        """Decide those together that wait for each other to leave, or the first of them alone."""
        heads = [m for m in self._heads() if not self._must[m] & self._waiting.keys()]
        for name in sorted(heads, key=lambda m: (self._start(m), m)):
            ring = [name]
            for other in ring:
                blocking = self._leave[other] & self._waiting.keys()
                ring += sorted(m for m in blocking if m in heads and m not in ring)
            if len(ring) <= _TOGETHER and self._decide_all(ring, deadline):
                return True
        return False

    def _try_harder(self, ready: Sequence[str], deadline: Deadline) -> bool:
        """Decide one of those that found no way with more effort, or with who is in its way."""
        ranked = sorted(ready, key=lambda m: (self._start(m), m))
        for name in ranked:
            self._failed[name] = _HARDER, {}
            if self._decide_one(name, deadline) is None:
                return True
        heads = self._heads()
        for name in ranked:
            known = self._failed[name][1]
            some = [name, *(m for m in heads if self._waiting[m].object in known and m != name)]
            some = [m for m in some if not self._must[m] & self._waiting.keys()]
            if 1 < len(some) <= _TOGETHER and self._decide_all(some, deadline):
                return True
        return False

    def _decide_all(self, names: Sequence[str], deadline: Deadline) -> bool:
        """Decide motions of several objects at once."""
        self._place_changed(names[0])
        timed = [self._timed(name) for name in names]
        runs = self._floor.together(timed, deadline)
        if runs is None:
            return False
        for name in sorted(names, key=lambda n: (runs[n].arrival, n)):
            if not self._take(name, runs[name]):
                return False
        return True

    # -- who is next ---------------------------------------------------------------------------
    def _heads(self) -> list[str]:
        """Return the next motion of each object."""
        found: dict[str, str] = {}
        for name, motion in self._waiting.items():
            found.setdefault(motion.object, name)
        return list(found.values())

    def _ready(self) -> list[str]:
        """Return the motions that wait for no other one."""
        waiting = self._waiting.keys()
        return [
            m for m in self._heads() if not (self._must[m] & waiting or self._leave[m] & waiting)
        ]
