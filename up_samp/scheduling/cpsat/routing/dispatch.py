"""Who does what where: the tasks of travellers, for quick constructive schedules.

A task is one of several alternatives (stops of routes) that are done once; its times are one start
variable, and whatever opens the same door is one task. What the tasks need is read off the full
model: order, machines, doors, unary places.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from up_samp.scheduling.cpsat.encode.forms import TRUE, Cmp, Literal
from up_samp.scheduling.cpsat.encode.statevars import Key, StateVar
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.openings import RoutedTask, with_openings
from up_samp.scheduling.cpsat.routing.route import Route
from up_samp.scheduling.cpsat.routing.unit_places import UnitPlace, find_unit_places

Memory = dict[tuple[object, ...], dict[int, int]]
"""By what the tasks are called: of each set of them that are done (bits), what is left at least."""


@dataclass
class Work:
    """All tasks, with the routes they are on. ``lefts``: what was found out before about what sets
    of tasks leave (:mod:`.lefts`).
    """

    routes: list[Route]
    tasks: list[RoutedTask]
    units: list[UnitPlace]
    initial: dict[Key, int | None]
    lefts: Memory = field(default_factory=dict)

    def providers(self, state: Key, allowed: frozenset[int]) -> list[int]:
        """Return the tasks that bring a state variable to one of ``allowed``."""
        return [
            i
            for i, task in enumerate(self.tasks)
            if any(k == state and v in allowed for k, v, _ in task.changes)
        ]


def find_work(model: ScheduleModel, routes: list[Route]) -> Work | None:
    """Return the tasks of ``routes``; ``None`` if something else must be done, too.

    Assumes: what must be there in every schedule is done on the routes.
    """
    names = {n for r in routes for n, _ in r.stops}
    others = [
        a
        for a in model.world.activities.values()
        if a.name not in names and not model.store.never(a.present)
    ]
    if any(a.present == TRUE or a.present in model.exact for a in others):
        return None
    initial = {key: state.initial for key, state in model.states.vars.items()}
    return Work(routes, find_tasks(model, routes), find_unit_places(model, routes), initial)


def find_tasks(model: ScheduleModel, routes: list[Route]) -> list[RoutedTask]:
    """Return what may be done on ``routes``.

    Assumes: what has one start is done once at most; it is wanted only where
    :meth:`ScheduleModel.surely` says so.
    """
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
    for first, then, gap in _differences(model):
        if first in numbers and then in numbers:
            tasks[numbers[then]].after.append((numbers[first], gap))
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
    # what else it sets (that it is busy) tells no two ways to do a task apart
    asked = {e.state for route in routes for some in route.entries.values() for e in some}
    asked.update(key for route in routes for key in route.still)
    states = {k: s for k, s in model.states.vars.items() if k in asked and not s.numeric}
    _find_changes(model, states, owners, tasks)
    _find_stirs(model, states, tasks)
    return with_openings(model, routes, tasks)


def _differences(model: ScheduleModel) -> Iterator[tuple[int, int, int]]:
    """Yield (u, v, k) for every unconditional u + k <= v."""
    for form in model.stated:
        if form.__class__ is Cmp and not form.needs and form.op == "<=" and len(form.terms) == 2:
            (u, cu), (v, cv) = form.terms
            if (cu, cv) == (1, -1):
                yield u, v, form.const
            elif (cu, cv) == (-1, 1):
                yield v, u, form.const


def _gap_between(model: ScheduleModel, one: RoutedTask, other: RoutedTask) -> int | None:
    """Return the least gap between two tasks, whoever does them; ``None`` if some ways to do them,
    be they of two travellers, may overlap.
    """
    world = model.world.activities
    gaps = []
    for _, a, _ in one.ways:
        for _, b, _ in other.ways:
            first, second = sorted((world[a].index, world[b].index))
            gap = model.disjunctions.gaps.get((first, second))
            if gap is None:
                return None
            gaps.append(gap)
    return min(gaps)


def _find_changes(
    model: ScheduleModel,
    states: dict[Key, StateVar],
    owners: dict[int, int],
    tasks: list[RoutedTask],
) -> None:
    for key, state in states.items():
        for write in state.writes:
            if write.owner in owners and not write.value.terms:
                activity = model.states.activity(write.owner)
                low, high = model.states.difference(write.time, activity.start)
                change = (key, write.value.const, low)
                task = tasks[owners[write.owner]]
                if low == high and change not in task.changes:
                    task.changes.append(change)


def _find_stirs(model: ScheduleModel, states: dict[Key, StateVar], tasks: list[RoutedTask]) -> None:
    """Find what each task changes at a known time whoever does it, be it to the same value."""
    found: dict[str, set[tuple[Key, int]]] = {}
    for key, state in states.items():
        for write in state.writes:
            if write.owner is None:
                continue
            activity = model.states.activity(write.owner)
            low, high = model.states.difference(write.time, activity.start)
            if low == high and write.active == activity.present:
                found.setdefault(activity.name, set()).add((key, low))
    for task in tasks:
        each = [found.get(name, set()) for _, name, _ in task.ways]
        task.stirs = sorted(set.intersection(*each), key=str)
