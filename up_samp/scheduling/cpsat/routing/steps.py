"""From beginnings of sequences of tasks to those that are longer by a task: arrays of labels."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.routing.labels import Labels
from up_samp.scheduling.cpsat.routing.route import INFINITE
from up_samp.scheduling.cpsat.routing.rules import Change, Choice, Rules
from up_samp.scheduling.cpsat.routing.ways import NEVER


@dataclass(frozen=True)
class Steps:
    """Steps by the ``rules`` in schedules that end by ``end``."""

    rules: Rules
    end: int

    def beginning(self, begun: int = 0) -> Labels:
        """Return the one label of the beginning: everybody is at its place, nothing is done but
        what was ``begun`` before.
        """
        ready = [w.travel[w.number[w.route.initial]] for w in self.rules.ways]
        first = Labels.first(self._until(np.stack(ready)))
        return replace(first, done=first.done | begun)

    def _until(self, ready: Any) -> Any:
        """Return when travellers are ready where, and never where moves would end after
        all has to: so more labels are the same.
        """
        seen = max(w.route.step for w in self.rules.ways)
        return np.where(ready > self.end + seen, NEVER, ready)

    def continued(self, labels: Labels, number: int) -> Iterator[Labels]:
        """Yield the labels of what goes on with a choice, as far as that may end in time."""
        choice = self.rules.choices[number]
        needs = self.rules.programme.before[choice.task]
        bit = 1 << choice.task
        labels = labels.rows(((labels.done & bit) == 0) & ((needs & ~labels.done) == 0))
        if not len(labels):
            return
        latest = self._latest(labels, number)
        for arrival, used in self._arrivals(labels, choice):
            start = np.maximum(arrival, self._soonest(labels, choice.task))
            good = start <= latest
            some = replace(labels.rows(good), used=used[good])
            for starts, more in self._undisturbed(some, start[good], choice, latest[good]):
                found = self._done(more, starts, number)
                found = replace(found, spent=self._spent(found))
                yield found.rows(self._in_time(found))

    def _latest(self, labels: Labels, number: int) -> Any:
        """Return when a choice has to start at the latest."""
        choice = self.rules.choices[number]
        length, tail = self.rules.lengths[number], self.rules.tails[choice.task]
        last = labels.last.copy()
        last[:, choice.traveller] = number
        shared = labels.spent.copy()
        shared[:, choice.traveller] = length
        shared = shared.sum(1) + self.rules.rest(labels.done | 1 << choice.task, last)
        own = self.end - max(tail, length + choice.back)
        return np.minimum(own, labels.last.shape[1] * self.end - shared)

    def _arrivals(self, labels: Labels, choice: Choice) -> Iterator[tuple[Any, Any]]:
        """Yield when a choice's traveller may be there, and which moves are used up then."""
        axis, place = choice.traveller, choice.place
        ways, here = self.rules.ways[axis], self._places(labels, axis)
        leave = labels.leave[:, axis]
        arrival = labels.ready[:, axis, place]
        stays = (here == place) & (arrival == labels.free[:, axis])
        hop = np.where(leave >= 0, ways.hop[here, place], 0)
        hop = np.where(stays, 0, hop)
        done = self.rules.row(labels.done | 1 << choice.task)
        origins, goals = self.rules.left[done, axis].T
        left = goals & (origins | ways.leading[place])
        used = labels.used.copy()
        used[:, axis] = (used[:, axis] | hop) & left
        yield np.where(stays, arrival, arrival - choice.late), used
        spared = hop & ~labels.used[:, axis] & left != 0
        if spared.any():
            used = labels.used.copy()
            used[:, axis] &= left
            detour = np.maximum(arrival, leave + ways.detour[here, place]) - choice.late
            yield np.where(spared, detour, NEVER), used

    def _places(self, labels: Labels, axis: int) -> Any:
        """Return where a traveller did its last task (at the beginning: where it is)."""
        initial = self.rules.ways[axis].number[self.rules.ways[axis].route.initial]
        places = np.array([*(c.place for c in self.rules.choices), initial])
        return places[labels.last[:, axis]]

    def _soonest(self, labels: Labels, task: int) -> Any:
        """Return when a task may start, after the last ones of all travellers."""
        tasks = np.array([*(c.task for c in self.rules.choices), 0])
        lengths = np.array([t.length for t in self.rules.programme.tasks])
        soonest = np.zeros(len(labels), dtype=np.int64)
        for axis, route in enumerate(self.rules.programme.routes):
            last = tasks[labels.last[:, axis]]
            since = labels.free[:, axis] - route.gap - lengths[last] + self.rules.waits[last, task]
            soonest = np.maximum(soonest, np.where(labels.last[:, axis] >= 0, since, 0))
        return soonest

    def _undisturbed(
        self, labels: Labels, start: Any, choice: Choice, latest: Any
    ) -> Iterator[tuple[Any, Labels]]:
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
        leave, ready = labels.leave.copy(), labels.ready.copy()
        for axis in others:
            there = needed[axis][row] <= start[:, None]
            leaves = start + change.delay - change.still[axis][0]
            ready[:, axis] = self._onwards(labels, axis, there, leaves)
            here = np.arange(there.shape[1]) == self._places(labels, axis)[:, None]
            alone = (there == here).all(1) & (leave[:, axis] >= 0)
            leave[:, axis] = np.where(alone, np.maximum(leave[:, axis], leaves), -1)
        labels = replace(labels, leave=leave, ready=ready)
        for axis, other in itertools.product(others, range(len(self.rules.ways))):
            if other != axis:
                self._hand_over(labels, axis, other)
        yield start, labels

    def _hand_over(self, labels: Labels, axis: int, other: int) -> None:
        """Let a traveller come where another one did its last task only after that one has left."""
        since = np.maximum(labels.free[:, axis], labels.leave[:, axis])
        after = self.rules.handovers[axis, self._places(labels, axis), other]
        ready = labels.ready[:, other]
        labels.ready[:, other] = np.minimum(np.maximum(ready, since[:, None] + after), NEVER)

    def _needed(self, labels: Labels, change: Change, axis: int) -> Any:
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

    def _onwards(self, labels: Labels, axis: int, there: Any, leaves: Any) -> Any:
        """Return when a traveller is ready where, if it rests at one of the places where it may be
        ``there`` and does not leave before ``leaves``.
        """
        ready = labels.ready[:, axis]
        off = np.where(there, np.maximum(ready, leaves[:, None]), NEVER).astype(ready.dtype)
        found = np.where(there, ready, NEVER)
        for place in np.flatnonzero(there.any(0)):
            rows = np.flatnonzero(there[:, place])
            costs = self._costs(axis, place, labels.used[rows, axis])
            further = np.minimum(off[rows, place][:, None] + costs, NEVER)
            found[rows] = np.minimum(found[rows], further)
        return np.where(there, ready, found)

    def _costs(self, axis: int, place: Any, used: Any) -> Any:
        """Return how far it is to everywhere, with moves used up."""
        ways = self.rules.ways[axis]
        return np.where(ways.hop[place] & used[:, None], ways.detour[place], ways.travel[place])

    def _done(self, labels: Labels, start: Any, number: int) -> Labels:
        """Return the labels after a choice."""
        choice = self.rules.choices[number]
        axis = choice.traveller
        length, gap = self.rules.lengths[number], self.rules.gaps[axis]
        found = replace(
            labels,
            done=labels.done | 1 << choice.task,
            last=labels.last.copy(),
            free=labels.free.copy(),
            leave=labels.leave.copy(),
            ready=labels.ready.copy(),
        )
        found.last[:, axis] = number
        free = start + length + gap
        found.free[:, axis] = found.leave[:, axis] = free
        costs = self._costs(axis, choice.place, labels.used[:, axis])
        found.ready[:, axis] = np.minimum(free[:, None] + costs, NEVER)
        for other, place, delay in self.rules.doors[choice.task]:
            found.ready[:, other, place] = np.maximum(found.ready[:, other, place], start + delay)
        for other in range(len(self.rules.ways)):
            if other != axis:
                self._hand_over(found, axis, other)
                self._hand_over(found, other, axis)
        matters = self.rules.matters[self.rules.row(found.done)]
        return replace(found, ready=self._until(np.where(matters, found.ready, NEVER)))

    def _in_time(self, labels: Labels) -> Any:
        """Return which labels can be continued in time, even if the rest is shared out evenly."""
        total = labels.spent.sum(1) + self.rules.rest(labels.done, labels.last)
        return total <= labels.last.shape[1] * self.end

    def hopeful(self, labels: Labels) -> Labels:
        """Return the labels of which each task that is left may end in time, with all after it, and
        so may all of them once the first one has started.
        """
        front, alive = self._front(labels), np.ones(len(labels), dtype=bool)
        first = np.full(len(labels), NEVER)
        starts: dict[int, Any] = {}
        for task in self.rules.order:
            left = labels.done >> task & 1 == 0
            ways = [c for c in self.rules.choices if c.task == task]
            came = [labels.ready[:, c.traveller, c.place] - c.late for c in ways]
            start = np.maximum(front, np.min(came, axis=0))
            for earlier in starts:
                if self.rules.programme.before[task] >> earlier & 1:
                    start = np.maximum(start, starts[earlier] + self.rules.ordered[earlier, task])
            starts[task] = np.where(left, start, -NEVER)
            alive &= ~left | (start + self.rules.tails[task] <= self.end)
            if not self.rules.aside >> task & 1:
                first = np.where(left, np.minimum(first, start), first)
        lefts = self.rules.lefts[self.rules.row(labels.done)]
        return labels.rows(alive & ((first >= NEVER) | (first + lefts <= self.end)))

    def _spent(self, labels: Labels) -> Any:
        """Return how much of its time each traveller has spent when it did its last task; what it
        waits for others before it can go on is spent, too.
        """
        spent = np.empty(labels.free.shape, dtype=np.int64)
        done, front = self.rules.row(labels.done), self._front(labels)
        for axis, ways in enumerate(self.rules.ways):
            free, here = labels.free[:, axis], self._places(labels, axis)
            ready = labels.ready[:, axis].astype(np.int64)
            work, home = self.rules.open[done, axis], self.rules.homes[axis]
            since = np.where(home, ready, np.where(work, np.maximum(ready, front[:, None]), NEVER))
            wait = np.where(since < NEVER, since - ways.travel[here], NEVER)
            rows = np.arange(len(labels))
            wait[rows, here] -= ways.route.step - ways.route.gap  # seen to have come later
            gap = np.where(labels.last[:, axis] >= 0, ways.route.gap, 0)
            spent[:, axis] = np.minimum(np.maximum(free, wait.min(1)) - gap, self.end)
        return spent

    def _front(self, labels: Labels) -> Any:
        """Return when the last task started."""
        begun = labels.free - self.rules.gaps - self.rules.lengths[labels.last]
        return np.where(labels.last >= 0, begun, 0).max(1)
