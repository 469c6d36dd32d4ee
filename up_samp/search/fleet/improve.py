"""Tours of a fleet by large-neighbourhood search: first ones, and better and better ones.

*First tours*: all tours are decided in the order of time, again and again; those that ended late
have their turns sooner in the next round (squeaky wheel optimisation; Joslin and Clements 1999).
*Better tours*: some are withdrawn and decided anew among the others, whose motions and times stay
as they are (Shaw 1998; for paths of many robots: Li et al., "Anytime Multi-Agent Path Finding via
Large Neighborhood Search", IJCAI 2021). What is withdrawn, and who goes first then, is the choice
of a *move*: one of the functions in :data:`MOVES`. A change is kept unless the plan gets longer by
it, or its tours do on the whole.
"""

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
from up_samp.search.fleet.tuning import LargeTuning, ToursTuning
from up_samp.search.search import Search
from up_samp.upio import Itinerary


@dataclass(frozen=True)
class FirstTours:
    """Tours and the best way to decide them that was found. ``ahead``: how much sooner (s) robots
    had their turns than they would.
    """

    tours: TourPlanner
    decided: FleetSolution
    ahead: Mapping[str, float] = field(default_factory=dict)


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
        found = squeaky_wheel(tours, tuning, random.Random(search.seed), deadline)
        if found is None and _whole(tours, tuning, deadline):
            found = FirstTours(tours, tours.decided())
    return found


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


