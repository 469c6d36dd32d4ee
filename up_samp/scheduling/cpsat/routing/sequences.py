"""Proofs that no schedule ends by a given time, over all sequences of tasks.

Tasks are taken in the order of their starts. What is known of a sequence so far (a label)
is who did which task last, and the earliest end of each of these; the next task starts after its
traveller has come, no sooner than any task before it, and as much later as precedences and
disjunctions with the last ones ask. (With others they are met: these ended before a last one of
their traveller began.)

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
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from up_samp.model import Deadline
from up_samp.scheduling.cpsat.encode.terms import INFINITE
from up_samp.scheduling.cpsat.routing.rules import NEVER, SequenceChoice, SequenceRules, StateChange

# ------------------ Labels
# Partial sequences of tasks, many at once, as arrays with a row each, and how they are extended.


@dataclass(frozen=True)
class LabelTable:
    """Labels in rows; columns are travellers but for ``done`` and ``parent``.

    ``done``: bits of the tasks. ``last``: the number of what it did last, as one traveller at one
    place (-1: nothing). ``free``: when it can do something again, where that was. ``ready`` (for
    each place, too): when it can do something there, or go on from there. Both are lower bounds.
    ``own``: what it carries and has set (a number, see :mod:`.own_states`).
    ``parent``: the row that it was made from, among the labels with one task less.
    """

    done: Any
    last: Any
    free: Any
    ready: Any
    own: Any
    parent: Any

    def __len__(self) -> int:
        return len(self.done)

    @staticmethod
    def first(ready: Any) -> LabelTable:
        """Return the one label of the beginning, where nothing is done: a row of ``ready`` for each
        traveller.
        """
        count = len(ready)
        zero = np.zeros((1, count), dtype=np.int64)
        nothing = np.full((1, count), -1, dtype=np.int64)
        none = np.zeros(1, dtype=np.int64)
        return LabelTable(none, nothing, zero, ready[None], zero, none)

    def rows(self, which: Any) -> LabelTable:
        """Return some of the labels (numbers or a mask)."""
        return LabelTable(*(column[which] for column in self._columns()))

    def _columns(self) -> tuple[Any, ...]:
        return self.done, self.last, self.free, self.ready, self.own, self.parent

    def numbered(self) -> LabelTable:
        """Return the labels as parents of those that are made from them."""
        return replace(self, parent=np.arange(len(self)))

    def bare(self) -> LabelTable:
        """Return the labels without what only those that are made from them need."""
        none = np.zeros((len(self), 0), dtype=np.int64)
        return replace(self, ready=none)

    @staticmethod
    def joined(some: list[LabelTable]) -> LabelTable:
        """Return the labels of several sets of them."""
        columns = zip(*(labels._columns() for labels in some), strict=True)
        return LabelTable(*(np.concatenate(column) for column in columns))

    def undominated(self, deadline: Deadline = Deadline.never()) -> LabelTable:
        """Return the labels without those that another one is at least as good as: the same is
        done by the same, who carry the same, nothing later, nobody further on its way.

        Each is compared with a few ones before it in an order in which better ones come first, so
        some that are dominated may be left; more of them, if the ``deadline`` comes.
        """
        sums = self.free.sum(1) + self.ready.sum((1, 2), dtype=np.int64)
        mine = self.rows(np.lexsort((sums, *self.own.T, *self.last.T, self.done)))
        return mine.rows(~mine._worse(deadline))

    def _worse(self, deadline: Deadline) -> Any:
        """Return which rows are dominated by one that is a few rows before (24 at most)."""
        worse = np.zeros(len(self), dtype=bool)
        same = (self.done[1:] == self.done[:-1]) & (self.last[1:] == self.last[:-1]).all(1)
        same &= (self.own[1:] == self.own[:-1]).all(1)
        group = np.concatenate(([0], np.cumsum(~same)))
        for shift in range(1, min(25, len(self))):
            near = group[shift:] == group[:-shift]
            a = np.flatnonzero(near & ~worse[shift:])
            if deadline.expired() or not near.any():
                break
            b = a + shift
            better = (self.free[a] <= self.free[b]).all(1)
            a, b = a[better], b[better]
            worse[b[(self.ready[a] <= self.ready[b]).all((1, 2))]] = True
        return worse


# ------------------ From beginnings of sequences of tasks to those that are longer by a task


@dataclass(frozen=True)
class Steps:
    """Steps by the ``rules`` in schedules that end by ``end``."""

    rules: SequenceRules
    end: int

    def beginning(self) -> LabelTable:
        """Return the one label of the beginning: everybody is at its place, and nothing is done."""
        ready = [w.travel[w.number[w.route.initial]] for w in self.rules.ways]
        return LabelTable.first(np.stack(ready))

    def continued(self, labels: LabelTable, number: int) -> Iterator[LabelTable]:
        """Yield the labels of what goes on with a choice, as far as that may end in time."""
        choice = self.rules.choices[number]
        needs = self.rules.programme.before[choice.task]
        bit = 1 << choice.task
        able = self.rules.own[labels.own[:, choice.traveller], number] >= 0
        labels = labels.rows(able & ((labels.done & bit) == 0) & ((needs & ~labels.done) == 0))
        if not len(labels):
            return
        latest = self._latest(labels, number)
        start = np.maximum(self._arrival(labels, choice), self._soonest(labels, choice.task))
        good = start <= latest
        some = labels.rows(good)
        for starts, more in self._undisturbed(some, start[good], choice, latest[good]):
            found = self._done(more, starts, number)
            yield found.rows(self._in_time(found))

    def _latest(self, labels: LabelTable, number: int) -> Any:
        """Return when a choice has to start at the latest."""
        choice = self.rules.choices[number]
        length, tail = self.rules.lengths[number], self.rules.tails[choice.task]
        last = labels.last.copy()
        last[:, choice.traveller] = number
        shared = self.spent(labels)
        shared[:, choice.traveller] = length
        shared = shared.sum(1) + self.rules.rest(labels.done | 1 << choice.task, last)
        own = self.end - max(tail, length + choice.back)
        for until, queue in self.rules.queues[choice.task]:
            left = sum(lasts * ((labels.done & bit) == 0) for bit, lasts in queue.items())
            own = np.minimum(own, self.end - until - left)
        return np.minimum(own, labels.last.shape[1] * self.end - shared)

    def _arrival(self, labels: LabelTable, choice: SequenceChoice) -> Any:
        """Return when a choice's traveller may be there."""
        axis, place = choice.traveller, choice.place
        arrival = labels.ready[:, axis, place]
        stays = self._places(labels, axis) == place
        stays &= arrival == labels.free[:, axis]
        return np.where(stays, arrival, arrival - choice.late)

    def _places(self, labels: LabelTable, axis: int) -> Any:
        """Return where a traveller did its last task (at the beginning: where it is)."""
        return self.rules.places[axis][labels.last[:, axis]]

    def _soonest(self, labels: LabelTable, task: int) -> Any:
        """Return when a task may start, after the last ones of all travellers."""
        rules = self.rules
        soonest = np.full(len(labels), rules.programme.tasks[task].release, dtype=np.int64)
        for axis in range(len(rules.ways)):
            last = labels.last[:, axis]
            since = labels.free[:, axis] - rules.gaps[axis] - rules.lengths[last]
            since += rules.waits[rules.tasks[last], task]
            free = labels.free[:, axis]  # since the beginning, where nothing is done
            soonest = np.maximum(soonest, np.where(labels.last[:, axis] >= 0, since, free))
        return soonest

    def _undisturbed(
        self, labels: LabelTable, start: Any, choice: SequenceChoice, latest: Any
    ) -> Iterator[tuple[Any, LabelTable]]:
        """Yield starts, with labels of where everybody else is at rest when something changes."""
        change = self.rules.changes[choice.task]
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
        ready = labels.ready.copy()
        for axis in others:
            there = needed[axis][row] <= start[:, None]
            leaves = start + change.delay - change.still[axis][0]
            ready[:, axis] = self._onwards(labels, axis, there, leaves)
        labels = replace(labels, ready=ready)
        for axis in others:
            self._hand_over_from(labels, axis)
        yield start, labels

    def _hand_over_from(self, labels: LabelTable, axis: int) -> None:
        """Let others come to where a traveller did its last task only after it can have left."""
        for other in range(len(self.rules.ways)):
            if other != axis:
                self._hand_over(labels, axis, other)

    def _hand_over(self, labels: LabelTable, axis: int, other: int) -> None:
        after = self.rules.handovers[axis, self._places(labels, axis), other]
        ready = labels.ready[:, other]
        since = labels.free[:, axis][:, None] + after
        labels.ready[:, other] = np.minimum(np.maximum(ready, since), NEVER)

    def _needed(self, labels: LabelTable, change: StateChange, axis: int) -> Any:
        """Return how late a change's task has to start for a traveller to rest at each place."""
        ready, here = labels.ready[:, axis], self._places(labels, axis)
        since = ready.astype(np.int64) - self.rules.ways[axis].route.step
        since += change.still[axis][1] - change.delay
        shut = (change.shut[axis] & ~labels.done[:, None]) != 0
        since = np.where(shut | (ready >= NEVER), INFINITE, since)
        rows = np.arange(len(labels))
        stays = ready[rows, here] == labels.free[:, axis]
        since[rows[stays], here[stays]] = -INFINITE
        return since

    def _onwards(self, labels: LabelTable, axis: int, there: Any, leaves: Any) -> Any:
        """Return when a traveller is ready where, if it rests at one of the places where it may be
        ``there`` and does not leave before ``leaves``.
        """
        ready = labels.ready[:, axis]
        off = np.where(there, np.maximum(ready, leaves[:, None]), NEVER).astype(ready.dtype)
        found = np.where(there, ready, NEVER)
        for place in np.flatnonzero(there.any(0)):
            rows = np.flatnonzero(there[:, place])
            costs = self.rules.ways[axis].travel[place]
            further = np.minimum(off[rows, place][:, None] + costs, NEVER)
            found[rows] = np.minimum(found[rows], further)
        return np.where(there, ready, found)

    def _done(self, labels: LabelTable, start: Any, number: int) -> LabelTable:
        """Return the labels after a choice."""
        choice = self.rules.choices[number]
        axis = choice.traveller
        length, gap = self.rules.lengths[number], self.rules.gaps[axis]
        found = replace(
            labels,
            done=labels.done | 1 << choice.task,
            last=labels.last.copy(),
            free=labels.free.copy(),
            ready=labels.ready.copy(),
            own=labels.own.copy(),
        )
        found.last[:, axis] = number
        found.own[:, axis] = self.rules.own[labels.own[:, axis], number]
        free = start + length + gap
        found.free[:, axis] = free
        costs = self.rules.ways[axis].travel[choice.place]
        found.ready[:, axis] = np.minimum(free[:, None] + costs, NEVER)
        for other, place, delay in self.rules.doors[choice.task]:
            found.ready[:, other, place] = np.maximum(found.ready[:, other, place], start + delay)
        self._hand_over_from(found, axis)
        for other in range(len(self.rules.ways)):
            if other != axis:
                self._hand_over(found, other, axis)
        return found

    def _in_time(self, labels: LabelTable) -> Any:
        """Return which labels can be continued in time, even if the rest is shared out evenly."""
        total = self.spent(labels).sum(1) + self.rules.rest(labels.done, labels.last)
        return total <= labels.last.shape[1] * self.end

    def spent(self, labels: LabelTable) -> Any:
        """Return how much of its time each traveller has spent when it did its last task."""
        gaps = np.where(labels.last >= 0, self.rules.gaps, 0)
        return np.minimum(labels.free - gaps, self.end)


