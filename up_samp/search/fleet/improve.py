"""First tours of a candidate, and better ones: priority search, large-neighbourhood search."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from up_samp.model import Deadline
from up_samp.search.events import Phase
from up_samp.search.fleet.assignment import Assignment
from up_samp.search.fleet.evaluator import Step
from up_samp.search.fleet.sequential import FleetSolution, alone, can_decide, times_of
from up_samp.search.fleet.tours import Past, Priorities, TourPlanner
from up_samp.search.fleet.tuning import LargeTuning, RoundsTuning, ToursTuning
from up_samp.search.search import Search
from up_samp.upio import Itinerary


@dataclass(frozen=True)
class FirstTours:
    """Tours and the best way to decide them that was found. ``ahead``: how much sooner (s) robots
    had their turns than they would, None if they had none.
    """

    tours: TourPlanner
    decided: FleetSolution
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
        rounds = PrioritySearch(tours, tuning, random.Random(search.seed))
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
class PrioritySearch:
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

    def best(self, deadline: Deadline) -> FleetSolution | None:
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

    def _round(self, given: Priorities, deadline: Deadline) -> FleetSolution | None:
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


# ------------------ Better rounds
# Better rounds: whose turn comes when is changed a little, and kept if everybody is done sooner.
# A round decides all tours anew in the order of time, on the ways that are known
#: it is over in a fraction of a second, and hangs on whose
# turn comes sooner than it would. So those turns are searched (iterated local search; Lourenço,
# Martin and Stützle 2003): some robots, those that end last most often, have their turns sooner
# or later; or those motions of theirs that take much longer than they would alone look for other
# ways, which all rounds know from then on. A round is given up as soon as somebody cannot end any
# more before the last one of the best round does.


@dataclass
class PriorityLocalSearch:
    """The best round so far, with how much sooner (s) robots have their turns in it, and the search
    for better ones.

    :param steep: to which power a tour's end counts.
    """

    tours: TourPlanner
    best: FleetSolution
    ahead: Mapping[str, float]
    tuning: RoundsTuning
    steep: int
    rng: random.Random

    def improved(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[FleetSolution]:
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
    ) -> FleetSolution | None:
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


# ------------------ Better plans of a fleet
# Better plans of a fleet: some tours are withdrawn and decided anew among the others. First all
# tours are decided again and again, if that is how they were
# found, until that brings nothing any more. Then comes a large-neighbourhood search (Shaw 1998;
# for paths of many robots: Li et al., "Anytime Multi-Agent Path Finding via Large Neighborhood
# Search", IJCAI 2021). One of the tours that end last is decided anew, with some of those that
# delay it or with any others, in a random order or in the order of time; or its robot gives a job
# to another one, or exchanges one with it. What is not withdrawn stays as it is, motions and
# times. A change is kept if the plan gets shorter, or if it does not and its tours do on the
# whole.


OpenTours = Callable[[Assignment, Deadline], TourPlanner | None]
"""Opens tours of what was dealt out, with nothing decided; None where they cannot be."""


@dataclass
class TourLNS:
    """The best tours so far of a fleet, and the search for better ones."""

    dealt: Assignment
    tours: TourPlanner
    best: FleetSolution
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

    def improved(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[FleetSolution]:
        """Yield tours that are over sooner than all before, until it is ``over``."""
        if self.ahead is not None:
            steep, ahead = self.dealt.tuning.steep, self.ahead
            rounds = PriorityLocalSearch(self.tours, self.best, ahead, self.rounds, steep, self.rng)
            for found in rounds.improved(over, deadline):
                self._keep(found)
                yield found
            self._keep(rounds.best)
        yield from self._changed(over, deadline)

    def _changed(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[FleetSolution]:
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

    def polished(self, changes: int, deadline: Deadline) -> FleetSolution:
        """Return the best tours after some ``changes``, none of which gives jobs to others."""
        for _ in range(changes):
            if deadline.expired():
                break
            found = self._other_order(deadline)
            if found is not None and self._cost(found) < self._cost(self.best):
                self._keep(found)
        return self.best

    def _keep(self, found: FleetSolution) -> None:
        """Go on from better tours."""
        self.best = found
        self.tried.clear()
        self.delays.clear()

    def _cost(self, decided: FleetSolution) -> tuple[int, float]:
        return decided.cost(self.dealt.tuning.steep)

    def _ranked(self) -> list[str]:
        """Return the robots, those that end last first."""
        ends = self.best.ends()
        return sorted(self.tours.robots, key=lambda r: (-ends.get(r, 0.0), r))

    def _other_order(self, deadline: Deadline) -> FleetSolution | None:
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

    def _other_jobs(self, deadline: Deadline) -> FleetSolution | None:
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

    def _anew(
        self, tours: TourPlanner, some: list[str], deadline: Deadline
    ) -> FleetSolution | None:
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


def _changes(
    dealt: Assignment, worst: str
) -> Iterator[tuple[tuple[object, ...], dict[str, list[Step]]]]:
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


def _option_of(dealt: Assignment, step: Step, robot: str) -> Step | None:
    """Return how a robot would do the job of a step, if it can."""
    options: Mapping[int, str] = {k: o.robot for k, o in enumerate(dealt.jobs.options[step[0]])}
    return next(((step[0], k) for k, who in options.items() if who == robot), None)