def squeaky_wheel(
    tours: TourPlanner, tuning: ToursTuning, rng: random.Random, deadline: Deadline
) -> FirstTours | None:
    """Return the tours of the best of some rounds, if any brings some. In each all are decided in
    the order of time; who is stuck, or ends late, has its turns sooner in the next one.
    """
    best: FirstTours | None = None
    ahead: dict[str, float] = {}
    first: list[str] = []  # whose whole tours go before all others
    late = set[str]()  # who was stuck before there was any good round
    for number in range(tuning.rounds):
        if deadline.expired() or (best is None and number >= tuning.hopeless):
            break
        noise = tuning.noise if ahead else 0.0
        turns = {r: ahead.get(r, 0.0) + rng.uniform(0, noise) for r in tours.robots}
        looks = number // tuning.each if number % tuning.each == 0 else 0
        past = Past.QUICK if looks else Past.NONE
        tours.reset()
        stuck = tours.decide_in_turns(Priorities(tuple(first), turns, looks, past=past), deadline)
        if stuck is not None:
            if best is None and stuck in late:
                first = _sooner(stuck, first)
            late.add(stuck)
            before = ahead if best is None else best.ahead
            ahead = {**before, stuck: before.get(stuck, 0.0) + tuning.sooner}
            continue
        found = tours.decided()
        if best is None or found.cost(1) < best.decided.cost(1):
            best = FirstTours(tours, found, turns)
        ends = found.ends()
        usual = sorted(ends.values())[len(ends) // 2]
        ahead = {
            robot: tuning.kept * ahead.get(robot, 0.0) + tuning.heard * max(0.0, end - usual)
            for robot, end in ends.items()
        }
    return best


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


# ------------------ Better tours


OpenTours = Callable[[Assignment, Deadline], TourPlanner | None]
"""Opens tours of what was dealt out, with nothing decided; None where they cannot be."""


@dataclass(frozen=True)
class Change:
    """What a move asks for: the tours of some robots are ``withdrawn`` (None: all) and decided
    anew, in the order of time or whole, with ``given`` priorities.

    :param dealt: what is dealt out then, if that is something else.
    """

    withdrawn: Sequence[str] | None
    given: Priorities
    in_turns: bool = True
    dealt: Assignment | None = None


@dataclass
class FleetLNS:
    """The best tours so far of a fleet, and the search for better ones.

    :param ahead: how much sooner (s) robots have their turns when all tours are decided anew.
    """

    dealt: Assignment
    tours: TourPlanner
    best: FleetSolution
    ahead: Mapping[str, float]
    open_tours: OpenTours
    tuning: LargeTuning
    rng: random.Random
    tried: set[tuple[object, ...]] = field(default_factory=set)
    """Exchanges of jobs that did not help since the last change."""
    _delaying: dict[str, set[str]] = field(default_factory=dict)
    """Who delays a robot, as far as that was asked since the last change."""

    def improved(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[FleetSolution]:
        """Yield tours that are over sooner than all before, until it is ``over`` or many changes in
        a row bring nothing.
        """
        stale, shares = 0, [share for _, share in MOVES]
        while stale < self.tuning.stale and not over():
            ((move, _),) = self.rng.choices(MOVES, shares)
            stale += 1
            before = self.cost(self.best)
            found = self._decided(move(self, deadline), deadline)
            if found is None or self.cost(found) > before:
                continue
            # as good ones, too: they lead elsewhere
            self.best = found
            self.tried.clear()
            self._delaying.clear()
            if self.cost(found) < before:
                stale = 0
            if self.cost(found)[0] < before[0]:
                yield found

    def cost(self, decided: FleetSolution) -> tuple[int, float]:
        """Return the makespan of tours, and what they are worth on the whole."""
        return decided.cost(self.dealt.tuning.steep)

    def last_first(self) -> list[str]:
        """Return the robots, those that end last first."""
        ends = self.best.ends()
        return sorted(self.tours.robots, key=lambda r: (-ends.get(r, 0.0), r))

    def one_of_the_last(self) -> str:
        """Return a robot at random, one that ends last more likely than others."""
        ranked = self.last_first()
        return ranked[min(int(self.rng.expovariate(0.7)), len(ranked) - 1)]

    def delaying(self, robot: str, deadline: Deadline) -> list[str]:
        """Return who delays a robot in the best tours."""
        if robot not in self._delaying:
            self._delaying[robot] = self.tours.delaying(self.best, robot, deadline)
        return sorted(self._delaying[robot])

    def _decided(self, change: Change, deadline: Deadline) -> FleetSolution | None:
        """Return what comes of a change; None where somebody is stuck or too late. What is better
        is gone on from.
        """
        tours = self.tours if change.dealt is None else self.open_tours(change.dealt, deadline)
        if tours is None:
            return None
        if change.withdrawn is None:
            tours.reset()
        elif not tours.adopt(self.best, change.withdrawn):
            return None
        decide = tours.decide_in_turns if change.in_turns else tours.decide
        if decide(change.given, deadline) is not None:
            return None
        found = tours.decided()
        if self.cost(found) <= self.cost(self.best):
            self.tours, self.dealt = tours, change.dealt or self.dealt
            if change.withdrawn is None:
                self.ahead = change.given.ahead
        return found


# ------------------ Moves: what is withdrawn, and who goes first then


Move = Callable[[FleetLNS, Deadline], Change]


def other_turns(search: FleetLNS, deadline: Deadline) -> Change:
    """Everybody anew in the order of time, some with their turns sooner or later."""
    del deadline
    rng, tuning, ahead = search.rng, search.tuning, dict(search.ahead)
    for _ in range(rng.choice(tuning.turns)):
        robot = search.one_of_the_last() if rng.random() < 0.5 else rng.choice(search.tours.robots)
        ahead[robot] = ahead.get(robot, 0.0) + rng.uniform(-tuning.sooner, tuning.sooner)
    return Change(None, Priorities(ahead=ahead, latest=search.best.lean().makespan))


def other_ways(search: FleetLNS, deadline: Deadline) -> Change:
    """Everybody anew in the order of time; those motions of some of the last that take longest look
    for other ways, which all know from then on.
    """
    change, looking = other_turns(search, deadline), dict[str, int]()
    for robot in sorted({search.one_of_the_last() for _ in range(2)}):
        delays = search.tours.delays(search.best, robot)
        longest = sorted(delays, key=lambda name: (-delays[name], name))
        for name in longest[: search.tuning.motions]:
            if delays[name] > search.tuning.delayed:
                looking[name] = search.tours.looked(name) + 1
    ahead = change.given.ahead if search.rng.random() < 0.5 else search.ahead
    return replace(change, given=replace(change.given, ahead=ahead, looking=looking))


def some_of_the_last(search: FleetLNS, deadline: Deadline) -> Change:
    """One of the last tours anew, with some of those that delay it, or with any others."""
    rng, tuning = search.rng, search.tuning
    last = search.one_of_the_last()
    others = sorted(set(search.tours.robots) - {last})
    many = min(len(others), rng.randint(1, tuning.together))
    delaying = search.delaying(last, deadline) if rng.random() < tuning.delaying else []
    some = rng.sample(delaying, min(len(delaying), many))
    some += rng.sample([r for r in others if r not in some], many - len(some))
    some.append(last)
    rng.shuffle(some)
    if rng.random() < 0.5:
        some.sort(key=lambda robot: robot != last)
    return _anew(search, some)


def other_jobs(search: FleetLNS, deadline: Deadline) -> Change:
    """A job of the last tour done by another robot, with or without one in exchange: one of those
    changes that are over soonest as far as driving alone tells.
    """
    ends, worst = search.best.ends(), search.last_first()[0]
    options = []
    for key, changed in _exchanges(search.dealt, worst):
        longer = {r: search.dealt.cost(r, changed[r]) - search.dealt.cost(r, search.dealt.tours[r])
                  for r in changed}  # fmt: skip
        then = max(ends.get(r, 0.0) + more for r, more in longer.items())
        if key not in search.tried and then < ends[worst]:
            options.append((then, str(key), key, changed))
    if not options:
        return some_of_the_last(search, deadline)
    options.sort(key=lambda option: option[:2])
    few = min(len(options), search.tuning.choice)
    _, _, key, changed = options[search.rng.randrange(few)]
    search.tried.add(key)
    return replace(_anew(search, list(changed)), dealt=search.dealt.with_tours(changed))


def _anew(search: FleetLNS, some: Sequence[str]) -> Change:
    """Return a change in which some tours are decided anew, in that order or in that of time."""
    rng, tuning = search.rng, search.tuning
    # other ways are looked for now and then: that takes far longer than to wait on known ones
    looks = tuning.looks if rng.random() < tuning.looking else 0
    in_turns = rng.random() < 0.5
    first = () if in_turns else tuple(some)
    limit = search.best.lean().makespan
    return Change(some, Priorities(first, looks=looks, limit=limit), in_turns)


MOVES: tuple[tuple[Move, float], ...] = (
    (other_turns, 0.35),
    (other_ways, 0.1),
    (some_of_the_last, 0.5),
    (other_jobs, 0.05),
)
"""What may be changed, and how large a share of all changes each move has."""


def _exchanges(
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
