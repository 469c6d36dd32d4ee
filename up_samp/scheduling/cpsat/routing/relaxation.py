"""The problem with its moves taken out: a relaxation that gives bounds, and a hint for the rest.

Moves are replaced by the time that they take at least between what happens at places, in a circuit
per traveller. A move happens once at most, so only one leg can use it, and others pay for a detour.
What moves keep as it is (doors) changes between the legs only, a door is opened once
(:mod:`.once`), a unary place is used by one after the other, and what moves take from
(:mod:`.levels`) lasts. Other constraints, conditions
and effects that speak of moves are dropped, so every schedule of the problem is one of the
collapsed problem: its optimum is a lower bound, and if it has no schedule, the problem has none. A
relaxed schedule, with shortest paths of moves put back in, is a hint for the full model; the full
model alone decides whether it holds.
"""

from __future__ import annotations

from typing import Any

from unified_planning.model.scheduling import Activity

from up_samp.model import CandidateSchedule, Deadline
from up_samp.scheduling.cpsat.encode.alternatives import merge_forms
from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Form,
    Lin,
    Literal,
    constant,
    disjunction,
    indicator_sum,
)
from up_samp.scheduling.cpsat.encode.statevars import Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.problem import Additions
from up_samp.scheduling.cpsat.routing.dispatch import find_tasks
from up_samp.scheduling.cpsat.routing.expand import changes_by_name, expand
from up_samp.scheduling.cpsat.routing.legs import Arc, Legs, Travel, entry_form
from up_samp.scheduling.cpsat.routing.levels import Course, find_levels
from up_samp.scheduling.cpsat.routing.once import opened_once
from up_samp.scheduling.cpsat.routing.order import PrecedenceClosure
from up_samp.scheduling.cpsat.routing.reduce import without
from up_samp.scheduling.cpsat.routing.route import INFINITE, Entry, Route
from up_samp.scheduling.cpsat.routing.unit_places import find_unit_places


