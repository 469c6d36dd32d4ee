"""What a sequence of tasks has to obey: who may do what where, precedences, changes, ways left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.routing.dispatch import Work
from up_samp.scheduling.cpsat.routing.programme import Programme, way_back
from up_samp.scheduling.cpsat.routing.ways import Ways


@dataclass(frozen=True)
class Choice:
    """A task as one traveller does it at one place (by its number). ``late``: time by which it
    may begin before the move there is seen to have ended. ``spot``: the place in tables. ``back``:
    time from its end to that of everything, if it is the last one.
    """

    task: int
    traveller: int
    place: int
    spot: int
    late: int
    back: int


@dataclass(frozen=True)
class Change:
    """What a task changes at ``delay`` from its start. ``still`` has (a, b) of each traveller whose
    moves end by then - b, or begin at then - a or later: ``slack`` from the task's start at most.
    ``shut`` are, for each place of these, bits of the tasks that must have started before for
    anybody to have come there.
    """

    delay: int
    slack: int
    still: dict[int, tuple[int, int]]
    shut: dict[int, Any]


def choices_of(programme: Programme, ways: list[Ways]) -> list[Choice]:
    """Return all ways to do all tasks of a programme."""
    return [
        Choice(
            number,
            axis,
            ways[axis].number[place],
            1 + programme.spots[axis].index(place),
            programme.routes[axis].step - programme.routes[axis].rest(stop),
            way_back(programme.routes[axis], place),
        )
        for number, task in enumerate(programme.tasks)
        for axis, stop, places in task.ways
        for place in sorted(places)
    ]


def waits_of(work: Work, programme: Programme) -> tuple[Any, Any]:
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


def tails_of(programme: Programme, ordered: Any) -> list[int]:
    """Return the least time from each task's start to the end of what has to start after it."""
    tails = [task.length for task in programme.tasks]
    for _ in tails:
        for task, needs in enumerate(programme.before):
            for earlier in range(len(tails)):
                if needs >> earlier & 1:
                    tails[earlier] = max(tails[earlier], int(ordered[earlier, task]) + tails[task])
    return tails


def change_of(programme: Programme, ways: list[Ways], number: int) -> Change | None:
    """Return what a task changes while moves of others keep it as it is: the most of them."""
    found: list[Change] = []
    for key, delay in programme.tasks[number].stirs:
        still = {a: r.still[key] for a, r in enumerate(programme.routes) if key in r.still}
        shut = {
            axis: np.array(
                [_shut(programme, ways[axis], p, delay - last) for p in ways[axis].places]
            )
            for axis, (_, last) in still.items()
        }
        slack = max((delay - first for first, _ in still.values()), default=0)
        found.append(Change(delay, max(0, slack), still, shut))
    return max(found, key=lambda change: len(change.still), default=None)


def _shut(programme: Programme, ways: Ways, place: int, latest: int) -> int:
    """Return the tasks (bits) that have to start before one at whose start + ``latest`` somebody
    has come to a place: what opens the way there, if it cannot be later.
    """
    route, bits = ways.route, 0
    if place == route.initial:
        return 0
    for entry in route.entries.get(place, ()):
        for number, task in enumerate(programme.tasks):
            delays = [d for k, _, d in task.changes if k == entry.state]
            if task.opens == entry.state and delays[0] > latest + route.step - entry.lead:
                bits |= 1 << number
    return bits


def left_of(choices: list[Choice], ways: list[Ways], sets: Any) -> Any:
    """Return, for each set of tasks and traveller, bits of the direct moves from places where work
    is left, and of those to such places.
    """
    left = np.zeros((len(sets), len(ways), 2), dtype=np.int64)
    for choice in choices:
        rows = sets >> choice.task & 1 == 0
        hop = ways[choice.traveller].hop
        left[rows, choice.traveller, 0] |= np.bitwise_or.reduce(hop[choice.place])
        left[rows, choice.traveller, 1] |= np.bitwise_or.reduce(hop[:, choice.place])
    return left
