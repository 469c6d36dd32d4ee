"""The least time that travellers together spend on their tasks, by dynamic programming.

Over (tasks done, where everybody did its last one), after Held and Karp (1962). Times between two
tasks of one traveller hold whatever it does in between.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.routing.dispatch import Work
from up_samp.scheduling.cpsat.routing.openings import RoutedTask
from up_samp.scheduling.cpsat.routing.route import INFINITE, Route


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
    def of(work: Work, most: int, *, doors: bool = True) -> Programme | None:
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

    def tables(self, over: Callable[[], bool], *, anywhere: bool = False) -> dict[int, Any] | None:
        """Return the table of each set; ``None`` if there is no time. ``anywhere``: travellers may
        begin wherever they like.
        """
        shape = [len(some) + 1 for some in self.spots]
        steps = [list(self._steps(task, anywhere=anywhere)) for task in self.tasks]
        end = np.zeros(shape, dtype=np.int64)
        for axis, (route, some) in enumerate(zip(self.routes, self.spots, strict=True)):
            end = end + self._along(axis, [0, *(way_back(route, p) for p in some)])
        tables = {self.layers[-1][0]: end}
        for layer in reversed(self.layers[:-1]):
            for count, done in enumerate(layer):
                if count % 100 == 0 and over():  # a look costs, and some layers are large
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

    def _steps(self, task: RoutedTask, *, anywhere: bool) -> Iterator[tuple[int, int, Any]]:
        """Yield (route, index of the place, costs from everywhere) for all ways to do a task."""
        for axis, stop, places in task.ways:
            route, some = self.routes[axis], self.spots[axis]
            for place in sorted(places):
                costs = [cost(route, route.initial, place, stop, first=True)]
                if anywhere:
                    costs = [route.rest(stop) - route.step]
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
