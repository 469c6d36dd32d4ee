"""Task allocation: which robot does which job, in which order, by insertion and annealing.

An assignment is a guess that proves nothing. Jobs are given out by insertion where they end
soonest, and then moved and exchanged between robots by simulated annealing (Osman 1993) on what
their tours take alone. Latest ends are heeded, with some more for traffic. Long tours count far
more than short ones: the last end is what counts.
"""

from __future__ import annotations

import itertools
import math
import random
from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise, starmap
from operator import attrgetter, itemgetter
from types import MappingProxyType

import numpy as np
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.model import CandidateSchedule, Configuration, Deadline
from up_samp.model.graphs import grouped
from up_samp.model.snapshot import TermKind
from up_samp.search.fleet.evaluator import AssignmentEvaluator, Step, Stop
from up_samp.search.fleet.evaluator_kernel import CostWeights, anneal, drawn, insert
from up_samp.search.fleet.jobs import Jobs, WorkMode
from up_samp.search.fleet.travel_times import OneDrive, TravelTimeModel
from up_samp.tuning import Tuning

ROUNDS = 4
"""In which the drives of an assignment are planned and jobs assigned anew, at most."""
_AT_ONCE = 4_000
"""Changes after which is seen whether there is time left."""
_WARM = 0.1
"""Share of all cost by which a change may be worse at first, with the usual power of ends."""


ChosenDrives = Mapping[str, Sequence[tuple[int, str]]]
"""By robot, in order: the number of a job of its tour, and the name of a drive that it makes then.
"""
NO_DRIVES: ChosenDrives = MappingProxyType({})