# ------------------ Proofs over all sequences


Found = list[tuple[int, int]]
"""(choice, start) of the tasks of a sequence, in its order."""


_AT_ONCE = 200_000
"""Beginnings that are looked at before the clock is."""
_PLAIN = 20_000
"""Beginnings that are looked at with no regard to changes."""
_STEEP = 4.0
"""How many times as many beginnings as the last proof the next one may cost..."""
_CHEAP = 2_000
"""...or as this many, which cost next to nothing."""


@dataclass(frozen=True)
class Sequences:
    """All sequences of tasks that obey the ``rules``."""

    rules: SequenceRules
    most: int
    """How many beginnings all proofs together may look at (some 10 microseconds each)."""
    seen: list[int] = field(default_factory=lambda: [0])
    """How many were looked at."""
    found: list[Found] = field(default_factory=list)
    """Sequences that the last end was not refuted for, the one that ends first first."""

    def plain(self) -> Sequences:
        """Return the same with no regard to changes: it bounds less, but its labels are fewer, and
        go further where they are too many. It may look at a few.
        """
        return Sequences(self.rules.plain(), min(self.most, _PLAIN))

    @property
    def is_spent(self) -> bool:
        """Whether all beginnings that may be looked at were."""
        return self.seen[0] > self.most

    def refuted(self, end: int, deadline: Deadline) -> bool:
        """Return whether it is proven that no schedule ends by ``end``."""
        return self._search(end, deadline) is None

    def sought(self, end: int, width: int, deadline: Deadline) -> bool:
        """Look for a sequence that may end by ``end`` among the most promising beginnings of each
        length, ``width`` of them (a beam search); return whether one was ``found``.
        """
        return bool(self._search(end, deadline, width))

    def _search(self, end: int, deadline: Deadline, width: int = 0) -> bool | None:
        """Return whether some sequence may end by ``end``; ``None`` if there is none, ``False`` if
        it was not found out.
        """
        if end >= NEVER:
            return False
        steps = Steps(self.rules, end)
        layers = self._layers(steps, deadline, width)
        if layers is None:
            return False
        labels = layers[-1]
        if not len(labels):
            return None
        # the first one mostly is a schedule
        order = np.argsort(self._ends(labels), kind="stable")[:4]
        self.found[:] = [self._path(layers, int(row)) for row in order]
        return True

    def _layers(self, steps: Steps, deadline: Deadline, width: int) -> list[LabelTable] | None:
        """Return the labels with one task more each time, up to those with all tasks or to where
        there are none; ``None`` if they are too many, or time is over.
        """
        layers, labels = [], steps.beginning()
        for _ in range(len(self.rules.programme.tasks)):
            layers.append(labels.bare())
            labels = labels.numbered()
            following: list[LabelTable] = []
            for start in range(0, len(labels), _AT_ONCE):
                some = labels.rows(slice(start, start + _AT_ONCE))
                for choice in range(len(self.rules.choices)):
                    if deadline.expired() or self.is_spent:
                        return None
                    more = [found for found in steps.continued(some, choice) if len(found)]
                    self.seen[0] += sum(map(len, more))
                    following += more
            labels = LabelTable.joined(following) if following else labels.rows([])
            if not len(labels):
                break
            labels = labels.undominated(deadline)
            if 0 < width < len(labels):
                total = steps.spent(labels).sum(1) + self.rules.rest(labels.done, labels.last)
                labels = labels.rows(np.sort(np.argsort(total, kind="stable")[:width]))
        return [*layers, labels]

    def _ends(self, labels: LabelTable) -> Any:
        """Return when everybody is where it has to be in the end."""
        backs = np.array([*(c.back for c in self.rules.choices), 0])
        ends = labels.free - self.rules.gaps + backs[labels.last]
        return np.where(labels.last >= 0, ends, 0).max(1)

    def end(self) -> int:
        """Return when the first sequence ends that was ``found``: the soonest of all, where none
        were left out.
        """
        rules, last, done, rest = self.rules, dict[int, int](), 0, [0]
        for number, start in self.found[0]:
            choice = rules.choices[number]
            last[choice.traveller] = start + int(rules.lengths[number]) + choice.back
            rest.append(start + rules.tails[choice.task])
            for until, queue in rules.queues[choice.task]:
                rest.append(start + until + sum(n for bit, n in queue.items() if not bit & done))
            done |= 1 << choice.task
        return max([*rest, *last.values()])

    def _path(self, layers: list[LabelTable], row: int) -> Found:
        """Return how one of the last labels was come to."""
        rows = [row]
        for after in layers[:0:-1]:
            rows.append(int(after.parent[rows[-1]]))
        path = []
        pairs = zip(itertools.pairwise(layers), itertools.pairwise(rows[::-1]), strict=True)
        for (before, after), (one, other) in pairs:
            axis = int(np.flatnonzero(before.last[one] != after.last[other])[0])
            number = int(after.last[other, axis])
            busy = self.rules.lengths[number] + self.rules.gaps[axis]
            path.append((number, int(after.free[other, axis] - busy)))
        return path


