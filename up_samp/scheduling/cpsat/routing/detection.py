"""Routes inside a problem: a state variable that some members of a clique change (moves) and others
need (work at places), all one at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.statevars import Key, Read, StateVar
from up_samp.scheduling.cpsat.encode.store import TRUE, Cmp, Form, Literal
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.encode.timeline import Link, Timeline
from up_samp.scheduling.cpsat.routing.entrances import find_entries, find_still
from up_samp.scheduling.cpsat.routing.route import Move, Route

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel


def find_routes(model: ScheduleModel) -> list[Route]:
    """Return the routes of a model that can be collapsed together."""
    routes = []
    cliques = model.disjunctions.sets()
    for timeline in model.timelines.values():
        if isinstance(timeline, Timeline) and refusal(model, timeline, cliques) is None:
            routes.append(_route(model, timeline, cliques))
    # what happens at a place on one route stays: it cannot be a move of another that is collapsed
    stops = {name for route in routes for name, _ in route.stops}
    routes = [r for r in routes if not any(move.name in stops for move in r.moves)]
    for route in routes:
        route.measure()
    return routes


Cliques = list[tuple[int, set[int]]]
"""Sets of activities that are done one at a time, each with its gap."""


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
            why = refusal(model, timeline, cliques)
            found[key] = why or "what happens at its places moves somebody else"
    return found


def refusal(model: ScheduleModel, timeline: Timeline, cliques: Cliques) -> str | None:
    """Return why a state variable is no traveller's place (``None``: it is)."""
    state = timeline.state
    if state.initial is None:
        return "it has no initial value"
    if not state.writes:
        return "nothing changes it"
    owners = {w.owner for w in state.writes}
    readers = {r.owner for r in state.reads if r.allowed is not None}
    for owner in sorted(owners - readers, key=str):
        return f"{_name(model, owner)} changes it wherever it was"
    clique = _clique(owners, cliques)
    if clique is None:
        return "nothing keeps all that changes it one at a time"
    for i, write in enumerate(state.writes):
        link = timeline.linked.get(i)
        if link is None or not _plain(model, link):
            name = _name(model, write.owner)
            return f"{name} does not lead from a place at its start to one place in the end"
    if not _stops(model, state, clique[1] - {o for o in owners if o is not None})[0]:
        return "nothing that is kept apart from its moves happens at its places"
    return None


def _name(model: ScheduleModel, owner: int | None) -> str:
    return "the problem itself" if owner is None else model.states.activity(owner).name


def _happens(model: ScheduleModel, owner: int | None) -> bool:
    """Return whether what changes or needs a state may be there at all."""
    return owner is None or not model.store.never(model.states.activity(owner).present)


def _clique(owners: set[int | None], cliques: Cliques) -> tuple[int, set[int]] | None:
    fitting = (c for c in cliques if owners <= c[1])
    return max(fitting, key=lambda c: len(c[1]), default=None)


def _route(model: ScheduleModel, timeline: Timeline, cliques: Cliques) -> Route:
    """Return the route of a state variable that :func:`refusal` has nothing against."""
    state = timeline.state
    links = list(timeline.linked.values())
    owners = {w.owner for w in state.writes}
    gap, members = _clique(owners, cliques) or (0, set())
    lasting = _lasting(model)
    possible = [link for link in links if _happens(model, link.write.owner)]
    moves = [move for link in possible for move in _moves(model, link, lasting)]
    never = frozenset(_name(model, o) for o in owners if not _happens(model, o))
    stops, late = _stops(model, state, members - {o for o in owners if o is not None})
    lag = 1 + min(_delay(model, link) for link in links)
    final = _final(model, state)
    route = Route(
        state.key, gap, state.initial or 0, final, moves, stops, late, never=never, lag=lag
    )
    _find_returns(model, route)
    _find_visits(model, route)
    find_entries(model, route, possible)
    route.still = find_still(model, state, possible)
    return route


Lasting = dict[tuple[Literal, int, int], int]
"""(presence, variable, value) -> how long an activity lasts at least with that value."""


def _lasting(model: ScheduleModel) -> Lasting:
    """Return what is stated about durations for single values of variables: as a clause of "it is
    absent", "it lasts so long" and "the variable has another value".
    """
    by_times = {
        ((a.start.terms[0][0], 1), (a.end.terms[0][0], -1)): a
        for a in model.world.activities.values()
        if a.size.terms
    }
    found: Lasting = {}
    for form in model.stated:
        if form.__class__ is not tuple or form[0] != "|" or len(form) != 4:
            continue
        absent = [x for x in form[1:] if x.__class__ is int]
        others = [x for x in form[1:] if x.__class__ is Cmp and x.op == "!="]
        longer = [y for x in form[1:] for y in _times(x)]
        if (len(absent), len(others), len(longer)) != (1, 1, 1):
            continue
        activity = by_times.get(tuple(sorted(longer[0].terms, key=lambda t: -t[1])))  # type: ignore[arg-type]
        chosen = others[0].terms
        if activity is None or activity.present != ~absent[0] or len(chosen) != 1:
            continue
        (variable, factor), shift = chosen[0], others[0].const
        if factor == 1 and longer[0].const > 0:
            key = (activity.present, variable, -shift)
            found[key] = max(longer[0].const, found.get(key, 0))
    return found


