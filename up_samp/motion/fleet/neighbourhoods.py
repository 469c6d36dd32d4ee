"""Many robots at once: prioritised planning that ejects who is in the way, then large-neighbourhood
search over motions (MAPF-LNS and MAPF-LNS2; Li, Chen, Harabor, Stuckey, Koenig 2021 and 2022).

Each motion is planned among all others' runs: on the ways that are known for it, and on one that a
search in space and time proposes (:mod:`up_samp.motion.fleet.space_time`), with the exact timing of
:func:`up_samp.motion.fleet.speed.fit`. Work is counted in motions planned.
"""

from __future__ import annotations

import itertools
import math
import random
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from up_samp.geometry.memory import Memory
from up_samp.model import Deadline, Rest, TimedMotion
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.space_time import proposer_of
from up_samp.motion.fleet.speed import fit
from up_samp.motion.fleet.timed_path import ON_TIME, TimedPath, natural_timing, run_of
from up_samp.motion.fleet.workspace import Workspace, rest_run
from up_samp.motion.protocol import WorkBudget

Runs = Mapping[str, TimedPath]
"""Runs by the names of their motions."""

SOON = 0.2
"""A motion that is so much later (s) than alone is given other ways."""

PRICE, MORE = 8.0, 4.0
"""What it costs (s) to eject who is in the way, and by how much more each time that it has been."""

SIZES = (2, 3, 4, 5, 6, 8)
"""Of neighbourhoods."""


