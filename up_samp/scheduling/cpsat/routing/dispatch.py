"""Who does what where: the tasks of travellers, for quick constructive schedules.

A task is one of several alternatives (stops of routes) that are done once; its times are one start
variable, and whatever opens the same door is one task. What the tasks need is read off the full
model: order, machines, doors, unary places.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import Any

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.encode.forms import TRUE, Literal, difference_told
from up_samp.scheduling.cpsat.encode.states import Key, StateVar, Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.needs import (
    Held,
    OwnState,
    Way,
    WayNeeds,
    find_needs,
    find_own_states,
    find_set_back,
    gaps_told,
    later_than,
    releases_told,
    ways_with,
)
from up_samp.scheduling.cpsat.routing.route import Move, Route


@dataclass(frozen=True, eq=False)
class UnitPlace:
    """A unary place: it is taken by whoever rests at one of ``places`` (by route's key)."""

    places: Mapping[Key, frozenset[int]]

    def places_of(self, route: Key) -> frozenset[int]:
        """Return the places of a route that it holds."""
        return self.places.get(route, frozenset())


def find_unit_places(model: ScheduleModel, routes: list[Route]) -> list[UnitPlace]:
    """Return the unary places: 0/1 fluents that arrivals decrease and departures increase.

    Assumes: every arrival takes the one unit at its end, every departure gives it back at its
    start, whoever begins there has it, and nobody is put there otherwise.
    """
    carriers: dict[int | None, set[Key]] = {}
    for route in routes:
        for move in route.moves:
            index = model.world.activities[move.name].index
            carriers.setdefault(index, set()).add(route.key)
    found = []
    for state in model.states.vars.values():
        writes = [w for w in state.writes if not model.store.never(w.active)]
        if not writes or state.bounds != (0, 1) or not all(w.add for w in writes):
            continue
        # who takes one unit for two travellers says nothing of these two
        if any(len(carriers.get(w.owner, ())) != 1 for w in writes):
            continue
        changes = _unit_changes(model, routes, writes)
        if changes is None:
            continue
        arrivals, departures = changes
        places: dict[Key, frozenset[int]] = {}
        for route in routes:
            comes = {(m.name, m.to) for m in route.moves}
            inside = frozenset(to for name, to in comes if to in arrivals.get(name, ()))
            begins = {(m.name, origin) for m in route.moves for origin in m.origins}
            taken, given = _are(comes, inside, arrivals), _are(begins, inside, departures)
            if not (taken and given and inside.isdisjoint(route.free)):
                break
            places[route.key] = inside
        else:
            here = sum(route.initial in places[route.key] for route in routes)
            if here + (state.initial or 0) <= 1:  # who is there has it
                found.append(UnitPlace(places))
    return found


Ends = dict[str, frozenset[int]]
"""Moves that take a unit (or give one back) -> the places to (or from) which they do."""


def _are(ends: set[tuple[str, int]], inside: frozenset[int], known: Ends) -> bool:
    """Return whether those moves take or give a unit, of one route, that lead in or out."""
    return {e for e in ends if e[1] in inside} == {e for e in ends if e[1] in known.get(e[0], ())}


def _unit_changes(
    model: ScheduleModel, routes: list[Route], writes: list[Write]
) -> tuple[Ends, Ends] | None:
    """Return who takes a unit at its end and who gives it back at its start, or a unit after it;
    None if anybody does anything else with it.
    """
    taken, given = Ends(), Ends()
    moves: dict[str, list[Move]] = {}
    for move in (move for route in routes for move in route.moves):
        moves.setdefault(move.name, []).append(move)
    for write in writes:
        activity = model.states.activity(write.owner or 0)
        step = 0 if write.value.terms else write.value.const
        start = model.states.difference(write.time, activity.start) in ((0, 0), (1, 1))
        end = model.states.difference(write.time, activity.end) == (0, 0)
        if not (step == -1 and end) and not (step == 1 and start):
            return None
        places = _places(model, activity, write.active, moves[activity.name], arrives=step == -1)
        if not places:
            return None
        found = taken if step == -1 else given
        found[activity.name] = found.get(activity.name, frozenset()) | places
    return taken, given


def _places(
    model: ScheduleModel,
    activity: ActivityVars,
    active: Literal,
    moves: list[Move],
    *,
    arrives: bool,
) -> frozenset[int]:
    """Return the places of which a literal tells that an activity begins or ends there (none, if
    it says anything else).
    """
    found = set[int]()
    for move in moves:
        places = frozenset((move.to,)) if arrives else move.origins
        if active == activity.present:
            found |= places
        elif len(places) == 1:
            # who goes from one place to another is told by one variable where it comes from, and
            # by another one where it goes to
            tells = (model.store.is_value(*item) for item in move.values if item[1] in places)
            if any(model.store.all_of([activity.present, told]) == active for told in tells):
                found |= places
    return frozenset(found)


# ------------------ Doors among the tasks: what opens one is one thing to do, whoever does it
# A state that has to be changed before somebody may come to a place (a door), that nothing sets
# back: whoever changes it first opens the way for all, and later openings change nothing. So a
# bound may look at the first opening only, and quick schedules need no other.


@dataclass
class RoutedTask:
    """Done once at most, in one of ``ways``: (route, stop's name, places), no sooner than its
    ``release``. One that is ``wanted`` is done in one of them in every schedule. ``after`` are
    (task, time from its start), ``apart`` are (task, gap); ``tail`` is the least time from its
    start to the end of what is done on no route. ``changes`` are (state, value, time from the
    start), of the states that ways need or that moves keep as they are. A ``visit`` is done by
    nothing but arriving.
    """

    length: int
    wanted: bool
    ways: list[tuple[int, str, frozenset[int]]] = field(default_factory=list)
    release: int = 0
    after: list[tuple[int, int]] = field(default_factory=list)
    apart: list[tuple[int, int]] = field(default_factory=list)
    changes: list[tuple[Key, int, int]] = field(default_factory=list)
    stirs: list[tuple[Key, int]] = field(default_factory=list)
    """(state, time from the start) of what surely changes, whoever does it."""
    tail: int = 0
    queues: list[tuple[int, dict[int, int]]] = field(default_factory=list)
    """Of things on no route that are done one at a time: the least time from its start to the end
    of that on which it hangs, and of each task that starts later how long that lasts on which it
    hangs."""
    visit: bool = False
    needed: bool = False
    """Nobody wants it by itself, but something that is wanted cannot be done before it."""
    opens: Key | None = None
    """The door that it opens, if it and only it does, and nothing shuts it."""
    again: bool = False
    """Several of its ways may be taken, at times of their own: it is the first of these."""
    opened: list[tuple[int, int]] = field(default_factory=list)
    """(needed task, time from its start): what opens the way to this one, whoever does it."""

    def is_of_one(self, way: int) -> bool:
        """Return whether one traveller alone takes a way, and they do not meet."""
        names = [name for _, name, _ in self.ways]
        return names.count(names[way]) == 1


Need = tuple[Key, frozenset[int]]
"""A state, and the values that it must have for somebody to come."""


def with_openings(
    model: ScheduleModel, routes: list[Route], tasks: list[RoutedTask]
) -> list[RoutedTask]:
    """Return ``tasks`` with those that open the same as one, and what cannot go without them.

    Assumes: all that changes a state opens it, alike, and opens nothing else; nothing shuts it.
    """
    entrances = sorted(
        {
            (entry.state, entry.allowed)
            for route in routes
            for entries in route.entries.values()
            for entry in entries
        },
        key=str,
    )
    openers = {e: found for e in entrances if (found := _openers(model, tasks, e))}
    counts: dict[int, int] = {}
    for found in openers.values():
        for task in found:
            counts[task] = counts.get(task, 0) + 1
    openers = {e: some for e, some in openers.items() if all(counts[t] == 1 for t in some)}
    tasks, places = _merged(tasks, list(openers.values()))
    for (key, _), some in openers.items():
        tasks[places[some[0]]].opens = key
    _mark(routes, tasks, {e: places[some[0]] for e, some in openers.items()})
    return tasks


def _openers(model: ScheduleModel, tasks: list[RoutedTask], entrance: Need) -> list[int] | None:
    """Return the tasks that open an entrance, if all that changes it does just that, and alike."""
    key, allowed = entrance
    state = model.states.vars[key]
    changes = model.states.sure_changes(state)
    if state.numeric or state.initial in allowed or not changes:
        return None
    names = {name: i for i, task in enumerate(tasks) for _, name, _ in task.ways}
    if any(c.owner.name not in names or c.value not in allowed for c in changes):
        return None
    found = dict.fromkeys(names[change.owner.name] for change in changes)
    some = [tasks[i] for i in found]
    first = some[0]
    alike = all(
        not t.wanted and t.length == first.length and t.changes == first.changes for t in some
    )
    return list(found) if alike and sum(k == key for k, _, _ in first.changes) == 1 else None


def _merged(
    tasks: list[RoutedTask], groups: list[list[int]]
) -> tuple[list[RoutedTask], dict[int, int]]:
    """Return the tasks with each group as one, and old -> new numbers. What is said of one of
    several is not said of the others: no relations of theirs are left.
    """
    leader = {i: some[0] for some in groups for i in some}
    kept = [i for i in range(len(tasks)) if leader.get(i, i) == i]
    number = {i: kept.index(leader.get(i, i)) for i in range(len(tasks))}
    members = {some[0]: some for some in groups}
    several = {i for some in groups if len(some) > 1 for i in some}

    def of_each(i: int, relations: list[tuple[int, int]]) -> list[tuple[int, int]]:
        return [(number[t], gap) for t, gap in relations if several.isdisjoint((i, t))]

    found = []
    for i in kept:
        one, some = tasks[i], [tasks[m] for m in members.get(i, [i])]
        one.ways, one.again = [way for task in some for way in task.ways], i in several
        one.release = min(task.release for task in some)
        one.stirs = [s for s in one.stirs if all(s in task.stirs for task in some)]
        one.after, one.apart = of_each(i, one.after), of_each(i, one.apart)
        one.queues = [(end, {number[t]: n for t, n in some.items()}) for end, some in one.queues]
        found.append(one)
    return found, number


def _mark(routes: list[Route], tasks: list[RoutedTask], openers: dict[Need, int]) -> None:
    """Mark what has to be opened for what is wanted, and so on."""
    agenda = [i for i, task in enumerate(tasks) if task.wanted]
    known = set(agenda)
    while agenda:
        number = agenda.pop()
        for entrance, lead in entrances_of(routes, tasks[number]).items():
            opener = openers.get(entrance)
            if opener is None or opener == number:
                continue
            delay = next(d for k, _, d in tasks[opener].changes if k == entrance[0])
            tasks[number].opened.append((opener, delay + lead))
            if opener not in known:
                known.add(opener)
                tasks[opener].needed = True
                agenda.append(opener)


def entrances_of(routes: list[Route], task: RoutedTask) -> dict[Need, int]:
    """Return what must be open for a task whoever does it wherever, and for how long at least."""
    common: dict[Need, int] | None = None
    for number, stop, places in task.ways:
        route = routes[number]
        late = route.step - route.rest(stop)
        for place in places:
            mine = {(e.state, e.allowed): e.lead - late for e in route.entries_to(place)}
            common = (
                mine
                if common is None
                else {e: min(lead, mine[e]) for e, lead in common.items() if e in mine}
            )
    return common or {}


# ------------------ Who does what where


@dataclass
class RoutedWork:
    """All tasks, with the routes they are on."""

    routes: list[Route]
    tasks: list[RoutedTask]
    units: list[UnitPlace]
    initial: dict[Key, int | None]
    needs: dict[Way, WayNeeds] = field(default_factory=dict)
    own: list[OwnState] = field(default_factory=list)
    made_for: dict[str, frozenset[Way]] = field(default_factory=dict)
    """Moves that are made only where some ways to do tasks are taken."""
    held: dict[str, list[Held]] = field(default_factory=dict)
    """What moves and stops need of states that are set back."""
    others: frozenset[str] = frozenset()
    """Activities on no route."""
    worth: Callable[[CandidateSchedule], float] = attrgetter("makespan")
    """What a schedule costs."""
    tours: dict[tuple[tuple[int, int], ...], Any] = field(default_factory=dict, init=False)
    """Of sequences that were tried (see :mod:`.list_scheduling`)."""

    def providers(self, state: Key, allowed: frozenset[int]) -> list[int]:
        """Return the tasks that bring a state variable to one of ``allowed``."""
        return [
            i
            for i, task in enumerate(self.tasks)
            if any(k == state and v in allowed for k, v, _ in task.changes)
        ]

    @cached_property
    def set_back(self) -> frozenset[Key]:
        """The states that are set back."""
        return frozenset(key for key, *_ in itertools.chain(*self.held.values()))

    @cached_property
    def refills(self) -> list[dict[Way, frozenset[int]]]:
        """What fills each own state up, and where."""
        return [
            {
                (task, way): places
                for task, known in enumerate(self.tasks)
                for way, (route, _, places) in enumerate(known.ways)
                if route == state.route and state.refilled_by((task, way))
            }
            for state in self.own
        ]


def _on_no_route(model: ScheduleModel, routes: list[Route]) -> list[ActivityVars]:
    """Return what no traveller does, neither as a move nor at a stop."""
    routed = {n for r in routes for n in (*r.movers, *dict(r.stops))}
    return [a for a in model.world.activities.values() if a.name not in routed]


def find_work(model: ScheduleModel, routes: list[Route]) -> RoutedWork:
    """Return the tasks of ``routes``.

    Assumes: schedules of them alone are made whole by who also decides about what is on no route.
    """
    others = frozenset(
        a.name for a in _on_no_route(model, routes) if not model.store.never(a.present)
    )
    initial = {key: state.initial for key, state in model.states.vars.items()}
    tasks, units = find_tasks(model, routes), find_unit_places(model, routes)
    names = {
        name: (number, way)
        for number, task in enumerate(tasks)
        for way, (_, name, _) in enumerate(task.ways)
        if not task.visit
    }
    activities, coming = model.world.activities, ways_with(model, names)
    needs = find_needs(model, names, coming)
    for number, task in enumerate(tasks):
        ways = (needs.get((number, way), WayNeeds()) for way in range(len(task.ways)))
        task.after += _before_whoever_does_it(list(ways))
    held, changes = find_set_back(model, routes, names, coming)
    for (number, _), told in changes.items():
        tasks[number].changes = [*dict.fromkeys((*tasks[number].changes, *told))]
    alone = {name: (n, way) for name, (n, way) in names.items() if tasks[n].is_of_one(way)}
    own = find_own_states(model, routes, alone)
    made_for = {
        move.name: frozenset(some)
        for route in routes
        for move in route.moves
        if (some := coming.get(activities[move.name].present))
    }
    return RoutedWork(routes, tasks, units, initial, needs, own, made_for, held, others)


def _before_whoever_does_it(some: list[WayNeeds]) -> list[tuple[int, int]]:
    """Return (task, time from its start) of what comes before a task in whichever of its ways it
    is done.
    """
    each = [{task: gap for (task, _), gap in needs.ended.items()} for needs in some]
    common = set.intersection(*map(set, each))
    return [(task, min(gaps[task] for gaps in each)) for task in sorted(common)]


def find_tasks(model: ScheduleModel, routes: list[Route]) -> list[RoutedTask]:
    """Return what may be done on ``routes``.

    Assumes: what has one start is done once at most; it is wanted only where
    :meth:`ScheduleModel.surely` says so.
    """
    tasks, numbers, owners = _stops(model, routes)
    for form in model.stated:
        told = difference_told(form)
        if told is not None and not form.needs and told[0] in numbers and told[1] in numbers:
            tasks[numbers[told[1]]].after.append((numbers[told[0]], told[2]))
    seen = set[tuple[int, int]]()
    for a, b in model.disjunctions.gaps:
        i, j = sorted((owners.get(a, -1), owners.get(b, -1)))
        if i < 0 or i == j or (i, j) in seen:
            continue
        seen.add((i, j))
        if len({w[0] for w in tasks[i].ways} | {w[0] for w in tasks[j].ways}) == 1:
            continue  # one traveller does one thing at a time anyway
        least = _gap_between(model, tasks[i], tasks[j])
        if least is not None:
            tasks[i].apart.append((j, least))
            tasks[j].apart.append((i, least))
    _find_beside(model, tasks, numbers, routes)
    # what else it sets (that it is busy) tells no two ways to do a task apart
    asked = {e.state for route in routes for some in route.entries.values() for e in some}
    asked.update(key for route in routes for key in route.still)
    states = {k: s for k, s in model.states.vars.items() if k in asked and not s.numeric}
    _find_changes(model, states, owners, tasks)
    return with_openings(model, routes, tasks)


def _stops(
    model: ScheduleModel, routes: list[Route]
) -> tuple[list[RoutedTask], dict[int, int], dict[int, int]]:
    """Return what is done at stops, with the number of each by its start and by its activities."""
    numbers: dict[int, int] = {}
    tasks: list[RoutedTask] = []
    owners: dict[int, int] = {}
    presences: dict[int, list[Literal]] = {}
    for number, route in enumerate(routes):
        for name, places in route.stops:
            activity = model.world.activities[name]
            start = activity.start.terms[0][0]
            if start not in numbers:
                numbers[start] = len(tasks)
                tasks.append(RoutedTask(activity.least, wanted=False))
            owners[activity.index] = numbers[start]
            presences.setdefault(numbers[start], []).append(activity.present)
            tasks[numbers[start]].ways.append((number, name, places))
        for name, places in route.visits:
            tasks.append(RoutedTask(0, True, [(number, name, places)], visit=True))
    for number, some in presences.items():
        # what may be done without any route is not sure, though one of the alternatives is
        tasks[number].wanted = model.surely(some)
    releases = releases_told(model)
    for start in releases.keys() & numbers.keys():  # in whichever of its ways it is done
        since, some = releases[start], presences[numbers[start]]
        sure = min(since.get(presence, 0) for presence in some)
        tasks[numbers[start]].release = max(0, since.get(TRUE, 0), sure)
    return tasks, numbers, owners


def _gap_between(model: ScheduleModel, one: RoutedTask, other: RoutedTask) -> int | None:
    """Return the least gap between two tasks, whoever does them; ``None`` if some ways to do them,
    be they of two travellers, may overlap.
    """
    index, gaps = model.world.activities, model.disjunctions.gaps
    pairs = itertools.product(one.ways, other.ways)
    both = (sorted((index[a].index, index[b].index)) for (_, a, _), (_, b, _) in pairs)
    least = min(gaps.get((first, second), -1) for first, second in both)
    return None if least < 0 else least


def _find_beside(
    model: ScheduleModel, tasks: list[RoutedTask], numbers: dict[int, int], routes: list[Route]
) -> None:
    """Find what tasks ask of each other by way of what is surely done on no route (a machine
    prepares, then somebody comes): the time between them, to the end of all else, and between those
    that hang on two such things that do not overlap.

    Assumes: what is stated without a condition of the start of a task holds whoever does it.
    """
    others = {a.index: a for a in _on_no_route(model, routes) if a.present == TRUE}
    gaps = gaps_told(model).get(frozenset(), {}) if others else {}
    starts = {start: n for start, n in numbers.items() if tasks[n].wanted}
    until: dict[int, dict[int, int]] = {index: {} for index in others}
    for start, number in starts.items():
        later = later_than(gaps, start)
        for var in later.keys() & starts.keys():
            if later[var] > 0:
                tasks[starts[var]].after.append((number, later[var]))
        for index, other in others.items():
            (var, _), *_ = other.end.terms
            if var in later:
                until[index][number] = later[var] + other.end.const
                tasks[number].tail = max(tasks[number].tail, until[index][number])
    since = {
        index: {
            starts[var]: gap
            for var, gap in later_than(gaps, other.start.terms[0][0]).items()
            if var in starts
        }
        for index, other in others.items()
    }
    _find_queues(model, tasks, until, since)


def _find_queues(
    model: ScheduleModel,
    tasks: list[RoutedTask],
    until: dict[int, dict[int, int]],
    since: dict[int, dict[int, int]],
) -> None:
    """Find what tasks ask of each other that hang on things which do not overlap: ``until`` says
    how long after the start of a task each of these ends at least, ``since`` how long after its
    start that task begins.
    """
    queues: dict[tuple[int, int], dict[int, int]] = {}
    for (a, b), gap in model.disjunctions.gaps.items():
        for i, j in itertools.product(until.get(a, ()), until.get(b, ())):
            if i != j and i in since[a] and j in since[b]:
                then = until[a][i] + gap + since[b][j]
                back = until[b][j] + gap + since[a][i]
                if min(then, back) > 0:
                    tasks[j].apart.append((i, then - tasks[i].length))
                    tasks[i].apart.append((j, back - tasks[j].length))
                    queues.setdefault((i, a), {})[j] = b
                    queues.setdefault((j, b), {})[i] = a
    for (number, index), queue in queues.items():
        some = frozenset(queue.values())
        if len(some) == len(queue) and model.disjunctions.apart(some):
            lasting = {task: model.states.activity(b).least for task, b in queue.items()}
            tasks[number].queues.append((until[index][number], lasting))


def _find_changes(
    model: ScheduleModel,
    states: dict[Key, StateVar],
    owners: dict[int, int],
    tasks: list[RoutedTask],
) -> None:
    """Find what each task changes at a known time, and what it changes whoever does it, be it to
    the same value.
    """
    found: dict[str, set[tuple[Key, int]]] = {}
    for key, write in ((key, write) for key, state in states.items() for write in state.writes):
        if write.owner is None:
            continue
        activity = model.states.activity(write.owner)
        since, latest = model.states.difference(write.time, activity.start)
        if since < latest:
            continue
        if write.active == activity.present:
            found.setdefault(activity.name, set()).add((key, since))
        if write.owner in owners and not write.value.terms:
            changes, change = tasks[owners[write.owner]].changes, (key, write.value.const, since)
            changes += [] if change in changes else [change]
    for task in tasks:
        each = [found.get(name, set()) for _, name, _ in task.ways]
        task.stirs = sorted(set.intersection(*each), key=str)