class RoutingRelaxation:
    """The routing relaxation of a problem, for the routes of its full model.

    :raises OutOfTimeError: when ``deadline`` comes before it is built.
    """

    def __init__(
        self, full: ScheduleModel, parts: Additions, routes: list[Route], deadline: Deadline
    ) -> None:
        self.full = full
        removed = {name for route in routes for name in route.movers}
        tasks = find_tasks(full, routes)
        self.routes = routes = [route.with_visits() for route in routes]
        kept = without(parts, removed)
        kept.constraints += opened_once(kept, tasks)
        environment = full.problem.environment
        kept.activities += [
            Activity(name, 0, _env=environment) for route in routes for name, _ in route.visits
        ]
        self.model = ScheduleModel(full.problem, kept, deadline, limit_at_least=full.limit)
        self.units = find_unit_places(full, routes)
        self._legs = Legs(self.model.store, self.model.limit, self.units, routes)
        self._forms: list[Form] = []
        self._order = PrecedenceClosure(self.model.stated)
        for route in routes:
            self._circuit(route)
        for form in merge_forms(self._forms, self.model.exact):
            self.model.store.enforce(form)
        self._legs.keep_still(self.model.states.vars)
        self._legs.hold(self.model.surely)

    # -- the circuit of one traveller ----------------------------------------------------------
    def _circuit(self, route: Route) -> None:
        store = self.model.store
        makespan = Lin(((self.model.world.makespan, 1),))
        stops = [(self.model.world.activities[name], places) for name, places in route.stops]
        circuit: list[tuple[int, int, Any]] = [(0, 0, store.raw(store.boolean()))]
        load: list[tuple[Literal, int]] = []
        hops: dict[tuple[int, int], list[Literal]] = {}
        courses = [Course(store, level, stops) for level in find_levels(self.full, route)]
        for j, (stop, places) in enumerate(stops, 1):
            circuit.append((j, j, store.raw(~stop.present)))
            load.append((stop.present, stop.least))
            arcs = self._arcs(route, stops, j)
            for arc in arcs:
                circuit.append((arc.i, j, store.raw(arc.literal)))
                late = route.step - arc.rest if arc.distance else 0
                load.append((arc.literal, arc.lead + arc.distance - late))
                soonest = arc.since.shift(arc.lead + arc.distance - late)
                self._legs.when(soonest.le(stop.start), arc.literal)
                if arc.hop is not None:
                    hops.setdefault(arc.hop, []).append(arc.literal)
            back = self._way_back(route, stop.name, places)
            literal = store.boolean()
            circuit.append((j, 0, store.raw(literal)))
            load.append((literal, back))
            self._legs.when(stop.end.shift(back).le(makespan), literal)
            for course in courses:
                course.come(j, arcs)
                course.leave(j, literal, route.returns.get(stop.name, route.final))
            leg = self._legs.add(route, stop, arcs)
            self._legs.stay(route, stop, places, arcs)
            self._enter(route, stop, places, leg, arcs)
        store.model.add_circuit(circuit)
        store.enforce(indicator_sum(load).le(makespan))
        for hop, literals in hops.items():
            most = len(route.hops[hop])
            if len(literals) > most:
                store.enforce(indicator_sum([(x, 1) for x in literals]).le(constant(most)))

    def _arcs(
        self, route: Route, stops: list[tuple[ActivityVars, frozenset[int]]], j: int
    ) -> list[Arc]:
        """Return the ways to come to stop ``j``."""
        stop, places = stops[j - 1]
        before = [(0, constant(0), 0, frozenset((route.initial,)))]
        before += [
            (i, other.end, route.gap, origins)
            for i, (other, origins) in enumerate(stops, 1)
            if i != j and not self._never_after(other, stop)
        ]
        arcs = []
        rest = route.rest(stop.name)
        for i, since, lead, origins in before:
            for distance, last, hop in self._ways(route, origins, places):
                literal = self.model.store.boolean()
                around = route.around(*hop) if hop is not None and route.still else None
                stays = distance == 0 and origins == places and len(places) == 1
                arcs.append(Arc(i, literal, since, lead, distance, last, rest, hop, around, stays))
        return arcs

    def _never_after(self, one: ActivityVars, other: ActivityVars) -> bool:
        """Return whether ``other`` cannot come after ``one``: it is an alternative, or earlier."""
        pair = (min(one.index, other.index), max(one.index, other.index))
        if pair in self.model.disjunctions.exclusive:
            return True
        return self._order.before(other.start.terms[0][0], one.start.terms[0][0])

    def _ways(
        self, route: Route, origins: frozenset[int], places: frozenset[int]
    ) -> list[tuple[int, int, tuple[int, int] | None]]:
        """Return (travel time, least duration of the last move, move if it is direct): the best
        way, and a worse one where the best cannot be had by everybody.
        """
        best = route.between(origins, places)
        if best >= INFINITE:
            return []
        if len(origins) > 1 or len(places) > 1:
            return [(best, route.last_least(places) if best else 0, None)]
        (a,), (b,) = origins, places
        last = route.last_least(places)
        if a == b:
            loop = route.loop(a)
            wanted = loop < INFINITE and any(b in u.places_of(route.key) for u in self.units)
            return [(0, 0, None), (loop, last, None)] if wanted else [(0, 0, None)]
        if route.free or not route.is_direct(a, b):
            return [(best, last, None)]
        ways: list[tuple[int, int, tuple[int, int] | None]] = [(best, route.least(a, b), (a, b))]
        arrivals = sum(p == places for _, p in route.stops)
        if arrivals > len(route.hops[a, b]):
            detour = route.way(a, places, {m.name for m in route.hops[a, b]})
            if detour is not None:
                ways.append((detour[0], last, None))
        return ways

    @staticmethod
    def _way_back(route: Route, stop: str, places: frozenset[int]) -> int:
        """Return the time from the end of a last stop to the end of everything."""
        final = route.returns.get(stop, route.final)
        if final is None or places & final:
            return 0
        distance = route.between(places, final)
        return 0 if distance >= INFINITE else max(0, route.gap + distance - route.step)

    # -- what moves need -----------------------------------------------------------------------
    def _enter(
        self,
        route: Route,
        stop: ActivityVars,
        places: frozenset[int],
        leg: Travel | None,
        arcs: list[Arc],
    ) -> None:
        """State what a stop needs before anybody can come to it."""
        if route.initial in places or len(places) != 1:
            return
        late = route.step - route.rest(stop.name)
        for entry in route.entries.get(next(iter(places)), ()):
            self._supported(entry, entry.lead - late, stop, leg, arcs)

    def _supported(
        self, entry: Entry, lead: int, stop: ActivityVars, leg: Travel | None, arcs: list[Arc]
    ) -> None:
        store = self.model.store
        able = self._able(entry)
        if able is None:
            return
        times = {w.time._replace(needs=()) for w in able}
        if len(times) == 1:
            time = times.pop()
            self._forms.append(entry_form(stop, time, lead))
            self._forms.append(disjunction([~stop.present, *(w.active for w in able)]))
            if leg is not None:
                self._legs.open_before(leg, arcs, entry, time)
            return
        ways = []
        for write in able:
            literal = store.boolean()
            store.clause([~literal, write.active])
            self._legs.when(write.time.shift(lead).le(stop.start), literal)
            ways.append(literal)
        store.clause([*ways, ~stop.present])

    def _able(self, entry: Entry) -> list[Write] | None:
        """Return the effects, in the routing relaxation, that support an entry; ``None`` where none
        is needed, or where a move may be one.
        """
        state = self.model.states.vars.get(entry.state)
        if state is not None and state.writes:
            if state.numeric or state.initial in entry.allowed:
                return None
            return [w for w in state.writes if w.value.terms or w.value.const in entry.allowed]
        whole = self.full.states.vars[entry.state]
        if whole.numeric or whole.initial in entry.allowed:
            return None
        able = []
        for write in whole.writes:
            if write.value.terms or write.value.const not in entry.allowed:
                continue
            if self.full.store.never(write.active):
                continue
            found = self._translated(write)
            if found is None:
                return None
            able.append(found)
        return able

    def _translated(self, write: Write) -> Write | None:
        """Return an effect of the whole problem at the same time of the same activity."""
        owner = self.full.states.activity(write.owner) if write.owner is not None else None
        made = self.model.world.activities.get("" if owner is None else owner.name)
        if owner is None or made is None or write.active != owner.present:
            return None
        low, high = self.full.states.difference(write.time, owner.end)
        if low != high:
            return None
        time = made.end.shift(low)._replace(needs=())
        return Write(made.index, made.present, time, write.value)

    def expanded(self, schedule: CandidateSchedule) -> CandidateSchedule:
        """Return a schedule of the routing relaxation with moves put in."""
        return expand(self.routes, schedule, changes_by_name(self.full))

    def hints(self, known: dict[int, int]) -> dict[int, int]:
        """Translate values of the full model's variables to this model's."""
        found = {}
        for name, made in self.model.world.activities.items():
            other = self.full.world.activities.get(name)
            if other is None:  # a visit
                continue
            pairs = [(made.present, other.present)] if made.present != TRUE else []
            for mine, theirs in ((made.start, other.start), (made.end, other.end)):
                pairs.append((mine.terms[0][0], theirs.terms[0][0]))
            found.update({mine: known[theirs] for mine, theirs in pairs if theirs in known})
        return found
