"""Tours decided piece by piece, in the order of time.

Whole tours (:mod:`up_samp.search.tours`) are not fair: who is decided last finds gaps only, and
waits. Here whoever comes first to the next place that others need is decided next, until it stands
where nobody else has to be. That is token passing (Ma, Li, Kumar and Koenig, "Lifelong multi-agent
path finding for online pickup and delivery tasks", AAMAS 2017), with places of one's own as the
endpoints where agents wait for the token.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from up_samp.model import Deadline
from up_samp.scheduling.partial_order import Earliest
from up_samp.search.search import Search
from up_samp.search.tours import End, Past, Tours
from up_samp.search.visits import contested
from up_samp.upio import Itinerary


class ToursInTurns(Tours):
    """Tours that may be decided piece by piece, too."""

    def __init__(
        self, search: Search, itinerary: Itinerary, times: Earliest, homes: frozenset[str]
    ) -> None:
        super().__init__(search, itinerary, times, homes)
        self._contested = contested(search.facts, search.motions.service, itinerary)
        self.past = Past.QUICK
        """Which ways past others are looked for at first: they are about to go on. More are looked
        for where nobody finds any, or somebody is late.
        """
        self.ahead: Mapping[str, float] = {}
        """By how much (s) a robot's turn comes sooner than it does to the next place."""
        self.latest = math.inf
        """Everything is given up once somebody cannot be done by then (units)."""

    def decide_in_turns(self, first: Sequence[str], deadline: Deadline) -> str | None:
        """Decide all tours that are not decided piece by piece in the order of time, those of
        ``first`` whole before the others; return None, or the robot that should have gone sooner.
        """
        self._past = Past.ANY
        for robot in first:
            if self._decide(self._stretch(robot), deadline) is End.LATE or deadline.expired():
                return robot
        asleep = set[str]()  # they found no way among what is decided
        self._past = self.past
        while self._waiting:
            pieces = {r: self._piece(r) for r in self.robots if r not in asleep}
            ready = [(self._rank(r, piece), r) for r, piece in pieces.items() if piece]
            turn = min(ready)[1] if ready else None
            end = End.STUCK if turn is None else self._decide(pieces[turn], deadline)
            if end is End.DECIDED:
                if turn is not None and self._done(self._chains[turn]) > self.latest:
                    return turn
                self._past = self.past
                asleep.clear()
            elif self._past is not Past.ANY and (turn is None or end is End.LATE):
                self._past = Past(self._past + 1)
                asleep.clear()
            elif turn is None or end is End.LATE:
                return turn or next(r for r in self.robots if self._left(r))
            else:
                asleep.add(turn)
            if deadline.expired():
                return turn or self.robots[0]
        self._past = Past.ANY
        return None

    def _rank(self, robot: str, piece: Sequence[str]) -> float:
        """Return when a robot's turn comes (s): when it comes to the next place, or sooner."""
        return self._facts.seconds(self._end(piece[0])) - self.ahead.get(robot, 0.0)

    def _piece(self, robot: str) -> list[str]:
        """Return the next motions of a robot, up to the first that ends where no other one has to
        be: there it may stay until its turn comes again.
        """
        stretch = self._stretch(robot)
        own = [n for n, name in enumerate(stretch) if name not in self._contested]
        return stretch[: own[0] + 1] if own else stretch
