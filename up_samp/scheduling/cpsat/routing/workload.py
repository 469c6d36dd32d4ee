"""A lower bound from all the work there is: the least time that travellers need for their tasks.

Tasks are done in some order, by their starts; whoever does the next one comes from where it did
its last one. The least total over all orders that the precedences allow is found by dynamic
programming over (tasks done, where everybody is), after Held and Karp (1962). What has to be done
before a place may be entered (doors) adds what it costs to squeeze it in. Everybody's share ends
by the makespan, so the total by the number of travellers is a bound; travellers that take turns
count as one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.encode.statevars import Key
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import INFINITE, Route
from up_samp.scheduling.cpsat.routing.dispatch import Task, Work

MOST_STATES = 2_000_000
"""States of the dynamic programme; more of them take longer than they are worth."""


def lanes(model: ScheduleModel, routes: list[Route]) -> list[list[int]]:
    """Return the routes (by number) in groups that take turns: all they do is one at a time.

    Time in which a traveller only waits until its arrival is seen is not shared out, so these do
    not count.
    """
    index = model.world.activities
    wholes = [
        {index[n].index for n in (*(m.name for m in r.moves), *(s for s, _ in r.stops))}
        for r in routes
    ]
    left = list(range(len(routes)))
    groups = []
    while left:
        sets = [
            [r for r in left if wholes[r] <= clique and routes[r].step == routes[r].gap <= gap]
            for gap, clique in model.disjunctions.sets()
        ]
        group = max(sets, key=len, default=[]) or left[:1]
        groups.append(group)
        left = [r for r in left if r not in group]
    return groups


def bound_by_work(
    model: ScheduleModel, work: Work, over: Callable[[], bool] = lambda: False
) -> int:
    """Return a lower bound on the makespan (0 where the problem is too large for this)."""
    programme = _Programme.of(work)
    total = None if programme is None else programme.least(over)
    if total is None:
        return 0
    extra = sum(_squeezed(work, tasks) for tasks in _needed(model, work))
    return -(-(total + extra) // len(lanes(model, work.routes)))


# -- what a route costs ----------------------------------------------------------------------------
def cost(route: Route, here: int, place: int, stop: str, *, first: bool) -> int:
    """Return the least time from the end of what is done ``here`` until ``stop`` begins."""
    distance = route.travel.get((here, place), INFINITE)
    if distance >= INFINITE:
        return INFINITE
    late = route.step - route.rest(stop) if distance else 0
    return distance - late + (0 if first else route.gap)


def way_back(route: Route, place: int) -> int:
    """Return the least time from the end of a last stop, at ``place``, to that of everything."""
    if route.final is None or place in route.final:
        return 0
    distance = route.between(frozenset((place,)), route.final)
    return 0 if distance >= INFINITE else max(0, route.gap + distance - route.step)


# -- dynamic programming -----------------------------------------------------------------------
@dataclass(frozen=True)
class _Programme:
    """``tables[done][i, j, ...]`` is the least time spent when the tasks in ``done`` (bits) are
    done and the travellers did their last ones at their i-th, j-th, ... spots (0: nothing yet).
    """

    routes: list[Route]
    tasks: list[Task]
    before: list[int]
    """Bits of the tasks that start before each one."""
    layers: list[list[int]]
    """Sets of tasks that may be done at some time, by size."""
    spots: list[list[int]]

    @staticmethod
    def of(work: Work) -> _Programme | None:
        """Return the programme, ``None`` if it would be too large."""
        wanted = [i for i, task in enumerate(work.tasks) if task.wanted]
        number = {task: k for k, task in enumerate(wanted)}
        before = [0] * len(wanted)
        for task in wanted:
            for earlier, gap in work.tasks[task].after:
                if earlier in number and gap > 0:
                    before[number[task]] |= 1 << number[earlier]
        spots: list[set[int]] = [set() for _ in work.routes]
        for task in wanted:
            for route, _, places in work.tasks[task].ways:
                spots[route] |= places
        positions = math.prod(len(some) + 1 for some in spots)
        layers = _ideals(before, MOST_STATES // positions)
        if not wanted or layers is None:
            return None
        tasks = [work.tasks[t] for t in wanted]
        return _Programme(work.routes, tasks, before, layers, [sorted(some) for some in spots])

    def least(self, over: Callable[[], bool]) -> int | None:
        """Return the least total time of all travellers, ``None`` if there is no way or no time."""
        shape = [len(some) + 1 for some in self.spots]
        steps = [list(self._steps(task)) for task in self.tasks]
        start = np.full(shape, INFINITE)
        start[(0,) * len(shape)] = 0
        tables = {0: start}
        for layer in self.layers[1:]:
            if over():
                return None
            following = {done: np.full(shape, INFINITE) for done in layer}
            for done, table in tables.items():
                for number, needs in enumerate(self.before):
                    if done >> number & 1 or needs & ~done:
                        continue
                    target = following[done | 1 << number]
                    for axis, index, costs in steps[number]:
                        best = (table + costs).min(axis=axis)
                        where = (slice(None),) * axis + (index,)
                        target[where] = np.minimum(target[where], best)
            tables = following
        (table,) = tables.values()
        for axis, (route, some) in enumerate(zip(self.routes, self.spots, strict=True)):
            table = table + self._along(axis, [0, *(way_back(route, p) for p in some)])
        least = int(table.min())
        return least if least < INFINITE else None

    def _steps(self, task: Task) -> Iterator[tuple[int, int, Any]]:
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


# -- what has to be squeezed in ----------------------------------------------------------------
def _needed(model: ScheduleModel, work: Work) -> list[list[Task]]:
    """Return sets of tasks of each of which one has to be done, though nobody wants it by itself:
    what opens the doors on the only ways to what is wanted. The sets have no task in common.
    """
    wanted: dict[tuple[Key, frozenset[int]], None] = {}
    for task in work.tasks:
        if task.wanted:
            common: set[tuple[Key, frozenset[int]]] | None = None
            for route_number, _, places in task.ways:
                route = work.routes[route_number]
                for place in places:
                    entries = () if place == route.initial else route.entries.get(place, ())
                    mine = {(e.state, e.allowed) for e in entries}
                    common = mine if common is None else common & mine
            wanted.update(dict.fromkeys(sorted(common or (), key=str)))
    owners = {name: i for i, task in enumerate(work.tasks) for _, name, _ in task.ways}
    found, taken = [], set[int]()
    for key, allowed in wanted:
        state = model.states.vars[key]
        if state.numeric or state.initial in allowed:
            continue
        tasks: set[int] | None = set()
        for write in state.writes:
            if write.value.terms or write.value.const in allowed:
                name = "" if write.owner is None else model.states.activity(write.owner).name
                tasks = None if tasks is None or name not in owners else tasks | {owners[name]}
        if tasks and not tasks & taken and not any(work.tasks[t].wanted for t in tasks):
            taken |= tasks
            found.append([work.tasks[t] for t in sorted(tasks)])
    return found


def _squeezed(work: Work, tasks: list[Task]) -> int:
    """Return the least time that one of ``tasks`` adds to a route, wherever it comes in it."""
    least = INFINITE
    for task in tasks:
        for route_number, stop, places in task.ways:
            route = work.routes[route_number]
            own = {name for t in tasks for _, name, _ in t.ways}
            spots = {p for name, some in route.stops if name not in own for p in some}
            spots.add(route.initial)
            late = max((route.step - route.rest(s) for s, _ in route.stops), default=0)
            for place in places:
                around = min(_detours(route, stop, place, spots, late), default=INFINITE)
                least = min(least, task.length + max(0, around))
    return 0 if least >= INFINITE else least


def _detours(route: Route, stop: str, place: int, spots: set[int], late: int) -> Iterator[int]:
    """Yield how much longer a route is by ``place`` between any two places, or in the end."""
    for a in spots:
        coming = cost(route, a, place, stop, first=True)
        if coming >= INFINITE:
            continue
        yield coming + way_back(route, place) - way_back(route, a)
        for b in spots:
            going = route.travel.get((place, b), INFINITE)
            direct = route.travel.get((a, b), INFINITE)
            if going < INFINITE and direct < INFINITE:
                yield coming + going + route.gap - late - direct
