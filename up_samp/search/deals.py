"""Who does which job, in which order: a guess that proves nothing, of what is worth a look.

Jobs are dealt out by insertion where they end soonest, and then moved and exchanged between
robots by simulated annealing (Osman 1993) on what their tours take alone. Latest ends are heeded,
with some more for traffic. Long tours count far more than short ones: the last end is what counts.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.model import Body, Configuration, Deadline
from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.search.jobs import Jobs
from up_samp.search.tuning import DealsTuning

Lasts = Callable[[Body, Configuration, Configuration], float]
"""How long a body takes at least from one pose to another (s)."""
Step = tuple[int, int]
"""A job and which of its options is taken."""


class Guess:
    """What work takes a robot, from place to place (s): ``lasts``."""

    def __init__(self, snapshot: Snapshot, lasts: Lasts) -> None:
        self.snapshot = snapshot
        self._lasts = lasts
        self._known: dict[tuple[Body, Configuration, Configuration], float] = {}

    def ride(self, robot: str, a: Configuration, b: Configuration) -> float:
        """Return how long (s) a robot drives from one pose to another."""
        key = self.snapshot.objects[robot].body, a, b
        known = self._known.get(key)
        if known is None:
            known = self._known[key] = 0.0 if a == b else self._lasts(*key)
        return known


@dataclass
class Deal:
    """Who does which jobs in which order, by robot."""

    guess: Guess
    jobs: Jobs
    tours: dict[str, list[Step]]
    tuning: DealsTuning = field(default_factory=DealsTuning)
    bias: Mapping[Step, float] = field(default_factory=dict)
    """What a step is taken to cost more or less than guessed (share)."""
    _work: dict[Step, float] = field(default_factory=dict)

    def cost(self, robot: str, tour: Sequence[Step]) -> float:
        """Return a guess of when a robot has done a tour (s), and what is late counts more."""
        snapshot, ride = self.guess.snapshot, self.guess.ride
        here = snapshot.configurations[snapshot.initial[robot]]
        total = late = 0.0
        for step in tour:
            option = self.jobs.options[step[0]][step[1]]
            total += ride(robot, here, option.entry) + self._busy(step)
            here = option.exit
            if option.due < math.inf:
                # traffic takes time, too
                late += max(
                    0.0, self.tuning.traffic * total - option.due * snapshot.seconds_per_unit
                )
        return total + self.tuning.late * late

    def _busy(self, step: Step) -> float:
        """Return how long (s) a step takes from its entry to its exit."""
        known = self._work.get(step)
        if known is None:
            option = self.jobs.options[step[0]][step[1]]
            known = option.work + sum(self.guess.ride(option.robot, a, b) for a, b in option.legs)
            known = self._work[step] = known * (1.0 + self.bias.get(step, 0.0))
        return known

    def with_tours(self, changed: Mapping[str, list[Step]]) -> Deal:
        """Return the same with other tours of some robots."""
        return replace(self, tours={**self.tours, **changed})


def deal(
    jobs: Jobs,
    guess: Guess,
    tuning: DealsTuning,
    deadline: Deadline,
    *,
    seed: int = 0,
    noise: float = 0.0,
) -> Deal:
    """Return a quick and balanced share of all jobs: as good as it gets until ``deadline``.

    :param noise: share by which guesses of what jobs take are changed.
    """
    rng = random.Random(seed)
    bias = {
        (j, k): rng.uniform(-noise, noise)
        for j, options in enumerate(jobs.options)
        for k in range(len(options))
    }
    robots = sorted({o.robot for options in jobs.options for o in options})
    found = Deal(guess, jobs, {robot: [] for robot in robots}, tuning, bias)
    work = [min(o.work for o in options) for options in jobs.options]
    due = [min(o.due for o in options) for options in jobs.options]
    for job in sorted(range(len(jobs.options)), key=lambda j: (due[j], -work[j], j)):
        found.tours = {**found.tours, **inserted(found, job)}
    return exchanged(found, tuning.exchanges * len(jobs.options), rng, deadline)


def inserted(found: Deal, job: int) -> dict[str, list[Step]]:
    """Return the tour of who has done everything soonest then with a job more."""
    best: tuple[float, float, str, list[Step]] | None = None
    for number, option in enumerate(found.jobs.options[job]):
        tour = found.tours[option.robot]
        before = found.cost(option.robot, tour)
        for at in range(len(tour) + 1):
            longer = [*tour[:at], (job, number), *tour[at:]]
            end = found.cost(option.robot, longer)
            key = (end, end - before, option.robot, longer)
            if best is None or key[:3] < best[:3]:
                best = key
    assert best is not None
    return {best[2]: best[3]}


def exchanged(found: Deal, tries: int, rng: random.Random, deadline: Deadline) -> Deal:
    """Return the best share that annealing comes by: jobs moved, or exchanged by two robots."""
    robots, tuning = sorted(found.tours), found.tuning
    tours = {robot: list(tour) for robot, tour in found.tours.items()}
    weigh = {robot: found.cost(robot, tours[robot]) ** tuning.steep for robot in robots}
    total = math.fsum(weigh.values())
    best, least = dict(tours), total
    for number in range(tries):
        changed = _changed(found, tours, rng)
        if changed is None:
            continue
        after = {robot: found.cost(robot, tour) ** tuning.steep for robot, tour in changed.items()}
        worse = sum(after[r] - weigh[r] for r in sorted(after))
        if deadline.expired():
            break
        cooling = (tuning.cold / tuning.warm) ** (number / tries) if tuning.warm else 0.0
        heat = tuning.warm * cooling * total
        if worse > 0 and (heat <= 0 or rng.random() >= math.exp(-worse / heat)):
            continue
        tours.update(changed)
        weigh.update(after)
        total += worse
        if total < least:
            best, least = dict(tours), total
    return found.with_tours(best)


def _changed(
    found: Deal, tours: Mapping[str, list[Step]], rng: random.Random
) -> dict[str, list[Step]] | None:
    """Return tours in which a random job is done at another time, by another, or for another."""
    jobs = found.jobs.options
    full = [robot for robot in sorted(tours) if tours[robot]]
    if not full:
        return None
    one = rng.choice(full)
    step = rng.choice(tours[one])
    number = rng.randrange(len(jobs[step[0]]))
    other = jobs[step[0]][number].robot
    left = [s for s in tours[one] if s != step]
    into = left if other == one else list(tours[other])
    at = rng.randint(0, len(into))
    moved = [*into[:at], (step[0], number), *into[at:]]
    if other == one or not into or rng.random() < 0.5:
        return {one: left, other: moved} if other != one else {one: moved}
    back = rng.choice(into)
    options = [k for k, o in enumerate(jobs[back[0]]) if o.robot == one]
    if not options:
        return None
    place = rng.randint(0, len(left))
    taken = [*left[:place], (back[0], rng.choice(options)), *left[place:]]
    return {one: taken, other: [s for s in moved if s != back]}


def decided_by(deal: Deal, names: Sequence[str]) -> frozenset[str]:
    """Return the activities that may be present if everybody does what was dealt out, and makes use
    of what may come of a job only in the end (to go home).
    """
    jobs = deal.jobs
    chosen = {(j, k) for tour in deal.tours.values() for j, k in tour}
    gone = {o.leader for j, options in enumerate(jobs.options) for k, o in enumerate(options)
            if (j, k) not in chosen}  # fmt: skip
    for tour in deal.tours.values():
        for j, k in tour[:-1]:
            gone |= jobs.options[j][k].extras
    return frozenset(names) - jobs.without(gone) - _detours(deal)


def _detours(deal: Deal) -> set[str]:
    """Return the drives between fixed places that are no part of a job and not on the way from one
    to the next: to the first stop, from stop to stop, and from the last one to where nothing is
    done, if a robot has to be there in the end.
    """
    snapshot, options = deal.guess.snapshot, [o for some in deal.jobs.options for o in some]
    own = {n for o in options for n in (*o.members, *o.extras)}
    stops = {pose for o in options for leg in (*o.legs, (o.entry, o.exit)) for pose in leg}
    ways = {robot: _ways(deal, robot) for robot in deal.tours}
    last = {robot: _last(deal, robot) for robot in deal.tours}
    found = set()
    for task in snapshot.tasks:
        fixed = all(term.kind is TermKind.CONSTANT for term in task.terms)
        if task.activity in own or task.object not in ways or not fixed:
            continue
        a, b = (snapshot.configurations[task.terms[i].name] for i in (0, -1))
        home = a == last[task.object] and b not in stops
        if (a, b) not in ways[task.object] and not home:
            found.add(task.activity)
    return found


def _ways(deal: Deal, robot: str) -> set[tuple[Configuration, Configuration]]:
    """Return from where to where a robot drives for its jobs."""
    snapshot, found = deal.guess.snapshot, set[tuple[Configuration, Configuration]]()
    here = snapshot.configurations[snapshot.initial[robot]]
    for j, k in deal.tours[robot]:
        option = deal.jobs.options[j][k]
        found |= {(here, option.entry), *option.legs}
        here = option.exit
    return found


def _last(deal: Deal, robot: str) -> Configuration:
    """Return where a robot is when its jobs are done."""
    if deal.tours[robot]:
        j, k = deal.tours[robot][-1]
        return deal.jobs.options[j][k].exit
    return deal.guess.snapshot.configurations[deal.guess.snapshot.initial[robot]]


def state_order(problem: SchedulingMotionProblem, deal: Deal) -> None:
    """State in a thinned problem that everything is done as it was dealt out, in that order."""
    manager = problem.environment.expression_manager
    activities = {a.name: a for a in problem.activities}
    for tour in deal.tours.values():
        before: list[Activity] = []
        for j, k in tour:
            option = deal.jobs.options[j][k]
            mine = [
                activities[n] for n in sorted(option.members | option.extras) if n in activities
            ]
            for a in mine:
                problem.add_constraint(a.present)
                for earlier in before:
                    problem.add_constraint(
                        manager.LE(earlier.end, a.start), [earlier.present, a.present]
                    )
            before = mine
