"""What travellers have left on their way (batteries, tanks), in the routing relaxation.

A level is taken from by moves alone and changed by stops of one traveller. As that one does one
thing at a time, the level at a stop follows from the one at the stop before, less what the way
takes at least. So a schedule of the relaxation charges about where one of the problem has to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from up_samp.scheduling.cpsat.encode.forms import Lin, Literal, constant
from up_samp.scheduling.cpsat.encode.statevars import StateVar, Write
from up_samp.scheduling.cpsat.encode.store import Store
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.legs import Arc
from up_samp.scheduling.cpsat.routing.route import INFINITE, Route
from up_samp.scheduling.cpsat.routing.shortest import shorten

Ways = dict[tuple[int, int], int]
"""(place, place) -> what is taken on the way at least."""


@dataclass(frozen=True)
class Level:
    """A level within ``low`` and ``high``: ``gains`` are what stops add to it, ``ways`` what ways
    take from it at least; ``start`` is the place at first.
    """

    start: int
    initial: int
    low: int
    high: int
    gains: Mapping[str, int]
    ways: Ways

    def taken(self, some: Iterable[int], others: Iterable[int]) -> int:
        """Return what is taken at least from one of some places to one of others."""
        targets = list(others)
        least = min((self.ways.get((a, b), INFINITE) for a in some for b in targets), default=0)
        return 0 if least >= INFINITE else least


def find_levels(model: ScheduleModel, route: Route) -> list[Level]:
    """Return the levels of a route: numbers that its moves take from, and that nobody but its moves
    and stops changes. (Who may be put somewhere else gets there for nothing.)

    Assumes: nobody but a traveller's moves and stops changes a level, and its moves only take from
    it.
    """
    if route.free:
        return []
    found = (_level(model, route, state) for state in model.states.vars.values() if state.numeric)
    return [level for level in found if level is not None]


def _level(model: ScheduleModel, route: Route, state: StateVar) -> Level | None:
    stops = {name for name, _ in route.stops}
    taken: dict[str, int] = {}
    gains: dict[str, int] = {}
    for write in state.writes:
        if model.store.never(write.active):
            continue
        name = _owner(model, write)
        if name is None or not (write.add and not write.value.terms):
            return None
        if name in route.movers and write.value.const <= 0:
            taken[name] = taken.get(name, 0) - write.value.const
        elif name in stops and _after_start(model, write):
            gains[name] = gains.get(name, 0) + write.value.const
        else:
            return None
    if not taken or state.initial is None:
        return None
    return Level(route.initial, state.initial, *state.bounds, gains, _ways(route, taken))


def _owner(model: ScheduleModel, write: Write) -> str | None:
    """Return the activity that always has this effect, within it."""
    if write.owner is None:
        return None
    owner = model.states.activity(write.owner)
    inside = model.states.difference(write.time, owner.start)[0] >= 0
    ends = model.states.difference(owner.end, write.time)[0] >= 0
    return owner.name if inside and ends and write.active == owner.present else None


def _after_start(model: ScheduleModel, write: Write) -> bool:
    """Return whether an effect comes after the start of its activity: nobody sees it together with
    one at the end of what came before.
    """
    owner = model.states.activity(write.owner or 0)
    return model.states.difference(write.time, owner.start)[0] >= 1


def _ways(route: Route, taken: Mapping[str, int]) -> Ways:
    """Return what ways take at least."""
    ways: Ways = {}
    places = {route.initial}
    for (a, b), moves in route.hops.items():
        ways[a, b] = min(taken.get(m.name, 0) for m in moves)
        places |= {a, b}
    ways |= {(p, p): 0 for p in places}
    shorten(ways, places)
    return ways


class Course:
    """A level along a route: what is left at most when its traveller comes to each stop."""

    def __init__(
        self, store: Store, level: Level, stops: Sequence[tuple[ActivityVars, frozenset[int]]]
    ) -> None:
        self._store = store
        self._level = level
        self._stops = stops
        low, high = level.low, level.high
        self._left = [Lin(((store.integer(low, high), 1),)) for _ in range(len(stops) + 1)]
        store.enforce(self._left[0].le(constant(level.initial)))

    def come(self, j: int, arcs: Iterable[Arc]) -> None:
        """State that who comes to stop ``j`` (from 1 on) has no more than was left before, less
        what the way takes.
        """
        for arc in arcs:
            change = -self._level.taken(self._places(arc.i), self._places(j))
            before = self._left[arc.i].shift(self._gain(arc.i) + change)
            self._store.enforce(self._left[j].le(before), (arc.literal,))

    def leave(self, j: int, literal: Literal, final: frozenset[int] | None) -> None:
        """State that what is left after the last stop ``j`` is enough for the way to ``final``."""
        back = 0 if final is None else self._level.taken(self._places(j), final)
        least = constant(self._level.low + back - self._gain(j))
        self._store.enforce(least.le(self._left[j]), (literal,))

    def _places(self, j: int) -> frozenset[int]:
        return self._stops[j - 1][1] if j else frozenset((self._level.start,))

    def _gain(self, j: int) -> int:
        return self._level.gains.get(self._stops[j - 1][0].name, 0) if j else 0
