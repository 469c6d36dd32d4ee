"""Places for one among the places of routes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.forms import Literal
from up_samp.scheduling.cpsat.encode.statevars import Key, Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.routing.route import Move, Route

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
    """Return the unary places: 0/1 fluents that arrivals decrease and departures increase.

    Assumes: every arrival takes the one unit at its end, every departure gives it back at its
    start, and whoever begins there has it.
    """
    carriers: dict[int | None, set[Key]] = {}
    for route in routes:
        for move in route.moves:
            index = model.world.activities[move.name].index
            carriers.setdefault(index, set()).add(route.key)
    found = []
    for key, state in model.states.vars.items():
        writes = [w for w in state.writes if not model.store.never(w.active)]
        if not writes or state.bounds != (0, 1) or not all(w.add for w in writes):
            continue
        # who takes one unit for two travellers says nothing of these two
        if any(len(carriers.get(w.owner, ())) != 1 for w in writes):
            continue
        changes = _unit_changes(model, routes, writes)
        if changes is None:
            continue
        arrivals, departures = changes
        places = []
        for route in routes:
            comes = {(m.name, m.to) for m in route.moves}
            inside = frozenset(to for name, to in comes if to in arrivals.get(name, ()))
            begins = {(m.name, origin) for m in route.moves for origin in m.origins}
            if not (_are(comes, inside, arrivals) and _are(begins, inside, departures)):
                break
            places.append((route.key, inside))
        else:
            here = sum(
                route.initial in inside for route, (_, inside) in zip(routes, places, strict=True)
            )
            if here + (state.initial or 0) <= 1:  # who is there has it
                found.append(UnitPlace(key, tuple(places)))
    return found


Ends = dict[str, frozenset[int]]
"""Moves that take a unit (or give one back) -> the places to (or from) which they do."""


def _are(ends: set[tuple[str, int]], inside: frozenset[int], known: Ends) -> bool:
    """Return whether those moves take or give a unit, of one route, that lead in or out."""
    return {e for e in ends if e[1] in inside} == {e for e in ends if e[1] in known.get(e[0], ())}


def _unit_changes(
    model: ScheduleModel, routes: list[Route], writes: list[Write]
) -> tuple[Ends, Ends] | None:
    """Return who takes a unit at its end and who gives it back at its start, or a unit after it;
    None if anybody does anything else with it.
    """
    taken, given = Ends(), Ends()
    moves: dict[str, list[Move]] = {}
    for move in (move for route in routes for move in route.moves):
        moves.setdefault(move.name, []).append(move)
    for write in writes:
        activity = model.states.activity(write.owner or 0)
        step = 0 if write.value.terms else write.value.const
        start = model.states.difference(write.time, activity.start) in ((0, 0), (1, 1))
        end = model.states.difference(write.time, activity.end) == (0, 0)
        if not (step == -1 and end) and not (step == 1 and start):
            return None
        places = _places(model, activity, write.active, moves[activity.name], arrives=step == -1)
        if not places:
            return None
        found = taken if step == -1 else given
        found[activity.name] = found.get(activity.name, frozenset()) | places
    return taken, given


def _places(
    model: ScheduleModel,
    activity: ActivityVars,
    active: Literal,
    moves: list[Move],
    *,
    arrives: bool,
) -> frozenset[int]:
    """Return the places of which a literal tells that an activity begins or ends there (none, if
    it says anything else).
    """
    found = set[int]()
    for move in moves:
        places = frozenset((move.to,)) if arrives else move.origins
        if active == activity.present:
            found |= places
        elif len(places) == 1:
            # who goes from one place to another is told by one variable where it comes from, and
            # by another one where it goes to
            tells = (model.store.value_known(*item) for item in move.values if item[1] in places)
            present = activity.present
            if any(t is not None and _both(model, present, t) == active for t in tells):
                found |= places
    return frozenset(found)


def _both(model: ScheduleModel, one: Literal, other: Literal) -> Literal | None:
    return model.store.conjunction_known([one, other])
