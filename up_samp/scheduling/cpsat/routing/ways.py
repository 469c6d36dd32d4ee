"""The ways of one traveller as tables, for the labels of sequences of tasks.

Places have numbers here. A direct move between two places where tasks are done has a bit, if it is
the only one and the best way: it happens once at most, and who needs it again takes a detour.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.routing.openings import RoutedTask
from up_samp.scheduling.cpsat.routing.route import Route

MOST_BITS = 62
"""Places, or direct moves, that have a bit in a word."""
NEVER = 2**29
"""A time that does not come, in tables: two of them are still one word."""


@dataclass(frozen=True)
class Ways:
    """What one traveller needs from place to place (times; NEVER: there is no way)."""

    route: Route
    places: list[int]
    number: dict[int, int]
    travel: Any
    """From each place to each place."""
    detour: Any
    """The same without the direct move, where that has a bit."""
    hop: Any
    """The bit of the direct move from each place to each place; 0: it is not told apart."""
    leading: Any
    """All such bits of the moves from each place."""

    @staticmethod
    def of(route: Route, axis: int, tasks: list[RoutedTask], size: int) -> Ways:
        """Return the ways of a route (its number: ``axis``) among ``tasks``, in tables that are
        large enough for ``size`` places.
        """
        places = places_of(route)
        number = {place: k for k, place in enumerate(places)}
        travel = np.full((size, size), NEVER, dtype=np.int32)
        for (a, b), time in route.travel.items():
            travel[number[a], number[b]] = min(time, NEVER)
        detour = travel.copy()
        hop = np.zeros((size, size), dtype=np.int64)
        for bit, (a, b) in enumerate(_told_apart(route, axis, tasks)[:MOST_BITS]):
            hop[number[a], number[b]] = 1 << bit
            other = route.way(a, frozenset((b,)), {m.name for m in route.hops[a, b]})
            detour[number[a], number[b]] = NEVER if other is None else min(other[0], NEVER)
        return Ways(route, places, number, travel, detour, hop, np.bitwise_or.reduce(hop, axis=1))

    def nearby(self, some: set[int]) -> Ways:
        """Return the same with ``some`` of the places as near to everywhere as can be."""
        here = self.among(some)[:, None]
        return replace(
            self,
            travel=np.where(here, 0, self.travel),
            detour=np.where(here, 0, self.detour),
            hop=np.where(here, 0, self.hop),
            leading=np.where(here[:, 0], 0, self.leading),
        )

    def among(self, some: Iterable[int]) -> Any:
        """Return which of the places are among ``some``."""
        found = np.zeros(len(self.travel), dtype=bool)
        found[[number for place, number in self.number.items() if place in some]] = True
        return found


def places_of(route: Route) -> list[int]:
    """Return all places where the traveller may be."""
    return sorted({route.initial} | {b for _, b in route.travel})


def _told_apart(route: Route, axis: int, tasks: list[RoutedTask]) -> list[tuple[int, int]]:
    """Return the direct ways of a single move that might be wanted twice (none where something
    else may put the traveller somewhere, too).
    """
    if route.free:
        return []
    counts: Counter[int] = Counter()
    for task in tasks:
        counts.update({p for way, _, places in task.ways if way == axis for p in places})
    often = sorted(place for place, count in counts.items() if count > 1)
    return [
        (a, b)
        for a in often
        for b in often
        if a != b and route.is_direct(a, b) and len(route.hops[a, b]) == 1
    ]
