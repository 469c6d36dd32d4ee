"""A lower bound from all the work there is: the least time that travellers need for their tasks.

Tasks are done in some order, by their starts; whoever does the next one comes from where it did
its last one. The least total over all orders that the precedences allow is found by dynamic
programming over (tasks done, where everybody is), after Held and Karp (1962). What has to be done
before a place may be entered (doors) adds what it costs to squeeze it in. Everybody's share ends
by the makespan, so the total by the number of travellers is a bound; travellers that take turns
count as one. Sequences of tasks then prove more (:mod:`.sequences`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from up_samp.scheduling.cpsat.encode.statevars import Key
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.assignment import bound_by_assignment
from up_samp.scheduling.cpsat.routing.dispatch import Work
from up_samp.scheduling.cpsat.routing.lefts import with_lefts
from up_samp.scheduling.cpsat.routing.openings import RoutedTask
from up_samp.scheduling.cpsat.routing.programme import Programme, cost, way_back
from up_samp.scheduling.cpsat.routing.route import INFINITE, Route
from up_samp.scheduling.cpsat.routing.rules import Rules
from up_samp.scheduling.cpsat.routing.sequences import Sequences, raised
from up_samp.scheduling.cpsat.tuning import BoundsTuning


def lanes(model: ScheduleModel, routes: list[Route]) -> list[list[int]]:
    """Return the routes (by number) in groups that take turns: all they do is one at a time.

    Time in which a traveller only waits until its arrival is seen is not shared out, so these do
    not count.

    Assumes: of travellers that take turns, all moves and stops are done one at a time.
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


@dataclass(frozen=True)
class WorkBound:
    """A lower bound on the makespan, and the sequences of tasks that it was found among (``None``:
    they are too many); what the proof of a greater bound failed at is ``found`` there.
    """

    value: int
    sequences: Sequences | None = None


def bound_by_work(
    model: ScheduleModel,
    work: Work,
    known: int = 0,
    over: Callable[[], bool] = lambda: False,
    *,
    value: int = 0,
    tuning: BoundsTuning | None = None,
) -> WorkBound:
    """Return a lower bound on the makespan; of large fleets, by who does what alone.

    Assumes: every wanted task is done by one of its ways, and a traveller is at one place at a
    time.

    :param known: a lower bound.
    :param over: tells that the time is up.
    :param value: the makespan of a schedule (0: there is none); no more is asked for.
    """
    tuning = tuning or BoundsTuning()
    states = tuning.states
    programme = Programme.of(work, states) or Programme.of(work, states, doors=False)
    if programme is None:
        return WorkBound(bound_by_assignment(work, known, over, tuning))
    tables = programme.tables(over)
    if tables is None or programme.start(tables) >= INFINITE:
        return WorkBound(known)
    counted = {id(task) for task in programme.tasks}
    extra = sum(
        _squeezed(work, tasks)
        for tasks in _needed(model, work)
        if not any(id(task) in counted for task in tasks)
    )
    total = programme.start(tables) + extra
    known = max(known, -(-total // len(lanes(model, work.routes))))
    rules = Rules.of(work, programme, tables)
    if rules is None:
        return WorkBound(known)
    labels = tuning.labels
    sequences = Sequences(rules, min(labels, tuning.unaided), tuning=tuning)
    if labels:
        known = raised(sequences.plain(), known, over, value)
        known = raised(sequences, known, over, value)
    if sequences.is_spent and labels > tuning.unaided and not over():
        rules = with_lefts(rules, labels // 2, over, work.lefts, tuning)
        sequences = Sequences(rules, labels, tuning=tuning)
        known = raised(sequences, known, over, value)
    return WorkBound(known, sequences)


# -- what has to be squeezed in ----------------------------------------------------------------
def _needed(model: ScheduleModel, work: Work) -> list[list[RoutedTask]]:
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
            if model.store.never(write.active):
                continue
            if write.value.terms or write.value.const in allowed:
                name = "" if write.owner is None else model.states.activity(write.owner).name
                tasks = None if tasks is None or name not in owners else tasks | {owners[name]}
        if tasks and not tasks & taken and not any(work.tasks[t].wanted for t in tasks):
            taken |= tasks
            found.append([work.tasks[t] for t in sorted(tasks)])
    return found


def _squeezed(work: Work, tasks: list[RoutedTask]) -> int:
    """Return the least time that one of ``tasks`` adds to a route, wherever it comes in it."""
    least = INFINITE
    for task in tasks:
        for route_number, stop, places in task.ways:
            route = work.routes[route_number]
            own = {name for t in tasks for _, name, _ in t.ways}
            stops = [*route.stops, *route.visits]
            spots = {p for name, some in stops if name not in own for p in some}
            spots.add(route.initial)
            late = max((route.step - route.rest(s) for s, _ in stops), default=0)
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
