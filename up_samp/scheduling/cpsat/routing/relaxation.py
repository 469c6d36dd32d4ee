"""The problem with its moves taken out: a relaxation that gives bounds, and a hint for the rest."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import Any

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.encode.disjunctions import merge_forms
from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Form,
    Lin,
    Literal,
    constant,
    disjunction,
    indicator_sum,
)
from up_samp.scheduling.cpsat.encode.states import Write
from up_samp.scheduling.cpsat.encode.terms import INFINITE, ActivityVars
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.route import (
    Entrance,
    Route,
    changes_by_name,
    expand,
    way_back,
)
from up_samp.scheduling.cpsat.routing.rules import cost

# ------------------ The problem with its moves taken out
# A relaxation that gives bounds, and a hint for the rest. Moves are replaced by the time that they
# take at least between what happens at places, in a circuit per traveller. A door is opened before
# anybody passes.
# Constraints that speak of moves are dropped, so every schedule of the problem is one of the
# collapsed problem: its optimum is a lower bound, and if it has no schedule, the problem has none.
# A relaxed schedule, with shortest paths of moves put back in, is a hint for the full model, which
# alone decides whether it holds.


class RoutingRelaxation:
    """The routing relaxation of a problem, for the routes of its full model: the same variables,
    and a ``model`` without the constraints on those of moves.
    """

    def __init__(self, full: ScheduleModel, routes: list[Route]) -> None:
        self.full = full
        self.routes = [route.with_visits() for route in routes]
        activities = full.world.activities
        moves = {name for route in routes for name in route.movers} & activities.keys()
        kept = {name: made for name, made in activities.items() if name not in moves}
        self._movers = {activities[name].index for name in moves}
        moved = _variables(full, moves) - _variables(full, kept.keys())
        for key, state in full.states.vars.items():
            if any(write.owner in self._movers for write in state.writes):
                moved.update(full.orders.get(key, ()))
        self.model = copy.copy(full)
        self.model.store = store = full.store.without(moved)
        for route in routes:
            for name, _ in route.visits:
                at = Lin(((store.integer(0, full.limit), 1),))
                kept[name] = ActivityVars(name, -1, TRUE, at, at, 0, 0, constant(0))
        self.model.world = replace(full.world, store=store, activities=kept)
        self._forms: list[Form] = []
        for route in self.routes:
            self._circuit(route)
        for form in merge_forms(self._forms, full.exact):
            store.enforce(form)

    # -- the circuit of one traveller ----------------------------------------------------------
    def _circuit(self, route: Route) -> None:
        store = self.model.store
        makespan = Lin(((self.model.world.makespan, 1),))
        made, rests = self.model.world.activities, route.rests
        stops = [(made[name], places) for name, places in route.stops if name not in rests]
        circuit: list[tuple[int, int, Any]] = [(0, 0, store.raw(store.boolean()))]
        # what is done anywhere is no stop on the way, and may begin before a move is seen to end
        load = [(made[name].present, max(0, made[name].least - route.step)) for name in rests]
        for j, (stop, places) in enumerate(stops, 1):
            circuit.append((j, j, store.raw(~stop.present)))
            load.append((stop.present, stop.least))
            for i, since, least in self._arcs(route, stops, j):
                literal = store.boolean()
                circuit.append((i, j, store.raw(literal)))
                load.append((literal, least))
                self._when(since.shift(least).le(stop.start), literal)
            back = way_back(route, places, route.final)
            literal = store.boolean()
            circuit.append((j, 0, store.raw(literal)))
            load.append((literal, back))
            self._when(stop.end.shift(back).le(makespan), literal)
            self._enter(route, stop, places)
        store.model.add_circuit(circuit)
        store.enforce(indicator_sum(load).le(makespan))

    def _when(self, form: Form, literal: Literal) -> None:
        """Demand a comparison whatever it needs: ``literal`` says that those are present."""
        bare = form._replace(needs=()) if form.__class__ is not int else form
        self.model.store.enforce(bare, (literal,))

    def _arcs(
        self, route: Route, stops: list[tuple[ActivityVars, frozenset[int]]], j: int
    ) -> Iterator[tuple[int, Lin, int]]:
        """Yield from which stops (0: the start) a traveller may come to stop ``j``, when it is done
        there, and the least time from then on.
        """
        stop, places = stops[j - 1]
        before = [(0, constant(0), frozenset((route.initial,)))]
        before += [
            (i, other.end, origins)
            for i, (other, origins) in enumerate(stops, 1)
            if i != j and self.model.disjunctions.gap(other.index, stop.index) < INFINITE
        ]
        for i, since, origins in before:
            pairs = itertools.product(origins, places)
            least = min(cost(route, a, b, stop.name, first=not i) for a, b in pairs)
            if least < INFINITE:
                yield i, since, least

    # -- what moves need -----------------------------------------------------------------------
    def _enter(self, route: Route, stop: ActivityVars, places: frozenset[int]) -> None:
        """State what a stop needs before anybody can come to it."""
        if route.initial in places or len(places) != 1:
            return
        late = route.step - route.rest(stop.name)
        for entry in route.entries.get(next(iter(places)), ()):
            self._supported(entry, entry.lead - late, stop)

    def _supported(self, entry: Entrance, lead: int, stop: ActivityVars) -> None:
        store = self.model.store
        able = self._able(entry)
        if able is None:
            return
        times = {w.time._replace(needs=()) for w in able}
        if len(times) == 1:
            time = times.pop()
            self._forms.append(disjunction([~stop.present, time.shift(lead).le(stop.start)]))
            self._forms.append(disjunction([~stop.present, *(w.active for w in able)]))
            return
        ways = []
        for write in able:
            literal = store.boolean()
            store.clause([~literal, write.active])
            self._when(write.time.shift(lead).le(stop.start), literal)
            ways.append(literal)
        store.clause([*ways, ~stop.present])

    def _able(self, entry: Entrance) -> list[Write] | None:
        """Return the effects that support an entry; ``None`` where none is needed, or where a move
        may be one.
        """
        state = self.full.states.vars[entry.state]
        if state.numeric or state.initial in entry.allowed:
            return None
        able = [
            write
            for write in state.writes
            if (write.value.terms or write.value.const in entry.allowed)
            and not self.full.store.never(write.active)
        ]
        return None if any(write.owner in self._movers for write in able) else able

    def expanded(self, schedule: CandidateSchedule) -> CandidateSchedule:
        """Return a schedule of the routing relaxation with moves put in."""
        return expand(self.routes, schedule, changes_by_name(self.full))


def _variables(model: ScheduleModel, names: Collection[str]) -> set[int]:
    """Return the variables of some activities."""
    found = {var for var, _, owner in model.parameters.values() if owner in names}
    for made in (model.world.activities[name] for name in names):
        found |= {made.present} - {TRUE}
        found |= {var for lin in (made.start, made.end, made.size) for var, _ in lin.terms}
    return found
