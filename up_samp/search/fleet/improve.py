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

import itertools
import math
import random
import statistics
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from up_samp.model import CandidateSchedule, Deadline
from up_samp.search.check import Check
from up_samp.search.events import Phase
from up_samp.search.fleet.assignment import NOISE, Assignment, biased, exchanged, mended
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.sequential import FleetSolution, alone, can_decide, times_of
from up_samp.search.fleet.tours import Priorities, TourPlanner
from up_samp.search.knowledge import Incumbent
from up_samp.search.resolve import STEP_EFFORT, Subproblem
from up_samp.search.search import Search
from up_samp.search.world import groups_of
from up_samp.upio import Itinerary, read_itinerary
from up_samp.upio.restrict import restrict

Answer = TypeVar("Answer")

# candidates of the usual search
MANY, _SHARE = 14, 0.6
"""Motions that may meet, from which on a candidate's motions are not first tried as scheduled; and
the share of the remaining time that they get."""
_FEW_ROUNDS = 4
"""In which all their tours are decided, and those of another share of the jobs."""
# first tours
_HOPELESS = 6
"""Rounds without tours, after which they are decided whole."""
_NOISE = 3.0
"""s at most, by which turns are changed at random."""
_HEARD = 0.3
"""Of how much later a robot ended: by that its turn comes sooner."""
_KEPT = 0.9
"""Of that, kept from round to round."""
_STUCK_SOONER = 20.0
"""s by which turns of who was stuck come sooner."""
_ORDERS = 12
"""Of the robots, for whole tours; who finds no tour goes first in the next one."""
# better tours
AGAIN_DEALT = 2
"""Shares of the jobs in a row that bring nothing, before the tours of the best are changed."""
_DRAWN = 3
"""Shares of the jobs, of which the best one is tried."""
_STEEP = 60.0
"""Power of a tour's end that counts in those: hardly any but the last one does."""
_TOGETHER = 5
"""Tours at most, that are decided anew with one of the last."""
_CRITICAL = 0.5
"""Share of choices that fall on what the last end hangs on."""
_TURNS = (1, 1, 2, 3, 5)
"""Robots whose turns change at once: one of these."""
_SOONER = 10.0
"""s at most, by which turns come sooner or later."""
DELAYED = 6.0
"""s by which a motion takes longer than alone that looks for another way."""


def plan_tours(
    search: Search,
    itinerary: Itinerary,
    deadline: Deadline,
    *,
    homes: frozenset[str] = frozenset(),
) -> tuple[TourPlanner, FleetSolution] | None:
    """Return the tours of a candidate, and the best way to decide them that was found; None where
    there is none.

    :param homes: motions at the end of tours that may be left out where nobody needs them.
    """
    search.tell.stage(Phase.GROUP, count=len(itinerary.motions))
    with search.budget.motion_time():
        tours = undecided_tours(search, itinerary, homes)
        if tours is None:
            return None
        tours.learn_ways_past(deadline)
        found = squeaky_wheel(tours, search.tuning.rounds, random.Random(search.seed), deadline)
        if found is None and _whole(tours, deadline):
            found = tours.decided()
    return None if found is None else (tours, found)


def in_order(search: Search, itinerary: Itinerary) -> Incumbent | None:
    """Return a plan with the activities of a candidate of many motions at once, decided in a few
    rounds of tours; None where none is found.
    """
    if max((len(g) for g in groups_of(itinerary.motions)), default=0) < MANY:
        return None
    return _in_few_rounds(search, itinerary, search.budget.share(_SHARE, float("inf")))


def in_order_at_last(search: Search, schedule: CandidateSchedule, check: Check) -> Incumbent | None:
    """Return a plan with the activities of a candidate whose motions were not found as scheduled,
    decided one after the other, as long as there is no plan; None where none is found.

    Motions together may take more time than there is, on a busy machine at the latest. Decided in
    turn they come late, but most of them side by side, while motions that only happen one at a
    time (:func:`up_samp.search.resolve.serialize_motions`) take two or three times as long.
    """
    if search.bounds.incumbent is not None:
        return None
    # what the check told is in the relaxation by now: the candidate may break it
    problem = restrict(search.knowledge.relaxation, schedule)
    near = Subproblem(search, problem, STEP_EFFORT).schedule(schedule)
    if near is None:
        return None
    itinerary = read_itinerary(search.knowledge.relaxation, near)
    return _in_few_rounds(search, itinerary, search.budget.part("motions one at a time"))


