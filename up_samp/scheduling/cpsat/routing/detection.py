"""Routes inside a problem: a state variable that some members of a clique change (moves) and others
need (work at places), all one at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.statevars import Key, Read, StateVar
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.encode.timeline import Timeline
from up_samp.scheduling.cpsat.routing.changes import Change, changes_of
from up_samp.scheduling.cpsat.routing.entrances import find_entries, find_still
from up_samp.scheduling.cpsat.routing.lengths import Lengths
from up_samp.scheduling.cpsat.routing.route import INFINITE, Move, Route
from up_samp.scheduling.cpsat.routing.visits import find_visits

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel


def find_routes(model: ScheduleModel) -> list[Route]:
    """Return the routes of a model that can be collapsed together.

    Assumes: a traveller's moves and stops are done one at a time, and no stop is a move of another
    route.
    """
    cliques = model.disjunctions.sets()
    places = [
        place
        for timeline in model.timelines.values()
        if isinstance(timeline, Timeline)
        and isinstance(place := _place(model, timeline, cliques), Place)
    ]
    lengths = Lengths(model, {v for p in places for c in p.changes for v in (c.origin, c.target)
                              if v is not None})  # fmt: skip
    routes = _together([_route(model, place, lengths) for place in places])
    for route in routes:
        route.measure()
    return routes


def _together(routes: list[Route]) -> list[Route]:
    """Return the routes that can be collapsed together, those with the most moves first.

    What happens at a place on one route stays: it cannot be a move of another that is collapsed.
    (A door's opening is a move of the door, and who goes through stops there.)
    """
    stops, movers, kept = set[str](), set[str](), set[Key]()
    for route in sorted(routes, key=lambda r: -len(r.moves)):
        mine = {name for name, _ in route.stops}
        if not route.movers & stops and not mine & movers:
            stops |= mine
            movers |= route.movers
            kept.add(route.key)
    return [route for route in routes if route.key in kept]


Cliques = list[tuple[int, set[int]]]
"""Sets of activities that are done one at a time, each with its gap."""


@dataclass(frozen=True)
class Place:
    """A state variable that tells where a traveller is: ``members`` (indices) are done one at a
    time with ``gap`` between them, and so are most of ``changes``.
    """

    state: StateVar
    gap: int
    members: frozenset[int]
    changes: list[Change]

    @property
    def free(self) -> frozenset[int]:
        """Where something may put the traveller at any time."""
        return frozenset[int]().union(*(c.targets for c in self.changes if c.free))

    @property
    def owners(self) -> frozenset[int]:
        """Who changes it, of those that are there."""
        return frozenset(c.activity.index for c in self.changes if c.activity is not None)


def refusals(model: ScheduleModel, routes: list[Route]) -> dict[Key, str]:
    """Return why the object-valued state variables that several activities change are no routes."""
    cliques, known = model.disjunctions.sets(), {route.key for route in routes}
    found = {}
    for key, timeline in model.timelines.items():
        if key in known or not isinstance(timeline, Timeline):
            continue
        state = timeline.state
        owners = {w.owner for w in state.writes} - {None}
        if len(state.values or ()) > 2 and len(owners) > 2:
            place = _place(model, timeline, cliques)
            what = "what happens at its places, or its moves, are moves or stops of another"
            found[key] = place if isinstance(place, str) else what
    return found


def _place(model: ScheduleModel, timeline: Timeline, cliques: Cliques) -> Place | str:
    """Return a state variable as a traveller's place, or why it is none."""
    state = timeline.state
    if state.initial is None:
        return "it has no initial value"
    owners = {w.owner for w in state.writes if _happens(model, w.owner)}
    if not owners:
        return "nothing changes it"
    gap, members = max(
        cliques, key=lambda c: (len(owners & c[1]), len(c[1])), default=(0, set[int]())
    )
    if 2 * len(owners & members) < len(owners):
        return "nothing keeps all that changes it one at a time"
    changes = changes_of(model, timeline, members)
    place = Place(state, gap, frozenset(members), changes)
    free = [c for c in changes if c.free]
    if 2 * len(free) > len(changes) or all(c.odd and len(c.targets) > 1 for c in changes):
        name = next(name_of(c) for c in changes if c.odd)
        return f"{name} does not lead from a place at its start to one place in the end"
    values = frozenset(state.values or ())
    if len(values) < 3 and any(c.origins >= values for c in changes):
        return "it is a switch that is set whatever it was"
    if not _stops(model, place)[0]:
        return "nothing that is kept apart from its moves happens at its places"
    return place


def name_of(change: Change) -> str:
    """Return who makes a change."""
    return "the problem itself" if change.activity is None else change.activity.name


def _name(model: ScheduleModel, owner: int | None) -> str:
    return "the problem itself" if owner is None else model.states.activity(owner).name


def _happens(model: ScheduleModel, owner: int | None) -> bool:
    """Return whether what changes or needs a state may be there at all."""
    return owner is None or not model.store.never(model.states.activity(owner).present)


def _route(model: ScheduleModel, place: Place, lengths: Lengths) -> Route:
    """Return the route of a traveller."""
    state = place.state
    bound = [c for c in place.changes if not c.free]
    moves = [move for change in bound for move in _moves(change, lengths)]
    never = frozenset(_name(model, w.owner) for w in state.writes if not _happens(model, w.owner))
    stops, late = _stops(model, place)
    route = Route(
        state.key,
        place.gap,
        state.initial or 0,
        _final(model, state),
        moves,
        stops,
        late,
        odd={name_of(c): c.odd for c in place.changes if c.odd},
        free=place.free,
        never=never,
        lag=_lag(bound),
    )
    _find_returns(model, route)
    find_visits(model, route)
    find_entries(model, route, bound)
    route.still = {} if place.free else find_still(model, state, place.owners)
    return route


def _lag(changes: list[Change]) -> int:
    """Return the time from the end of a move until the next one, or a stop, may begin at least."""
    seen = 1 + min(c.delay for c in changes)
    return max(0, seen - any(c.touches for c in changes))


def _moves(change: Change, lengths: Lengths) -> Iterator[Move]:
    """Yield a change as a move, or as one for each origin and goal where variables tell them: they
    have one name, and happen once together.
    """
    activity = change.activity
    assert activity is not None
    if change.origin is None and change.target is None:
        for to in sorted(change.targets):
            yield Move(activity.name, change.origins, to, activity.least)
        return
    for to in sorted(change.targets):
        told = {} if change.target is None else {change.target: to}
        if change.origin is None:
            some = [(change.origins, told)]
        else:
            some = [(frozenset((a,)), {**told, change.origin: a}) for a in sorted(change.origins)]
        for origins, values in some:
            least = lengths.least(activity, values)
            if least < INFINITE and origins != {to}:
                yield Move(activity.name, origins, to, least, tuple(values.items()))


def _stops(
    model: ScheduleModel, place: Place
) -> tuple[list[tuple[str, frozenset[int]]], frozenset[str]]:
    """Return the stops with their places, and which of them need these only after their start."""
    places: dict[int, frozenset[int]] = {}
    early = set()
    for read in place.state.reads:
        if read.owner is None or read.allowed is None or read.owner in place.owners:
            continue
        if read.owner in place.members and _happens(model, read.owner):
            activity = model.states.activity(read.owner)
            if read.active == activity.present and _inside(model, activity, read):
                known = places.get(read.owner, read.allowed)
                # who may be put elsewhere meanwhile need not be at both
                both = known | read.allowed if place.free else known & read.allowed
                places[read.owner] = both
                if model.states.difference(read.lo, activity.start) == (0, 0):
                    early.add(read.owner)
    late = frozenset(model.states.activity(i).name for i in places.keys() - early)
    # what needs two places at once never happens
    return [(model.states.activity(i).name, p) for i, p in sorted(places.items()) if p], late


def _inside(model: ScheduleModel, activity: ActivityVars, read: Read) -> bool:
    after = model.states.difference(read.lo, activity.start)[0] >= 0
    return after and model.states.difference(activity.end, read.hi)[0] >= 0


def _final(model: ScheduleModel, state: StateVar) -> frozenset[int] | None:
    final: frozenset[int] | None = None
    for read in state.reads:
        if read.owner is None and read.lo == read.hi == model.states.far and read.allowed:
            final = read.allowed if final is None else final & read.allowed
    return final


def _find_returns(model: ScheduleModel, route: Route) -> None:
    """Find what has to be followed by a move: stops, or every move to any other place.

    Assumes: a follow-up asks for some move afterwards, not for the next one or the last one.
    """
    to: dict[str, frozenset[int]] = {}
    for move in route.moves:
        to[move.name] = to.get(move.name, frozenset()) | {move.to}
    stops = {name for name, _ in route.stops}
    left: dict[frozenset[int], set[str]] = {}
    for follow_up in model.follow_ups:
        helpers = follow_up.helpers - route.never
        if not helpers <= to.keys() - route.odd.keys():
            continue
        places = frozenset[int]().union(*(to[h] for h in helpers))
        if follow_up.activity in stops:
            # it may come to one after the other, so each says something alone: the narrower one is
            # kept
            known = route.returns.get(follow_up.activity, places)
            narrower = min(known, places, key=lambda some: (len(some), sorted(some)))
            route.returns[follow_up.activity] = narrower
        elif follow_up.activity in to:
            left.setdefault(places, set()).add(follow_up.activity)
    for places, movers in left.items():
        whoever = {name for name, some in to.items() if not some <= places}
        fixed = route.initial in places and route.final is None and not route.free
        if whoever <= movers and fixed:
            route.final = places
