"""Better plans of a fleet: some tours are withdrawn and decided anew among the others.

First all tours are decided again and again (:mod:`up_samp.search.better_rounds`), if that is how
they were found, until that brings nothing any more. Then comes a large-neighbourhood search (Shaw
1998; for paths of many robots: Li et al., "Anytime Multi-Agent Path Finding via Large Neighborhood
Search", IJCAI 2021). One of the tours that end last is decided anew, with some of those that delay
it or with any others, in a random order or in the order of time; or its robot gives a job to
another one, or exchanges one with it. What is not withdrawn stays as it is, motions and times. A
change is kept if the plan gets shorter, or if it does not and its tours do on the whole.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from up_samp.model import Deadline
from up_samp.search.better_rounds import BetterRounds
from up_samp.search.deals import Deal
from up_samp.search.decided import Decided
from up_samp.search.large_tuning import LargeTuning, RoundsTuning
from up_samp.search.rehearsal import Step
from up_samp.search.tours import Priorities, TourPlanner

OpenTours = Callable[[Deal, Deadline], TourPlanner | None]
"""Opens tours of what was dealt out, with nothing decided; None where they cannot be."""


@dataclass
class Better:
    """The best tours so far of a fleet, and the search for better ones."""

    dealt: Deal
    tours: TourPlanner
    best: Decided
    open_tours: OpenTours
    tuning: LargeTuning
    rng: random.Random
    tried: set[tuple[object, ...]] = field(default_factory=set)
    """Exchanges of jobs that did not help since the last change."""
    delays: dict[str, set[str]] = field(default_factory=dict)
    """Who delays a robot, as far as that was asked since the last change."""
    ahead: Mapping[str, float] | None = None
    """How much sooner (s) robots had their turns in the round that these tours are of, if any."""
    rounds: RoundsTuning = field(default_factory=RoundsTuning)

    def improved(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[Decided]:
        """Yield tours that are over sooner than all before, until it is ``over``."""
        if self.ahead is not None:
            steep, ahead = self.dealt.tuning.steep, self.ahead
            rounds = BetterRounds(self.tours, self.best, ahead, self.rounds, steep, self.rng)
            for found in rounds.improved(over, deadline):
                self._keep(found)
                yield found
            self._keep(rounds.best)
        yield from self._changed(over, deadline)

    def _changed(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[Decided]:
        """Yield the same, with a few tours decided anew at a time."""
        stale = 0
        while stale < self.tuning.stale and not over():
            change = self._other_jobs if self.rng.random() < self.tuning.jobs else self._other_order
            found, before = change(deadline), self.best
            stale += 1
            if found is None or self._cost(found) >= self._cost(before):
                continue
            self._keep(found)
            stale = 0
            if found.lean().makespan < before.lean().makespan:
                yield found

    def polished(self, changes: int, deadline: Deadline) -> Decided:
        """Return the best tours after some ``changes``, none of which gives jobs to others."""
        for _ in range(changes):
            if deadline.expired():
                break
            found = self._other_order(deadline)
            if found is not None and self._cost(found) < self._cost(self.best):
                self._keep(found)
        return self.best

    def _keep(self, found: Decided) -> None:
        """Go on from better tours."""
        self.best = found
        self.tried.clear()
        self.delays.clear()

    def _cost(self, decided: Decided) -> tuple[int, float]:
        return decided.cost(self.dealt.tuning.steep)

    def _ranked(self) -> list[str]:
        """Return the robots, those that end last first."""
        ends = self.best.ends()
        return sorted(self.tours.robots, key=lambda r: (-ends.get(r, 0.0), r))

    def _other_order(self, deadline: Deadline) -> Decided | None:
        """Return what comes of deciding one of the last tours anew, with those that delay it or
        with any others, in a random order.
        """
        rng, ranked = self.rng, self._ranked()
        last = ranked[min(int(rng.expovariate(1.0)), len(ranked) - 1)]
        others = sorted(set(ranked) - {last})
        many = min(len(others), rng.randint(1, self.tuning.together))
        asked = rng.random() < self.tuning.delaying
        delaying = sorted(self._delaying(last, deadline)) if asked else []
        some = rng.sample(delaying, min(len(delaying), many))
        some += rng.sample([r for r in others if r not in some], many - len(some))
        some.append(last)
        rng.shuffle(some)
        if rng.random() < self.tuning.ahead:
            some.sort(key=lambda robot: robot != last)
        return self._anew(self.tours, some, deadline)

    def _delaying(self, robot: str, deadline: Deadline) -> set[str]:
        """Return who delays a robot in the best tours."""
        if robot not in self.delays:
            self.delays[robot] = self.tours.delaying(self.best, robot, deadline)
        return self.delays[robot]

    def _other_jobs(self, deadline: Deadline) -> Decided | None:
        """Return what comes of giving a job of the last tour to another robot."""
        options = self._exchanges()
        if not options:
            return self._other_order(deadline)
        _, key, changed = options[self.rng.randrange(min(len(options), self.tuning.choice))]
        self.tried.add(key)
        dealt = self.dealt.with_tours(changed)
        tours = self.open_tours(dealt, deadline)
        found = None if tours is None else self._anew(tours, list(changed), deadline)
        if tours is not None and found is not None and self._cost(found) < self._cost(self.best):
            self.dealt, self.tours = dealt, tours
        return found

    def _anew(self, tours: TourPlanner, some: list[str], deadline: Deadline) -> Decided | None:
        """Return what comes of deciding some tours anew, in that order or in the order of time."""
        # other ways are looked for now and then: that takes far longer than to wait on known ones
        looks = self.tuning.looks if self.rng.random() < self.tuning.looking else 0
        in_turns = self.rng.random() < self.tuning.in_turns
        if not tours.adopt(self.best, some):
            return None
        given = Priorities(looks=looks, limit=self.best.lean().makespan)
        if in_turns:
            stuck = tours.decide_in_turns(given, deadline)
        else:
            stuck = tours.decide(replace(given, first=tuple(some)), deadline)
        return None if stuck is not None else tours.decided()

    def _exchanges(self) -> list[tuple[float, tuple[object, ...], dict[str, list[Step]]]]:
        """Return ways to take a job from the last tour, those first that are over soonest as far as
        driving alone tells: (s, key, tours).
        """
        ends, (worst, *_) = self.best.ends(), self._ranked()
        found = []
        for key, changed in _changes(self.dealt, worst):
            if key in self.tried:
                continue
            then = max(
                ends.get(r, 0.0)
                + self.dealt.cost(r, changed[r])
                - self.dealt.cost(r, self.dealt.tours[r])
                for r in changed
            )
            if then < ends[worst]:
                found.append((then, key, changed))
        found.sort(key=lambda option: (option[0], str(option[1])))
        return found


def _changes(dealt: Deal, worst: str) -> Iterator[tuple[tuple[object, ...], dict[str, list[Step]]]]:
    """Yield tours in which a job of one robot is done by another one, with or without one in
    exchange.
    """
    jobs, tours = dealt.jobs.options, dealt.tours
    for at, step in enumerate(tours.get(worst, ())):
        left = [s for s in tours[worst] if s != step]
        for number, option in enumerate(jobs[step[0]]):
            other, mine = option.robot, (step[0], number)
            if other == worst:
                continue
            theirs = tours[other]
            for place in range(len(theirs) + 1):
                moved = [*theirs[:place], mine, *theirs[place:]]
                yield ("move", step, other, place), {worst: left, other: moved}
            for place, back in enumerate(theirs):
                mirrored = _option_of(dealt, back, worst)
                if mirrored is not None:
                    swapped = [*theirs[:place], mine, *theirs[place + 1 :]]
                    taken = [*tours[worst][:at], mirrored, *tours[worst][at + 1 :]]
                    yield ("swap", step, back), {worst: taken, other: swapped}


def _option_of(dealt: Deal, step: Step, robot: str) -> Step | None:
    """Return how a robot would do the job of a step, if it can."""
    options: Mapping[int, str] = {k: o.robot for k, o in enumerate(dealt.jobs.options[step[0]])}
    return next(((step[0], k) for k, who in options.items() if who == robot), None)