def raised(sequences: Sequences, known: int, deadline: Deadline, value: int = 0) -> int:
    """Return the best lower bound that is proven from ``known`` on, up to the ``value`` of a
    schedule (0: there is none), in steps that cost a few times as much each.
    """
    low, step, high = known, 1, value or 4 * known + 1000
    costs: list[tuple[int, int]] = []
    while low < high and not sequences.is_spent and not deadline.expired():
        end, before = min(low + step, high) - 1, sequences.seen[0]
        if sequences.refuted(end, deadline):
            low = end + 1
            costs.append((end, sequences.seen[0] - before))
            step = _step(costs, sequences.most - sequences.seen[0])
        elif sequences.is_spent or deadline.expired() or not sequences.found:
            break
        else:
            # what is found ends as soon as any does, mostly: to refute one unit less is enough
            high = max(low, min(end, sequences.end()))
            step = high - low
    return low


def _step(costs: list[tuple[int, int]], left: int) -> int:
    """Return by how much more time may be refuted next: ``costs`` are the efforts so far (end,
    labels), ``left`` is what more there may be.
    """
    if len(costs) < 2:
        return 8 if costs[-1][1] < _CHEAP else 1  # the end that is found says how far it was
    (one, few), (other, many) = costs[-2:]
    growth = math.log(max(many, 2) / max(few, 1)) / (other - one)
    dear = min(_STEEP * max(many, _CHEAP), left / 2)
    return max(1, int(math.log(max(1.0, dear / max(many, 1))) / max(growth, 0.05)))
