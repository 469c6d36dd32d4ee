"""What travellers have left on their way (batteries, tanks).

A level is taken from by moves alone, and changed by stops, of one traveller. (What stops alone
change is its own state: see :mod:`.dispatch`.)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from up_samp.scheduling.cpsat.encode.durations import INFINITE
from up_samp.scheduling.cpsat.encode.states import StateVar, Write
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.route import Route, shorten

Ways = dict[tuple[int, int], int]
"""(place, place) -> what is taken on the way at least."""


@dataclass(frozen=True)
class RouteLevel:
    """A level within ``low`` and ``high``: ``gains`` are what stops add to it, ``settings`` what
    stops set it to (a swapped battery is full), ``ways`` what ways take from it at least.
    """

    initial: int
    low: int
    high: int
    gains: Mapping[str, int]
    settings: Mapping[str, int]
    ways: Ways

    def after(self, left: int, stop: str) -> int:
        """Return what is left after a stop, of what was left before."""
        return self.settings.get(stop, left + self.gains.get(stop, 0))

    def refilled_by(self, stop: str) -> bool:
        """Return whether who has little left has more after a stop."""
        return self.after(self.low, stop) > self.low

    def taken(self, some: Iterable[int], others: Iterable[int]) -> int:
        """Return what is taken at least from one of some places to one of others."""
        targets = list(others)
        least = min((self.ways.get((a, b), INFINITE) for a in some for b in targets), default=0)
        return 0 if least >= INFINITE else least


def find_levels(model: ScheduleModel, route: Route) -> list[RouteLevel]:
    """Return the levels of a route: numbers that nobody but its moves and stops changes. (Who may
    be put somewhere else gets there for nothing.)

    Assumes: nobody but a traveller's moves and stops changes a level, and its moves only take from
    it.
    """
    if route.free:
        return []
    found = (_level(model, route, state) for state in model.states.vars.values() if state.numeric)
    return [level for level in found if level is not None]


def _level(model: ScheduleModel, route: Route, state: StateVar) -> RouteLevel | None:
    stops = {name for name, _ in route.stops}
    taken: dict[str, int] = {}
    gains: dict[str, int] = {}
    settings: dict[str, int] = {}
    for write in state.writes:
        if model.store.never(write.active):
            continue
        name, value = _owner(model, write), write.value.const
        if name is None or write.value.terms:
            return None
        if write.add and name in route.movers and value <= 0:
            taken[name] = taken.get(name, 0) - value
        elif name not in stops or not _after_start(model, write):
            return None
        elif write.add:
            gains[name] = gains.get(name, 0) + value
        else:
            settings[name] = value
    both = gains.keys() & settings.keys()  # what is left then hangs on which of them comes first
    if not taken or both or state.initial is None:
        return None
    return RouteLevel(state.initial, *state.bounds, gains, settings, _ways(route, taken))


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
