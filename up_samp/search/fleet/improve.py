"""Tours of a fleet by large-neighbourhood search: first ones, and better and better ones.

*First tours*: all tours are decided in the order of time, again and again; those that ended late
have their turns sooner in the next round (squeaky wheel optimisation; Joslin and Clements 1999).
*Better tours*: it is decided for all at once who goes first, and on which ways
(:mod:`up_samp.search.fleet.right_of_way`). What is changed before that, again and again, is what
the *moves* take in turns: the functions in :data:`MOVES` (large-neighbourhood search; Shaw 1998). A
change is kept unless the plan gets longer by it, or its tours do on the whole.
"""

from __future__ import annotations

import itertools
import math
import random
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from up_samp.model import CandidateSchedule, Deadline, Trajectory
from up_samp.search.check import Check
from up_samp.search.events import Phase
from up_samp.search.fleet.assignment import Assignment, exchanged, mended
from up_samp.search.fleet.evaluator import AssignmentEvaluator, Step
from up_samp.search.fleet.evaluator_kernel import CostWeights
from up_samp.search.fleet.sequential import FleetSolution, alone, can_decide, times_of
from up_samp.search.fleet.tours import TourPlanner
from up_samp.search.fleet.travel_times import TravelTimeModel
from up_samp.search.knowledge import Incumbent
from up_samp.search.resolve import STEP_EFFORT, Subproblem
from up_samp.search.search import Search
from up_samp.search.world import groups_of
from up_samp.upio import Itinerary, read_itinerary
from up_samp.upio.restrict import restrict

# candidates of the usual search
MANY = 14
"""Motions that may meet, from which on a candidate's motions are not first tried as scheduled."""
# first tours
_ROUNDS, _FEW_ROUNDS = 16, 6
"""In which all tours are decided: those of a large problem's first plan, and a candidate's."""
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
_HOPED = 1.1
"""Of what tours are expected to take if places are taken in turns: if that is possible they take no
longer.
"""
_WARMTHS = 0.3, 0.1, 0.1, 0.1, 0.1
"""Of the annealing of assignments, one after the other, as a share of the usual warmth; the
best one of them is tried."""
_LOOKS = 3
"""Times that such assignments are looked for, as long as none is expected to be done as soon as the
best tours."""
_STEEP = 60.0
"""Power of a tour's end that counts in those: hardly any but the last one does."""
_LONGER = 0.035, 0.016, 0.008, 0.0
"""Of the best tours' makespan: by so much tours of another assignment may be longer at first, and
each time that motions have looked for ways past each other."""


def plan_tours(
    search: Search,
    itinerary: Itinerary,
    deadline: Deadline,
    *,
    homes: frozenset[str] = frozenset(),
    known: Mapping[str, Trajectory] | None = None,
) -> tuple[TourPlanner, FleetSolution] | None:
    """Return the tours of a candidate, and the best way to decide them that was found; None where
    there is none.

    :param homes: motions at the end of tours that may be left out where nobody needs them.
    :param known: what a plan drives, which is tried first.
    """
    search.tell.stage(Phase.GROUP, count=len(itinerary.motions))
    with search.budget.motion_time():
        tours = undecided_tours(search, itinerary, homes)
        if tours is None:
            return None
        found = tours.as_planned(known or {})
        if found is not None:
            return tours, found
        tours.learn_ways_past(deadline)
        found = squeaky_wheel(tours, random.Random(search.seed), deadline)
        if found is None:
            tours.set_off_later()
            found = squeaky_wheel(tours, random.Random(search.seed), deadline)
        if found is None and _whole(tours, deadline):
            found = tours.decided()
    return None if found is None else (tours, found)


def in_order(search: Search, itinerary: Itinerary) -> Incumbent | None:
    """Return a plan with the activities of a candidate of many motions at once, decided in a few
    rounds of tours; None where none is found.
    """
    if max((len(g) for g in groups_of(itinerary.motions)), default=0) < MANY:
        return None
    return _in_few_rounds(search, itinerary, search.budget.part("candidates of many motions"))


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
        found = None if tours is None else squeaky_wheel(tours, rng, deadline, _FEW_ROUNDS)
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
    tours: TourPlanner, rng: random.Random, deadline: Deadline, rounds: int = _ROUNDS
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
    for _ in range(rounds):
        if deadline.expired():
            break
        noise = _NOISE * bool(ahead)
        turns = {r: ahead.get(r, 0.0) + rng.uniform(0, noise) for r in tours.robots}
        tours.reset()
        stuck = tours.decide_in_turns(deadline, first, turns)
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
        stuck = tours.decide_in_turns(deadline, first, looks=1)
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
OpenTours = Callable[[Assignment, Deadline], TourPlanner | None]
"""Opens tours of an assignment, with nothing decided; None where they cannot be."""