@dataclass
class MovingGroup:
    """Motions to be planned among each other and what is there for good (``world``), with the best
    answer so far.
    """

    workspace: Workspace
    motions: Mapping[str, TimedMotion]
    world: Sequence[TimedPath]
    budget: WorkBudget
    ways: dict[str, list[Path]] = field(default_factory=dict)
    """The ways that are known for each motion; the first is the best one alone."""
    best: Runs | None = None
    least: float = 0.0
    """Lateness (s) of everybody alone."""
    stuck: set[str] = field(default_factory=set)
    """Motions that could not be planned after some others."""
    passed: set[str] = field(default_factory=set)
    """Objects that were in the way of best paths."""
    ended: str = ""
    """What ended the search for better runs."""
    _planned: Memory[tuple[TimedPath | None, bool]] = field(default_factory=lambda: Memory(2_000))

    def __post_init__(self) -> None:
        due = {name: (m.release, m.due, name) for name, m in self.motions.items()}
        self.order = sorted(due, key=lambda name: due[name])
        """The motions by release, then by due (less slack first), then by name."""
        chains: dict[str, list[str]] = {}
        for name in self.order:
            chains.setdefault(self.motions[name].object, []).append(name)
        self.after = {n: names[k + 1 :] for names in chains.values() for k, n in enumerate(names)}
        """The later motions of the same object, by name."""
        self.before = {n: k for names in chains.values() for k, n in itertools.pairwise(names)}
        """The same object's motion just before each one (where there is one)."""
        self.starts = {n: self.at_start(n) for n in self.order if n not in self.before}
        """Where objects rest until they may first leave, by the names of their first motions."""

    @property
    def deadline(self) -> Deadline:
        """When to give up."""
        return self.budget.deadline

    def cost(self, name: str, arrival: float) -> float:
        """Return what it costs that a motion arrives at a time (s): a second costs 1, after the
        motion's due 100 more.
        """
        return arrival + 100.0 * max(0.0, arrival - self.motions[name].due - ON_TIME)

    def is_late(self, run: TimedPath) -> bool:
        """Return whether a run arrives after its motion's due."""
        return run.arrival > self.motions[run.name].due + ON_TIME

    def lateness(self, runs: Runs) -> float:
        """Return the sum of all lateness (s)."""
        late = (runs[name].arrival - self.motions[name].due for name in sorted(runs))
        return sum(x for x in late if x > ON_TIME)

    def finished(self) -> bool:
        """Return whether nobody can be less late, as far as driving alone tells."""
        return self.best is not None and self.lateness(self.best) <= self.least + ON_TIME

    def keep(self, runs: Runs) -> None:
        """Make runs the best ones, if they are less late, or as late and over sooner."""
        if self.best is None or self._worth(runs) < self._worth(self.best):
            self.best = runs

    def _worth(self, runs: Runs) -> tuple[float, float]:
        return self.lateness(runs), sum(runs[name].arrival for name in sorted(runs))

    def others(self, name: str, runs: Runs) -> list[TimedPath]:
        """Return what is there for a motion: the world, ``runs``, and who has none yet, at its
        start until it may leave.
        """
        since = self.motions[name].release
        waiting = (n for n in self.starts if n not in runs and self.motions[n].release > since)
        return [*self.world, *runs.values(), *(self.starts[n] for n in waiting)]

    def alone(self, name: str) -> float:
        """Return the least seconds that a motion is known to take."""
        return min(way.natural.duration for way in self.ways[name])

    def after_last(self, name: str, runs: Runs) -> TimedMotion:
        """Return a motion as it may happen: not before its object has arrived from the last one."""
        motion, previous = self.motions[name], self.before.get(name)
        if previous is None or previous not in runs:
            return motion
        arrival = runs[previous].arrival
        since = max(motion.present_from, arrival)
        release = max(motion.release, arrival)
        return replace(motion, present_from=min(since, release), release=release)

    def plan(self, name: str, runs: Runs, without: Collection[str] = ()) -> TimedPath | None:
        """Return the earliest run found of a motion among ``runs``, but those ``without``: small
        groups ask the same again and again.
        """
        self.budget.used += 1
        ways = self.ways[name]
        known = frozenset(ways)
        key = name, frozenset(runs.items()), frozenset(without), known
        run, sought = self._planned.get(key) or self._sought(name, runs, without)
        if sought:
            self._forget(name, run)
        if known == frozenset(ways):  # else there are more ways to try next time
            self._planned.put(key, (run, sought))
        return run

    def _sought(
        self, name: str, runs: Runs, without: Collection[str]
    ) -> tuple[TimedPath | None, bool]:
        """Return the earliest run found, and whether other ways than those known were looked at."""
        motion = self.after_last(name, runs)
        others = self.others(name, {n: run for n, run in runs.items() if n not in without})
        best: TimedPath | None = None
        ways = self.ways[name]
        enough = motion.release + self.alone(name) + SOON
        for way in sorted(ways, key=lambda way: (way.fastest, way.number))[:2]:
            best = fit(self.workspace, motion, way, others, best)
        if best is not None and best.arrival <= enough:
            return best, False
        proposer = proposer_of(self.workspace)
        for wide in (False, True):
            if proposer is None or (best is not None and best.arrival <= enough):
                break
            until = math.inf if best is None else best.arrival
            proposed = proposer.propose(motion, others, until=until, wide=wide)
            if proposed is not None and proposed not in ways:
                ways.append(proposed)
                best = fit(self.workspace, motion, proposed, others, best)
        for way in sorted(ways, key=lambda way: (way.fastest, way.number)):
            best = fit(self.workspace, motion, way, others, best)
        return best, True

    def _forget(self, name: str, best: TimedPath | None) -> None:
        """Keep the eight ways that were of use last, the best one alone among them."""
        ways = self.ways[name]
        if best is not None and best.path in ways[1:]:
            ways.remove(best.path)
            ways.insert(1, best.path)
        del ways[8:]

    def met(self, run: TimedPath, runs: Runs) -> list[str]:
        """Return which runs one meets."""
        meeting = self.workspace.meeting
        return [n for n in sorted(runs) if n != run.name and meeting(run, runs[n])[0] < math.inf]

    def ideal(self, name: str, runs: Runs) -> TimedPath:
        """Return the run of a motion on its best way as if nobody were there."""
        motion = self.after_last(name, runs)
        way = min(self.ways[name], key=lambda way: way.natural.duration)
        return run_of(motion, way, natural_timing(way, motion.release))

    def at_start(self, name: str, seconds: float = 0.0) -> TimedPath:
        """Return a motion's object as it rests at the start, until so long after it may leave."""
        m = self.motions[name]
        rest = Rest(m.object, m.body, m.poses[0], m.present_from, m.release + seconds)
        return replace(rest_run(self.workspace, rest), avoid=m.avoid)


