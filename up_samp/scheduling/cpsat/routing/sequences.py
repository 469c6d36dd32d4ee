"""Proofs that no schedule ends by a given time, over all sequences of tasks.

Tasks are taken in the order of their starts. What is known of a sequence so far (:mod:`.labels`)
is who did which task last, and the earliest end of each of these; the next task starts after its
traveller has come, no sooner than any task before it, and as much later as precedences and
disjunctions with the last ones ask. (With others they are met: these ended before a last one of
their traveller began.) A direct move that happens once is used up, and who needs it again takes a
detour.

What a task changes while moves keep it as it is (a door that opens) finds everybody else at rest:
where it last did something, or where it has come by then. So the task starts at once, or when one
of the others has come to one more place; after it, each is where it may be, and leaves later.

Of two beginnings with the same tasks done and the same last ones, one with no end later is enough:
labels, as in resource-constrained shortest paths. A beginning that cannot be continued in time,
even if the rest is shared out evenly, is dropped; if none is left, no schedule ends by then (a
destructive lower bound, Klein and Scholl 1999).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.routing.dispatch import Work
from up_samp.scheduling.cpsat.routing.labels import Labels
from up_samp.scheduling.cpsat.routing.programme import Programme
from up_samp.scheduling.cpsat.routing.route import INFINITE
from up_samp.scheduling.cpsat.routing.rules import (
    Change,
    Choice,
    change_of,
    choices_of,
    left_of,
    tails_of,
    waits_of,
)
from up_samp.scheduling.cpsat.routing.ways import MOST_BITS, Ways

MOST_AT_ONCE = 200_000
"""Beginnings that are looked at before the clock is."""
NEARBY = 24
"""Beginnings that each is compared with."""


@dataclass(frozen=True)
class Sequences:
    """All sequences of tasks, with what is needed to bound them."""

    programme: Programme
    ways: list[Ways]
    choices: list[Choice]
    changes: list[Change | None]
    """Of each task."""
    waits: Any
    """From the start of each task to that of each later one, at least."""
    tails: list[int]
    """From the start of each task to the end of all that has to come after it, at least."""
    sets: Any
    """All sets of tasks that may be done (bits), in order."""
    rests: Any
    """A row for each of them: the least time that is left, for all positions of the travellers."""
    shape: tuple[int, ...]
    left: Any
    """(set, traveller, 2): bits of the direct moves from and to places where work is left."""
    most: int
    """How many beginnings all proofs together may look at (some 10 microseconds each)."""
    seen: list[int] = field(default_factory=lambda: [0])
    """How many were looked at."""
    found: list[int] = field(default_factory=list)
    """The choices of the sequence that the last end was not refuted for."""

    @staticmethod
    def of(work: Work, programme: Programme, tables: dict[int, Any], most: int) -> Sequences | None:
        """Return the sequences of the tasks of a programme; ``None`` if they are too many."""
        ways = [Ways.of(r, axis, programme.tasks) for axis, r in enumerate(programme.routes)]
        if max(len(programme.tasks), *(len(w.places) for w in ways)) > MOST_BITS:
            return None
        choices = choices_of(programme, ways)
        ordered, waits = waits_of(work, programme)
        sets = np.array(sorted(tables), dtype=np.int64)
        rests = np.stack([tables[int(done)].ravel() for done in sets])
        return Sequences(
            programme,
            ways,
            choices,
            [change_of(programme, ways, number) for number in range(len(programme.tasks))],
            waits,
            tails_of(programme, ordered),
            sets,
            rests,
            tables[0].shape,
            left_of(choices, ways, sets),
            most,
        )

    def plain(self) -> Sequences:
        """Return the same with no regard to changes and to moves that happen once: it bounds less,
        but its labels are fewer, and go further where they are too many. It may look at a fifth.
        """
        ways = [replace(w, hop=0 * w.hop, leading=0 * w.leading) for w in self.ways]
        nothing: list[Change | None] = [None] * len(self.changes)
        most = self.most // 5
        return replace(self, ways=ways, changes=nothing, most=most, seen=[0], found=[])

    # -- proofs --------------------------------------------------------------------------------
    def refuted(self, end: int, over: Callable[[], bool]) -> bool:
        """Return whether it is proven that no schedule ends by ``end``."""
        layers = [Labels.first([w.number[w.route.initial] for w in self.ways])]
        for _ in self.programme.tasks:
            following: list[Labels] = []
            labels = layers[-1].numbered()
            for start in range(0, len(labels), MOST_AT_ONCE):
                some = labels.rows(slice(start, start + MOST_AT_ONCE))
                for choice in range(len(self.choices)):
                    if over() or self.seen[0] > self.most:
                        return False
                    more = [found for found in self._continued(some, choice, end) if len(found)]
                    self.seen[0] += sum(map(len, more))
                    following += more
            if not following:
                return True
            layers.append(Labels.joined(following).undominated(NEARBY, over))
        self.found[:] = self._path(layers)
        return False

    def _path(self, layers: list[Labels]) -> list[int]:
        """Return the choices that led to the label that ends first, in their order."""
        row = int(np.argmin(layers[-1].free.max(1)))
        path = []
        for before, after in reversed(list(itertools.pairwise(layers))):
            parent = int(after.parent[row])
            done = int(after.done[row]) & ~int(before.done[parent])
            path += [c for c in after.last[row] if c >= 0 and 1 << self.choices[c].task == done]
            row = parent
        return path[::-1]

    def _continued(self, labels: Labels, number: int, end: int) -> Iterator[Labels]:
        """Yield the labels of what goes on with a choice, as far as that may end in time."""
        choice = self.choices[number]
        needs = self.programme.before[choice.task]
        bit = 1 << choice.task
        labels = labels.rows(((labels.done & bit) == 0) & ((needs & ~labels.done) == 0))
        if not len(labels):
            return
        latest = self._latest(labels, number, end)
        for arrival, used in self._arrivals(labels, choice):
            start = np.maximum(arrival, self._soonest(labels, choice.task))
            good = start <= latest
            some = replace(labels.rows(good), used=used[good])
            for starts, more in self._undisturbed(some, start[good], choice, latest[good]):
                found = self._done(more, starts, number)
                yield found.rows(self._in_time(found, end))

    def _latest(self, labels: Labels, number: int, end: int) -> Any:
        """Return when a choice has to start at the latest."""
        choice = self.choices[number]
        length, tail = self.programme.tasks[choice.task].length, self.tails[choice.task]
        last = labels.last.copy()
        last[:, choice.traveller] = number
        shared = self._spent(labels)
        shared[:, choice.traveller] = length
        shared = shared.sum(1) + self._rest(labels.done | 1 << choice.task, last)
        return np.minimum(end - max(tail, length + choice.back), len(self.ways) * end - shared)

    def _arrivals(self, labels: Labels, choice: Choice) -> Iterator[tuple[Any, Any]]:
        """Yield when a choice's traveller may be there, and which moves are used up then."""
        axis, place = choice.traveller, choice.place
        ways, here = self.ways[axis], self._places(labels, axis)
        leave = labels.leave[:, axis]
        arrival = self._reached(labels, axis, [place])[:, 0] - choice.late
        arrival = np.where(here == place, np.minimum(labels.free[:, axis], leave), arrival)
        hop = np.where(labels.spots[:, axis] == 1 << here, ways.hop[here, place], 0)
        done = np.searchsorted(self.sets, labels.done | 1 << choice.task)
        left = self.left[done, axis, 1] & (self.left[done, axis, 0] | ways.leading[place])
        taken = hop & labels.used[:, axis] != 0
        used = labels.used.copy()
        used[:, axis] = (used[:, axis] | hop) & left
        yield np.where(taken, INFINITE, arrival), used
        spared = taken | (hop & left != 0)
        if spared.any():
            used = labels.used.copy()
            used[:, axis] &= left
            detour = leave + ways.detour[here, place] - choice.late
            yield np.where(spared, detour, INFINITE), used

    def _places(self, labels: Labels, axis: int) -> Any:
        """Return where a traveller did its last task (at the beginning: where it is)."""
        initial = self.ways[axis].number[self.ways[axis].route.initial]
        places = np.array([*(c.place for c in self.choices), initial])
        return places[labels.last[:, axis]]

    def _reached(self, labels: Labels, axis: int, places: list[int]) -> Any:
        """Return when a traveller may be at each of ``places`` and go on, unless it is there by
        the way.
        """
        travel = self.ways[axis].travel[:, places]
        spots, leave = labels.spots[:, axis], labels.leave[:, axis]
        costs = travel[self._places(labels, axis)]
        found = leave[:, None] + costs
        several = np.flatnonzero(spots & (spots - 1))
        if not len(several):
            return found
        for spot in range(len(travel)):
            rows = several[spots[several] >> spot & 1 != 0]
            found[rows] = np.minimum(found[rows], leave[rows, None] + travel[spot])
        there = spots[several, None] >> np.array(places) & 1 != 0
        sooner = labels.free[several, axis, None] + costs[several]
        found[several] = np.where(there, np.minimum(found[several], sooner), found[several])
        return found

    def _soonest(self, labels: Labels, task: int) -> Any:
        """Return when a task may start, after the last ones of all travellers."""
        tasks = np.array([*(c.task for c in self.choices), 0])
        lengths = np.array([t.length for t in self.programme.tasks])
        soonest = np.zeros(len(labels), dtype=np.int64)
        for axis, route in enumerate(self.programme.routes):
            last = tasks[labels.last[:, axis]]
            since = labels.free[:, axis] - route.gap - lengths[last] + self.waits[last, task]
            soonest = np.maximum(soonest, np.where(labels.last[:, axis] >= 0, since, 0))
        return soonest

    def _undisturbed(
        self, labels: Labels, start: Any, choice: Choice, latest: Any
    ) -> Iterator[tuple[Any, Labels]]:
        """Yield starts, with labels of where everybody else is at rest when something changes."""
        change = self.changes[choice.task]
        others = [axis for axis in change.still if axis != choice.traveller] if change else []
        if change is None or not others or not len(labels):
            yield start, labels
            return
        needed = {axis: self._needed(labels, change, axis) for axis in others}
        rows, starts = [np.arange(len(labels))], [start]
        for since in needed.values():
            row, place = np.nonzero((since > start[:, None]) & (since <= latest[:, None]))
            rows.append(row)
            starts.append(since[row, place])
        span = int(latest.max()) + 1
        row, start = np.divmod(
            np.unique(np.concatenate(rows) * span + np.concatenate(starts)), span
        )
        labels = labels.rows(row)
        leave, spots, ahead = labels.leave.copy(), labels.spots.copy(), labels.ahead.copy()
        for axis in others:
            leaves = start + change.delay - change.still[axis][0]
            there = needed[axis][row] <= start[:, None]
            bits = (there << np.arange(there.shape[1])).sum(1)
            far = self.ways[axis].travel[self._places(labels, axis)]
            farthest = np.where(there, far, 0).max(1)
            rests = leave[:, axis] < leaves
            spots[rests, axis], ahead[rests, axis] = bits[rests], farthest[rests]
            leave[rests, axis] = leaves[rests]
        yield start, replace(labels, leave=leave, spots=spots, ahead=ahead)

    def _needed(self, labels: Labels, change: Change, axis: int) -> Any:
        """Return how late a change's task has to start for a traveller to rest at each place."""
        ways = self.ways[axis]
        places = np.arange(len(ways.places))
        since = self._reached(labels, axis, list(places)) - ways.route.step
        since += change.still[axis][1] - change.delay
        shut = (change.shut[axis] & ~labels.done[:, None]) != 0
        there = labels.spots[:, axis, None] >> places & 1 != 0
        return np.where(there, -INFINITE, np.where(shut, INFINITE, since))

    def _done(self, labels: Labels, start: Any, number: int) -> Labels:
        """Return the labels after a choice."""
        choice = self.choices[number]
        axis = choice.traveller
        length, gap = self.programme.tasks[choice.task].length, self.programme.routes[axis].gap
        found = replace(
            labels,
            done=labels.done | 1 << choice.task,
            last=labels.last.copy(),
            free=labels.free.copy(),
            leave=labels.leave.copy(),
            spots=labels.spots.copy(),
            ahead=labels.ahead.copy(),
        )
        found.last[:, axis], found.spots[:, axis] = number, 1 << choice.place
        found.free[:, axis] = found.leave[:, axis] = start + length + gap
        found.ahead[:, axis] = 0
        return found

    def _in_time(self, labels: Labels, end: int) -> Any:
        """Return which labels can be continued in time, even if the rest is shared out evenly."""
        rest = self._rest(labels.done, labels.last)
        return self._spent(labels).sum(1) + rest <= len(self.ways) * end

    def _spent(self, labels: Labels) -> Any:
        """Return how much of its time each traveller has spent when it did its last task; what it
        waits for others before it can go on is spent, too.
        """
        gaps = np.array([route.gap for route in self.programme.routes])
        slack = max((c.slack for c in self.changes if c is not None), default=0)
        spent = np.maximum(labels.free, labels.leave - slack - labels.ahead)
        return spent - np.where(labels.last >= 0, gaps, 0)

    def _rest(self, done: Any, last: Any) -> Any:
        """Return the least time that is left for all travellers together."""
        spots = np.array([*(c.spot for c in self.choices), 0])
        where = np.ravel_multi_index(tuple(spots[last].T), self.shape)
        return self.rests[np.searchsorted(self.sets, done), where]


def raised(sequences: Sequences, known: int, over: Callable[[], bool]) -> int:
    """Return the best lower bound that is proven from ``known`` on: in growing steps, then halves.

    Each unit may double the effort, so steps are short.
    """
    low, step, most = known, 1, 4 * known + 1000
    while low < most and sequences.refuted(low + step - 1, over):
        low, step = low + step, min(2 * step, max(1, known // 40))
    high = low + step - 1
    while low < high and sequences.seen[0] <= sequences.most and not over():
        middle = (low + high - 1) // 2
        if sequences.refuted(middle, over):
            low = middle + 1
        else:
            high = middle
    return low
