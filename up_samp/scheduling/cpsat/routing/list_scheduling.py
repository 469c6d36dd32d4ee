"""Schedules of travellers by list scheduling: one task after the other, as early as it fits."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass, field
from itertools import starmap

from up_samp.model import CandidateSchedule, Deadline
from up_samp.scheduling.cpsat.encode.states import Key
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.dispatch import (
    RoutedTask,
    RoutedWork,
    UnitPlace,
)
from up_samp.scheduling.cpsat.routing.needs import Change, Held, Way, WayNeeds
from up_samp.scheduling.cpsat.routing.route import (
    Entrance,
    Move,
    Route,
    Still,
    calm,
    changes_by_name,
    expand,
)
from up_samp.scheduling.cpsat.routing.rules import tails_of_wanted
from up_samp.scheduling.cpsat.routing.sequences import Found, Sequences

Step = tuple[int, int]
"""(task, number of its way; -1: whichever is done first)."""


_DEEP = 12


class DeadEnd(Exception):  # noqa: N818
    """A sequence cannot be scheduled in this simple way."""


@dataclass
class Traveller:
    """Where a traveller is, and from when on it may do something."""

    route: Route
    here: int
    free: int = 0
    used: set[str] = field(default_factory=set)


class Decoder:
    """Times for one sequence of tasks. ``full``: who fills a level up fills it as far as it goes,
    not only as far as it has to.
    """

    def __init__(self, work: RoutedWork, *, full: bool = False) -> None:
        self.work, self.full = work, full
        self.robots = [Traveller(route, route.initial) for route in work.routes]
        self.done: dict[int, tuple[int, int]] = {}
        self.ways: dict[int, int] = {}
        self.order: list[int] = []
        self.times: dict[str, tuple[int, int]] = {}
        self.changed: dict[Key, list[tuple[int, int]]] = {}
        self.legs: list[tuple[int, int, Still]] = []
        self.asked: list[Held] = []
        """What all that was timed needs of states that are set back, by the clock."""
        self.left: dict[UnitPlace, int] = {}
        self.inside: dict[UnitPlace, int] = {}
        for (number, robot), unit in itertools.product(enumerate(self.robots), work.units):
            if robot.here in unit.places_of(robot.route.key):
                self.inside[unit] = number
        self.own = [state.initial for state in work.own]
        self._chosen: dict[int, int] = {}

    def run(self, sequence: list[Step]) -> CandidateSchedule:
        """Return the schedule of a sequence (:class:`DeadEnd` if there is none)."""
        self._chosen = dict(sequence)
        pending = [task for task, _ in sequence]
        while pending:
            ready = next((t for t in pending if self._is_ready(t)), None)
            if ready is None:
                if any(self.work.tasks[t].wanted for t in pending):
                    raise DeadEnd
                break
            pending.remove(ready)
            self._do(ready, 0)
        for number, robot in enumerate(self.robots):
            if robot.route.final is not None and robot.here not in robot.route.final:
                self._go(number, robot.route.final, 0, None)
        return CandidateSchedule(dict(self.times))

    # -- tasks ---------------------------------------------------------------------------------
    def _is_ready(self, number: int) -> bool:
        tasks = self.work.tasks
        before = (p for p, _ in tasks[number].after if tasks[p].wanted)
        return number in self.done or (
            all(p in self.done for p in before) and bool(self._open_ways(number))
        )

    def _open_ways(self, number: int) -> list[int]:
        """Return the ways in which a task may be done now, of those that are chosen."""
        chosen = self._chosen.get(number, -1)
        ways = [chosen] if chosen >= 0 else range(len(self.work.tasks[number].ways))
        return [way for way in ways if self._is_open(number, way)]

    def _is_open(self, number: int, way: int) -> bool:
        own = zip(self.work.own, self.own, strict=True)
        needs = self.work.needs.get((number, way), WayNeeds())
        fits = all(state.after(value, (number, way)) is not None for state, value in own)
        return (
            fits
            and all(self.ways.get(t, w) == w for t, w in needs.along)
            and all(
                t in self.done
                or ((t, w) not in needs.along and self._chosen.get(t, w) not in (-1, w))
                for (t, w), _ in needs.first
            )
            and self._can_come((number, way))
        )

    def _do(self, number: int, depth: int) -> None:
        if number in self.done:
            return
        if depth > _DEEP:
            raise DeadEnd
        task = self.work.tasks[number]
        ways = self._open_ways(number)
        if not ways:
            raise DeadEnd
        way = min(ways, key=lambda w: (self._estimate(task, w), w))
        needs = self.work.needs.get((number, way), WayNeeds())
        self._chosen.update(needs.along)
        robot_number, name, places = task.ways[way]
        robot = self.robots[robot_number]
        if robot.here not in places:
            self._go(robot_number, places, depth, (number, way))
        start = max(robot.free, self._earliest(task))
        for (other, _), gap in needs.first:
            start = max(start, self.done[other][0] + gap if other in self.done else 0)
        for entry in robot.route.entries_to(robot.here):
            since = self._provided(robot_number, entry, depth)
            start = max(start, since + entry.lead) if since is not None else start
        start = self._undisturbed(task, start)
        start = self._timed(name, start, task.length, task.changes)
        self.done[number] = (start, start + task.length)
        if not task.visit:
            self.times[name] = (start, start + task.length)
        for key, value, delay in task.changes:
            self.changed.setdefault(key, []).append((start + delay, value))
        after = (s.after(v, (number, way)) for s, v in zip(self.work.own, self.own, strict=True))
        self.own = [value for value in after if value is not None]
        if len(self.own) < len(self.work.own):
            raise DeadEnd  # something else was done on the way
        robot.free = start + task.length + robot.route.gap
        self.ways[number] = way
        self.order.append(number)

    def _earliest(self, task: RoutedTask) -> int:
        start = task.release
        for before, gap in task.after:
            if before in self.done:
                start = max(start, self.done[before][0] + gap)
        for other, gap in task.apart:
            if other in self.done:
                start = max(start, self.done[other][1] + gap)
        return start

    def _estimate(self, task: RoutedTask, way: int) -> int:
        number, _, places = task.ways[way]
        robot = self.robots[number]
        travel = robot.route.between(frozenset((robot.here,)), places)
        return max(robot.free + travel, self._earliest(task))

    def _undisturbed(self, task: RoutedTask, start: int) -> int:
        """Return the first time from ``start`` on at which its changes disturb no move."""
        again = True
        while again:
            again = False
            for (key, _, delay), (begin, end, still) in itertools.product(task.changes, self.legs):
                if key not in still:
                    continue
                first, last = still[key]
                if begin + first < start + delay < end + last:
                    start, again = end + last - delay, True
        return start

    def _provided(self, number: int, entry: Entrance, depth: int) -> int | None:
        """Return when a state came to be as it is needed (making it so if nobody has);
        ``None`` if it is so from the start.
        """
        if entry.state in self.work.set_back or (
            self.work.initial.get(entry.state) in entry.allowed
        ):
            return None
        for time, value in self.changed.get(entry.state, ()):
            if value in entry.allowed:
                return time
        providers = self.work.providers(entry.state, entry.allowed)
        if not providers:
            raise DeadEnd
        task = providers[0]
        if self._chosen.get(task, -1) < 0:
            ways = enumerate(self.work.tasks[task].ways)
            self._chosen[task] = next((w for w, (r, _, _) in ways if r == number), -1)
        self._do(task, depth + 1)
        return self._provided(number, entry, depth + 1)

    # -- states that are set back --------------------------------------------------------------
    def _first(self, name: str, start: int, length: int, changes: list[Change]) -> float:
        """Return the first time from ``start`` on at which what a move or a stop needs of states
        that are set back is so, and what it ``changes`` is nobody's need (inf: not yet).
        """
        if not self.work.held:  # mostly, and a sequence is one of thousands
            return start
        moments = {start}
        moments |= {
            t + 1 - n[2] for n in self._needs(name, 0, 0) for t, _ in self.changed.get(n[0], ())
        }
        pairs = itertools.product(changes, self.asked)
        moments |= {n[3] + 1 - delay for (key, _, delay), n in pairs if n[0] == key}

        def fits(at: int) -> bool:
            more = [(key, value, at + delay) for key, value, delay in changes]
            asked = [(need, more) for need in self.asked if changes]
            asked += [(need, []) for need in self._needs(name, at, at + length)]
            return all(starmap(self._is_so, asked))

        return next(filter(fits, sorted(at for at in moments if at >= start)), math.inf)

    def _needs(self, name: str, start: int, end: int) -> list[Held]:
        """Return what a move or a stop needs of states that are set back, by the clock."""
        held = self.work.held.get(name, ())
        return [(key, some, start + first, end + last) for key, some, first, last in held]

    def _is_so(self, need: Held, more: list[Change]) -> bool:
        """Return whether a state is as it has to be, and stays so, with ``more`` changes."""
        key, allowed, first, last = need
        changes = self.changed.get(key, []) + [(t, value) for k, value, t in more if k == key]
        seen = (change for change in changes if change[0] <= last)
        time, value = max(seen, default=(-1, self.work.initial.get(key)))
        return time < first and (allowed is None or value in allowed)

    def _timed(self, name: str, start: int, length: int, changes: list[Change]) -> int:
        """Return the first time at which something may be done, and keep its needs from then on."""
        found = self._first(name, start, length, changes)
        if found == math.inf:
            raise DeadEnd
        self.asked += self._needs(name, int(found), int(found) + length)
        return int(found)

    def _let_through(self, number: int, move: Move, depth: int) -> bool:
        """Let somebody do what a move needs (open a door that closes by itself), unless the move
        can be made as soon without; return whether that was done: who did it may be elsewhere now.
        """
        free = self.robots[number].free
        begin = self._first(move.name, free, move.least, [])
        if begin == free:
            return False
        ready, _, task, way = min(
            (
                (
                    self._through(number, move, task, way),
                    self.work.tasks[task].ways[way][0],
                    task,
                    way,
                )
                for key, allowed, *_ in self.work.held.get(move.name, ())
                if allowed is not None
                for task in self.work.providers(key, allowed)
                for way in self._open_ways(task)
                if task not in self.done
            ),
            default=(math.inf, 0, 0, 0),
        )
        if begin + move.least <= ready:
            return False
        self._chosen[task] = way
        self._do(task, depth + 1)
        return True

    def _through(self, number: int, move: Move, task: int, way: int) -> float:
        """Return when a traveller may have come through where a task was done before for it."""
        known = self.work.tasks[task]
        who, _, places = known.ways[way]
        ready = max(self._estimate(known, way) + known.length, self.robots[number].free)
        mine = self.robots[number].route.between(places, {move.to})
        return ready + (mine if who == number else move.least)

    # -- moves ---------------------------------------------------------------------------------
    def _go(self, number: int, places: frozenset[int], depth: int, doing: Way | None) -> None:
        """Drive a robot to one of ``places``, with doors opened and what it has filled up before.
        ``doing``: what it does there (None: nothing, and it goes nowhere from there).
        """
        if depth > _DEEP:
            raise DeadEnd
        robot = self.robots[number]
        for place in sorted(places)[:1] if len(places) == 1 else ():
            for entry in robot.route.entries_to(place):
                self._provided(number, entry, depth + 1)
        if robot.here in places:
            return
        for state in self._draining(number):
            self._fill(number, state, places, depth, last=doing is None)
        self._drive(number, places, depth, doing)

    def _drive(self, number: int, places: frozenset[int], depth: int, doing: Way | None) -> None:
        robot = self.robots[number]
        found = robot.route.way(robot.here, places, robot.used | self._barred(doing))
        if found is None:
            raise DeadEnd
        for move in found:
            if self._let_through(number, move, depth):
                return self._drive(number, places, depth + 1, doing)
            self._move(number, move, depth)
        return None

    def _barred(self, doing: Way | None) -> set[str]:
        """Return the moves that are made for other tasks than the one that is to be done."""
        done = set(self.ways.items())
        made_for = self.work.made_for.items()
        return {m for m, some in made_for if doing not in some and not some <= done}

    def _can_come(self, doing: Way) -> bool:
        """Return whether moves lead to where a task is done, where many are made for one task."""
        number, _, places = self.work.tasks[doing[0]].ways[doing[1]]
        robot = self.robots[number]
        return (
            not self.work.made_for
            or robot.here in places
            or robot.route.way(robot.here, places, robot.used | self._barred(doing)) is not None
        )

    def _draining(self, number: int) -> list[int]:
        """Return the own states of a robot that its moves take from."""
        states = enumerate(self.work.own)
        return [i for i, s in states if s.route == number and s.takings]

    def _fill(
        self, number: int, state: int, places: frozenset[int], depth: int, *, last: bool
    ) -> None:
        """Fill a state up that moves take from, at the nearest place, unless it lasts until
        ``places``, and from there to where there is more (not if that is the ``last`` drive).
        """
        robot, known = self.robots[number], self.work.own[state]

        def left() -> dict[Way, frozenset[int]]:
            refills = self.work.refills[state]
            return {way: at for way, at in refills.items() if way[0] not in self.done}

        def lasts() -> bool:
            further = (known.taken(places, at) for at in left().values())
            onward = 0 if last else min(further, default=0)
            needed = known.taken((robot.here,), places) + onward
            return self.own[state] - needed >= known.least

        if lasts():
            return
        refills = left()
        if depth > _DEEP or not refills:
            raise DeadEnd
        where = min(refills.values(), key=lambda at: robot.route.between({robot.here}, at))
        if robot.here not in where:
            self._drive(number, where, depth, None)
        for (task, way), at in refills.items():
            if at == where and self._is_open(task, way) and (self.full or not lasts()):
                self._chosen[task] = way
                self._do(task, depth + 1)
        if not lasts():
            raise DeadEnd

    def _move(self, number: int, move: Move, depth: int) -> None:
        robot = self.robots[number]
        start = robot.free
        for entry in robot.route.entries_to(move.to):
            since = self._provided(number, entry, depth + 1)
            if since is not None:
                start = max(start, since, since + entry.lead - robot.route.step - move.least)
        arriving = [u for u in self.work.units if move.to in u.places_of(robot.route.key)]
        for unit in arriving:
            holder = self.inside.get(unit)
            if holder is not None and holder != number:
                self._clear(holder, depth + 1)
            start = max(start, self.left.get(unit, -1) + 1 - move.least)
        start = self._calm(robot.route, start, move.least)
        start = self._timed(move.name, start, move.least, [])
        self.times[move.name] = (start, start + move.least)
        if robot.route.still:
            self.legs.append((start, start + move.least, robot.route.still))
        for unit in [u for u, holder in self.inside.items() if holder == number]:
            self.left[unit] = start
            del self.inside[unit]
        for unit in arriving:
            self.inside[unit] = number
        robot.used.add(move.name)
        for state in self._draining(number):
            self.own[state] -= self.work.own[state].taken((robot.here,), (move.to,))
            if self.own[state] < self.work.own[state].least:
                raise DeadEnd
        robot.here = move.to
        robot.free = start + move.least + robot.route.step

    def _calm(self, route: Route, start: int, length: int) -> int:
        """Return the first time from ``start`` on at which nothing changes during a move."""
        events = ((k, time) for k in route.still for time, _ in self.changed.get(k, ()))
        return calm(route.still, events, start, length)

    def _clear(self, number: int, depth: int) -> None:
        """Drive a robot away to the nearest place where nobody has to be."""
        if depth > _DEEP:
            raise DeadEnd
        robot = self.robots[number]
        wanted = {
            p
            for task in self.work.tasks
            for r, _, ps in task.ways
            for p in ps
            if r == number and task.wanted
        }
        options = []
        banned = robot.used | self._barred(None)
        for (origin, to), moves in robot.route.hops.items():
            full = any(
                self.inside.get(u, number) != number
                for u in self.work.units
                if to in u.places_of(robot.route.key)
            )
            shut = any(self._closed(entry) for entry in robot.route.entries.get(to, ()))
            if origin != robot.here or full or shut:
                continue
            options += [
                (to in wanted, m.least, m)
                for m in moves
                if m.name not in banned and self._first(m.name, robot.free, m.least, []) < math.inf
            ]
        if not options:
            raise DeadEnd
        self._move(number, min(options, key=lambda o: o[:2])[2], depth)

    def _closed(self, entry: Entrance) -> bool:
        changed = (value for _, value in self.changed.get(entry.state, ()))
        return entry.allowed.isdisjoint({self.work.initial.get(entry.state), *changed})


# ------------------ From a sequence of tasks that bounds were sought among to a schedule


def steps_of(work: RoutedWork, sequences: Sequences, found: Found) -> list[Step]:
    """Return who does which task, in the order of a sequence."""
    rules = sequences.rules
    numbers = {id(task): number for number, task in enumerate(work.tasks)}
    tasks, choices = rules.programme.tasks, rules.choices
    return [(numbers[id(tasks[choices[n].task])], choices[n].way) for n, _ in found]


def times_of(
    model: ScheduleModel, work: RoutedWork, sequences: Sequences, found: Found
) -> CandidateSchedule:
    """Return the schedule of a sequence, with moves put in. It may break what sequences leave out;
    mostly it does not.
    """
    times = {}
    steps = steps_of(work, sequences, found)
    for (number, way), (_, start) in zip(steps, found, strict=True):
        task = work.tasks[number]
        times[task.ways[way][1]] = (start, start + task.length)
    return expand(work.routes, CandidateSchedule(times), changes_by_name(model))


# ------------------ Schedules of travellers by list scheduling
# One task after the other, as early as it fits. A plan is a sequence of tasks with who does each;
# ``Decoder`` gives every task and move its time (a serial schedule generation scheme, Kolisch
# 1996): doors are opened where nobody has done so before, moves wait until nothing changes in their
# midst, and robots leave a unary place when somebody else needs it. ``improve`` anneals the
# sequence (Kirkpatrick et al. 1983).


_GREEDY = (4, 20)
"""Greedy sequences that are tried, without annealing and before it."""


@dataclass
class Tour:
    """A sequence with its schedule; ``cost`` orders tours."""

    sequence: list[Step]
    schedule: CandidateSchedule
    cost: float


def decode(work: RoutedWork, sequence: list[Step], *, full: bool = False) -> Tour | None:
    """Return the tour of a sequence, ``None`` at a dead end (``full``: see :class:`Decoder`)."""
    decoder = Decoder(work, full=full)
    try:
        schedule = decoder.run(sequence)
    except DeadEnd:
        return None
    busy = sum(robot.free for robot in decoder.robots) / max(1, len(decoder.robots))
    ends = sum(end for _, end in decoder.done.values()) / max(1, len(decoder.done))
    cost = work.worth(schedule) + 0.02 * busy + 0.05 * ends
    return Tour([(t, decoder.ways[t]) for t in decoder.order], schedule, cost)


def _decoded(work: RoutedWork, sequence: list[Step]) -> Tour | None:
    """Return the tour of a sequence, which is remembered: with few tasks, and late in annealing,
    the same come again and again.
    """
    key = tuple(sequence)
    if key not in work.tours:
        if len(work.tours) >= 1_000:  # of large problems that is some 20 MB
            work.tours.clear()
        work.tours[key] = decode(work, sequence)
    found: Tour | None = work.tours[key]
    return found


def improve(
    work: RoutedWork,
    rounds: int,
    seed: int,
    deadline: Deadline,
    *,
    start: list[Step] | None = None,
    enough: int = 0,
) -> Tour | None:
    """Return the best tour found by simulated annealing over sequences, from a few greedy ones and
    ``start``; a makespan of ``enough`` ends it.
    """
    rng = random.Random(seed)
    tours = (decode(work, start) if start else None, _greedy(work, rng, _GREEDY[rounds > 0]))
    best = min((t for t in tours if t is not None), key=lambda t: t.cost, default=None)
    if best is None:
        return None
    current = best
    heat = 0.08 * max(1.0, best.cost)
    cooling = 0.05 ** (1 / max(1, rounds))
    for _ in range(rounds):
        if deadline.expired() or best.schedule.makespan <= enough:
            break
        new = _decoded(work, _neighbour(work, current.sequence, rng))
        heat *= cooling
        if new is None:
            continue
        if new.cost <= current.cost or rng.random() < math.exp((current.cost - new.cost) / heat):
            current = new
            if new.cost < best.cost:
                best = new
    return best


def _greedy(work: RoutedWork, rng: random.Random, attempts: int) -> Tour | None:
    wanted = [i for i, task in enumerate(work.tasks) if task.wanted]
    if not wanted:
        return None
    tails = tails_of_wanted(work)
    found = []
    for attempt in range(attempts):
        noise = {i: rng.random() * attempt for i in wanted}
        order = sorted(wanted, key=lambda i: (-tails[i] - noise[i] * work.tasks[i].length, i))
        tour = decode(work, [(i, -1) for i in order], full=attempt % 2 == 1)
        if tour is not None:
            found.append(tour)
    return min(found, key=lambda tour: tour.cost, default=None)


def _neighbour(work: RoutedWork, sequence: list[Step], rng: random.Random) -> list[Step]:
    """Return a sequence with a task done by another, at another time, or not on purpose."""
    new = list(sequence)
    if not new:
        return new
    at = rng.randrange(len(new))
    task, way = new[at]
    kind = rng.random()
    if not work.tasks[task].wanted and kind < 0.3:
        del new[at]  # whoever needs it first does it
    elif kind < 0.5 and len(work.tasks[task].ways) > 1:
        new[at] = (task, rng.choice([w for w in range(len(work.tasks[task].ways)) if w != way]))
    else:
        step = new.pop(at)
        near = max(0, min(len(new), at + rng.randint(-6, 6)))
        new.insert(near if kind < 0.85 else rng.randint(0, len(new)), step)
        if kind > 0.9:
            new[at if at < len(new) else -1] = (new[at if at < len(new) else -1][0], -1)
    return new