@dataclass
class Assignment:
    """Who does which jobs in which order, by robot, and what tells how long that takes."""

    evaluator: AssignmentEvaluator
    tours: dict[str, list[Step]]
    tuning: Tuning = field(default_factory=Tuning)

    @property
    def guess(self) -> TravelTimeModel:
        """What drives take."""
        return self.evaluator.guess

    @property
    def jobs(self) -> Jobs:
        """All jobs, with the ways to do each."""
        return self.evaluator.jobs

    def drives_home(self) -> dict[str, dict[int, list[str]]]:
        """Return by robot the drives out of the way of others that have to be where it is, by the
        number of the job of its tour that they come after: the last one, beside those that may come
        of it, and those before which it waits so long for the next one that there is time for it.
        One of them is made: who may have several jobs under way ends in one place or another.
        """
        options, duties = self.jobs.options, self.guess.duties
        work = {r: [options[j][k] for j, k in tour] for r, tour in self.tours.items()}
        stops = Counter(p for some in work.values() for p in {p for o in some for p in o.stops})
        left = {key: iter(names) for key, names in duties.drives_home.items()}
        found: dict[str, dict[int, list[str]]] = {robot: {} for robot in work}
        for robot, some in work.items():
            for _, at in sorted(self._waits(robot, some), reverse=True):
                before = max(at + 1 - duties.loads.get(robot, 1), 0)
                exits = sorted({option.exit for option in some[before : at + 1]})
                names = [next(left.get((robot, exit_), iter(())), "") for exit_ in exits]
                if all(names) and max(stops[exit_] for exit_ in exits) > 1:
                    found[robot][at] = names
        return found

    def _waits(self, robot: str, some: Sequence[WorkMode]) -> Iterator[tuple[float, int]]:
        """Yield how much longer (s) than for the way to where a robot is at first, and on from
        there, it waits until its next job is released, and the number of the job after which it
        does: for ever (``inf``) after the last one, if it may end anywhere.
        """
        snapshot, ride, done = self.guess.snapshot, self.guess.ride, 0.0
        home = here = snapshot.configurations[snapshot.initial[robot]]
        for number, option in enumerate(some):
            came = done + ride(robot, here, option.entry)
            begin = max(came, option.release * snapshot.seconds_per_unit)
            left = begin - done - ride(robot, here, home) - ride(robot, home, option.entry)
            if number and left > 0.0:
                yield left, number - 1
            done = begin + option.work + self.guess.pause(option)
            done += sum(ride(robot, a, b) for a, b in option.legs)
            here = option.exit
        if some and robot not in self.guess.duties.ends:
            yield math.inf, len(some) - 1

    def drives(self) -> dict[str, list[tuple[int, OneDrive]]]:
        """Return by robot the drives of its tour, in order, each with the number of the job that it
        belongs to: for the jobs, and out of the way behind them.
        """
        snapshot, rests = self.guess.snapshot, self.drives_home()
        found: dict[str, list[tuple[int, OneDrive]]] = {}
        for robot in self.tours:
            home = here = snapshot.configurations[snapshot.initial[robot]]
            stops, mine = self._stops(robot), found.setdefault(robot, [])
            last = {number: at for at, (number, _) in enumerate(stops)}
            for at, (number, there) in enumerate(stops):
                mine.append((number, (robot, here, there)))
                here = there
                if number in rests[robot] and last[number] == at:
                    mine.append((number, (robot, here, home)))
                    here = home
        return found

    def _stops(self, robot: str) -> list[tuple[int, Configuration]]:
        """Return where a robot works on its tour, with the number of the job. Who may have two jobs
        under way fetches for the second one before it brings the first one, where that is sooner
        and neither is done by a crew, which does nothing else in between.
        """
        found, ride = list[tuple[int, Configuration]](), partial(self.guess.ride, robot)
        some, paired = [self.jobs.options[j][k] for j, k in self.tours[robot]], False
        crews = self.jobs.crews
        for number, option in enumerate(some):
            mine, before = option.stops, some[number - 1].stops if number else []
            jobs = {j for j, _ in self.tours[robot][max(number - 1, 0) : number + 1]}
            free = robot in self.guess.duties.loads and not paired and jobs.isdisjoint(crews)
            if paired := free and len(mine) == len(before) == 2:
                ways = (before + mine, [before[0], mine[0], before[1], mine[1]])
                apart, together = (sum(starmap(ride, pairwise(way))) for way in ways)
                paired = together < apart
            found += [(number, pose) for pose in mine]
            if paired:
                found[-3:-1] = found[-2], found[-3]
        return found

    def ways(self) -> list[OneDrive]:
        """Return all drives that are made, also those home that may be."""
        found = {drive for some in self.drives().values() for _, drive in some}
        for robot, tour in self.tours.items():
            option = self.jobs.options[tour[-1][0]][tour[-1][1]] if tour else None
            home = None if option is None else self.guess.home(option)
            if option is not None and home is not None:
                found.add((robot, option.exit, home))
        return sorted(found)

    def handovers(self) -> list[tuple[OneDrive, OneDrive]]:
        """Return the drives by which robots leave places, with those by which others come there."""
        ways = [drive for drive in self.ways() if drive[1] != drive[2]]
        leaving, coming = grouped(ways, itemgetter(1)), grouped(ways, itemgetter(2))
        return [
            (one, other)
            for place in sorted(leaving)
            for one, other in itertools.product(leaving[place], coming.get(place, ()))
            if one[0] != other[0]
        ]


def assign(
    evaluator: AssignmentEvaluator,
    deadline: Deadline,
    rng: random.Random,
    tuning: Tuning,
    *,
    rounds: int = ROUNDS,
) -> Assignment:
    """Return a quick and balanced assignment of all jobs: as good as it gets until ``deadline``.

    Its drives are planned, and jobs are assigned again with what is known then, until nothing new
    is learned (at most ``rounds`` times).
    """
    found = with_all_jobs(Assignment(evaluator, {robot: [] for robot in evaluator.robots}, tuning))
    return mended(exchanged(found, rng, deadline), rng, deadline, rounds)


