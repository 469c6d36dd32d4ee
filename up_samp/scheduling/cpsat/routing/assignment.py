"""A lower bound for large fleets: who does which tasks, with times left out.

Each traveller does its tasks in some order; before each of them it comes from another one, or from
its start, which only the first one can. So they take at least what each task needs from the nearest
other one (one of them: from the start), and the way back of one. From that follows which sets of
tasks one traveller can do by a given time; if the sets of all cannot cover the tasks, no schedule
ends by then (set covering, by CP-SAT). The first end that is not refuted is a bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ortools.sat.python import cp_model

from up_samp.scheduling.cpsat.routing.dispatch import Work
from up_samp.scheduling.cpsat.routing.programme import cost, way_back
from up_samp.scheduling.cpsat.routing.route import INFINITE, Route
from up_samp.scheduling.cpsat.tuning import BoundsTuning


@dataclass(frozen=True)
class Share:
    """What one task costs one traveller: ``first`` if it comes from its start, ``later`` if not,
    and the way ``back`` if it is the last one.
    """

    first: int
    later: int
    back: int

    def plus(self, length: int) -> Share:
        """Return the share with the task's own length."""
        return Share(
            min(INFINITE, self.first + length), min(INFINITE, self.later + length), self.back
        )

    @property
    def base(self) -> int:
        """What it costs if it is not the first one (or, where it has to be that, as the first)."""
        return self.later if self.later < INFINITE else self.first

    @property
    def start(self) -> int:
        """What it costs beside that if it is the first one; mostly less than nothing."""
        return self.first - self.base if self.first < INFINITE else 0

    @property
    def least(self) -> int:
        """What it costs alone."""
        return self.first + self.back if self.first < INFINITE else self.later + self.back

    @property
    def most(self) -> int:
        """The greatest time that is possible."""
        return max(c for c in (self.first, self.later) if c < INFINITE) + self.back


def shares(work: Work) -> list[dict[int, Share]]:
    """Return, for each wanted task, what it costs each traveller that can do it."""
    wanted = [task for task in work.tasks if task.wanted]
    spots: dict[int, list[tuple[int, int]]] = {}
    for number, task in enumerate(wanted):
        for route, _, places in task.ways:
            spots.setdefault(route, []).extend((number, place) for place in places)
    found = []
    for number, task in enumerate(wanted):
        mine: dict[int, Share] = {}
        for axis, stop, places in task.ways:
            share = _share(work.routes[axis], stop, places, number, spots[axis])
            if share is not None:
                mine[axis] = share.plus(task.length)
        found.append(mine)
    return found


def _share(
    route: Route, stop: str, places: frozenset[int], number: int, spots: list[tuple[int, int]]
) -> Share | None:
    first = min(cost(route, route.initial, place, stop, first=True) for place in places)
    later = min(
        (
            cost(route, here, place, stop, first=False)
            for place in places
            for other, here in spots
            if other != number
        ),
        default=INFINITE,
    )
    if min(first, later) >= INFINITE:
        return None
    return Share(first, later, min(way_back(route, place) for place in places))


def bound_by_assignment(
    work: Work,
    known: int,
    over: Callable[[], bool] = lambda: False,
    tuning: BoundsTuning | None = None,
) -> int:
    """Return a lower bound on the makespan, at least ``known``: the first that is not refuted, or
    less if the time is ``over``.

    Assumes: a traveller comes to each task from its start or from another task that is done.
    """
    tuning = tuning or BoundsTuning()
    costs = shares(work)
    if not costs or any(not mine for mine in costs):
        return known
    most = max(known, sum(max(share.most for share in mine.values()) for mine in costs))
    low = max(known, max(min(s.least for s in mine.values()) for mine in costs))
    step = 1
    while low < most and not over() and _refuted(costs, low + step - 1, tuning):
        low, step = low + step, 2 * step
    high = low + step - 1
    while low < high and not over():
        middle = (low + high - 1) // 2
        if _refuted(costs, middle, tuning):
            low = middle + 1
        else:
            high = middle
    return low


def _refuted(costs: list[dict[int, Share]], end: int, tuning: BoundsTuning) -> bool:
    """Return whether it is proven that the travellers cannot share all tasks and end by ``end``.

    Whoever does some tasks by then does one of the sets that are possible and as large as can be.
    """
    model = cp_model.CpModel()
    done: list[list[cp_model.IntVar]] = [[] for _ in costs]
    count = 0
    for axis in sorted({axis for mine in costs for axis in mine}):
        sets = _possible(costs, axis, end, tuning.sets - count)
        if sets is None:
            return False
        count += len(sets)
        chosen = []
        for some in sets:
            chosen.append(model.new_bool_var(""))
            for task in some:
                done[task].append(chosen[-1])
        model.add_at_most_one(chosen)
    for options in done:
        model.add_bool_or(options)
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    solver.parameters.linearization_level = 2
    solver.parameters.max_deterministic_time = tuning.cover
    return bool(solver.solve(model) == cp_model.INFEASIBLE)


def _possible(
    costs: list[dict[int, Share]], axis: int, end: int, most: int
) -> list[frozenset[int]] | None:
    """Return the sets of tasks that one traveller may do by ``end``, but for parts of others;
    ``None`` if there are more than ``most``.
    """
    mine = [(task, some[axis]) for task, some in enumerate(costs) if axis in some]
    start = min((s.start for _, s in mine), default=0)
    back = min((s.back for _, s in mine), default=0)
    found: list[frozenset[int]] = []

    def extend(since: int, some: list[tuple[int, Share]], total: int) -> bool:
        if some:
            ends = min(s.start for _, s in some) + min(s.back for _, s in some)
            if total + ends <= end:
                found.append(frozenset(task for task, _ in some))
                if len(found) > most:
                    return False
        for index in range(since, len(mine)):
            longer = total + mine[index][1].base
            possible = longer + start + back <= end
            if possible and not extend(index + 1, [*some, mine[index]], longer):
                return False
        return True

    if not extend(0, [], 0):
        return None
    known, tasks = set(found), [task for task, _ in mine]
    return [s for s in found if not any(t not in s and s | {t} in known for t in tasks)]