@dataclass
class FleetLNS:
    """The best tours so far of a fleet, and the search for better ones."""

    assignment: Assignment
    tours: TourPlanner
    best: FleetSolution
    open_tours: OpenTours
    rng: random.Random
    without_traffic: float = math.inf
    """When (s) all jobs are done at the soonest, as far as shared places tell."""
    looked: FleetSolution | None = None
    """Tours whose motions have looked for ways past each other."""
    tried: list[Mapping[str, Sequence[Step]]] = field(default_factory=list)
    """Assignments whose tours were decided."""

    def __post_init__(self) -> None:
        self.tried.append(self.assignment.tours)

    def improved(self, over: Callable[[], bool], deadline: Deadline) -> Iterator[FleetSolution]:
        """Yield tours that are over sooner than all before, until it is ``over`` or many changes in
        a row bring nothing.
        """
        self.tours.learn_ways_past(deadline)  # those of a plan may be all that is known
        yield from self.changed(over, deadline, (right_of_way,), 1)
        yield from self.changed(over, deadline, MOVES, self.assignment.tuning.stale)

    def changed(
        self, over: Callable[[], bool], deadline: Deadline, moves: Sequence[Move], stale: int
    ) -> Iterator[FleetSolution]:
        """The same by some moves only, one after the other, until as many changes in a row bring
        nothing as are ``stale``.
        """
        left, turns = stale, itertools.cycle(moves)
        while left > 0 and not over():
            move = next(turns)
            left -= 1
            before = self.cost(self.best)
            found = move(self, deadline)
            if found is None or self.cost(found) > before:
                continue
            # as good ones, too: they lead elsewhere
            self.best = found
            if self.cost(found) < before:
                left = stale
            if self.cost(found)[0] < before[0]:
                yield found

    def cost(self, decided: FleetSolution) -> tuple[int, float]:
        """Return the makespan of tours, and what they are worth on the whole."""
        return decided.cost(self.assignment.evaluator.rules.steep)

    @property
    def makespan(self) -> int:
        """When the best tours are over (units)."""
        return self.best.lean().makespan


# ------------------ Moves


def right_of_way(search: FleetLNS, deadline: Deadline) -> FleetSolution | None:
    """Who goes first, and on which of the known ways, decided anew for all at once: at first so
    that they are not much longer than expected, which leaves far less to decide.
    """
    assignment, known = search.assignment, search.best.driven()
    expected = max(end for end, _ in assignment.evaluator.ends(assignment.tours).values())
    hoped = int(_HOPED * expected / assignment.guess.snapshot.seconds_per_unit)
    limits = sorted({min(hoped, search.makespan), search.makespan})
    found = (search.tours.coordinated(known, limit, deadline) for limit in limits)
    return next(filter(None, found), None)


def ways_past(search: FleetLNS, deadline: Deadline) -> FleetSolution | None:
    """The same, after motions that meet have looked for ways past each other."""
    if search.looked is search.best:
        return None
    search.looked = search.best
    return search.tours.past_each_other(search.best, search.makespan, deadline)


def reassign(search: FleetLNS, deadline: Deadline) -> FleetSolution | None:
    """All jobs assigned anew with what is known now of drives and of handovers at shared places;
    all tours are decided at once.
    """
    usual, guess = search.assignment.evaluator, search.assignment.guess
    gaps = search.tours.handovers(search.best) or [usual.rules.handover]
    guess.ask_handovers(search.assignment.handovers(), deadline)
    rules = usual.rules._replace(steep=_STEEP, at_once=True)
    known = replace(usual, rules=rules, exact=True)
    found = _promising(search, known, deadline)
    if found is None:
        return None
    search.tried.append(found.tours)
    least = replace(usual, rules=usual.rules._replace(handover=gaps[0])).ends(found.tours).values()
    search.without_traffic = min(search.without_traffic, max(end for end, _ in least))
    again = replace(found, evaluator=usual)
    tours = search.open_tours(again, deadline)
    # ways past each other are known now
    guess.ask_handovers(found.handovers(), deadline, again=True)
    decided = None if tours is None else _at_once(search, tours, deadline)
    if tours is None or decided is None or search.cost(decided) > search.cost(search.best):
        return None
    search.tours, search.assignment = tours, again
    return decided


def _at_once(search: FleetLNS, tours: TourPlanner, deadline: Deadline) -> FleetSolution | None:
    """Return tours of another assignment, decided at once, again with ways of motions past each
    other as long as they are longer than the best ones; None where they stay much longer.
    """
    limits = [int(search.makespan * (1.0 + longer)) for longer in _LONGER]
    found = tours.coordinated({}, limits[0], deadline)
    for limit in limits[1:]:
        if found is None or search.cost(found) <= search.cost(search.best):
            break
        found = tours.past_each_other(found, limit, deadline)
    return found


def _promising(
    search: FleetLNS, expected: AssignmentEvaluator, deadline: Deadline
) -> Assignment | None:
    """Return the best by what is ``expected`` of some assignments that were not tried yet,
    each near the one before; None where none are found.
    """
    near, found = search.assignment, list[Assignment]()
    for _ in range(_LOOKS):
        for warmth in _WARMTHS:
            near = _other(near, expected, search.rng, warmth, deadline)
            if near.tours not in search.tried:
                found.append(near)
        usual = expected.rules._replace(handover=_usual(near.guess, expected.rules))
        evaluator = replace(expected, rules=usual)
        best = min(found, key=lambda one: evaluator.length(one.tours), default=None)
        soon = evaluator.length(search.assignment.tours)
        if best is None or deadline.expired() or evaluator.length(best.tours) < soon:
            break
    return best


def _other(
    near: Assignment,
    expected: AssignmentEvaluator,
    rng: random.Random,
    warmth: float,
    deadline: Deadline,
) -> Assignment:
    """Return another assignment near one, by what is ``expected`` of them."""
    # handovers of which nothing is known may be as short as any: so some of them are looked at
    known = near.guess.handovers
    least, usual = min(known.values(), default=0.0), _usual(near.guess, expected.rules)
    rules = expected.rules._replace(handover=rng.uniform(least, 2 * usual - least))
    asked = replace(near, evaluator=replace(expected, rules=rules))
    return mended(exchanged(asked, rng, deadline, warmth=warmth, another=True), rng, deadline)


def _usual(guess: TravelTimeModel, rules: CostWeights) -> float:
    """Return how long (s) handovers take on average, as far as they are known."""
    return statistics.fmean(guess.handovers.values() or [rules.handover])


MOVES: tuple[Move, ...] = (ways_past, reassign)