def _times(form: Form) -> list[Cmp]:
    """Return the comparison of times in a part of a clause, with the presence that it needs."""
    parts = form[1:] if form.__class__ is tuple and form[0] == "&" else (form,)
    return [p for p in parts if p.__class__ is Cmp and p.op == "<=" and len(p.terms) == 2]


def _moves(model: ScheduleModel, link: Link, lasting: Lasting) -> list[Move]:
    """Return a transition as a move, or as one for each origin where a variable tells it: they
    have one name, and happen once together.
    """
    activity = model.states.activity(link.write.owner or 0)
    origins, to = link.read.allowed or frozenset(), link.write.value.const
    if link.read.value is None:
        return [Move(activity.name, origins, to, activity.least)]
    terms = link.read.value.terms
    variable = terms[0][0] if terms == ((terms[0][0], 1),) and not link.read.value.const else -1
    return [
        Move(
            activity.name,
            frozenset((origin,)),
            to,
            max(activity.least, lasting.get((activity.present, variable, origin), 0)),
        )
        for origin in sorted(origins)
    ]


def _plain(model: ScheduleModel, link: Link) -> bool:
    """Return whether a transition needs its origin from its start and arrives in the end."""
    activity = model.states.activity(link.write.owner or 0)
    starts = model.states.difference(link.read.lo, activity.start) == (0, 0)
    low, high = model.states.difference(link.write.time, activity.end)
    ends = low == high <= 0
    return starts and ends and link.write.active == activity.present and not link.write.value.terms


def _delay(model: ScheduleModel, link: Link) -> int:
    """Return the time of a transition's effect, counted from its end (0 or less)."""
    activity = model.states.activity(link.write.owner or 0)
    return model.states.difference(link.write.time, activity.end)[0]


def _stops(
    model: ScheduleModel, state: StateVar, members: set[int]
) -> tuple[list[tuple[str, frozenset[int]]], frozenset[str]]:
    """Return the stops with their places, and which of them need these only after their start."""
    places: dict[int, frozenset[int]] = {}
    early = set()
    for read in state.reads:
        if read.owner in members and read.allowed is not None and _happens(model, read.owner):
            activity = model.states.activity(read.owner)
            if read.active == activity.present and _inside(model, activity, read):
                places[read.owner] = places.get(read.owner, read.allowed) & read.allowed
                if model.states.difference(read.lo, activity.start) == (0, 0):
                    early.add(read.owner)
    late = frozenset(model.states.activity(i).name for i in places.keys() - early)
    return [(model.states.activity(i).name, p) for i, p in sorted(places.items())], late


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
    """Find what has to be followed by a move: stops, or every move to any other place."""
    to = {move.name: move.to for move in route.moves}
    stops = {name for name, _ in route.stops}
    left: dict[frozenset[int], set[str]] = {}
    for follow_up in model.follow_ups:
        helpers = follow_up.helpers - route.never
        if not helpers <= to.keys():
            continue
        places = frozenset(to[h] for h in helpers)
        if follow_up.activity in stops:
            known = route.returns.get(follow_up.activity)
            route.returns[follow_up.activity] = places if known is None else known & places
        elif follow_up.activity in to:
            left.setdefault(places, set()).add(follow_up.activity)
    for places, movers in left.items():
        whoever = {name for name, place in to.items() if place not in places}
        if whoever <= movers and route.initial in places and route.final is None:
            route.final = places


def _find_visits(model: ScheduleModel, route: Route) -> None:
    """Find the places to which one of some moves has to be made.

    A visit begins when such a move ends, so nothing may need a rest after it.
    """
    if route.gap > 0:
        return
    leading = {model.world.activities[m.name].present: m.to for m in route.moves}
    clauses = [form[1:] if form.__class__ is tuple and form[0] == "|" else (form,)
               for form in model.stated]  # fmt: skip
    clauses += [*model.exact.values(), *((p,) for p in leading if p == TRUE)]
    visited = set()
    for every in clauses:
        clause = [x for x in every if x.__class__ is not int or not model.store.never(x)]
        if all(literal.__class__ is int and literal in leading for literal in clause):
            places = {leading[literal] for literal in clause}
            visited |= places if len(places) == 1 else set()
    known = {next(iter(places)) for _, places in route.stops if len(places) == 1}
    for place in sorted(visited - known):
        route.visits.append((f"visit {place} of {route.key}", frozenset((place,))))
    route.late |= {name for name, _ in route.visits}
