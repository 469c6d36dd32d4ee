"""Better rounds: whose turn comes when is changed a little, and kept if everybody is done sooner.

A round decides all tours anew in the order of time, on the ways that are known
(:mod:`up_samp.search.first_tours`): it is over in a fraction of a second, and hangs on whose turn
comes sooner than it would. So those turns are searched (iterated local search; Lourenço, Martin and
Stützle 2003): some robots, those that end last most often, have their turns sooner or later; or
those motions of theirs that take much longer than they would alone look for other ways, which all
rounds know from then on. A round is given up as soon as somebody cannot end any more before the
last one of the best round does.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from up_samp.model import Deadline
from up_samp.search.decided import Decided
from up_samp.search.large_tuning import RoundsTuning
from up_samp.search.tours import Priorities, TourPlanner


@dataclass
class BetterRounds:
    """The best round so far, with how much sooner (s) robots have their turns in it, and the search
    for better ones.

    :param steep: to which power a tour's end counts.
    """

    tours: TourPlanner
    best: Decided
    ahead: Mapping[str, float]
    tuning: RoundsTuning
    steep: int
    rng: random.Random

    def improved(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[Decided]:
        """Yield tours that are over sooner than all before, until it is ``over`` or many rounds in
        a row bring nothing.
        """
        stale = 0
        while stale < self.tuning.stale and not over():
            looking = self._looking() if self.rng.random() < self.tuning.looking else {}
            turned = not looking or self.rng.random() < self.tuning.both
            ahead = self._other_turns() if turned else self.ahead
            found, before = self._round(ahead, looking, deadline), self.best
            stale += 1
            if found is None or found.cost(self.steep) > before.cost(self.steep):
                continue
            self.best, self.ahead = found, ahead  # as good ones, too: they lead elsewhere
            if found.cost(self.steep) < before.cost(self.steep):
                stale = 0
            if found.lean().makespan < before.lean().makespan:
                yield found

    def _round(
        self, ahead: Mapping[str, float], looking: Mapping[str, int], deadline: Deadline
    ) -> Decided | None:
        """Return the tours of a round; None where somebody was stuck or ends too late."""
        latest = self.best.lean().makespan
        given = Priorities(ahead=ahead, looking=looking, latest=latest)
        self.tours.reset()
        stuck = self.tours.decide_in_turns(given, deadline)
        return self.tours.decided() if stuck is None else None

    def _other_turns(self) -> dict[str, float]:
        """Return turns of which some come sooner or later."""
        rng, last, found = self.rng, self._last_first(), dict(self.ahead)
        for _ in range(rng.choice(self.tuning.turns)):
            robot = self._one_of_the_last(last) if rng.random() < 0.5 else rng.choice(last)
            sooner = rng.uniform(-self.tuning.sooner, self.tuning.sooner)
            found[robot] = found.get(robot, 0.0) + sooner
        return found

    def _looking(self) -> dict[str, int]:
        """Return how often motions look for other ways, those of some of the last robots that take
        longest.
        """
        last, found = self._last_first(), dict[str, int]()
        for robot in sorted({self._one_of_the_last(last) for _ in range(2)}):
            delays = self.tours.delays(self.best, robot)
            longest = sorted(delays, key=lambda name: (-delays[name], name))[: self.tuning.motions]
            for name in longest:
                if delays[name] > self.tuning.delayed:
                    found[name] = self.tours.looked(name) + 1
        return found

    def _last_first(self) -> list[str]:
        ends = self.best.ends()
        return sorted(self.tours.robots, key=lambda robot: (-ends.get(robot, 0.0), robot))

    def _one_of_the_last(self, ranked: list[str]) -> str:
        return ranked[min(int(self.rng.expovariate(0.5)), len(ranked) - 1)]
