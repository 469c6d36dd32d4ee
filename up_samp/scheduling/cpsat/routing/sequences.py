"""Proofs that no schedule ends by a given time, over all sequences of tasks.

Tasks are taken in the order of their starts. What is known of a sequence so far is who did which
task last, and the earliest end of each of these; the next task starts after its traveller has come,
no sooner than any task before it, and as much later as precedences and disjunctions with the last
ones ask. (With others they are met: these ended before a last one of their traveller began.) Of
two beginnings with the same tasks done and the same last ones, one with no end later is enough:
labels, as in resource-constrained shortest paths. A beginning that cannot be continued in time,
even if the rest is shared out evenly, is dropped; if none is left, no schedule ends by then (a
destructive lower bound, Klein and Scholl 1999).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from up_samp.scheduling.cpsat.routing.dispatch import Work
from up_samp.scheduling.cpsat.routing.programme import Programme, cost
from up_samp.scheduling.cpsat.routing.route import INFINITE

MOST_LABELS = 100_000
"""Beginnings that all proofs together may look at (some 5 microseconds each)."""

Ends = tuple[int, ...]
Lasts = tuple[int, ...]
"""What each traveller did last: the number of a choice (-1: nothing)."""


@dataclass(frozen=True)
class Choice:
    """A task as one traveller does it at one place. ``since[c]`` is the time from the end of its
    choice c (-1: from the beginning) until it can start.
    """

    task: int
    traveller: int
    spot: int
    length: int
    since: dict[int, int]


@dataclass(frozen=True)
class Sequences:
    """All sequences of tasks, with what is needed to bound them."""

    programme: Programme
    tables: dict[int, Any]
    choices: list[Choice]
    of_task: list[list[int]]
    waits: dict[tuple[int, int], int]
    """(task, later one) -> the least time from start to start."""
    seen: list[int] = field(default_factory=lambda: [0])
    """How many beginnings were looked at."""

    @staticmethod
    def of(work: Work, programme: Programme, tables: dict[int, Any]) -> Sequences:
        """Return the sequences of the tasks of a programme."""
        spots = [
            (number, axis, stop, place)
            for number, task in enumerate(programme.tasks)
            for axis, stop, places in task.ways
            for place in sorted(places)
        ]
        choices: list[Choice] = []
        of_task: list[list[int]] = [[] for _ in programme.tasks]
        for number, axis, stop, place in spots:
            route = programme.routes[axis]
            since = {-1: cost(route, route.initial, place, stop, first=True)}
            for index, (_, other_axis, _, here) in enumerate(spots):
                if other_axis == axis:
                    since[index] = cost(route, here, place, stop, first=False)
            of_task[number].append(len(choices))
            spot = 1 + programme.spots[axis].index(place)
            length = programme.tasks[number].length
            choices.append(Choice(number, axis, spot, length, since))
        return Sequences(programme, tables, choices, of_task, _waits(work, programme))

    def refuted(self, end: int, over: Callable[[], bool]) -> bool:
        """Return whether it is proven that no schedule ends by ``end``."""
        count = len(self.programme.routes)
        labels: dict[tuple[int, Lasts], list[Ends]] = {(0, (-1,) * count): [(0,) * count]}
        for _ in self.programme.tasks:
            following: dict[tuple[int, Lasts], list[Ends]] = {}
            for (done, lasts), some in labels.items():
                if over() or self.seen[0] > MOST_LABELS:
                    return False
                for key, ends in self._continued(done, lasts, some, end):
                    self.seen[0] += 1
                    following.setdefault(key, []).append(ends)
            labels = {key: _undominated(some) for key, some in following.items()}
        return not labels

    def _continued(
        self, done: int, lasts: Lasts, some: list[Ends], end: int
    ) -> Iterator[tuple[tuple[int, Lasts], Ends]]:
        """Yield what may come next within the time."""
        choices = self.choices
        for task, needs in enumerate(self.programme.before):
            if done >> task & 1 or needs & ~done:
                continue
            table = self.tables[done | 1 << task]
            after = [
                (t, self.waits.get((choices[last].task, task), 0) - choices[last].length)
                for t, last in enumerate(lasts)
                if last >= 0
            ]
            for number in self.of_task[task]:
                choice = choices[number]
                since = choice.since[lasts[choice.traveller]]
                if since >= INFINITE:
                    continue
                mine = choice.traveller
                now = (*lasts[:mine], number, *lasts[mine + 1 :])
                rest = table[tuple(choices[c].spot if c >= 0 else 0 for c in now)]
                most = len(lasts) * end - int(rest)
                for ends in some:
                    start = max(ends[mine] + since, *(ends[t] + wait for t, wait in after), 0)
                    finish = start + choice.length
                    if finish <= end and sum(ends) - ends[mine] + finish <= most:
                        key = (done | 1 << task, now)
                        yield key, (*ends[:mine], finish, *ends[mine + 1 :])


def _waits(work: Work, programme: Programme) -> dict[tuple[int, int], int]:
    number = {id(task): k for k, task in enumerate(programme.tasks)}
    found: dict[tuple[int, int], int] = {}
    for task in programme.tasks:
        here = number[id(task)]
        for earlier, gap in (*task.after, *task.opened):
            there = number.get(id(work.tasks[earlier]))
            if there is not None:
                found[there, here] = max(gap, found.get((there, here), 0))
        for other, gap in task.apart:
            there = number.get(id(work.tasks[other]))
            if there is not None:
                least = work.tasks[other].length + gap
                found[there, here] = max(least, found.get((there, here), 0))
    return found


def _undominated(some: list[Ends]) -> list[Ends]:
    """Return the ends of which no other ones are nowhere later."""
    kept: list[Ends] = []
    for ends in sorted(set(some)):
        if not any(all(a <= b for a, b in zip(other, ends, strict=True)) for other in kept):
            kept.append(ends)
    return kept


def raised(sequences: Sequences, known: int, over: Callable[[], bool]) -> int:
    """Return the best lower bound that is proven from ``known`` on: in growing steps, then halves.

    A step too far costs most, so steps grow slowly.
    """
    low, step, most = known, 1, 4 * known + 1000
    while low < most and sequences.refuted(low + step - 1, over):
        low, step = low + step, min(2 * step, max(2, known // 16))
    high = low + step - 1
    while low < high and sequences.seen[0] <= MOST_LABELS and not over():
        middle = (low + high - 1) // 2
        if sequences.refuted(middle, over):
            low = middle + 1
        else:
            high = middle
    return low
