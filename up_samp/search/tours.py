"""Plans for many robots by construction: whole tours, one robot after the other.

A robot's *tour* is all that it does until it stays somewhere for good. Tours are decided one after
the other, each among those decided before (prioritised planning; Erdmann and Lozano-Pérez 1987).
Within its tour a robot may stand at a place as long as nobody who is decided comes by there: the
stays that this leaves are searched depth first, the soonest first (safe intervals; Phillips and
Likhachev 2011). What is decided is thus never in the way of what is decided, and nobody starves: a
station that others visit later is free until then.

Where the floor is *well-formed* this never fails. Every tour begins and ends where a robot is in
nobody's way, and between any two places where robots stop there is a way past all others at such
ends. So in the worst case a robot waits at its start until all those before it have come to their
ends, and then drives alone (Čáp, Novák, Kleiner and Selecký, "Prioritized Planning Algorithms for
Trajectory Coordination of Multiple Mobile Robots", IEEE T-ASE 2015). Elsewhere it is a try.

Whoever finds no tour, or is late, goes first when all is begun anew.
"""

from __future__ import annotations

import enum
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from up_samp.model import Deadline
from up_samp.motion.fleet.timed_path import TimedPath
from up_samp.scheduling.partial_order import Earliest
from up_samp.search.bounds import Incumbent
from up_samp.search.decisions import QUICK, Decisions, can_decide, times_of
from up_samp.search.events import Phase
from up_samp.search.search import Search
from up_samp.search.tuning import InOrderTuning, ToursTuning
from up_samp.upio import Itinerary


class End(enum.Enum):
    """How the search for a tour, or for what is left of one, ended."""

    DECIDED = enum.auto()
    STUCK = enum.auto()
    LATE = enum.auto()
    """Something would be too late, whatever is tried from here on."""


@dataclass(frozen=True)
class ByTours:
    """The component: see the module."""

    tuning: ToursTuning = field(default_factory=ToursTuning)
    motions: InOrderTuning = field(default_factory=InOrderTuning)

    def __call__(self, search: Search, itinerary: Itinerary) -> Incumbent | None:
        """Return a plan with the activities of a candidate, or None where none is found."""
        if not can_decide(search, itinerary):
            return None
        search.tell.stage(Phase.GROUP, count=len(itinerary.motions))
        deadline = search.budget.share(self.tuning.share, float("inf"))
        with search.budget.motion_time():
            found = self._decided(search, itinerary, deadline)
        return None if found is None else search.plan_of(found.schedule(), found.trajectories())

    def _decided(self, search: Search, itinerary: Itinerary, deadline: Deadline) -> Tours | None:
        times = times_of(search, itinerary)
        if times is None:
            return None
        begun, first = times.state(), list[str]()
        for _ in range(self.tuning.orders):
            times.restore(begun)
            tours = Tours(search, itinerary, times, self.motions, self.tuning)
            stuck = tours.decide(first, deadline)
            if stuck is None:
                return tours
            if deadline.expired() or first[:1] == [stuck]:
                return None
            first = [stuck, *(name for name in first if name != stuck)]
        return None


