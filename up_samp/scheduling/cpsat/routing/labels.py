"""What is known of beginnings of schedules, many at once: arrays with a row each.

A label says which tasks are done, and of each traveller what it did last, when it is free after
that, and since when it may be where, at rest, with nothing done since.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.tuning import BoundsTuning


@dataclass(frozen=True)
class Labels:
    """Labels in rows; columns are travellers but for ``done`` and ``parent``.

    ``done``: bits of the tasks. ``last``: the number of what it did last, as one traveller at one
    place (-1: nothing). ``free``: when it can do something again, where that was. ``leave``: when
    it can leave that place; -1: it may have left already. ``ready`` (for each place, too): when it
    can do something there, or go on from there. All of these are lower bounds. ``used``: bits of
    moves that are used up. ``spent``: how much of its time is spent at least, be it with waiting.
    ``turned``: who of its parent's travellers each one is (twins are exchanged). ``parent``: the
    row that it was made from, among the labels with one task less.
    """

    done: Any
    last: Any
    free: Any
    leave: Any
    ready: Any
    used: Any
    spent: Any
    turned: Any
    parent: Any

    def __len__(self) -> int:
        return len(self.done)

    @staticmethod
    def first(ready: Any) -> Labels:
        """Return the one label of the beginning, where nothing is done: a row of ``ready`` for each
        traveller.
        """
        count = len(ready)
        zero = np.zeros((1, count), dtype=np.int64)
        nothing = np.full((1, count), -1, dtype=np.int64)
        none = np.zeros(1, dtype=np.int64)
        own = np.arange(count)[None]
        return Labels(none, nothing, zero, zero, ready[None], zero, zero, own, none)

    def rows(self, which: Any) -> Labels:
        """Return some of the labels (numbers or a mask)."""
        return Labels(*(column[which] for column in self._columns()))

    def _columns(self) -> tuple[Any, ...]:
        times = self.free, self.leave, self.ready
        return self.done, self.last, *times, self.used, self.spent, self.turned, self.parent

    def numbered(self) -> Labels:
        """Return the labels as parents of those that are made from them."""
        own = np.broadcast_to(np.arange(self.last.shape[1]), self.last.shape)
        return replace(self, turned=own, parent=np.arange(len(self)))

    def bare(self) -> Labels:
        """Return the labels without what only those that are made from them need."""
        none = np.zeros((len(self), 0), dtype=np.int64)
        return replace(self, leave=none, ready=none, used=none, spent=none)

    @staticmethod
    def joined(some: list[Labels]) -> Labels:
        """Return the labels of several sets of them."""
        columns = zip(*(labels._columns() for labels in some), strict=True)
        return Labels(*(np.concatenate(column) for column in columns))

    def undominated(self, tuning: BoundsTuning, over: Callable[[], bool] = lambda: False) -> Labels:
        """Return the labels without those that another one is at least as good as: the same is
        done by the same, nothing later, nobody further on its way, with no more moves used up.

        Each is compared with a few ones before it in an order in which better ones come
        first, and again with others where many fall away, so some that are dominated may be left;
        more of them, if the time is ``over``.
        """
        sums = self.free.sum(1) + self.leave.sum(1) + self.ready.sum((1, 2), dtype=np.int64)
        mine = self.rows(np.lexsort((sums, *self.last.T, self.done)))
        first, last = 1, tuning.near
        for _ in range(tuning.near_rounds):
            worse = mine._worse(range(first, last + 1), over)
            left = len(mine) - int(worse.sum())
            if left == len(mine) or over():
                break
            # those that were further off are nearer now
            first, mine = 1 + last * left // len(mine), mine.rows(~worse)
            last = first + tuning.near
        return mine

    def _worse(self, shifts: range, over: Callable[[], bool]) -> Any:
        """Return which rows are dominated by one that is so many rows before."""
        worse = np.zeros(len(self), dtype=bool)
        same = (self.done[1:] == self.done[:-1]) & (self.last[1:] == self.last[:-1]).all(1)
        group = np.concatenate(([0], np.cumsum(~same)))
        for shift in (s for s in shifts if s < len(self)):
            near = group[shift:] == group[:-shift]
            a = np.flatnonzero(near & ~worse[shift:])
            if over() or not near.any():
                break
            b = a + shift
            better = (self.free[a] <= self.free[b]).all(1)
            better &= (self.leave[a] <= self.leave[b]).all(1)
            better &= ((self.used[a] & ~self.used[b]) == 0).all(1)
            a, b = a[better], b[better]
            worse[b[(self.ready[a] <= self.ready[b]).all((1, 2))]] = True
        return worse
