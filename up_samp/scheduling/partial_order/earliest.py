"""Earliest times of points under differences, as some of them become known later than expected.

A simple temporal network (Dechter, Meiri and Pearl, 1991) that is only ever pushed forward: its
points start at their earliest times, and whoever raises one raises what depends on it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from up_samp.scheduling.partial_order.differences import HORIZON, ZERO, Difference, Point


class Earliest:
    """Earliest integer times of the starts and ends of ``names`` under ``differences``.

    ``feasible`` is false where no times keep them all.
    """

    def __init__(self, names: Iterable[str], differences: Iterable[Difference]) -> None:
        self.times: dict[Point, int] = {ZERO: 0, HORIZON: 0}
        self._after: dict[Point, list[tuple[Point, int]]] = {ZERO: [], HORIZON: []}
        self._pinned: set[Point] = {ZERO}
        for name in names:
            start, end = ("start", name), ("end", name)
            self.times[start] = self.times[end] = 0
            self._after[start] = [(end, 0)]
            self._after[end] = [(HORIZON, 0)]
        for d in differences:
            if d.then != HORIZON:
                self._after[d.first].append((d.then, d.lag + d.strict))
        self.feasible = self._push(list(self.times)) is not None

    def after(self, point: Point) -> list[Point]:
        """Return the points that may not come before a point."""
        return [then for then, lag in self._after[point] if lag >= 0]

    def latest(self) -> dict[Point, float]:
        """Return when each point may be at the latest, with all others free (inf: any time)."""
        before: dict[Point, list[tuple[Point, int]]] = {point: [] for point in self._after}
        for first, then in self._after.items():
            for point, lag in then:
                before[point].append((first, lag))
        found = dict.fromkeys(self._after, math.inf)
        found[ZERO] = 0.0
        todo = deque([ZERO])
        while todo:
            point = todo.popleft()
            for first, lag in before[point]:
                if found[point] - lag < found[first]:
                    found[first] = found[point] - lag
                    todo.append(first)
        return found

    def raised(self, wanted: dict[Point, int], *, pin: bool = False) -> bool:
        """Let points come no sooner than ``wanted``, and with ``pin`` exactly then, for good.

        Return false, with nothing changed, where the differences or pinned points forbid that.
        """
        before = {p: self.times[p] for p in wanted}
        if any(p in self._pinned and t != before[p] for p, t in wanted.items()):
            return False
        if pin and any(t < before[p] for p, t in wanted.items()):
            return False
        self.times.update({p: max(t, before[p]) for p, t in wanted.items()})
        added = wanted.keys() - self._pinned if pin else set()
        self._pinned |= added
        changed = self._push(list(wanted))
        if changed is None:
            self._pinned -= added
            self.times.update(before)
            return False
        return True

    def state(self) -> tuple[dict[Point, int], set[Point]]:
        """Return all times, and which of them are pinned, to go back to (:meth:`restore`)."""
        return dict(self.times), set(self._pinned)

    def restore(self, state: tuple[dict[Point, int], set[Point]]) -> None:
        """Go back to a state that was before."""
        times, pinned = state
        self.times, self._pinned = dict(times), set(pinned)

    def _push(self, since: list[Point]) -> dict[Point, int] | None:
        """Raise what depends on some points; return what was changed, or None (and nothing is) if
        that has no end or moves what is pinned.
        """
        old: dict[Point, int] = {}
        count: dict[Point, int] = {}
        queue, waiting = deque(since), set(since)
        while queue:
            point = queue.popleft()
            waiting.discard(point)
            time = self.times[point]
            for then, lag in self._after[point]:
                if self.times[then] >= time + lag:
                    continue
                count[then] = count.get(then, 0) + 1
                if then in self._pinned or count[then] > len(self.times):
                    self.times.update(old)
                    return None
                old.setdefault(then, self.times[then])
                self.times[then] = time + lag
                if then not in waiting:
                    waiting.add(then)
                    queue.append(then)
        return old