def _in_few_rounds(search: Search, itinerary: Itinerary, deadline: Deadline) -> Incumbent | None:
    search.tell.stage(Phase.GROUP, count=len(itinerary.motions))
    with search.budget.motion_time():
        tours = undecided_tours(search, itinerary, frozenset())
        rng = random.Random(search.seed)
        found = None if tours is None else squeaky_wheel(tours, _FEW_ROUNDS, rng, deadline)
    if found is None:
        return None
    return search.plan_of(found.schedule, found.trajectories())


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
    tours: TourPlanner, rounds: int, rng: random.Random, deadline: Deadline
) -> FleetSolution | None:
    """Return the tours of the best of some rounds, if any brings some. In each all are decided in
    the order of time; who is stuck, or ends late, has its turns sooner in the next one.
    """
    best: FleetSolution | None = None
    ahead: dict[str, float] = {}
    """How much sooner (s) robots have their turns than they would."""
    kept: dict[str, float] = {}
    """The same, in the best round so far."""
    first: list[str] = []  # whose whole tours go before all others
    late = set[str]()  # who was stuck before there was any good round
    for number in range(rounds):
        if deadline.expired() or (best is None and number >= _HOPELESS):
            break
        noise = _NOISE if ahead else 0.0
        turns = {r: ahead.get(r, 0.0) + rng.uniform(0, noise) for r in tours.robots}
        tours.reset()
        stuck = tours.decide_in_turns(Priorities(tuple(first), ahead=turns), deadline)
        if stuck is not None:
            if best is None and stuck in late:
                first = _sooner(stuck, first)
            late.add(stuck)
            before = ahead if best is None else kept
            ahead = {**before, stuck: before.get(stuck, 0.0) + _STUCK_SOONER}
            continue
        found = tours.decided()
        if best is None or found.cost(1) < best.cost(1):
            best, kept = found, turns
        ends = found.ends()
        usual = sorted(ends.values())[len(ends) // 2]
        ahead = {
            robot: _KEPT * ahead.get(robot, 0.0) + _HEARD * max(0.0, end - usual)
            for robot, end in ends.items()
        }
    return best


def _whole(tours: TourPlanner, deadline: Deadline) -> bool:
    """Decide whole tours, one after the other; return whether that was possible."""
    first = tours.ranked()
    for _ in range(_ORDERS):
        tours.reset()
        stuck = tours.decide_in_turns(Priorities(tuple(first), looks=1), deadline)
        if stuck is None:
            return True
        if deadline.expired() or first[:1] == [stuck]:
            return False
        first = _sooner(stuck, first)
    return False


def _sooner(stuck: str, first: Sequence[str]) -> list[str]:
    """Return who goes first if one more has to."""
    return [stuck, *(name for name in first if name != stuck)]


# ------------------ Better tours


Move = Callable[["FleetLNS", Deadline], FleetSolution | None]
Moves = Sequence[tuple[Move, float]]
"""What may be changed, and how large a share of all changes each move has."""
OpenTours = Callable[[Assignment, Deadline], TourPlanner | None]
"""Opens tours of what was dealt out, with nothing decided; None where they cannot be."""


@dataclass
class FleetLNS:
    """The best tours so far of a fleet, and the search for better ones."""

    dealt: Assignment
    tours: TourPlanner
    best: FleetSolution
    open_tours: OpenTours
    rng: random.Random
    without_traffic: float = math.inf
    """When (s) all jobs are done at the soonest, as far as shared places tell."""
    _asked: dict[Hashable, Any] = field(default_factory=dict)
    """What was asked of the best tours, with the answers."""

    def improved(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[FleetSolution]:
        """Yield tours that are over sooner than all before, until it is ``over`` or many changes in
        a row bring nothing.
        """
        # another share of the jobs pays while the best tours are hardly better than first ones
        yield from self.changed(over, deadline, ((deal_again, 1.0),), AGAIN_DEALT)
        yield from self.changed(over, deadline, MOVES, self.dealt.tuning.stale)

    def changed(
        self, over: Callable[[], bool], deadline: Deadline, moves: Moves, stale: int
    ) -> Iterator[FleetSolution]:
        """The same by some moves only, until as many changes in a row bring nothing as are
        ``stale``.
        """
        left, shares = stale, [share for _, share in moves]
        while left > 0 and not over():
            [(move, _)] = self.rng.choices(moves, shares)
            left -= 1
            before = self.cost(self.best)
            found = move(self, deadline)
            if found is None or self.cost(found) > before:
                continue
            # as good ones, too: they lead elsewhere
            self.best = found
            self._asked.clear()
            if self.cost(found) < before:
                left = stale
            if self.cost(found)[0] < before[0]:
                yield found

    def cost(self, decided: FleetSolution) -> tuple[int, float]:
        """Return the makespan of tours, and what they are worth on the whole."""
        return decided.cost(self.dealt.rehearsal.rules.steep)

    def last_first(self) -> list[str]:
        """Return the robots, those that end last first."""
        ends = self.best.ends()
        return sorted(self.tours.robots, key=lambda r: (-ends.get(r, 0.0), r))

    def _once(self, question: Hashable, answer: Callable[[], Answer]) -> Answer:
        """Return what is answered to a question on the best tours, asked once as long as they are
        the best.
        """
        if question not in self._asked:
            self._asked[question] = answer()
        found: Answer = self._asked[question]
        return found

    def critical(self) -> list[str]:
        """Return the motions that the last end hangs on."""
        return self._once("critical", lambda: self.tours.critical(self.best))

    def one_of_the_last(self) -> str:
        """Return a robot at random that the last end hangs on, or one that ends last more likely
        than others.
        """
        if self.rng.random() < _CRITICAL:
            return self.tours.robot_of(self.rng.choice(self.critical()))
        ranked = self.last_first()
        return ranked[min(int(self.rng.expovariate(0.7)), len(ranked) - 1)]

    def delaying(self, robot: str, deadline: Deadline) -> list[str]:
        """Return who delays a robot in the best tours."""
        return self._once(
            ("delaying", robot), lambda: sorted(self.tours.delaying(self.best, robot, deadline))
        )

    def delays(self, robot: str) -> dict[str, float]:
        """Return by how much (s) a robot's motions end later than if nobody was in their way."""
        return self._once(("delays", robot), lambda: self.tours.delays(self.best, robot))

    def since(self, robots: Iterable[str], moment: float) -> dict[str, int]:
        """Return how many motions of robots were decided before a moment (s)."""
        found = {}
        for robot in robots:
            before = itertools.takewhile(
                lambda piece: self.best.turns[piece[0]] < moment, self.tours.pieces(robot)
            )
            found[robot] = sum(map(len, before))
        return found

    def anew(
        self, kept: Mapping[str, int], given: Priorities, deadline: Deadline
    ) -> FleetSolution | None:
        """Return what comes of it if of some robots only so many motions as are ``kept`` stay as
        they are and all others are decided anew in turns; None where somebody is stuck or too late.
        """
        if not self.tours.adopt(self.best, kept):
            return None
        # of each drive other ways are looked for so often, over all changes: then they are known
        stuck = self.tours.decide_in_turns(replace(given, looks=2), deadline)
        return self.tours.decided() if stuck is None else None


# ------------------ Moves: what is withdrawn, and whose turn comes first then


def other_turns(search: FleetLNS, deadline: Deadline) -> FleetSolution | None:
    """Everybody anew from some moment on; some pieces of tours have their turns sooner or later,
    those of the last robots most often, or sooner, those that the last end hangs on.
    """
    return search.anew(*_turns_changed(search), deadline)


def _turns_changed(search: FleetLNS) -> tuple[dict[str, int], Priorities]:
    """Return how many motions of each robot come before the first turn that changes, and all turns
    then.
    """
    rng, turns, moment = search.rng, dict(search.best.turns), math.inf
    for _ in range(rng.choice(_TURNS)):
        some, sooner = _turned(search)
        for piece in some:
            turns[piece[0]] -= sooner
            moment = min(moment, turns[piece[0]], search.best.turns[piece[0]])
    kept = search.since(search.tours.robots, moment)
    return kept, Priorities(turns=turns, latest=search.best.lean().makespan)


def _turned(search: FleetLNS) -> tuple[list[list[str]], float]:
    """Return pieces of a tour whose turns change, and how much sooner (s) they come."""
    rng, tours = search.rng, search.tours
    if rng.random() < _CRITICAL:
        name = rng.choice(search.critical())
        mine = tours.pieces(tours.robot_of(name))
        return [piece for piece in mine if name in piece], rng.uniform(0.0, _SOONER)
    robot = search.one_of_the_last() if rng.random() < 0.7 else rng.choice(tours.robots)
    pieces = tours.pieces(robot)
    sooner = rng.uniform(-_SOONER, _SOONER)
    return pieces if rng.random() < 0.3 else [rng.choice(pieces)], sooner


def other_ways(search: FleetLNS, deadline: Deadline) -> FleetSolution | None:
    """The same, and of some of the last the motion that is delayed most looks for another way,
    which all know from then on.
    """
    looking = dict[str, int]()
    for robot in sorted({search.one_of_the_last() for _ in range(2)}):
        delays = search.delays(robot)
        name = min(delays, key=lambda name: (-delays[name], name), default="")
        if delays.get(name, 0.0) > DELAYED:
            looking[name] = search.tours.looked(name) + 1
    kept, given = _turns_changed(search)
    if not looking:
        return None
    some = {r: search.tours.pieces(r) for r in search.tours.robots}
    heads = [p[0] for ps in some.values() for p in ps if looking.keys() & set(p)]
    moment = min(search.best.turns[head] for head in heads)
    earlier = search.since(search.tours.robots, moment)
    kept = {robot: min(many, earlier[robot]) for robot, many in kept.items()}
    return search.anew(kept, replace(given, looking=looking), deadline)


def some_of_the_last(search: FleetLNS, deadline: Deadline) -> FleetSolution | None:
    """One of the last tours anew from some moment on, with those of some that delay it, or work
    where it does, or any others: one after the other, as they had their turns before, or as they
    come.
    """
    rng = search.rng
    last = search.one_of_the_last()
    others = [r for r in search.tours.robots if r != last]
    many = min(len(others), rng.randint(1, _TOGETHER))
    near = rng.choice(NEAR)(search, last, deadline)
    some = rng.sample(near, min(len(near), many))
    some += rng.sample([r for r in others if r not in some], many - len(some))
    some.insert(rng.randrange(len(some) + 1) if rng.random() < 0.5 else 0, last)
    moment = -math.inf
    if rng.random() < 0.5:
        moment = search.best.turns[rng.choice(search.tours.pieces(some[0]))[0]]
    order = rng.choice(("one after the other", "as before", "as they come"))
    first = tuple(some) if order == "one after the other" else ()
    turns = search.best.turns if order == "as before" else {}
    limit = search.best.lean().makespan
    given = Priorities(first, turns=turns, limit=limit)
    return search.anew(search.since(some, moment), given, deadline)


NEAR: tuple[Callable[[FleetLNS, str, Deadline], list[str]], ...] = (
    lambda search, robot, deadline: search.delaying(robot, deadline),
    lambda search, robot, _: sorted(search.tours.sharing(robot)),
    lambda *_: [],
)
"""Whose tours may be decided anew with a robot's before any others."""


def deal_again(search: FleetLNS, deadline: Deadline) -> FleetSolution | None:
    """All jobs dealt out anew with what is known now of drives and of changes at shared places;
    all tours are decided in rounds, and gone on with, if they are kept.
    """
    dealt, rng = search.dealt, search.rng
    usual = dealt.rehearsal
    gaps = search.tours.changeovers(search.best) or [usual.rules.handover]
    known = usual.rules._replace(steep=_STEEP, handover=statistics.median(gaps))
    found = _promising(search, replace(usual, rules=known), deadline)
    least = replace(usual, rules=known._replace(handover=gaps[0])).ends(found.tours).values()
    search.without_traffic = min(search.without_traffic, max(end for end, _ in least))
    again = replace(found, rehearsal=usual)
    tours = None if again.tours == dealt.tours else search.open_tours(again, deadline)
    decided = None if tours is None else squeaky_wheel(tours, _FEW_ROUNDS, rng, deadline)
    if tours is None or decided is None:
        return None
    trial = FleetLNS(again, tours, decided, search.open_tours, rng)
    tries = len(tours.robots)
    for _ in trial.changed(deadline.expired, deadline, ((other_turns, 1.0),), tries):
        pass
    if search.cost(trial.best) <= search.cost(search.best):
        search.tours, search.dealt = tours, again
    return trial.best


def _promising(search: FleetLNS, expected: AssignmentEvaluator, deadline: Deadline) -> Assignment:
    """Return the best by what is ``expected`` of some shares of the jobs, each by guesses that
    differ a little: what suits one of them best is found over and over.
    """
    dealt, rng, shares = search.dealt, search.rng, []
    for _ in range(_DRAWN):
        bias = biased(dealt.jobs, NOISE * rng.random() ** 2, rng)
        guessed = AssignmentEvaluator(expected.guess, dealt.jobs, expected.rules, bias)
        shares.append(exchanged(replace(dealt, rehearsal=guessed), rng, deadline))
    best = min(shares, key=lambda share: expected.length(share.tours))
    return mended(best, rng, deadline)


MOVES: Moves = (
    (other_turns, 0.72),
    (other_ways, 0.1),
    (some_of_the_last, 0.15),
    (deal_again, 0.03),
)