def first_runs(problem: MovingGroup) -> dict[str, TimedPath] | None:
    """Return runs of all motions that keep clear of each other, if found within the budget: one
    motion after the other, those with the least time to spare first; who is in the way of a motion
    is ejected where that is cheaper, and planned again.
    """
    motions = problem.motions
    price = dict.fromkeys(motions, PRICE)
    quarrels = Counter[tuple[str, str]]()

    def spare(name: str) -> tuple[float, str]:
        motion = motions[name]
        return motion.due - motion.release - problem.alone(name), name

    queue = sorted(motions, key=spare)
    runs: dict[str, TimedPath] = {}
    while queue:
        if problem.budget.spent():
            return None
        ready = (n for n in queue if problem.before.get(n) is None or problem.before[n] in runs)
        name = next(ready)
        queue.remove(name)
        run, gone = _inserted(problem, name, runs, price, quarrels)
        if run is None:
            run, gone = _forced(problem, name, runs, quarrels)
        if run is None or name in gone:
            return None
        for other in gone:
            price[other] += MORE
            quarrels.update([(name, other), (other, name)])
            for follower in (other, *problem.after[other]):
                if runs.pop(follower, None) is not None:
                    queue.append(follower)
        runs[name] = run
    return runs


def _inserted(
    problem: MovingGroup,
    name: str,
    runs: Runs,
    price: Mapping[str, float],
    quarrels: Mapping[tuple[str, str], int],
) -> tuple[TimedPath | None, list[str]]:
    """Return the cheapest run of a motion, and who has to go for it: twice as dear each time that
    it had to, or made this one go, or else two would take turns for as long as one waits.
    """
    best, gone = problem.plan(name, runs), list[str]()
    ideal = problem.ideal(name, runs)
    if best is None or best.arrival <= ideal.arrival + SOON:
        return best, gone
    least, mine = best.arrival, problem.motions[name].object
    met = [n for n in problem.met(ideal, runs) if problem.motions[n].object != mine]
    options = [[n] for n in met] if len(met) > 1 else []
    still = problem.others(name, {n: run for n, run in runs.items() if n not in met})
    if all(math.isinf(problem.workspace.meeting(ideal, other)[0]) for other in still):
        options.append(met)
    for option in options:
        bill = sum(price[n] * 2.0 ** quarrels.get((name, n), 0) for n in option)
        if ideal.arrival + bill >= least or not option:
            continue
        run = ideal if option is met else problem.plan(name, runs, option)
        if run is not None and run.arrival + bill < least:
            best, gone, least = run, option, run.arrival + bill
    return best, gone


