"""First tours of a candidate: in the order of time, or else whole, one robot after the other.

Ways past the places where others stand are looked for first. Then, in the order of time, all tours
are decided again and again, on the ways that are known: that takes a hundredth of the time that it
takes to look for ways. Those that ended late have their turns sooner
in the next round (squeaky wheel optimisation; Joslin and Clements, JAIR 1999), and now and then
they look for other ways. Who finds no tour, or misses what is due, goes before all others.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from up_samp.model import Deadline
from up_samp.search.decided import Decided
from up_samp.search.decisions import alone, can_decide, times_of
from up_samp.search.events import Phase
from up_samp.search.large_tuning import ToursTuning
from up_samp.search.search import Search
from up_samp.search.tours import Past, Priorities, TourPlanner
from up_samp.upio import Itinerary


@dataclass(frozen=True)
class FirstTours:
    """Tours and the best way to decide them that was found. ``ahead``: how much sooner (s) robots
    had their turns than they would, None if they had none.
    """

    tours: TourPlanner
    decided: Decided
    ahead: Mapping[str, float] | None


def plan_tours(
    search: Search,
    itinerary: Itinerary,
    deadline: Deadline,
    *,
    homes: frozenset[str] = frozenset(),
) -> FirstTours | None:
    """Return the tours of a candidate, decided; None where there is no way to do that.

    :param homes: motions at the end of tours that may be left out where nobody needs them.
    """
    search.tell.stage(Phase.GROUP, count=len(itinerary.motions))
    tuning = search.tuning.tours
    with search.budget.motion_time():
        tours = undecided_tours(search, itinerary, homes)
        if tours is None:
            return None
        tours.learn_ways_past(tuning.past, deadline)
        rounds = Rounds(tours, tuning, random.Random(search.seed))
        best = rounds.best(deadline)
        if best is not None:
            return FirstTours(tours, best, rounds.good)
        whole = _whole(tours, tuning, deadline)
    return FirstTours(tours, tours.decided(), None) if whole else None


def undecided_tours(
    search: Search, itinerary: Itinerary, homes: frozenset[str]
) -> TourPlanner | None:
    """Return the tours of a candidate, none of them decided; None where it is none that motions
    are decided one by one for.
    """
    if not can_decide(search, itinerary):
        return None
    times = times_of(search, itinerary, alone(search, itinerary))
    return None if times is None else TourPlanner(search, itinerary, times, homes)


@dataclass
class Rounds:
    """All tours decided in the order of time, again and again."""

    tours: TourPlanner
    tuning: ToursTuning
    rng: random.Random
    first: list[str] = field(default_factory=list)
    """Whose whole tours go before all others."""
    ahead: dict[str, float] = field(default_factory=dict)
    """How much sooner (s) robots have their turns than they would."""
    late: set[str] = field(default_factory=set)
    """Who was stuck before there was any good round."""
    good: dict[str, float] | None = None
    """What that was in the best round."""

    def best(self, deadline: Deadline) -> Decided | None:
        """Return the tours of the best round, if any round brought some."""
        tuning, best = self.tuning, None
        for number in range(tuning.rounds):
            if deadline.expired():
                break
            looking, more = divmod(number, tuning.each)
            looks = looking if not more else 0
            given = Priorities(
                tuple(self.first),
                self._turns(),
                looks,
                past=Past.QUICK if looks else Past.NONE,
            )
            found = self._round(given, deadline)
            if found is None and best is None and number + 1 >= tuning.hopeless:
                break
            if found is not None and (best is None or found.cost(1) < best.cost(1)):
                best, self.good = found, dict(given.ahead)
            if found is not None:
                self._hear(found.ends())
        return best

    def _turns(self) -> dict[str, float]:
        """Return how much sooner (s) robots have their turns in the next round."""
        noise = self.tuning.noise if self.ahead else 0.0
        return {r: self.ahead.get(r, 0.0) + self.rng.uniform(0, noise) for r in self.tours.robots}

    def _round(self, given: Priorities, deadline: Deadline) -> Decided | None:
        """Return the tours of one round; None where somebody was stuck: who goes first then."""
        tours = self.tours
        tours.reset()
        stuck = tours.decide_in_turns(given, deadline)
        if stuck is None:
            return tours.decided()
        if self.good is None and stuck in self.late:
            self.first = _sooner(stuck, self.first)
        self.late.add(stuck)
        before = self.ahead if self.good is None else self.good
        self.ahead = {**before, stuck: before.get(stuck, 0.0) + self.tuning.sooner}
        return None

    def _hear(self, ends: Mapping[str, float]) -> None:
        """Let those that ended later than most (s) have their turns sooner."""
        usual = sorted(ends.values())[len(ends) // 2]
        kept, heard = self.tuning.kept, self.tuning.heard
        self.ahead = {
            robot: kept * self.ahead.get(robot, 0.0) + heard * max(0.0, end - usual)
            for robot, end in ends.items()
        }


def _whole(tours: TourPlanner, tuning: ToursTuning, deadline: Deadline) -> bool:
    """Decide whole tours, one after the other; return whether that was possible."""
    first: list[str] = []
    tours.reset()
    for _ in range(tuning.orders):
        given = Priorities(tuple(first), looks=tuning.looks)
        stuck = tours.decide(given, deadline)
        if stuck is None:
            return True
        if deadline.expired() or first[:1] == [stuck]:
            return False
        first = _sooner(stuck, first)
        tours.begin_anew(replace(given, first=tuple(first)), deadline)
    return False


def _sooner(stuck: str, first: Sequence[str]) -> list[str]:
    """Return who goes first if one more has to."""
    return [stuck, *(name for name in first if name != stuck)]
