"""The problem with its moves taken out: a relaxation that gives bounds, and a hint for the rest.

Moves are replaced by the time that they take at least between what happens at places, in a circuit
per traveller. Constraints, conditions and effects that speak of moves are dropped, so every
schedule of the problem is one of the collapsed problem: its optimum is a lower bound, and if it has
no schedule, the problem has none. A collapsed schedule, with shortest paths of moves put
back in, is a hint for the full model; the full model alone decides whether it holds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.problem import Additions
from up_samp.scheduling.cpsat.routes import INFINITE, Entry, Route
from up_samp.scheduling.cpsat.store import TRUE, Lin, Literal, constant, indicator_sum
from up_samp.scheduling.cpsat.terms import ActivityVars

MOST_ARCS = 100_000


class Collapsed:
    """The collapsed model of a problem, for the routes of its full model."""

    def __init__(self, full: ScheduleModel, parts: Additions, routes: list[Route]) -> None:
        self.routes = routes
        self.full = full
        removed = {move.name for route in routes for move in route.moves}
        self.model = ScheduleModel(full.problem)
        self.model.limit_at_least = full.limit
        self.model.build(_without(parts, removed))
        self.arcs: dict[tuple[int, int, int], Literal] = {}
        for number, route in enumerate(routes):
            self._circuit(number, route)

    # -- the model -----------------------------------------------------------------------------
    def _circuit(self, number: int, route: Route) -> None:
        store = self.model.store
        makespan = Lin(((self.model.world.makespan, 1),))
        stops = [(self.model.world.activities[name], places) for name, places in route.stops]
        arcs: list[tuple[int, int, Any]] = [(0, 0, store.raw(store.boolean()))]
        load: list[tuple[Literal, int]] = []
        home = frozenset((route.initial,))
        for j, (stop, places) in enumerate(stops, 1):
            arcs.append((j, j, store.raw(~stop.present)))
            load.append((stop.present, stop.least))
            ways = [(0, route.between(home, places), constant(0))]
            for i, (other, origins) in enumerate(stops, 1):
                if i != j:
                    distance = route.between(origins, places) + route.gap
                    ways.append((i, distance, other.end))
            for i, distance, since in ways:
                if distance < INFINITE:
                    literal = self.arcs[number, i, j] = store.boolean()
                    arcs.append((i, j, store.raw(literal)))
                    load.append((literal, distance))
                    form = since.shift(distance).le(stop.start)._replace(needs=())
                    store.enforce(form, (literal,))
            back = self._way_back(route, places)
            literal = store.boolean()
            arcs.append((j, 0, store.raw(literal)))
            load.append((literal, back))
            store.enforce(stop.end.shift(back).le(makespan)._replace(needs=()), (literal,))
            self._enter(route, stop, places)
        store.model.add_circuit(arcs)
        store.enforce(indicator_sum(load).le(makespan))

    @staticmethod
    def _way_back(route: Route, places: frozenset[int]) -> int:
        """Return the time from the end of a last stop to the end of everything."""
        if route.final is None or places & route.final:
            return 0
        distance = route.between(places, route.final)
        return 0 if distance >= INFINITE else route.gap + distance - route.step

    def _enter(self, route: Route, stop: ActivityVars, places: frozenset[int]) -> None:
        """State what a stop needs before anybody can come to it."""
        if route.initial in places or len(places) != 1:
            return
        for entry in route.entries.get(next(iter(places)), ()):
            self._supported(entry, stop)

    def _supported(self, entry: Entry, stop: ActivityVars) -> None:
        store = self.model.store
        state = self.model.states.vars.get(entry.state)
        if state is None or not state.writes or state.numeric or state.initial in entry.allowed:
            return
        ways = []
        for write in state.writes:
            if write.value.terms or write.value.const in entry.allowed:
                literal = store.boolean()
                store.clause([~literal, write.active])
                in_time = write.time.shift(entry.lead).le(stop.start._replace(needs=()))
                store.enforce(in_time, (literal,))
                ways.append(literal)
        store.clause([*ways, ~stop.present])

    def once_only(self) -> None:
        """Restrict shortest paths to what the moves allow: each happens at most once.

        No relaxation any more, since a detour might help; for hints.
        """
        store = self.model.store
        for number, route in enumerate(self.routes):
            users: dict[tuple[int, int], list[Literal]] = {}
            for (owner, i, j), literal in self.arcs.items():
                if owner != number:
                    continue
                origins = frozenset((route.initial,)) if i == 0 else route.stops[i - 1][1]
                targets = route.stops[j - 1][1]
                if len(origins) == 1 and len(targets) == 1:
                    for hop in route.path(next(iter(origins)), next(iter(targets))):
                        users.setdefault(hop, []).append(literal)
            for hop, literals in users.items():
                total = indicator_sum([(x, 1) for x in literals])
                store.enforce(total.le(constant(len(route.hops[hop]))))

    def hints(self, known: dict[int, int]) -> dict[int, int]:
        """Translate values of the full model's variables to this model's."""
        found = {}
        for name, made in self.model.world.activities.items():
            other = self.full.world.activities[name]
            pairs = [(made.present, other.present)] if made.present != TRUE else []
            for mine, theirs in ((made.start, other.start), (made.end, other.end)):
                pairs.append((mine.terms[0][0], theirs.terms[0][0]))
            found.update({mine: known[theirs] for mine, theirs in pairs if theirs in known})
        return found

    # -- back to the full problem --------------------------------------------------------------
    def expand(self, schedule: CandidateSchedule) -> CandidateSchedule:
        """Return ``schedule`` with moves put in, as early as they may happen."""
        times = dict(schedule.times)
        used: set[str] = set()
        for route in self.routes:
            here, free = route.initial, 0
            stops = [(times[n], n, p) for n, p in route.stops if n in times]
            legs: list[tuple[int, frozenset[int]]] = []
            for (start, end), _, places in sorted(stops):
                legs.append((end, places))
                here, free = _drive(route, here, free, places, times, used)
                free = max(end + route.gap, start)
            if route.final is not None:
                _drive(route, here, free, route.final, times, used)
        return CandidateSchedule(times, schedule.parameters)


def _drive(
    route: Route,
    here: int,
    free: int,
    places: frozenset[int],
    times: dict[str, tuple[int, int]],
    used: set[str],
) -> tuple[int, int]:
    """Put the moves of a shortest path into ``times``; return (place, time when free)."""
    if not places or here in places:
        return here, free
    target = route.nearest(here, places)
    if route.travel.get((here, target), INFINITE) >= INFINITE:
        return here, free
    for hop in route.path(here, target):
        moves = sorted(route.hops[hop], key=lambda m: (m.name in used, m.least, m.name))
        move = moves[0]
        if move.name not in used:
            used.add(move.name)
            times[move.name] = (free, free + move.least)
        free += move.least + route.step
    return target, free


def _without(parts: Additions, removed: set[str]) -> Additions:
    """Return ``parts`` without the activities in ``removed`` and whatever speaks of them."""
    broken, broken_names = _broken(parts, removed)
    memo: dict[FNode, bool] = {}

    def clean(node: FNode) -> bool:
        known = memo.get(node)
        if known is None:
            known = _clean(node, removed, broken, broken_names, clean)
            memo[node] = known
        return known

    kept = Additions()
    kept.activities = [a for a in parts.activities if a.name not in removed]
    kept.variables = parts.variables
    kept.parameters = [p for p in parts.parameters if p[0].name not in removed]
    kept.constraints = [
        c for c in parts.constraints if _keeps(c[2], removed) and all(map(clean, (c[0], *c[1])))
    ]
    kept.conditions = [
        c
        for c in parts.conditions
        if _keeps(c[2], removed)
        and clean(c[1])
        and _timings_clean((c[0].lower, c[0].upper), removed)
    ]
    kept.effects = [
        e
        for e in parts.effects
        if _keeps(e[2], removed)
        and clean(e[1].fluent)
        and clean(e[1].value)
        and clean(e[1].condition)
        and _timings_clean((e[0],), removed)
    ]
    return kept


def _keeps(owner: Any, removed: set[str]) -> bool:
    return owner is None or owner.name not in removed


def _timings_clean(timings: tuple[Any, ...], removed: set[str]) -> bool:
    return all(t.timepoint.container not in removed for t in timings)


def _broken(parts: Additions, removed: set[str]) -> tuple[set[FNode], set[str]]:
    """Return the ground fluents, and the names of fluents, that removed activities change."""
    nodes, names = set(), set()
    for _, effect, owner in parts.effects:
        if owner is not None and owner.name in removed:
            if all(a.is_constant() for a in effect.fluent.args):
                nodes.add(effect.fluent)
            else:
                names.add(effect.fluent.fluent().name)
    return nodes, names


def _clean(
    node: FNode,
    removed: set[str],
    broken: set[FNode],
    names: set[str],
    recur: Callable[[FNode], bool],
) -> bool:
    kind = node.node_type
    if kind is Op.TIMING_EXP:
        return node.timing().timepoint.container not in removed
    if kind is Op.PRESENT_EXP:
        return node.presence().container not in removed
    if kind is Op.PARAM_EXP:
        return node.parameter().name.rsplit(".", 1)[0] not in removed
    if kind is Op.FLUENT_EXP:
        fluent = node.fluent().name
        if node in broken or fluent in names:
            return False
        touched = any(b.fluent().name == fluent for b in broken)
        if touched and not all(a.is_constant() for a in node.args):
            return False
    return all(recur(a) for a in node.args)
