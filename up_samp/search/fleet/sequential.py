"""Sequential (prioritised) planning: the motions of a candidate, decided one after the other.

A candidate says who does what, and in which order. Its times are a guess: how long robots wait for
each other is known only when their motions are. So its motions are decided among those decided
before (a reservation table), and the times of everything that depends on one follow what it really
takes, through the candidate's partial order of activities (right shift; a POS as of Policella et
al. 2004), by :mod:`up_samp.search.fleet.tours`.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from up_samp.model import (
    CandidateSchedule,
    Trajectory,
    UnsupportedError,
    avoids,
)
from up_samp.model.graphs import reached
from up_samp.motion.fleet.reservations import ReservationTable
from up_samp.motion.fleet.timed_path import TimedPath
from up_samp.scheduling.compilers.translate import read_plain
from up_samp.scheduling.partial_order import Difference, Earliest, Planned, orders_of
from up_samp.scheduling.partial_order.differences import HORIZON, ZERO
from up_samp.search.fleet.right_of_way import Driven
from up_samp.search.search import Search
from up_samp.upio import Itinerary
from up_samp.upio.restrict import decided


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
    problem = decided(search.knowledge.relaxation, schedule)
    try:
        planned = Planned(read_plain(problem, objective=False), schedule.times, schedule.parameters)
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
    for motion, change in itertools.product(itinerary.motions, itinerary.changes):
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
        behind = reached([("start", name)], lambda p: {*times.after(p)} - {ZERO, HORIZON})
        for anchor, then in behind:
            if anchor == "start" and then in found and then != name:
                found[then].add(name)
    return found


# ------------------ Tours that are decided: their motions, and when everything happens


@dataclass(frozen=True)
class FleetSolution:
    """All tours of a candidate: its ``schedule`` and, by activity, ``runs`` and when they are
    (start, end; units). ``needless`` are last motions that nobody needs: their
    robots are in nobody's way where they stand before.
    """

    schedule: CandidateSchedule
    runs: Mapping[str, TimedPath]
    pins: Mapping[str, tuple[int, int]]
    keys: Mapping[str, str]
    """What their trajectories are called in a plan."""
    needless: frozenset[str] = frozenset()

    def driven(self) -> Driven:
        """Return the way of each motion that is needed, and when it starts (s)."""
        return {
            name: (run.path, run.timing.trajectory.start)
            for name, run in self.runs.items()
            if name not in self.needless
        }

    def ends(self) -> dict[str, float]:
        """Return when each robot's last motion that is needed ends (s)."""
        found: dict[str, float] = defaultdict(float)
        for name, run in self.runs.items():
            arrival = 0.0 if name in self.needless else run.arrival
            found[run.object] = max(found[run.object], arrival)
        return dict(found)

    def cost(self, steep: float) -> tuple[int, float]:
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
