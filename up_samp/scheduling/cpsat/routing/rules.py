"""What a sequence of tasks has to obey: who does what where, precedences, changes, what is left,
what each traveller carries and has set.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from up_samp.model import Deadline
from up_samp.scheduling.cpsat.encode.terms import INFINITE
from up_samp.scheduling.cpsat.routing.dispatch import RoutedTask, RoutedWork
from up_samp.scheduling.cpsat.routing.needs import OwnState, Way
from up_samp.scheduling.cpsat.routing.route import Route, way_back

MOST_BITS = 62
"""Tasks, or places, that have a bit in a word."""
NEVER = 2**29
"""A time that does not come, in tables: two of them are still one word."""


@dataclass(frozen=True)
class TravelTables:
    """What one traveller needs from place to place (times; NEVER: there is no way)."""

    route: Route
    number: dict[int, int]
    """Of each place, in tables."""
    travel: Any
    """From each place to each place."""

    @staticmethod
    def of(route: Route, size: int) -> TravelTables:
        """Return the ways of a route, in tables that are large enough for ``size`` places."""
        number = {place: k for k, place in enumerate(places_of(route))}
        travel = np.full((size, size), NEVER, dtype=np.int32)
        for (a, b), time in route.travel.items():
            travel[number[a], number[b]] = min(time, NEVER)
        return TravelTables(route, number, travel)


def places_of(route: Route) -> list[int]:
    """Return all places where the traveller may be."""
    return sorted({route.initial} | {b for _, b in route.travel})


# ------------------ The least time that travellers together spend on their tasks
# By dynamic programming over (tasks done, where everybody did its last one), after Held and Karp
# (1962). Times between two tasks of one traveller hold whatever it does in between.


def cost(route: Route, here: int, place: int, stop: str, *, first: bool) -> int:
    """Return the least time from the end of what is done ``here`` until ``stop`` begins."""
    distance = route.travel.get((here, place), INFINITE)
    if distance >= INFINITE:
        return INFINITE
    late = route.step - route.rest(stop) if distance else 0
    return distance - late + (0 if first else route.gap)


@dataclass(frozen=True)
class Programme:
    """The wanted tasks, and all sets of them (bits) that may be done at some time.

    A table of a set has the least time that is still to be spent when it is done, and the
    travellers did their last ones at their i-th, j-th, ... ``spots`` (0: nothing yet).
    """

    routes: list[Route]
    tasks: list[RoutedTask]
    before: list[int]
    """Bits of the tasks that start before each one."""
    layers: list[list[int]]
    """Sets of tasks, by size."""
    spots: list[list[int]]

    @staticmethod
    def of(work: RoutedWork, most: int, *, doors: bool = True) -> Programme | None:
        """Return the programme, ``None`` if it has more than ``most`` states; with what opens
        ``doors``.
        """
        wanted = [i for i, task in enumerate(work.tasks) if task.wanted or (doors and task.needed)]
        number = {task: k for k, task in enumerate(wanted)}
        before = [0] * len(wanted)
        for task in wanted:
            for earlier, gap in (*work.tasks[task].after, *work.tasks[task].opened):
                if earlier in number and gap > 0:
                    before[number[task]] |= 1 << number[earlier]
        spots: list[set[int]] = [set() for _ in work.routes]
        for task in wanted:
            for route, _, places in work.tasks[task].ways:
                spots[route] |= places
        positions = math.prod(len(some) + 1 for some in spots)
        layers = _ideals(before, most // positions)
        if not wanted or layers is None:
            return None
        tasks = [work.tasks[t] for t in wanted]
        return Programme(work.routes, tasks, before, layers, [sorted(some) for some in spots])

    def tables(self, deadline: Deadline) -> dict[int, Any] | None:
        """Return the table of each set; ``None`` if there is no time."""
        shape = [len(some) + 1 for some in self.spots]
        steps = [list(self._steps(task)) for task in self.tasks]
        end = np.zeros(shape, dtype=np.int64)
        for axis, (route, some) in enumerate(zip(self.routes, self.spots, strict=True)):
            end = end + self._along(axis, [0, *(way_back(route, {p}, route.final) for p in some)])
        tables = {self.layers[-1][0]: end}
        for layer in reversed(self.layers[:-1]):
            for count, done in enumerate(layer):
                if (
                    count % 100 == 0 and deadline.expired()
                ):  # a look costs, and some layers are large
                    return None
                best = np.full(shape, INFINITE)
                for number, needs in enumerate(self.before):
                    if done >> number & 1 or needs & ~done:
                        continue
                    following = tables[done | 1 << number]
                    for axis, index, costs in steps[number]:
                        where = (slice(None),) * axis + (slice(index, index + 1),)
                        best = np.minimum(best, costs + following[where])
                tables[done] = best
        return tables

    def start(self, tables: dict[int, Any]) -> int:
        """Return the least time for all tasks."""
        return int(tables[0][(0,) * len(self.routes)])

    def _steps(self, task: RoutedTask) -> Iterator[tuple[int, int, Any]]:
        """Yield (route, index of the place, costs from everywhere) for all ways to do a task."""
        for axis, stop, places in task.ways:
            route, some = self.routes[axis], self.spots[axis]
            for place in sorted(places):
                costs = [cost(route, route.initial, place, stop, first=True)]
                costs += [cost(route, here, place, stop, first=False) for here in some]
                costs = [min(INFINITE, c + task.length) for c in costs]
                yield axis, 1 + some.index(place), self._along(axis, costs)

    def _along(self, axis: int, values: list[int]) -> Any:
        shape = [1] * len(self.routes)
        shape[axis] = len(values)
        return np.array(values, dtype=np.int64).reshape(shape)


def _ideals(before: list[int], most: int) -> list[list[int]] | None:
    """Return the sets (bits) that hold all predecessors of their members, by size; ``None`` if
    there are more than ``most``.
    """
    layers = [[0]]
    count = 1
    for _ in before:
        layer: dict[int, None] = {}
        for done in layers[-1]:
            for task, needs in enumerate(before):
                if not done >> task & 1 and not needs & ~done:
                    layer[done | 1 << task] = None
        count += len(layer)
        if count > most or not layer:
            return None
        layers.append(list(layer))
    return layers


# ------------------ What a sequence of tasks has to obey


@dataclass(frozen=True)
class SequenceChoice:
    """A task as one traveller does it at one place (by its number), in one ``way``. ``late``: time
    by which it may begin before the move there is seen to have ended. ``spot``: the place in
    tables. ``back``: time from its end to that of everything, if it is the last one.
    """

    task: int
    way: int
    traveller: int
    place: int
    spot: int
    late: int
    back: int


@dataclass(frozen=True)
class StateChange:
    """What a task changes at ``delay`` from its start. ``still`` has (a, b) of each traveller whose
    moves end by then - b, or begin at then - a or later. ``shut`` are, for each place of these,
    bits of the tasks that must have started before for anybody to have come there.
    """

    delay: int
    still: dict[int, tuple[int, int]]
    shut: dict[int, Any]


def choices_of(programme: Programme, ways: list[TravelTables]) -> list[SequenceChoice]:
    """Return all ways to do all tasks of a programme."""
    return [
        SequenceChoice(
            number,
            way,
            axis,
            ways[axis].number[place],
            1 + programme.spots[axis].index(place),
            programme.routes[axis].step - programme.routes[axis].rest(stop),
            way_back(programme.routes[axis], {place}, programme.routes[axis].final),
        )
        for number, task in enumerate(programme.tasks)
        for way, (axis, stop, places) in enumerate(task.ways)
        for place in sorted(places)
    ]


def waits_of(work: RoutedWork, programme: Programme) -> tuple[Any, Any]:
    """Return, from the start of each task to that of each later one, the least times that
    precedences alone ask for, and those that disjunctions do, too.
    """
    number = {id(task): k for k, task in enumerate(programme.tasks)}
    ordered = np.zeros((len(number), len(number)), dtype=np.int64)
    apart = ordered.copy()
    for task in programme.tasks:
        here = number[id(task)]
        for earlier, gap in (*task.after, *task.opened):
            there = number.get(id(work.tasks[earlier]))
            if there is not None:
                ordered[there, here] = max(gap, ordered[there, here])
        for other, gap in task.apart:
            there = number.get(id(work.tasks[other]))
            if there is not None:
                apart[there, here] = max(work.tasks[other].length + gap, apart[there, here])
    return ordered, np.maximum(ordered, apart)


def tails_of(tasks: list[RoutedTask], arcs: list[tuple[int, int, int]]) -> list[int]:
    """Return the least time from each task's start to the end of what has to start after it:
    ``arcs`` are (task, later one, least time from start to start).
    """
    tails = [max(task.length, task.tail) for task in tasks]
    for _ in tasks:
        for earlier, later, gap in arcs:
            tails[earlier] = max(tails[earlier], gap + tails[later])
    return tails


def tails_of_wanted(work: RoutedWork) -> list[int]:
    """Return the tails of all tasks, by what surely comes after them."""
    tasks = work.tasks
    sure = ((i, task) for i, task in enumerate(tasks) if task.wanted)
    arcs = [(before, i, gap) for i, task in sure for before, gap in task.after]
    return tails_of(tasks, arcs)


def change_of(programme: Programme, ways: list[TravelTables], number: int) -> StateChange | None:
    """Return what a task changes while moves of others keep it as it is: the most of them."""
    found: list[StateChange] = []
    for key, delay in programme.tasks[number].stirs:
        still = {a: r.still[key] for a, r in enumerate(programme.routes) if key in r.still}
        shut = {}
        for axis, (_, last) in still.items():
            shut[axis] = np.zeros(len(ways[axis].travel), dtype=np.int64)
            for place, here in ways[axis].number.items():
                shut[axis][here] = _shut(programme, ways[axis], place, delay - last)
        found.append(StateChange(delay, still, shut))
    return max(found, key=lambda change: len(change.still), default=None)


def _shut(programme: Programme, ways: TravelTables, place: int, latest: int) -> int:
    """Return the tasks (bits) that have to start before one at whose start + ``latest`` somebody
    has come to a place: what opens the way there, if it cannot be later.
    """
    route, bits = ways.route, 0
    every = enumerate(programme.tasks)
    for entry, (number, task) in itertools.product(route.entries_to(place), every):
        delays = [d for k, _, d in task.changes if k == entry.state]
        if task.opens == entry.state and delays[0] > latest + route.step - entry.lead:
            bits |= 1 << number
    return bits


def doors_of(programme: Programme, ways: list[TravelTables]) -> list[list[tuple[int, int, int]]]:
    """Return, for each task, (traveller, place, time from its start): when who goes on from there
    has come, where the task opens the way.
    """
    found: list[list[tuple[int, int, int]]] = []
    for task in programme.tasks:
        delays = [d for key, _, d in task.changes if key == task.opens]
        found.append(
            [
                (axis, number, delays[0] + entry.lead)
                for axis, some in enumerate(ways)
                for place, number in some.number.items()
                for entry in some.route.entries_to(place)
                if task.opens is not None and entry.state == task.opens
            ]
        )
    return found


def handovers_of(work: RoutedWork, ways: list[TravelTables]) -> Any:
    """Return, for each traveller, place, other traveller and its place, how long after the one can
    leave its place the other one can go on from its own, at least: where only one of them fits
    (-NEVER: they do not heed each other there).
    """
    shape = len(ways), len(ways[0].travel)
    found = np.full((*shape, *shape), -NEVER, dtype=np.int64)
    pairs = itertools.permutations(enumerate(ways), 2)
    for unit, ((axis, some), (other, others)) in itertools.product(work.units, pairs):
        here, there = (
            [way.number[p] for p in unit.places_of(way.route.key) & way.number.keys()]
            for way in (some, others)
        )
        found[np.ix_([axis], here, [other], there)] = others.route.step
    return found


@dataclass(frozen=True)
class SequenceRules:
    """All that sequences of tasks have to obey, and what is needed to bound them."""

    programme: Programme
    ways: list[TravelTables]
    choices: list[SequenceChoice]
    changes: list[StateChange | None]
    """Of each task."""
    waits: Any
    """From the start of each task to that of each later one, at least."""
    tails: list[int]
    """From the start of each task to the end of all that has to come after it, at least."""
    queues: list[list[tuple[int, dict[int, int]]]]
    """Of each task (see :class:`.RoutedTask`), by the bits of others."""
    sets: Any
    """All sets of tasks that may be done (bits), in order."""
    rests: Any
    """A row for each of them: the least time that is left, for all positions of the travellers."""
    shape: tuple[int, ...]
    doors: list[list[tuple[int, int, int]]]
    """(traveller, place, time from the start) of each task: when the way there is open."""
    handovers: Any
    own: Any
    """What each traveller carries and has set, as :func:`own_states_after` has it."""

    @staticmethod
    def of(work: RoutedWork, programme: Programme, tables: dict[int, Any]) -> SequenceRules | None:
        """Return the rules for the tasks of a programme; ``None`` if these are too many."""
        size = max(len(places_of(route)) for route in programme.routes)
        if max(len(programme.tasks), size) > MOST_BITS:
            return None
        ways = [TravelTables.of(route, size) for route in programme.routes]
        choices = choices_of(programme, ways)
        ordered, waits = waits_of(work, programme)
        arcs = [(a, b, int(ordered[a, b])) for a, b in np.argwhere(ordered > 0).tolist()]
        sets = np.array(sorted(tables), dtype=np.int64)
        changes = [change_of(programme, ways, number) for number in range(len(programme.tasks))]
        numbers = {id(task): number for number, task in enumerate(work.tasks)}
        wanted = [numbers[id(task)] for task in programme.tasks]
        done = [(c.traveller, (wanted[c.task], c.way)) for c in choices]
        return SequenceRules(
            programme,
            ways,
            choices,
            changes,
            waits,
            tails_of(programme.tasks, arcs),
            [
                [(end, {1 << wanted.index(t): n for t, n in q.items()}) for end, q in task.queues]
                for task in programme.tasks
            ],
            sets,
            np.stack([tables[int(done)].ravel() for done in sets]),
            tables[0].shape,
            doors_of(programme, ways),
            handovers_of(work, ways),
            own_states_after(work, wanted, done, len(tables) * tables[0].size),
        )

    def plain(self) -> SequenceRules:
        """Return the same with no regard to changes."""
        return replace(self, changes=[None] * len(self.changes))

    @cached_property
    def lengths(self) -> Any:
        """How long each choice takes; last: nothing that was done."""
        return np.array([*(self.programme.tasks[c.task].length for c in self.choices), 0])

    @cached_property
    def tasks(self) -> Any:
        """The task of each choice; last: of none (any one)."""
        return np.array([*(c.task for c in self.choices), 0])

    @cached_property
    def places(self) -> Any:
        """(traveller, choice): where each choice is; last: where the traveller begins."""
        places = [c.place for c in self.choices]
        return np.array([[*places, w.number[w.route.initial]] for w in self.ways])

    @cached_property
    def spots(self) -> Any:
        """The place of each choice in tables; last: nothing that was done."""
        return np.array([*(c.spot for c in self.choices), 0])

    @cached_property
    def gaps(self) -> Any:
        """How long each traveller rests between two tasks."""
        return np.array([route.gap for route in self.programme.routes])

    def row(self, done: Any) -> Any:
        """Return the rows of sets of tasks in tables."""
        return np.searchsorted(self.sets, done)

    def rest(self, done: Any, last: Any) -> Any:
        """Return the least time that is left for all travellers together."""
        where = np.ravel_multi_index(tuple(self.spots[last].T), self.shape)
        return self.rests[self.row(done), where]


# ------------------ What a traveller carries and has set
# A load is picked up and delivered by the same traveller; a fork that is taken holds nothing else.
# So what a traveller may do next hangs on what it did before, whoever else did what meanwhile. All
# of that is one number of each traveller, which each task changes: states of a finite automaton.


Known = tuple[tuple[int, ...], frozenset[Way]]
"""(the values of its own states, what it has begun and has still to end: ways of tasks)."""


Partners = dict[Way, frozenset[Way]]
"""A way to do a task -> what its traveller has begun and ends by it, ways of other tasks."""


def _partners(work: RoutedWork, wanted: frozenset[int]) -> Partners:
    """Return what has to be begun and ended by the same traveller, among ``wanted`` tasks that are
    done once.
    """
    routes = {way: work.tasks[way[0]].ways[way[1]][0] for way in work.needs}
    ends = {
        way: {o for o, gap in needs.ended.items() if gap > 0 and routes[o] == routes[way]}
        for way, needs in work.needs.items()
        if way[0] in wanted
    }
    enders = Counter(o for o, _ in {(o, way[0]) for way, some in ends.items() for o in some})
    # what several tasks end is not over when one of them is done
    once = frozenset(o for o, count in enders.items() if count == 1 and o[0] in wanted)
    return {way: once & some for way, some in ends.items()}


def own_states_after(
    work: RoutedWork, wanted: list[int], choices: list[tuple[int, Way]], most: int
) -> Any:
    """Return the number of a traveller after each of ``choices`` ((traveller, way)), by the one
    before it: a row for each number (0: at first), a column for each choice; -1: not then. What
    would take more numbers than ``most`` is left out.

    Assumes: whoever changes a traveller's own state is among the choices, once.
    """
    some = frozenset(task for task in wanted if not work.tasks[task].again)
    partners = _partners(work, some)
    columns, tables = [], []
    for axis in range(len(work.routes)):
        mine = {column: way for column, (who, way) in enumerate(choices) if who == axis}
        mine_alone = (s for s in work.own if s.route == axis and not s.takings)
        states = [s for s in mine_alone if {t for t, _ in (*s.gains, *s.settings)} <= some]
        columns.append(list(mine))
        tables.append(_table(states, partners, list(mine.values()), most))
    after = np.full((max(map(len, tables)), len(choices)), -1, dtype=np.int64)
    for some_columns, table in zip(columns, tables, strict=True):
        after[np.ix_(range(len(table)), some_columns)] = table
    return after


def _table(states: list[OwnState], partners: Partners, ways: list[Way], most: int) -> Any:
    """Return the rows of one traveller (one row that tells nothing, if they are too many)."""
    first: Known = (tuple(s.initial for s in states), frozenset())
    begin = frozenset[Way]().union(*partners.values())
    agenda: list[Any] = [first]
    numbers: dict[Known | None, int] = {None: -1, first: 0}
    rows: list[list[int]] = []
    for known in agenda:
        row = []
        for way in ways:
            ended = partners.get(way, frozenset())
            following = _following(states, known, way, ended, begin & {way})
            if following not in numbers:
                numbers[following] = len(agenda)
                agenda.append(following)
            row.append(numbers[following])
        rows.append(row)
        if len(numbers) > most:
            return np.zeros((1, len(ways)), dtype=np.int64)
    return np.array(rows, dtype=np.int64).reshape(len(rows), len(ways))


def _following(
    states: list[OwnState], known: Known, way: Way, ended: frozenset[Way], begins: frozenset[Way]
) -> Known | None:
    """Return what is known after a task is done in one way, which has ``ended`` what was begun and
    ``begins`` something; ``None`` if it cannot be done then.
    """
    values, begun = known
    after = [state.after(value, way) for state, value in zip(states, values, strict=True)]
    now = tuple(value for value in after if value is not None)
    fits = ended <= begun and len(now) == len(after)
    return (now, begun - ended | begins) if fits else None