class Tours(Decisions):
    """Tours that wait to be decided, and those that are."""

    def __init__(
        self,
        search: Search,
        itinerary: Itinerary,
        times: Earliest,
        motions: InOrderTuning,
        tuning: ToursTuning,
    ) -> None:
        super().__init__(search, itinerary, times, motions)
        self._tours = tuning
        self._chains: dict[str, list[str]] = defaultdict(list)
        for motion in itinerary.motions:
            self._chains[motion.object].append(motion.activity)
        self._dead: set[tuple[str, float]] = set()
        """Stays (motion, until) of the present tour from which there is no way on."""
        self._tries = 0

    def decide(self, first: Sequence[str], deadline: Deadline) -> str | None:
        """Decide all tours, those of ``first`` before the others; return None, or the robot that
        should have gone sooner.
        """
        order = self._ranked(first)
        while self._waiting:
            stuck: list[str] = []
            done = len(self._waiting)
            for robot in order:
                stretch = self._stretch(robot)
                if not stretch:
                    continue
                end = self._decide(stretch, deadline)
                if end is End.LATE or deadline.expired():
                    return robot
                if end is End.STUCK:
                    stuck.append(robot)
            if len(self._waiting) == done:
                return stuck[0] if stuck else next(r for r in order if self._left(r))
        return None

    def _ranked(self, first: Sequence[str]) -> list[str]:
        """Return all robots: ``first``, then those with the least time to spare, until something of
        theirs has to be done or until all is done.
        """
        latest, times = self._times.latest(), self._times.times
        ends = {r: times["end", chain[-1]] for r, chain in self._chains.items()}
        last = self._tours.stretch * max(ends.values(), default=0)
        spare = {
            robot: min(
                [last - ends[robot], *(latest["end", m] - times["end", m] for m in chain)],
            )
            for robot, chain in self._chains.items()
        }
        rest = sorted((r for r in spare if r not in first), key=lambda r: (spare[r], r))
        return [*(r for r in first if r in spare), *rest]

    def _left(self, robot: str) -> list[str]:
        """Return the motions of a robot that are not decided."""
        return [m for m in self._chains[robot] if m in self._waiting]

    def _stretch(self, robot: str) -> list[str]:
        """Return the next motions of a robot, up to the first that has to wait for one of another's
        that is not decided.
        """
        found: list[str] = []
        left = self._left(robot)
        others = self._waiting.keys() - set(left)
        for name in left:
            if (self._must[name] | self._leave[name]) & others:
                break
            found.append(name)
        return found

    def _decide(self, stretch: Sequence[str], deadline: Deadline) -> End:
        """Decide a robot's next motions, all or none."""
        self._dead.clear()
        self._tries = 0
        return self._drive(stretch, deadline)

    def _drive(self, stretch: Sequence[str], deadline: Deadline) -> End:
        """Decide motions one after the other, the soonest stays first."""
        if not stretch:
            return End.DECIDED
        name, rest = stretch[0], stretch[1:]
        motion = self._timed(name)
        self._place_changed(name)
        for since, until in self._floor.stays(motion):
            if (rest and (name, until) in self._dead) or (not rest and until < math.inf):
                continue
            if max(since, motion.release + self._least(name)) + self._stay(stretch) > until:
                continue
            end = self._stop(stretch, since, until, deadline)
            if end is not End.STUCK or deadline.expired() or self._tries > self._tours.tries:
                return end
        return End.STUCK

    def _stop(self, stretch: Sequence[str], since: float, until: float, deadline: Deadline) -> End:
        """Decide motions of which the first ends in a stay (s)."""
        name, rest = stretch[0], stretch[1:]
        run = self._run(name, since, until, deadline)
        if run is None:
            return End.STUCK
        motion, before = self._waiting[name], self._times.state()
        if not self._take(name, run):
            return End.LATE
        end = End.STUCK
        if not rest or self._facts.seconds(self._start(rest[0])) <= until:
            end = self._drive(rest, deadline)
        if end is not End.DECIDED:
            # whoever comes there later can leave no sooner
            self._dead.add((name, until))
            self._floor.withdraw(motion.object)
            self._times.restore(before)
            self._waiting[name] = motion
        return end

    def _run(self, name: str, since: float, until: float, deadline: Deadline) -> TimedPath | None:
        """Return a run that ends in a stay (s), if one is found."""
        self._tries += 1
        motion = self._timed(name)
        due = max(motion.due, since + self._tuning.grace)
        asked = replace(motion, present_until=until, due=due)
        attempt = self._floor.plan(asked, deadline, QUICK)
        late = attempt.run is None or attempt.run.arrival > due
        for effort in range(QUICK + 1, self._tours.effort + 1):
            if not late or deadline.expired():
                break
            other = self._floor.plan(asked, deadline, effort)
            if other.run is not None:
                attempt, late = other, other.run.arrival > due
        run = attempt.run
        return None if run is None or run.arrival > until else run

    def _stay(self, stretch: Sequence[str]) -> float:
        """Return how long (s) a robot stays at least where its first of some motions ends."""
        if len(stretch) < 2:
            return 0.0
        return self._facts.seconds(self._start(stretch[1]) - self._end(stretch[0]))

    def _least(self, name: str) -> float:
        """Return the least time (s) that a motion takes."""
        return self._facts.seconds(self._end(name) - self._start(name))
