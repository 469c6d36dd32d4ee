"""What is known of beginnings of schedules, many at once: arrays with a row each.

A label says which tasks are done, and of each traveller what it did last, when it is free after
that, and since when and where it may be since: after a change during which it has to stand still,
it is at one of several ``spots`` and leaves it no sooner than ``leave``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Labels:
    """Labels in rows; columns are travellers but for ``done``.

    ``done``: bits of the tasks. ``last``: the number of what it did last, as one traveller at one
    place (-1: nothing). ``free``: when it can do something again, where that was; ``leave``: when
    it can leave (both are lower bounds). ``spots``: bits of the places where it may be then.
    ``ahead``: how far from the last one it may be. ``used``: bits of moves that are used up.
    ``parent``: the row that it was made from, among the labels with one task less.
    """

    done: Any
    last: Any
    free: Any
    leave: Any
    spots: Any
    ahead: Any
    used: Any
    parent: Any

    def __len__(self) -> int:
        return len(self.done)

    @staticmethod
    def first(places: list[int]) -> Labels:
        """Return the one label of the beginning: everybody is at a place, nothing is done."""
        count = len(places)
        zero = np.zeros((1, count), dtype=np.int64)
        here = np.array([[1 << place for place in places]], dtype=np.int64)
        nothing = np.full((1, count), -1, dtype=np.int64)
        none = np.zeros(1, dtype=np.int64)
        return Labels(none, nothing, zero, zero, here, zero, zero, none)

    def rows(self, which: Any) -> Labels:
        """Return some of the labels (numbers or a mask)."""
        return Labels(*(column[which] for column in self._columns()))

    def _columns(self) -> tuple[Any, ...]:
        times = self.free, self.leave, self.spots, self.ahead
        return self.done, self.last, *times, self.used, self.parent

    def numbered(self) -> Labels:
        """Return the labels as parents of those that are made from them."""
        return replace(self, parent=np.arange(len(self)))

    @staticmethod
    def joined(some: list[Labels]) -> Labels:
        """Return the labels of several sets of them."""
        columns = zip(*(labels._columns() for labels in some), strict=True)
        return Labels(*(np.concatenate(column) for column in columns))

    def undominated(self, nearby: int, over: Callable[[], bool] = lambda: False) -> Labels:
        """Return the labels without those that another one is at least as good as: the same is
        done by the same, nothing later, with no fewer spots and no more moves used up.

        Each is compared with the ``nearby`` ones before it in an order in which better ones come
        first, so some that are dominated may be left; more of them, if the time is ``over``.
        """
        sums = self.free.sum(1) + self.leave.sum(1)
        order = np.lexsort((sums, *self.last.T, self.done))
        mine = self.rows(order)
        worse = np.zeros(len(mine), dtype=bool)
        same = (mine.done[1:] == mine.done[:-1]) & (mine.last[1:] == mine.last[:-1]).all(1)
        group = np.concatenate(([0], np.cumsum(~same)))
        for shift in range(1, min(nearby, len(mine) - 1) + 1):
            pairs = np.flatnonzero(group[shift:] == group[:-shift])
            if not len(pairs) or over():
                break
            a, b = mine.rows(pairs), mine.rows(pairs + shift)
            better = (a.free <= b.free).all(1) & (a.leave <= b.leave).all(1)
            better &= ((b.spots & ~a.spots) == 0).all(1) & ((a.used & ~b.used) == 0).all(1)
            worse[pairs[better] + shift] = True
        return mine.rows(~worse)