def assignment_of_plan(
    plan: CandidateSchedule, evaluator: AssignmentEvaluator, deadline: Deadline, tuning: Tuning
) -> Assignment:
    """Return the assignment that a plan has made; jobs of which it knows nothing are assigned, too.
    What its drives take is learned.
    """
    tours: dict[str, list[Step]] = {robot: [] for robot in evaluator.robots}
    begun = {
        (j, k): min(plan.times[name] for name in option.members)
        for j, options in enumerate(evaluator.jobs.options)
        for k, option in enumerate(options)
        if option.members <= plan.times.keys()
    }
    first = dict(sorted(sorted(begun), key=begun.__getitem__, reverse=True))
    for j, k in sorted(first.items(), key=begun.__getitem__):
        tours[evaluator.jobs.options[j][k].robot].append((j, k))
    found = with_all_jobs(Assignment(evaluator, tours, tuning))
    found.guess.ask(found.ways(), deadline)
    return found


def with_all_jobs(found: Assignment) -> Assignment:
    """Return an assignment with the jobs that it leaves out, each given to who has done all
    soonest.
    """
    work = [min(o.work for o in options) for options in found.jobs.options]
    due = [min(o.due for o in options) for options in found.jobs.options]
    left = set(range(len(work))) - {j for tour in found.tours.values() for j, _ in tour}
    for job in sorted(left, key=lambda j: (due[j], -work[j], j)):
        found = replace(found, tours={**found.tours, **inserted(found, job)})
    return found


def mended(
    found: Assignment, rng: random.Random, deadline: Deadline, rounds: int = ROUNDS
) -> Assignment:
    """Return an assignment of all jobs that is as good as one can tell by what its drives really
    take, and its handovers where these are looked at one by one.
    """
    for _ in range(rounds):
        new = found.guess.ask(found.ways(), deadline)
        if found.evaluator.exact:
            new += found.guess.ask_handovers(found.handovers(), deadline)
        if not new:
            break
        # drives that turn out longer change little: it is not to be stirred up much
        found = exchanged(found, rng, deadline, share=0.1, warmth=0.1)
    return found


def inserted(found: Assignment, job: int) -> dict[str, list[Step]]:
    """Return the tour of who has done everything soonest then with a job more."""
    evaluator = found.evaluator
    arrays = evaluator.arrays(found.tours)
    who = evaluator.robots[insert(evaluator.work(), evaluator.rules, arrays, job)]
    return {who: evaluator.tours(arrays)[who]}


def exchanged(
    found: Assignment,
    rng: random.Random,
    deadline: Deadline,
    *,
    share: float = 1.0,
    warmth: float = 1.0,
    another: bool = False,
) -> Assignment:
    """Return the best assignment that annealing comes by: jobs moved, or exchanged by two robots.

    :param share: of the usual changes...
    :param warmth: ...and of the usual warmth at first.
    :param another: the best one of the second half, as the first one leads elsewhere.
    """
    tuning, evaluator = found.tuning, found.evaluator
    # so that it is worth as many seconds whatever the power of ends that counts
    steeper = evaluator.rules.steep / CostWeights().steep
    cold = tuning.cold * steeper
    warm = cold + (_WARM * steeper - cold) * warmth
    tries = math.ceil(tuning.exchanges * len(found.jobs.options) * share)
    now, best = evaluator.arrays(found.tours), evaluator.arrays(found.tours)
    heats = np.zeros(tries)
    if warm > 0.0:
        heats = warm * (cold / warm) ** (np.arange(tries) / max(tries, 1))
    chance = np.random.default_rng(rng.getrandbits(64))
    parts = np.array_split(heats, math.ceil(tries / _AT_ONCE) or 1)
    for number, some in enumerate(parts):
        if deadline.expired():
            break
        if another and number == len(parts) // 2:
            best = evaluator.arrays(evaluator.tours(now))
        draws = drawn(chance, len(some))
        anneal(evaluator.work(), evaluator.rules, now, best, draws, some)
    return replace(found, tours=evaluator.tours(best))


