"""Decisions about the motions of a candidate, made one after the other: what they share.

A candidate says who does what, and in which order. Its times are a guess: how long robots wait for
each other is known only when their motions are. So its motions are decided among those decided
before (:class:`Committed`), and the times of everything that depends on one follow what it really
takes, through the candidate's partial order of activities (right shift; a POS as of Policella et
al. 2004).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping

from up_samp.model import CandidateSchedule, Rest, TimedMotion, Trajectory, UnsupportedError
from up_samp.motion.fleet.committed import Committed
from up_samp.motion.fleet.timed_path import TimedPath
from up_samp.scheduling.compilers.read import read_problem as read_plain
from up_samp.scheduling.partial_order import Difference, Earliest, Planned, orders_of
from up_samp.scheduling.partial_order.differences import HORIZON, ZERO
from up_samp.search.large_tuning import InOrderTuning
from up_samp.search.search import Search
from up_samp.search.visits import others_first
from up_samp.search.world import motion_key
from up_samp.upio import Itinerary
from up_samp.upio.restrict import restrict

QUICK = 0
"""The effort with which a motion is tried first: its best path, by waiting, speeds and lanes."""


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
    facts, floor = search.facts, Committed(search.motions.service, ())
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
            if motion.avoid is not None and change.object not in motion.avoid:
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


class Decisions:
    """Motions that wait to be decided, and those that are."""

    def __init__(
        self, search: Search, itinerary: Itinerary, times: Earliest, tuning: InOrderTuning
    ) -> None:
        self._facts, self._service = search.facts, search.motions.service
        self._itinerary, self._times, self._tuning = itinerary, times, tuning
        self._motions = {m.activity: m for m in itinerary.motions}
        self._waiting = dict(self._motions)
        self._must = ancestors(self._waiting, times)
        self._leave = others_first(self._facts, self._service, itinerary)
        self._floor = Committed(self._service, self._rests())

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
            due=release + self._tuning.patience * least + self._tuning.grace,
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
