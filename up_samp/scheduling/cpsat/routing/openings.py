"""Doors among the tasks: what opens one is one thing to do, whoever does it.

A state that has to be changed before somebody may come to a place (a door), that nothing sets back:
whoever changes it first opens the way for all, and later openings change nothing. So a bound may
look at the first opening only, and quick schedules need no other.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.scheduling.cpsat.encode.statevars import Key
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.route import Route


@dataclass
class RoutedTask:
    """Done once at most, in one of ``ways``: (route, stop's name, places). One that is ``wanted``
    is done in one of them in every schedule. ``after`` are (task, time from its start), ``apart``
    are (task, gap). ``changes`` are (state, value, time from the start), of the states that ways
    need or that moves keep as they are.
    A ``visit`` is done by nothing but arriving.
    """

    length: int
    wanted: bool
    ways: list[tuple[int, str, frozenset[int]]] = field(default_factory=list)
    after: list[tuple[int, int]] = field(default_factory=list)
    apart: list[tuple[int, int]] = field(default_factory=list)
    changes: list[tuple[Key, int, int]] = field(default_factory=list)
    stirs: list[tuple[Key, int]] = field(default_factory=list)
    """(state, time from the start) of what surely changes, whoever does it."""
    visit: bool = False
    needed: bool = False
    """Nobody wants it by itself, but something that is wanted cannot be done before it."""
    opens: Key | None = None
    """The door that it opens, if it and only it does, and nothing shuts it."""
    opened: list[tuple[int, int]] = field(default_factory=list)
    """(needed task, time from its start): what opens the way to this one, whoever does it."""


Entrance = tuple[Key, frozenset[int]]
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


def _openers(model: ScheduleModel, tasks: list[RoutedTask], entrance: Entrance) -> list[int] | None:
    """Return the tasks that open an entrance, if all that changes it does just that, and alike."""
    key, allowed = entrance
    state = model.states.vars[key]
    if state.numeric or state.initial in allowed or not state.writes:
        return None
    names = {name: i for i, task in enumerate(tasks) for _, name, _ in task.ways}
    found: dict[int, None] = {}
    for write in state.writes:
        if model.store.never(write.active):
            continue
        owner = None if write.owner is None else model.states.activity(write.owner)
        if owner is None or owner.name not in names or write.active != owner.present:
            return None
        if write.value.terms or write.value.const not in allowed:
            return None
        found[names[owner.name]] = None
    if not found:
        return None
    some = [tasks[i] for i in found]
    first = some[0]
    alike = all(
        not t.wanted and t.length == first.length and t.changes == first.changes for t in some
    )
    return list(found) if alike and sum(k == key for k, _, _ in first.changes) == 1 else None


def _merged(
    tasks: list[RoutedTask], groups: list[list[int]]
) -> tuple[list[RoutedTask], dict[int, int]]:
    """Return the tasks with each group as one, and old -> new numbers. What is said of the one is
    what is said of each.
    """
    leader = {i: some[0] for some in groups for i in some}
    kept = [i for i in range(len(tasks)) if leader.get(i, i) == i]
    number = {i: kept.index(leader.get(i, i)) for i in range(len(tasks))}
    members = {some[0]: some for some in groups}
    found = []
    for i in kept:
        some = [tasks[m] for m in members.get(i, [i])]
        one = some[0]
        merged = RoutedTask(one.length, one.wanted, changes=one.changes, visit=one.visit)
        merged.ways = [way for task in some for way in task.ways]
        merged.stirs = [s for s in one.stirs if all(s in task.stirs for task in some)]
        merged.after = _of_each([t.after for t in some], members, number)
        merged.apart = _of_each([t.apart for t in some], members, number)
        found.append(merged)
    return found, number


def _of_each(
    lists: list[list[tuple[int, int]]], members: dict[int, list[int]], number: dict[int, int]
) -> list[tuple[int, int]]:
    """Return the relations (task, gap) of a merged task to others that each of them has to each
    of theirs.
    """
    found = []
    known = [_greatest(some) for some in lists]
    for other in {task for some in known for task in some}:
        group = next((g for g in members.values() if other in g), [other])
        if other == group[0] and all(m in some for some in known for m in group):
            found.append((number[other], min(some[m] for some in known for m in group)))
    return sorted(found)


def _greatest(some: list[tuple[int, int]]) -> dict[int, int]:
    found: dict[int, int] = {}
    for task, gap in some:
        found[task] = max(gap, found.get(task, gap))
    return found


def _mark(routes: list[Route], tasks: list[RoutedTask], openers: dict[Entrance, int]) -> None:
    """Mark what has to be opened for what is wanted, and so on."""
    agenda = [i for i, task in enumerate(tasks) if task.wanted]
    known = set(agenda)
    while agenda:
        number = agenda.pop()
        for entrance, lead in _entrances(routes, tasks[number]).items():
            opener = openers.get(entrance)
            if opener is None or opener == number:
                continue
            delay = next(d for k, _, d in tasks[opener].changes if k == entrance[0])
            tasks[number].opened.append((opener, delay + lead))
            if opener not in known:
                known.add(opener)
                tasks[opener].needed = True
                agenda.append(opener)


def _entrances(routes: list[Route], task: RoutedTask) -> dict[Entrance, int]:
    """Return what must be open for a task whoever does it wherever, and for how long at least."""
    common: dict[Entrance, int] | None = None
    for number, stop, places in task.ways:
        route = routes[number]
        late = route.step - route.rest(stop)
        for place in places:
            entries = () if place == route.initial else route.entries.get(place, ())
            mine = {(e.state, e.allowed): e.lead - late for e in entries}
            common = (
                mine
                if common is None
                else {e: min(lead, mine[e]) for e, lead in common.items() if e in mine}
            )
    return common or {}
