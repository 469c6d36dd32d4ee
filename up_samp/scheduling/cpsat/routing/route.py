"""The route of one traveller, as it is read off a model: moves, stops, the shortest ways between
places.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Collection, Iterable, Set
from dataclasses import dataclass, field, replace

from up_samp.scheduling.cpsat.encode.durations import INFINITE
from up_samp.scheduling.cpsat.encode.states import Key

Pair = tuple[int, int]


def shorten(lengths: dict[Pair, int], places: Iterable[int]) -> dict[Pair, int]:
    """Make ``lengths`` (0 or more) those of shortest ways; return, for each pair that is shorter
    by way of another place, the last one that made it so (Floyd and Warshall).

    Of ways of one length the first one found stays. Sparse lengths are few steps: places that
    nothing leads from cost nothing. (``scipy.sparse.csgraph`` returns other ones among equals.)
    """
    order = list(places)
    via: dict[Pair, int] = {}
    for middle in order:
        onward = [(b, lengths[middle, b]) for b in order if b != middle and (middle, b) in lengths]
        for a in order:
            first = lengths.get((a, middle))
            if a == middle or first is None:
                continue
            for b, second in onward:
                known = lengths.get((a, b))
                if known is None or first + second < known:
                    lengths[a, b] = first + second
                    via[a, b] = middle
    return via


# ------------------ The route of one traveller


@dataclass(frozen=True, order=True)
class Move:
    """A transition: from one of ``origins`` to ``to``, lasting at least ``least``, if the variables
    in ``values`` (parameters) have these values.
    """

    name: str
    origins: frozenset[int]
    to: int
    least: int
    values: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class Entrance:
    """Everyone who comes to a place needs ``state`` to be in ``allowed``; a supporting effect
    comes ``lead`` or more before what is done there.
    """

    state: Key
    allowed: frozenset[int]
    lead: int


Timed = list[tuple[int, Move]]
"""Moves one after the other, with their starts."""


Still = dict[Key, tuple[int, int]]
"""State variables that nobody may change in the midst of any move -> (a, b): an effect comes by
``begin + a``, or from ``end + b`` on. Both are 0 where effects are at the ends of activities, and
-1 where they are a unit early."""


@dataclass
class Route:
    """One traveller. ``stops`` are (activity, places where it may happen)."""

    key: Key
    gap: int
    initial: int
    final: frozenset[int] | None
    moves: list[Move]
    stops: list[tuple[str, frozenset[int]]]
    late: frozenset[str] = frozenset()
    """Stops that need their place only after their start: a move may end when they begin."""
    entries: dict[int, list[Entrance]] = field(default_factory=dict)
    still: Still = field(default_factory=dict)
    returns: dict[str, frozenset[int]] = field(default_factory=dict)
    """Stops after which the traveller has to come to one of these places some time."""
    visits: list[tuple[str, frozenset[int]]] = field(default_factory=list)
    """Places where the traveller has to arrive some time, with a name for each: nothing happens
    there. As stops they last no time, and begin when a move ends (see :meth:`with_visits`)."""
    odd: dict[str, str] = field(default_factory=dict)
    """What changes the place and is no plain move -> why: they are not taken out."""
    free: frozenset[int] = frozenset()
    """Places to which something else may put the traveller at any time, in no time."""
    never: frozenset[str] = frozenset()
    """Moves that are stated to be absent: they are not among ``moves``."""
    lag: int = 1
    """Time from the end of a move until its effect is seen: 1 for an effect at the end, 0 for one
    at ``end - 1``."""
    hops: dict[tuple[int, int], list[Move]] = field(default_factory=dict)
    travel: dict[tuple[int, int], int] = field(default_factory=dict)
    _via: dict[tuple[int, int], int] = field(default_factory=dict)
    leaving: dict[int, list[tuple[int, list[Move]]]] = field(default_factory=dict)
    """Place -> (where one can go from there, with which moves, the quickest first)."""
    _ways: dict[tuple[int, frozenset[int]], tuple[int, list[Move]] | None] = field(
        default_factory=dict
    )

    @property
    def step(self) -> int:
        """Time from the end of a move to what may come next (its effect has to be seen)."""
        return max(self.lag, self.gap)

    @property
    def movers(self) -> frozenset[str]:
        """All plain moves, be it that they are stated never to happen."""
        return self.never | {move.name for move in self.moves} - self.odd.keys()

    def with_visits(self) -> Route:
        """Return the same route with its visits among its stops."""
        return replace(self, stops=[*self.stops, *self.visits])

    def rest(self, stop: str) -> int:
        """Return the time from the end of a move to a stop."""
        return self.gap if stop in self.late else self.step

    @property
    def home(self) -> frozenset[int] | None:
        """Where the traveller has to be in the end, or may as well be (``None``: anywhere)."""
        if self.final is not None or not self.returns:
            return self.final
        places = frozenset.intersection(*self.returns.values())
        return places or None

    def measure(self) -> None:
        """Compute the shortest travel times between places."""
        places = {self.initial, *(m.to for m in self.moves), *self.free}
        places = places.union(*(some for _, some in self.stops))
        for move in self.moves:
            places |= move.origins
            for origin in move.origins:
                if origin != move.to:
                    self.hops.setdefault((origin, move.to), []).append(move)
        order = sorted(places)
        for a in order:
            self.travel[a, a] = 0
        for (a, b), moves in self.hops.items():
            self.travel[a, b] = min(m.least for m in moves) + self.step
            # of copies of one move, the first ones are used first, as the problem has them
            choices = sorted(moves, key=lambda m: m.least)
            self.leaving.setdefault(a, []).append((b, choices))
        for a in order:
            for b in self.free - {a}:
                self.travel[a, b], self._via[a, b] = 0, b
        self._via.update(shorten(self.travel, order))

    def between(self, some: Set[int], others: Set[int]) -> int:
        """Return the least travel time from a place in ``some`` to one in ``others``."""
        return min(
            (self.travel.get((a, b), INFINITE) for a in some for b in others), default=INFINITE
        )

    def is_direct(self, a: int, b: int) -> bool:
        """Return whether the shortest way is one move."""
        return (a, b) in self.hops and (a, b) not in self._via

    def least(self, a: int, b: int) -> int:
        """Return the duration of the quickest move between two places."""
        return min(m.least for m in self.hops[a, b])

    def last_least(self, places: frozenset[int]) -> int:
        """Return the least duration of a move into one of ``places``."""
        if places & self.free:
            return 0
        return min((m.least for m in self.moves if m.to in places), default=0)

    def around(self, a: int, b: int) -> tuple[int, int] | None:
        """Return (travel time, duration of the last move) that ways from ``a`` to ``b`` at least
        take whose last move is quicker than the direct one; ``None`` if there are none.
        """
        direct = self.least(a, b)
        found = [
            (
                self.travel.get((a, via), INFINITE) + self.least(via, b) + self.step,
                self.least(via, b),
            )
            for via, to in self.hops
            if to == b and via != a and self.least(via, b) < direct
        ]
        distance = min((d for d, _ in found), default=INFINITE)
        return None if distance >= INFINITE else (distance, min(last for _, last in found))

    def loop(self, place: int) -> int:
        """Return the least travel time of a way out of a place and back."""
        return min(
            (
                self.travel.get((place, b), INFINITE) + self.travel.get((b, place), INFINITE)
                for b in {m.to for m in self.moves} - {place}
            ),
            default=INFINITE,
        )

    def way(
        self, here: int, targets: frozenset[int], banned: Collection[str] = ()
    ) -> tuple[int, list[Move]] | None:
        """Return the shortest travel time and moves to one of ``targets``, without the moves
        named in ``banned`` (Dijkstra); ``None`` if there is no way.
        """
        key = (here, targets)
        if key not in self._ways:
            self._ways[key] = self._shortest(here, targets, ())
        found = self._ways[key]
        if found is None or not any(move.name in banned for move in found[1]):
            return found
        return self._shortest(here, targets, banned)

    def _shortest(
        self, here: int, targets: frozenset[int], banned: Collection[str]
    ) -> tuple[int, list[Move]] | None:
        timed = self.soonest(here, targets, banned)
        if timed is None:
            return None
        end = timed[-1][0] + timed[-1][1].least + self.step if timed else 0
        return end, self._distinct(here, [move for _, move in timed], banned)

    def soonest(
        self,
        here: int,
        targets: frozenset[int],
        banned: Collection[str],
        free: int = 0,
        wait: Callable[[int, int], int] = lambda start, length: start,
    ) -> Timed | None:
        """Return the moves to one of ``targets`` that arrive first, from ``free`` on (Dijkstra;
        ``None``: there is no way). Each starts at the first time that ``wait`` gives for when it
        might start, and its length: who waits is never earlier.
        """
        ties = itertools.count()
        heap: list[tuple[int, int, int, Timed]] = [(free, here, next(ties), [])]
        done = set()
        while heap:
            now, place, _, timed = heapq.heappop(heap)
            if place in targets:
                return timed
            if place in done:
                continue
            done.add(place)
            for to, choices in self.leaving.get(place, ()):
                if to not in done:
                    move = next((m for m in choices if m.name not in banned), None)
                    if move is not None:
                        begin = wait(now, move.least)
                        ahead = begin + move.least + self.step
                        heapq.heappush(heap, (ahead, to, next(ties), [*timed, (begin, move)]))
        return None

    def _distinct(self, here: int, moves: list[Move], banned: Collection[str]) -> list[Move]:
        """Return a way without a move that it makes twice, where there are others for it."""
        if len({m.name for m in moves}) == len(moves):
            return moves
        found: list[Move] = []
        for move in moves:
            used = {m.name for m in found}.union(banned)
            same = (m for m in self.hops[here, move.to] if m.name not in used)
            found.append(min(same, key=lambda m: m.least, default=move))
            here = move.to
        return found


def way_back(route: Route, places: Set[int], final: Set[int] | None) -> int:
    """Return the least time from the end of a last stop, at one of ``places``, to that of
    everything, if the traveller has to come to one of ``final`` (``None``: anywhere).
    """
    if final is None or places & final:
        return 0
    distance = route.between(places, final)
    return 0 if distance >= INFINITE else max(0, route.gap + distance - route.step)
