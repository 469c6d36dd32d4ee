"""Places for one among the places of routes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.forms import Literal
from up_samp.scheduling.cpsat.encode.statevars import Key, Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.routing.route import Route

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel


@dataclass(frozen=True)
class UnitPlace:
    """A unary place: it is taken by whoever rests at one of ``places`` (by route's key)."""

    key: Key
    places: tuple[tuple[Key, frozenset[int]], ...]

    def places_of(self, route: Key) -> frozenset[int]:
        """Return the places of a route that it holds."""
        return self._by_route.get(route, frozenset())

    @cached_property
    def _by_route(self) -> dict[Key, frozenset[int]]:
        return dict(self.places)


def find_unit_places(model: ScheduleModel, routes: list[Route]) -> list[UnitPlace]:
    """Return the unary places: 0/1 fluents that arrivals decrease and departures increase."""
    owners = {
        model.world.activities[move.name].index: (route, move)
        for route in routes
        for move in route.moves
    }
    found = []
    for key, state in model.states.vars.items():
        writes = [w for w in state.writes if not model.store.never(w.active)]
        if not writes or state.bounds != (0, 1) or not all(w.add for w in writes):
            continue
        if any(w.owner not in owners for w in writes):
            continue
        arrivals, departures = _unit_moves(model, routes, writes)
        if arrivals is None:
            continue
        places = []
        for route in routes:
            inside = frozenset(m.to for m in route.moves if m.name in arrivals)
            comes = {m.name for m in route.moves if m.to in inside}
            own = {m.name for m in route.moves}
            begins = {(m.name, origin) for m in route.moves for origin in m.origins}
            goes = {(name, origin) for name, origin in begins if origin in inside}
            given = {(name, o) for name, o in begins if o in departures.get(name, ())}
            if comes != arrivals & own or goes != given:
                break
            places.append((route.key, inside))
        else:
            here = sum(
                route.initial in inside for route, (_, inside) in zip(routes, places, strict=True)
            )
            if here + (state.initial or 0) <= 1:  # who is there has it
                found.append(UnitPlace(key, tuple(places)))
    return found


Departures = dict[str, frozenset[int]]
"""Moves that give a unit back -> the places from which they do."""


def _unit_moves(
    model: ScheduleModel, routes: list[Route], writes: list[Write]
) -> tuple[set[str] | None, Departures]:
    """Return who takes a unit at its end and who gives it back at its start, or a unit after it;
    None if anybody does anything else with it.
    """
    arrivals: set[str] = set()
    departures: Departures = {}
    origins: dict[str, frozenset[int]] = {}
    for move in (move for route in routes for move in route.moves):
        origins[move.name] = origins.get(move.name, frozenset()) | move.origins
    for write in writes:
        activity = model.states.activity(write.owner or 0)
        start = model.states.difference(write.time, activity.start) in ((0, 0), (1, 1))
        end = model.states.difference(write.time, activity.end) == (0, 0)
        always = write.active == activity.present
        if write.value.terms or not (always or start):
            return None, {}
        if write.value.const == -1 and end and always:
            arrivals.add(activity.name)
            continue
        begun = origins[activity.name] if always else _begun(model, activity, write.active)
        if write.value.const != 1 or not start or not begun:
            return None, {}
        departures[activity.name] = departures.get(activity.name, frozenset()) | begun
    return arrivals, departures


def _begun(model: ScheduleModel, activity: ActivityVars, active: Literal) -> frozenset[int]:
    """Return the places of which a literal tells that an activity begins there (none, if it says
    anything else).
    """
    own = {i for i, _, owner in model.parameters.values() if owner == activity.name}
    store = model.store
    found = set()
    for variable in own:
        low, high = store.bounds[variable]
        for value in range(low, high + 1):
            there = store.value_known(variable, value)
            if there is not None:
                both = store.conjunction_known([activity.present, there])
                found |= {value} if both == active else set()
    return frozenset(found)