def in_stated_order(
    assignment: Assignment, earlier: Mapping[int, set[int]], crews: Mapping[int, int]
) -> Assignment:
    """Return the same assignment with all tours in one order of all jobs: each comes after those
    that are ``earlier``, else as assigned, those of one crew one after the other; as it is where
    nobody could follow such an order.
    """
    place = {j: at for tour in assignment.tours.values() for at, (j, _) in enumerate(tour)}
    first = dict[int, tuple[int, int]]()
    for j in sorted(place, key=lambda j: (place[j], j)):
        first.setdefault(crews.get(j, -1 - j), (place[j], j))
    left, rank = sorted(place, key=lambda j: (*first[crews.get(j, -1 - j)], j)), dict[int, int]()
    while left:
        waits = [bool(place.keys() & earlier.get(j, set()) - rank.keys()) for j in left]
        if all(waits):
            return assignment
        rank[left.pop(waits.index(False))] = len(rank)
    tours = {r: sorted(t, key=lambda step: rank[step[0]]) for r, t in assignment.tours.items()}
    return replace(assignment, tours=tours)


def decided_by(
    assignment: Assignment,
    activities: Sequence[Activity],
    beside: Collection[Stop] = (),
    chosen: ChosenDrives = NO_DRIVES,
) -> frozenset[str]:
    """Return the activities that may be present if everybody does what is assigned, and makes use
    of what may come of a job only in the end (to go home). Robots may drive to and from what is
    ``beside`` their tours. Of drives that are alike only those are left that are ``chosen``.
    """
    jobs, loads = assignment.jobs, assignment.guess.duties.loads
    done = [*itertools.chain(*assignment.tours.values())]
    gone = {o.leader for options in jobs.options for o in options}
    gone -= {jobs.options[j][k].leader for j, k in done}
    for robot, tour in assignment.tours.items():
        for j, k in tour[: -loads.get(robot, 1)]:
            gone |= jobs.options[j][k].extras
    gone = {*jobs.without(gone), *_detours(assignment, beside, in_any_order=not chosen)}
    names = {name for mine in chosen.values() for _, name in mine}
    by_name = dict(_free_drives(assignment))
    drives = {by_name[name] for name in names}
    gone |= {name for name, drive in by_name.items() if drive in drives} - names
    return frozenset(a.name for a in activities) - gone


def _detours(assignment: Assignment, beside: Collection[Stop], *, in_any_order: bool) -> set[str]:
    """Return the drives between fixed places that are no part of a job and not on the way from one
    to the next: to the first stop, from stop to stop, and from the last one to where nothing is
    done, if a robot has to be there in the end.

    :param in_any_order: whether stops of jobs that may be under way at once come in any order.
    """
    options = [o for some in assignment.jobs.options for o in some]
    stops = {pose for o in options for leg in (*o.legs, (o.entry, o.exit)) for pose in leg}
    drives = assignment.drives().items()
    tours = {r: _ways_between(assignment, r, some, in_any_order) for r, some in drives}
    found = set()
    for name, (robot, a, b) in _free_drives(assignment):
        ways, last = tours[robot]
        home = a in last and b not in stops
        mine = last | {*itertools.chain(*ways)}
        on_tour = {a, b} - {pose for who, pose in beside if who == robot}
        aside = on_tour < {a, b} and on_tour <= mine
        if (a, b) not in ways and not home and not aside:
            found.add(name)
    return found


def _free_drives(assignment: Assignment) -> Iterator[tuple[str, OneDrive]]:
    """Yield the drives between fixed places that are no part of a job, by name."""
    snapshot, options = assignment.guess.snapshot, itertools.chain(*assignment.jobs.options)
    own = {n for o in options for n in (*o.members, *o.extras)}
    for task in sorted(snapshot.tasks, key=attrgetter("activity")):
        fixed = all(term.kind is TermKind.CONSTANT for term in task.terms)
        if task.activity not in own and task.object in assignment.tours and fixed:
            a, b = (snapshot.configurations[task.terms[i].name] for i in (0, -1))
            yield task.activity, (task.object, a, b)


