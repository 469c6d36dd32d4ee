"""Routes inside a problem: a state variable that some members of a clique change (moves) and others
need (work at places), all one at a time.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.statevars import Key, Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.store import TRUE, Cmp, Form, Literal
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.encode.timeline import Link, Timeline

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel

INFINITE = 10**12


@dataclass(frozen=True, order=True)
class Move:
    """A transition: from one of ``origins`` to ``to``, lasting at least ``least``."""

    name: str
    origins: frozenset[int]
    to: int
    least: int


@dataclass(frozen=True)
class Entry:
    """Everyone who comes to a place needs ``state`` to be in ``allowed``; a supporting effect
    comes ``lead`` or more before what is done there.
    """

    state: Key
    allowed: frozenset[int]
    lead: int


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
    entries: dict[int, list[Entry]] = field(default_factory=dict)
    still: Still = field(default_factory=dict)
    returns: dict[str, frozenset[int]] = field(default_factory=dict)
    """Stops after which the traveller has to come to one of these places some time."""
    visits: list[tuple[str, frozenset[int]]] = field(default_factory=list)
    """Places where the traveller has to arrive some time, with a name for each: nothing happens
    there. As stops they last no time, and begin when a move ends (see :meth:`with_visits`)."""
    never: frozenset[str] = frozenset()
    """Moves that are stated to be absent: they are not among ``moves``."""
    lag: int = 1
    """Time from the end of a move until its effect is seen: 1 for an effect at the end, 0 for one
    at ``end - 1``."""
    hops: dict[tuple[int, int], list[Move]] = field(default_factory=dict)
    travel: dict[tuple[int, int], int] = field(default_factory=dict)
    _via: dict[tuple[int, int], int] = field(default_factory=dict)
    _leaving: dict[int, list[tuple[int, list[Move]]]] = field(default_factory=dict)
    _ways: dict[tuple[int, frozenset[int]], tuple[int, list[Move]] | None] = field(
        default_factory=dict
    )

    @property
    def step(self) -> int:
        """Time from the end of a move to what may come next (its effect has to be seen)."""
        return max(self.lag, self.gap)

    @property
    def movers(self) -> frozenset[str]:
        """All that is stated to change the place, be it that it never happens."""
        return self.never | {move.name for move in self.moves}

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
        """Compute the shortest travel times between places (Floyd and Warshall)."""
        places = {self.initial, *(m.to for m in self.moves)}
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
            choices = sorted(moves, key=lambda m: (m.least, m.name))
            self._leaving.setdefault(a, []).append((b, choices))
        for via in order:
            for a in order:
                first = self.travel.get((a, via), INFINITE)
                if a == via or first >= INFINITE:
                    continue
                for b in order:
                    through = first + self.travel.get((via, b), INFINITE)
                    if b != via and through < self.travel.get((a, b), INFINITE):
                        self.travel[a, b] = through
                        self._via[a, b] = via

    def between(self, some: frozenset[int], others: frozenset[int]) -> int:
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

    def leaving(self, place: int) -> list[tuple[int, list[Move]]]:
        """Return where one can go from a place, with the moves there, the quickest first."""
        return self._leaving.get(place, [])

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
        leaving, step = self._leaving, self.step
        ties = itertools.count()
        heap: list[tuple[int, int, int, list[Move]]] = [(0, here, next(ties), [])]
        done = set()
        while heap:
            distance, place, _, moves = heapq.heappop(heap)
            if place in targets:
                return distance, moves
            if place in done:
                continue
            done.add(place)
            for to, choices in leaving.get(place, ()):
                if to not in done:
                    move = next((m for m in choices if m.name not in banned), None)
                    if move is not None:
                        cost = distance + move.least + step
                        heapq.heappush(heap, (cost, to, next(ties), [*moves, move]))
        return None


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
    _find_entries(model, route, possible)
    route.still = _find_still(model, state, possible)
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


def _find_entries(model: ScheduleModel, route: Route, links: list[Link]) -> None:
    """Find what every transition into a place needs of other state variables (open doors)."""
    into: dict[int, list[ActivityVars]] = {}
    for link in links:
        activity = model.states.activity(link.write.owner or 0)
        into.setdefault(link.write.value.const, []).append(activity)
    movers = {link.write.owner for link in links}
    needs: Needs = {}
    for other in model.states.vars.values():
        if any(write.owner in movers for write in other.writes):
            continue  # a move may provide what it needs itself
        for read in other.reads:
            if read.owner is not None and read.allowed is not None and not read.guard_only:
                activity = model.states.activity(read.owner)
                before = model.states.difference(activity.end, read.lo)[0]
                if read.active == activity.present and before >= 0:
                    lead = before + 1 + route.step
                    needs.setdefault(read.owner, {})[other.key, read.allowed] = lead
    for place, activities in into.items():
        common = None
        for activity in activities:
            mine = set(needs.get(activity.index, {}))
            common = mine if common is None else common & mine
        for key, allowed in sorted(common or (), key=str):
            if model.states.vars[key].initial in allowed:
                continue
            lead = min(needs[a.index][key, allowed] for a in activities)
            route.entries.setdefault(place, []).append(Entry(key, allowed, max(0, lead)))
    _find_closed_off(model, route, needs)


Needs = dict[int, dict[tuple[Key, frozenset[int]], int]]
"""What each move needs of other state variables -> how long before what is done where it leads."""


def _find_closed_off(model: ScheduleModel, route: Route, needs: Needs) -> None:
    """Find the places to which there is no way but by moves that all need the same (rooms behind
    a door): to come there, one of these has been made before.
    """
    index = {move.name: model.world.activities[move.name].index for move in route.moves}
    for key, allowed in sorted({need for some in needs.values() for need in some}, key=str):
        if model.states.vars[key].initial in allowed:
            continue
        free = [m for m in route.moves if (key, allowed) not in needs.get(index[m.name], {})]
        leads = [some[key, allowed] for some in needs.values() if (key, allowed) in some]
        reached, size = {route.initial}, 0
        while size < len(reached):
            size = len(reached)
            reached |= {m.to for m in free if m.origins & reached}
        for place in sorted({m.to for m in route.moves} - reached):
            known = route.entries.setdefault(place, [])
            if not any((e.state, e.allowed) == (key, allowed) for e in known):
                known.append(Entry(key, allowed, max(0, min(leads))))


def _find_still(model: ScheduleModel, place: StateVar, links: list[Link]) -> Still:
    """Return what every transition keeps as it is between its start and its end."""
    owners = {link.write.owner for link in links}
    found: Still = {}
    for state in model.states.vars.values():
        if state is place or not state.writes or state.numeric:
            continue
        if any(write.owner is None or write.owner in owners for write in state.writes):
            continue  # nothing is kept apart from what the problem itself changes
        spans: dict[int, tuple[int, int]] = {}
        for read in state.reads:
            if read.owner is not None and read.owner in owners:
                span = _kept(model, model.states.activity(read.owner), read)
                known = spans.get(read.owner)
                if span is not None and (known is None or _width(span) > _width(known)):
                    spans[read.owner] = span
        if not spans:
            continue
        common = max(s[0] for s in spans.values()), min(s[1] for s in spans.values())
        others = [model.states.activity(o or 0) for o in owners - spans.keys()]
        # what lasts one unit has no midst
        if not others or (_width(common) <= 0 and all(a.least <= 1 for a in others)):
            found[state.key] = common
    return found


def _width(span: tuple[int, int]) -> int:
    return span[1] - span[0]


def _kept(model: ScheduleModel, activity: ActivityVars, read: Read) -> tuple[int, int] | None:
    """Return (a, b): effects on what is read come by ``start + a`` or from ``end + b`` on."""
    after = model.states.difference(read.lo, activity.start)[1] - 1
    before = 1 - model.states.difference(activity.end, read.hi)[1]
    near = after <= 0 and before >= -1
    return (after, before) if near and read.active == activity.present else None


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
        arrivals, departures = _unit_moves(model, writes)
        if arrivals is None:
            continue
        places = []
        for route in routes:
            inside = frozenset(m.to for m in route.moves if m.name in arrivals)
            comes = {m.name for m in route.moves if m.to in inside}
            goes = {m.name for m in route.moves if m.origins & inside}
            own = {m.name for m in route.moves}
            origins: dict[str, frozenset[int]] = {}
            for move in route.moves:
                origins[move.name] = origins.get(move.name, frozenset()) | move.origins
            mixed = any(some & inside and not some <= inside for some in origins.values())
            if mixed or comes != arrivals & own or goes != departures & own:
                break
            places.append((route.key, inside))
        else:
            here = sum(
                route.initial in inside for route, (_, inside) in zip(routes, places, strict=True)
            )
            if here + (state.initial or 0) <= 1:  # who is there has it
                found.append(UnitPlace(key, tuple(places)))
    return found


def _unit_moves(model: ScheduleModel, writes: list[Write]) -> tuple[set[str] | None, set[str]]:
    """Return who takes a unit at its end and who gives it back at its start, or a unit after it;
    None if anybody does anything else with it.
    """
    arrivals, departures = set(), set()
    for write in writes:
        activity = model.states.activity(write.owner or 0)
        if write.value.terms or write.active != activity.present:
            return None, set()
        start = model.states.difference(write.time, activity.start) in ((0, 0), (1, 1))
        end = model.states.difference(write.time, activity.end) == (0, 0)
        if write.value.const == -1 and end:
            arrivals.add(activity.name)
        elif write.value.const == 1 and start:
            departures.add(activity.name)
        else:
            return None, set()
    return arrivals, departures
