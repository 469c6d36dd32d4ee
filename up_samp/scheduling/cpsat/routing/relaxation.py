"""The problem with its moves taken out: a relaxation that gives bounds, and a hint for the rest."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from unified_planning.model import Effect, FNode, TimeInterval, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import TimepointKind

from up_samp.model import CandidateSchedule, Deadline
from up_samp.scheduling.cpsat.encode.disjunctions import merge_forms
from up_samp.scheduling.cpsat.encode.durations import INFINITE
from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Form,
    Lin,
    Literal,
    constant,
    difference_told,
    disjunction,
    indicator_sum,
)
from up_samp.scheduling.cpsat.encode.states import Write
from up_samp.scheduling.cpsat.encode.store import ModelStore
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.normal import Constraint, TimedEffect
from up_samp.scheduling.cpsat.problem import Additions
from up_samp.scheduling.cpsat.routing.dispatch import RoutedTask, find_tasks
from up_samp.scheduling.cpsat.routing.levels import RouteLevel, find_levels
from up_samp.scheduling.cpsat.routing.route import (
    Entrance,
    Route,
    changes_by_name,
    expand,
    way_back,
)


def precedence_closure(forms: Iterable[Form]) -> Callable[[int, int], bool]:
    """Return what tells of two variables whether the first is less than the other in every
    schedule, as far as that follows from unconditional differences between times.

    Assumes: what is stated without condition holds in every schedule, of the times of what is
    absent, too.

    :param forms: all that is stated; only ``u + k <= v`` (k > 0), said without condition, counts.
    """
    after: dict[int, set[int]] = {}
    for form in forms:
        told = difference_told(form)
        if told is not None and not form.needs and told[2] > 0:
            after.setdefault(told[0], set()).add(told[1])

    @cache
    def later(first: int) -> set[int]:
        known, agenda = set[int](), [first]
        while agenda:
            new = after.get(agenda.pop(), set()) - known
            known |= new
            agenda.extend(new)
        return known

    return lambda first, then: then in later(first)


# ------------------ A problem without some of its activities


def without(parts: Additions, removed: set[str]) -> Additions:
    """Return ``parts`` without the activities in ``removed`` and whatever speaks of them.

    Every schedule of the whole, but for these activities, is one of what is left.
    """
    clean, effects = _lasting(parts, removed)
    kept = Additions(whole=False)
    kept.activities = [a for a in parts.activities if a.name not in removed]
    kept.vague = frozenset(
        a.name for a in kept.activities if not (clean(a.duration.lower) and clean(a.duration.upper))
    )
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
        and not _before_end(c[0])
    ]
    kept.effects = effects
    return kept


def _lasting(
    parts: Additions, removed: set[str]
) -> tuple[Callable[[FNode], bool], list[TimedEffect]]:
    """Return what tells whether an expression means the same without ``removed``, and the effects
    that are left.

    Where one effect on a fluent goes, all do, with all that reads it, and so on.
    """
    nodes, names = set[FNode](), set[str]()
    while True:
        clean = _cleaner(removed, set(nodes), set(names))
        kept = [
            (timing, effect, owner)
            for timing, effect, owner in parts.effects
            if _keeps(owner, removed)
            and clean(effect.fluent)
            and clean(effect.value)
            and clean(effect.condition)
            and _timings_clean((timing,), removed)
        ]
        known = len(nodes) + len(names)
        left = {id(effect) for _, effect, _ in kept}
        for _, effect, _ in parts.effects:
            if id(effect) in left:
                continue
            if all(a.is_constant() for a in effect.fluent.args):
                nodes.add(effect.fluent)
            else:
                names.add(effect.fluent.fluent().name)
        if len(nodes) + len(names) == known:
            return clean, kept


def _before_end(span: TimeInterval) -> bool:
    """Return whether a span begins before the global end by a time counted from it: nobody knows
    when that is without what was taken out.
    """
    lower, upper = (t.timepoint.kind is TimepointKind.GLOBAL_END for t in (span.lower, span.upper))
    return lower and not (upper and span.lower.delay >= 0)


def _cleaner(removed: set[str], nodes: set[FNode], names: set[str]) -> Callable[[FNode], bool]:
    memo: dict[FNode, bool] = {}

    def clean(node: FNode) -> bool:
        known = memo.get(node)
        if known is None:
            known = memo[node] = _clean(node, removed, nodes, names, clean)
        return known

    return clean


def _keeps(owner: Any, removed: set[str]) -> bool:
    return owner is None or owner.name not in removed


def _timings_clean(timings: tuple[Any, ...], removed: set[str]) -> bool:
    return all(t.timepoint.container not in removed for t in timings)


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


# ------------------ Doors that the routing relaxation may open once
# A constraint that loses none of its optima. What opens a door again, where nothing shuts it,
# changes nothing. Take it out of a schedule: its traveller goes on from the stop before to the stop
# after, which takes no longer (travel times obey the triangle inequality, and whoever may not go
# directly is charged for a detour that the way by the button was, too); what reads the door reads
# what the first opening set. Only something else that an opening is good for could be missing, so
# there must be nothing of that kind.


def opened_once(parts: Additions, tasks: Iterable[RoutedTask]) -> list[Constraint]:
    """Return constraints on the presences of what opens doors; of each one, where that is needed,
    exactly one is there, else at most one.

    Assumes: an opening is good for nothing but its one door.
    """
    doors = [task for task in tasks if task.opens is not None]
    names = {name for task in doors for _, name, _ in task.ways}
    good = names & {a.name for a in parts.activities if a.optional}
    good -= _good_for_more(parts, good)
    activities = {a.name: a for a in parts.activities}
    found: list[Constraint] = []
    for task in doors:
        mine = [name for _, name, _ in task.ways]
        if good.issuperset(mine):
            found += _once([activities[name] for name in mine], needed=task.needed)
    return found


def _once(some: list[Activity], *, needed: bool) -> Iterator[Constraint]:
    manager = some[0].present.environment.expression_manager
    if needed:
        yield manager.Or([a.present for a in some]), [], None
    for a, b in itertools.combinations(some, 2):
        yield manager.Or(manager.Not(a.present), manager.Not(b.present)), [], None


def _good_for_more(parts: Additions, names: set[str]) -> set[str]:
    """Return which of ``names`` do more than change a fluent, or are wanted by a constraint."""
    more = {a.name for a, _ in parts.parameters}
    for constraint, scope, _ in parts.constraints:
        for node, positive in ((constraint, True), *((part, False) for part in scope)):
            more |= names.intersection(_asked_for(node, positive))
    effects: dict[str, list[tuple[Timing, Effect]]] = {name: [] for name in names}
    for timing, effect, owner in parts.effects:
        if owner is not None and owner.name in names:
            effects[owner.name].append((timing, effect))
    for name, some in effects.items():
        if sum(effect.is_assignment() for _, effect in some) != 1 or not _gives_back(some):
            more.add(name)
    return more


def _asked_for(node: FNode, positive: bool) -> Iterator[str]:
    """Yield whose presence might make a constraint true (false, if not ``positive``)."""
    kind = node.node_type
    if kind is Op.PRESENT_EXP:
        yield from [str(node.presence().container)] if positive else []
    elif kind is Op.NOT:
        yield from _asked_for(node.arg(0), not positive)
    elif kind is Op.IMPLIES:
        yield from _asked_for(node.arg(0), not positive)
        yield from _asked_for(node.arg(1), positive)
    else:
        for arg in node.args:
            yield from _asked_for(arg, positive)
            if kind not in (Op.AND, Op.OR):  # either way
                yield from _asked_for(arg, not positive)


def _gives_back(effects: list[tuple[Timing, Effect]]) -> bool:
    """Return whether what is not assigned is taken at the start and given back in the end."""
    balance: Counter[FNode] = Counter()
    for timing, effect in effects:
        if effect.is_assignment():
            continue
        at_start = timing.timepoint.kind is TimepointKind.START
        if timing.delay != 0 or not effect.value.is_constant() or not effect.condition.is_true():
            return False
        if at_start != effect.is_decrease():
            return False
        amount = effect.value.constant_value()
        balance[effect.fluent] += -amount if at_start else amount
    return not any(balance.values())


# ------------------ The ways of travellers between stops


@dataclass(frozen=True)
class Arc:
    """One way to come to a stop: from stop ``i`` (0: from the start, at ``since``) in ``distance``
    or more, where ``lead`` is the rest between the activity before and the first move.

    ``hop`` is the move's (from, to) on a direct way, ``rest`` the time from the end of the last
    move to the stop.
    """

    i: int
    literal: Literal
    since: Lin
    lead: int
    distance: int
    rest: int
    hop: tuple[int, int] | None = None


# As a traveller does one thing at a time, the level at a stop follows from the one at the stop
# before, less what the way takes at least. So a schedule of the relaxation charges about where one
# of the problem has to.


class Course:
    """A level along a route: what is left at most when its traveller comes to each stop."""

    def __init__(
        self,
        store: ModelStore,
        level: RouteLevel,
        stops: Sequence[tuple[ActivityVars, frozenset[int]]],
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


# ------------------ The problem with its moves taken out
# A relaxation that gives bounds, and a hint for the rest. Moves are replaced by the time that they
# take at least between what happens at places, in a circuit per traveller. A move happens once at
# most, so only one way can use it, and others pay for a detour. A door is opened once
# (:func:`opened_once`), and before anybody passes, and what moves take from (``levels``) lasts.
# Other constraints, conditions and effects that speak of moves are dropped, so every schedule of
# the problem is one of the collapsed problem: its optimum is a lower bound, and if it has no
# schedule, the problem has none. A relaxed schedule, with shortest paths of moves put back in, is a
# hint for the full model; the full model alone decides whether it holds.


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
        self._forms: list[Form] = []
        self._surely_before = precedence_closure(self.model.stated)
        for route in routes:
            self._circuit(route)
        for form in merge_forms(self._forms, self.model.exact):
            self.model.store.enforce(form)

    # -- the circuit of one traveller ----------------------------------------------------------
    def _circuit(self, route: Route) -> None:
        store = self.model.store
        makespan = Lin(((self.model.world.makespan, 1),))
        stops = [(self.model.world.activities[name], places) for name, places in route.stops]
        circuit: list[tuple[int, int, Any]] = [(0, 0, store.raw(store.boolean()))]
        load: list[tuple[Literal, int]] = []
        hops: dict[tuple[int, int], list[Literal]] = {}
        # where no way takes anything, the stops' own constraints say the same
        levels = [level for level in find_levels(self.full, route) if any(level.ways.values())]
        courses = [Course(store, level, stops) for level in levels]
        for j, (stop, places) in enumerate(stops, 1):
            circuit.append((j, j, store.raw(~stop.present)))
            load.append((stop.present, stop.least))
            arcs = self._arcs(route, stops, j)
            for arc in arcs:
                circuit.append((arc.i, j, store.raw(arc.literal)))
                late = route.step - arc.rest if arc.distance else 0
                load.append((arc.literal, arc.lead + arc.distance - late))
                soonest = arc.since.shift(arc.lead + arc.distance - late)
                self._when(soonest.le(stop.start), arc.literal)
                if arc.hop is not None:
                    hops.setdefault(arc.hop, []).append(arc.literal)
            back = way_back(route, places, route.returns.get(stop.name, route.final))
            literal = store.boolean()
            circuit.append((j, 0, store.raw(literal)))
            load.append((literal, back))
            self._when(stop.end.shift(back).le(makespan), literal)
            for course in courses:
                course.come(j, arcs)
                course.leave(j, literal, route.returns.get(stop.name, route.final))
            self._enter(route, stop, places)
        store.model.add_circuit(circuit)
        store.enforce(indicator_sum(load).le(makespan))
        for hop, literals in hops.items():
            most = len(route.hops[hop])
            if len(literals) > most:
                store.enforce(indicator_sum([(x, 1) for x in literals]).le(constant(most)))

    def _when(self, form: Form, literal: Literal) -> None:
        """Demand a comparison whatever it needs: ``literal`` says that those are present."""
        bare = form._replace(needs=()) if form.__class__ is not int else form
        self.model.store.enforce(bare, (literal,))

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
            for distance, hop in self._ways(route, origins, places):
                literal = self.model.store.boolean()
                arcs.append(Arc(i, literal, since, lead, distance, rest, hop))
        return arcs

    def _never_after(self, one: ActivityVars, other: ActivityVars) -> bool:
        """Return whether ``other`` cannot come after ``one``: it is an alternative, or earlier."""
        pair = (min(one.index, other.index), max(one.index, other.index))
        if pair in self.model.disjunctions.exclusive:
            return True
        return self._surely_before(other.start.terms[0][0], one.start.terms[0][0])

    def _ways(
        self, route: Route, origins: frozenset[int], places: frozenset[int]
    ) -> list[tuple[int, tuple[int, int] | None]]:
        """Return (travel time, move if it is direct): the best way, and a worse one where the best
        cannot be had by everybody.
        """
        best = route.between(origins, places)
        if best >= INFINITE:
            return []
        if len(origins) > 1 or len(places) > 1:
            return [(best, None)]
        (a,), (b,) = origins, places
        if a == b or route.free or not route.is_direct(a, b):
            return [(best, None)]
        ways: list[tuple[int, tuple[int, int] | None]] = [(best, (a, b))]
        arrivals = sum(p == places for _, p in route.stops)
        if arrivals > len(route.hops[a, b]):
            detour = route.way(a, places, {m.name for m in route.hops[a, b]})
            if detour is not None:
                ways.append((detour[0], None))
        return ways

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