def drives_chosen(assignment: Assignment, activities: Sequence[Activity]) -> ChosenDrives:
    """Return the drives that robots make on their tours where all that lead there are alike: nobody
    has to look for which of them, and when, then.
    """
    known, free = {a.name: a for a in activities}, dict(_free_drives(assignment))
    rests, named = assignment.drives_home(), grouped(free, free.__getitem__).items()
    left = {d: iter(some) for d, some in named if len({_asks(known[n]) for n in some}) == 1}
    found: dict[str, list[tuple[int, str]]] = {}
    for robot, drives in assignment.drives().items():
        mine = found.setdefault(robot, [])
        for number, drive in drives:
            rest = [n for n in rests[robot].get(number, ()) if free.get(n) == drive]
            some = iter(rest) if rest else left.get(drive, iter(()))
            mine += ((number, name) for name in itertools.islice(some, 1))
    return found


def _asks(activity: Activity) -> Hashable:
    """Return what an activity takes, asks for and changes, whenever that is."""
    effects = itertools.chain(*activity.effects.values())
    changes = frozenset((e.fluent, e.value, e.kind, e.condition) for e in effects)
    conditions = frozenset(itertools.chain(*activity.conditions.values()))
    return activity.duration.lower, activity.duration.upper, changes, conditions


def _ways_between(
    assignment: Assignment,
    robot: str,
    drives: Iterable[tuple[int, OneDrive]],
    in_any_order: bool,
) -> tuple[set[tuple[Configuration, Configuration]], set[Configuration]]:
    """Return from where to where a robot may drive for its jobs, and where it may be when all are
    done: as on its tour, or in whatever order it comes by the stops of those that it may have under
    way at once.
    """
    found = {(a, b) for _, (_, a, b) in drives}
    some = [assignment.jobs.options[j][k] for j, k in assignment.tours[robot]]
    start = assignment.guess.snapshot.configurations[assignment.guess.snapshot.initial[robot]]
    last = some[-1].exit if some else start
    many = assignment.guess.duties.loads.get(robot, 1)
    if many == 1 or not in_any_order:
        return found, {last}
    stops = [{*option.stops} for option in some]
    for at, mine in enumerate(stops):
        near = set().union(*stops[at : at + many + 1])
        found |= {pair for a in mine for b in near - {a} for pair in ((a, b), (b, a))}
        found |= {(start, stop) for stop in mine} if at < many else set()
    return found, set().union({last}, *stops[-many:])


def state_order(
    problem: SchedulingMotionProblem, assignment: Assignment, chosen: ChosenDrives = NO_DRIVES
) -> None:
    """State in a thinned problem that everything is done as assigned, in that order, with the
    drives that are ``chosen``. Of jobs that a robot may have under way at once, the scheduler finds
    the order.
    """
    any_of = problem.environment.expression_manager.Or
    activities, rests = {a.name: a for a in problem.activities}, assignment.drives_home()
    for robot, tour in assignment.tours.items():
        many, steps = assignment.guess.duties.loads.get(robot, 1), list[list[Activity]]()
        for at, (j, k) in enumerate(tour):
            option, home = assignment.jobs.options[j][k], rests[robot].get(at, ())
            drives = {name for number, name in chosen.get(robot, ()) if number == at}
            names = drives.union(option.members, option.extras) - {*home}
            mine = [activities[n] for n in sorted(names) if n in activities]
            homes = [activities[n] for n in home if n in activities]
            for a in mine:
                problem.add_constraint(a.present)
            if homes:
                problem.add_constraint(any_of([a.present for a in homes]))
            begun = steps[max(at - 2 * many + 1, 0) :]
            _state_after(problem, itertools.chain(*begun[: max(len(begun) - many + 1, 0)]), mine)
            _state_after(problem, itertools.chain(*begun, mine), homes)
            steps.append(mine + homes)
        in_turn = [activities[name] for _, name in chosen.get(robot, ())]
        for one, other in pairwise(in_turn):
            _state_after(problem, [one], [other])


def _state_after(
    problem: SchedulingMotionProblem, first: Iterable[Activity], then: Iterable[Activity]
) -> None:
    """State that all of ``first`` that is there has ended before any of ``then`` begins."""
    le = problem.environment.expression_manager.LE
    for one, other in itertools.product(first, then):
        problem.add_constraint(le(one.end, other.start), [one.present, other.present])
