"""Proofs that no schedule ends by a given time, over all sequences of tasks.

Tasks are taken in the order of their starts. What is known of a sequence so far (:mod:`.labels`)
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
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from up_samp.model import Deadline
from up_samp.scheduling.cpsat.routing.labels import LabelTable, Steps, Twins
from up_samp.scheduling.cpsat.routing.rules import NEVER, SequenceRules

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

    def anew(self, most: int) -> Sequences:
        """Return the same with nothing looked at or found."""
        return Sequences(self.rules, most)

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
            labels = self.twins.ordered(labels).undominated(deadline)
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
        last: dict[int, int] = {}
        for number, start in self.found[0]:
            choice = self.rules.choices[number]
            last[choice.traveller] = start + int(self.rules.lengths[number]) + choice.back
        return max(last.values(), default=0)

    def _path(self, layers: list[LabelTable], row: int) -> Found:
        """Return how one of the last labels was come to."""
        rows = [row]
        for after in layers[:0:-1]:
            rows.append(int(after.parent[rows[-1]]))
        who = np.arange(layers[0].last.shape[1])
        path = []
        pairs = zip(itertools.pairwise(layers), itertools.pairwise(rows[::-1]), strict=True)
        for (before, after), (one, other) in pairs:
            task = (int(after.done[other]) & ~int(before.done[one])).bit_length() - 1
            last = after.last[other].tolist()
            axis = next(a for a, c in enumerate(last) if c >= 0 and self._task(c) == task)
            busy = self.rules.lengths[last[axis]] + self.rules.gaps[axis]
            who = who[after.turned[other]]
            # a twin stands in for who did it
            number = last[axis] if who[axis] == axis else self.twins.same[last[axis], who[axis]]
            path.append((int(number), int(after.free[other, axis] - busy)))
        return path

    def _task(self, choice: int) -> int:
        return self.rules.choices[choice].task

    @cached_property
    def twins(self) -> Twins:
        """Who of the travellers is like whom."""
        return Twins.of(self.rules)


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
