"""The route of one traveller, as it is read off a model: moves, stops, the shortest ways between
places.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Collection, Iterable, Set
from dataclasses import dataclass, field
from functools import partial

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.encode.states import Key
from up_samp.scheduling.cpsat.encode.terms import INFINITE
from up_samp.scheduling.cpsat.model import ScheduleModel

Pair = tuple[int, int]


def shorten(lengths: dict[Pair, int], places: Iterable[int]) -> None:
    """Make ``lengths`` (0 or more) those of shortest ways (Floyd and Warshall). Sparse lengths are
    few steps: places that nothing leads from cost nothing.
    """
    order = list(places)
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
    rests: frozenset[str] = frozenset()
    """Stops that are there in every schedule and may be anywhere (breaks): their places are all."""
    late: frozenset[str] = frozenset()
    """Stops that need their place only after their start: a move may end when they begin."""
    entries: dict[int, list[Entrance]] = field(default_factory=dict)
    still: Still = field(default_factory=dict)
    visits: list[tuple[str, frozenset[int]]] = field(default_factory=list)
    """Places where the traveller has to arrive some time, with a name for each: nothing happens
    there. As stops they last no time, and begin when a move ends."""
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
    leaving: dict[int, list[tuple[int, list[Move]]]] = field(default_factory=dict)
    """Place -> (where one can go from there, with which moves, the quickest first)."""
    _ways: dict[tuple[int, frozenset[int]], Timed | None] = field(default_factory=dict)

    @property
    def step(self) -> int:
        """Time from the end of a move to what may come next (its effect has to be seen)."""
        return max(self.lag, self.gap)

    @property
    def movers(self) -> frozenset[str]:
        """All plain moves, be it that they are stated never to happen."""
        return self.never | {move.name for move in self.moves} - self.odd.keys()

    def entries_to(self, place: int) -> list[Entrance]:
        """Return what must be open for the traveller to come to a place (to its first: nothing)."""
        return [] if place == self.initial else self.entries.get(place, [])

    def rest(self, stop: str) -> int:
        """Return the time from the end of a move to a stop."""
        return self.gap if stop in self.late else self.step

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
            choices = sorted(moves, key=lambda m: m.least)
            self.leaving.setdefault(a, []).append((b, choices))
        for a in order:
            for b in self.free - {a}:
                self.travel[a, b] = 0
        shorten(self.travel, order)

    def between(self, some: Set[int], others: Set[int]) -> int:
        """Return the least travel time from a place in ``some`` to one in ``others``."""
        pairs = itertools.product(some, others)
        return min((self.travel.get(pair, INFINITE) for pair in pairs), default=INFINITE)

    def way(self, here: int, targets: frozenset[int], banned: Collection[str]) -> list[Move] | None:
        """Return the moves of the shortest way to one of ``targets``, without those named in
        ``banned``; ``None`` if there is no way.
        """
        key = (here, targets)
        if key not in self._ways:
            self._ways[key] = self.soonest(here, targets, ())
        found = self._ways[key]
        if any(move.name in banned for _, move in found or ()):
            found = self.soonest(here, targets, banned)
        return None if found is None else [move for _, move in found]

    def soonest(
        self,
        here: int,
        targets: frozenset[int],
        banned: Collection[str],
        free: int = 0,
        wait: Callable[[int, int], int] = lambda start, length: start,
    ) -> Timed | None:
        """Return the moves to one of ``targets`` that arrive first, from ``free`` on (Dijkstra;
        ``None``: there is no way), none of them made twice. Each starts at the first time that
        ``wait`` gives for when it might start, and its length: who waits is never earlier.
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
            made = {move.name for _, move in timed}.union(banned)
            for to, choices in self.leaving.get(place, ()):
                if to not in done:
                    move = next((m for m in choices if m.name not in made), None)
                    if move is not None:
                        begin = wait(now, move.least)
                        ahead = begin + move.least + self.step
                        heapq.heappush(heap, (ahead, to, next(ties), [*timed, (begin, move)]))
        return None


def way_back(route: Route, places: Set[int], final: Set[int] | None) -> int:
    """Return the least time from the end of a last stop, at one of ``places``, to that of
    everything, if the traveller has to come to one of ``final`` (``None``: anywhere).
    """
    if final is None or places & final:
        return 0
    distance = route.between(places, final)
    return 0 if distance >= INFINITE else max(0, route.gap + distance - route.step)


# ------------------ From a schedule of what happens at places to one with moves


Changes = dict[str, list[tuple[Key, int]]]
"""Activity -> the state variables that it changes, and when: counted from its end."""
Events = list[tuple[Key, int]]


def expand(routes: list[Route], schedule: CandidateSchedule, changes: Changes) -> CandidateSchedule:
    """Return ``schedule`` with moves put in, as early as they may happen, each made once if that is
    possible.
    """
    times = dict(schedule.times)
    events = [
        (key, schedule.times[name][1] + delay)
        for name, some in changes.items()
        if name in schedule.times
        for key, delay in some
    ]
    for route in routes:
        _expand(route, times, events)
    for name in (name for route in routes for name, _ in route.visits):
        times.pop(name, None)
    return CandidateSchedule(times, schedule.parameters)


def changes_by_name(model: ScheduleModel) -> Changes:
    """Return what each activity changes at a known time."""
    changes: Changes = {}
    for key, state in model.states.vars.items():
        for write in state.writes if not state.numeric else ():
            if write.owner is not None:
                owner = model.states.activity(write.owner)
                low, high = model.states.difference(write.time, owner.end)
                if low == high:
                    changes.setdefault(owner.name, []).append((key, low))
    return changes


def calm(still: Still, events: Iterable[tuple[Key, int]], start: int, length: int) -> int:
    """Return the first time from ``start`` on at which nothing changes during a move."""
    spans = sorted(
        (time - still[key][0], still[key][1] - still[key][0])
        for key, time in events
        if key in still
    )
    for time, more in spans:
        if start < time < start + length + more:
            start = time
    return start


def _expand(route: Route, times: dict[str, tuple[int, int]], events: Events) -> None:
    stops = sorted((times[n], n, places) for n, places in route.stops if n in times)
    goals = [(start, end, places) for (start, end), _, places in stops]
    if route.final is not None:
        goals.append((0, 0, route.final))
    wait = partial(calm, route.still, events)
    here, free, used = route.initial, 0, set[str]()
    for start, end, places in goals:
        timed: Timed = []
        if places and here not in places:
            banned = (used, ())  # if there is no way but by a move that is made
            ways = (route.soonest(here, places, some, free, wait) for some in banned)
            timed = next((way for way in ways if way is not None), [])
        for begin, move in timed:
            times[move.name] = (begin, begin + move.least)
            used.add(move.name)
            here, free = move.to, begin + move.least + route.step
        free = max(end + route.gap, start, free)