def _forced(
    problem: MovingGroup,
    name: str,
    runs: Runs,
    quarrels: Mapping[tuple[str, str], int],
) -> tuple[TimedPath | None, list[str]]:
    """Return a run of a motion that has none among ``runs``, and who has to go for it.

    Two could eject each other for ever. So who has ejected it, or was ejected by it, keeps its run
    where there is a way at all, or else gets time to leave its start, 3 s more each time (Cap,
    Novak, Kleiner, Selecky 2015, keep clear of starts).
    """
    mine = problem.motions[name].object
    own = {n: run for n, run in runs.items() if problem.motions[n].object == mine}
    kept = [n for n in runs if (name, n) in quarrels and n not in own]
    kept.sort(key=lambda n: (-quarrels[name, n], n))
    starts = {n: problem.at_start(n, 3.0 * quarrels[name, n]) for n in kept}
    while True:
        run = problem.plan(name, {**own, **starts, **{n: runs[n] for n in kept}})
        if run is not None:
            return run, [n for n in problem.met(run, runs) if n not in own]
        if not starts:
            return None, []
        if not kept:
            starts = dict(list(starts.items())[: len(starts) // 2])
        del kept[len(kept) // 2 :]


# ------------------ Large-neighbourhood search


def improve(
    problem: MovingGroup,
    runs: Runs,
    movable: Sequence[str],
    seed: int = 0,
    enough: Callable[[Runs], bool] = lambda runs: False,
) -> dict[str, TimedPath]:
    """Return runs that cost no more: until the budget is spent or they are good ``enough``, those
    of a few ``movable`` motions are taken out and planned again among the others, and kept if they
    cost less.
    """
    search = _Search(problem, dict(runs), sorted(movable), random.Random(seed))
    while len(search.movable) > 0 and not enough(search.runs) and not problem.budget.spent():
        search.step()
    return search.runs


class _Search:
    """The incumbent of a large-neighbourhood search, and how well each neighbourhood did."""

    def __init__(
        self,
        problem: MovingGroup,
        runs: dict[str, TimedPath],
        movable: Sequence[str],
        rng: random.Random,
    ) -> None:
        self.problem, self.runs, self.movable, self.rng = problem, runs, movable, rng
        self.scores = dict.fromkeys((self.delayed, self.nearby, self.anybody), 1.0)

    def step(self) -> None:
        """Try one neighbourhood."""
        choices = list(self.scores)
        [choose] = self.rng.choices(choices, [self.scores[c] for c in choices])
        size = min(self.rng.choice(SIZES), len(self.movable))
        names = self._whole(choose(size))
        old = sum(self.problem.cost(n, self.runs[n].arrival) for n in names)
        found = self._again(names, old)
        gain = 0.0
        if found is not None:
            new = sum(self.problem.cost(n, found[n].arrival) for n in names)
            gain = old - new
            if gain >= 0.0:
                self.runs.update(found)
        score = self.scores[choose]
        self.scores[choose] = min(3.0, score + 0.5) if gain > 0.01 else max(0.3, 0.95 * score)

    def _whole(self, names: Iterable[str]) -> list[str]:
        """Return motions with the later ones of the same objects."""
        found = dict.fromkeys(names)
        for name in list(found):
            found.update(dict.fromkeys(self.problem.after[name]))
        return list(found)

    def _again(self, names: Sequence[str], most: float) -> dict[str, TimedPath] | None:
        """Return runs of motions planned again one after the other that cost at most so much."""
        problem = self.problem
        kept = {n: run for n, run in self.runs.items() if n not in names}
        order = list(names)
        if self.rng.random() < 0.5:
            order.sort(key=lambda n: self._delay(n), reverse=True)
        else:
            self.rng.shuffle(order)
        order.sort(key=lambda n: len(problem.after[n]), reverse=True)
        least = {n: problem.cost(n, problem.motions[n].release + problem.alone(n)) for n in order}
        bill = sum(least.values())
        found: dict[str, TimedPath] = {}
        for name in order:
            run = problem.plan(name, {**kept, **found})
            if run is None:
                return None
            bill += problem.cost(name, run.arrival) - least[name]
            if bill > most + 1e-9:
                return None
            found[name] = run
        return found

    def _delay(self, name: str) -> float:
        problem, run = self.problem, self.runs[name]
        return run.arrival - problem.motions[name].release - problem.alone(name)

    def _one_delayed(self) -> str:
        weights = [max(self._delay(n), 0.0) + 0.02 for n in self.movable]
        return self.rng.choices(self.movable, weights)[0]

    def delayed(self, size: int) -> list[str]:
        """Return a motion that is late, those that hold it up, and those that hold these up."""
        name = self._one_delayed()
        found, todo = [name], [name]
        while todo and len(found) < size:
            ideal = self.problem.ideal(todo.pop(0), self.runs)
            met = [n for n in self.problem.met(ideal, self.runs) if n not in found]
            met = [n for n in met if n in self.movable]
            self.rng.shuffle(met)
            met = met[: size - len(found)]
            found += met
            todo += met
        return found

    def nearby(self, size: int) -> list[str]:
        """Return a motion that is late, and those that are nearest to it at one time."""
        name = self._one_delayed()
        run = self.runs[name]
        t = self.rng.uniform(run.timing.trajectory.start, run.arrival)
        here = run.timing.trajectory.at(t)

        def away(other: str) -> tuple[float, str]:
            return math.dist(here[:2], self.runs[other].timing.trajectory.at(t)[:2]), other

        others = sorted((n for n in self.movable if n != name), key=away)
        return [name, *others[: size - 1]]

    def anybody(self, size: int) -> list[str]:
        """Return any motions, one of them late."""
        name = self._one_delayed()
        others = [n for n in self.movable if n != name]
        return [name, *self.rng.sample(others, min(size - 1, len(others)))]
