"""Routes inside a problem: a state variable that some members of a clique change (moves) and others
need (work at places), all one at a time.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Cmp,
    Form,
    Lin,
    Literal,
    parts_of,
    value_told,
    variables_in,
)
from up_samp.scheduling.cpsat.encode.states import Key, Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.terms import INFINITE, ActivityVars
from up_samp.scheduling.cpsat.encode.timeline import Timeline
from up_samp.scheduling.cpsat.encode.variables import Values, implied_length
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.route import Entrance, Move, Route, Still

# ------------------ What moves a traveller, in whatever form
# A *move* leads from what it needs the place to be at its start (else from anywhere) to one place,
# or to that which a parameter names. What may do so or not is odd, but if it is one of the things
# that the traveller does one at a time, it takes its time, and leads to no place that it does not
# name. What is not among these, or changes the place after its end, may put the traveller there at
# any time, and in no time. So a few odd activities loosen a route, and leave the rest of it.


@dataclass(frozen=True)
class Mover:
    """What ``activity`` (``None``: the problem itself) does to a place: it leads from one of
    ``origins`` to one of ``targets``, by an effect ``delay`` (0 or less) after its end.

    ``touches``: it needs its origin right after its start only, so it may start at the instant at
    which another one ends. ``origin`` and ``target`` are the variables (parameters) that tell
    which, if there are any. ``odd`` says why it is no plain move (nothing: it is one). ``free``: it
    may happen at any time, beside all else.
    """

    activity: ActivityVars | None
    origins: frozenset[int]
    targets: frozenset[int]
    delay: int = 0
    origin: int | None = None
    target: int | None = None
    odd: str = ""
    free: bool = False
    touches: bool = False

    @property
    def name(self) -> str:
        """Who makes the change."""
        return "the problem itself" if self.activity is None else self.activity.name


def changes_of(model: ScheduleModel, timeline: Timeline, members: set[int]) -> list[Mover]:
    """Return what changes a state, if ``members`` are done one at a time.

    What is stated never to happen is not among it.

    Assumes: nothing but effects changes a place; what is not sure of them is odd, or free.
    """
    state = timeline.state
    writes: dict[int | None, list[int]] = {}
    for i, write in enumerate(state.writes):
        if not model.store.never(write.active):
            writes.setdefault(write.owner, []).append(i)
    return [_change(model, timeline, owner, some, members) for owner, some in writes.items()]


def _change(
    model: ScheduleModel,
    timeline: Timeline,
    owner: int | None,
    numbers: list[int],
    members: set[int],
) -> Mover:
    state = timeline.state
    writes = [state.writes[i] for i in numbers]
    everything = state.listed
    anywhere = frozenset[int]().union(*(_values(model, w.value, everything) for w in writes))
    if owner is None:
        return Mover(None, everything, anywhere, odd="sets it", free=True)
    activity = model.states.activity(owner)
    delays = [model.states.difference(w.time, activity.end) for w in writes]
    since = [model.states.difference(w.time, activity.start)[0] for w in writes]
    if owner not in members:
        why = "is not kept apart from all else that changes it"
        return Mover(activity, everything, anywhere, odd=why, free=True)
    if max(high for _, high in delays) > 0 or min(since) < 0:
        why = "changes it before its start or after its end"
        return Mover(activity, everything, anywhere, odd=why, free=True)
    # right after its start it sees what it sets then itself
    instants = [(0, 0), (1, 1)] if min(since) >= 1 else [(0, 0)]
    read = _at_start(model, activity, state, instants)
    origins, origin, touches = everything, None, False
    if read is not None and read.allowed is not None:
        origins, origin = read.allowed, _variable(read.value)
        touches = model.states.difference(read.lo, activity.start) != (0, 0)
    last = _last(timeline, numbers)
    if last is None or last.active != activity.present:
        delay = min(low for low, _ in delays)
        why = "may change it, or to what, is not certain"
        return Mover(activity, origins, anywhere, delay, origin, odd=why, touches=touches)
    delay = model.states.difference(last.time, activity.end)[0]
    targets, target = _values(model, last.value, everything), _variable(last.value)
    odd = "sets it to what is computed" if last.value.terms and target is None else ""
    return Mover(activity, origins, targets, delay, origin, target, odd, touches=touches)


def _at_start(
    model: ScheduleModel,
    activity: ActivityVars,
    state: StateVar,
    instants: list[tuple[int, int]],
) -> Read | None:
    """Return what an activity needs of a state at its start, or at one of other ``instants``,
    counted from there.
    """
    found = [
        read
        for read in state.reads
        if read.owner == activity.index
        and read.allowed is not None
        and read.active == activity.present
        and model.states.difference(read.lo, activity.start) in instants
    ]

    def worth(read: Read) -> tuple[bool, int, int]:
        """What a variable tells is worth more than a list, a short list more than a long one, and
        what is needed from the start on more than what is needed later.
        """
        later = model.states.difference(read.lo, activity.start)[0]
        return read.value is None, len(read.allowed or ()), later

    return min(found, key=worth, default=None)


def _last(timeline: Timeline, numbers: list[int]) -> Write | None:
    """Return the last of an activity's effects on a state, if it is known which one that is."""
    writes = timeline.state.writes
    for i in numbers:
        others = [writes[j] for j in numbers if j != i]
        if all(timeline.states.difference(writes[i].time, w.time)[0] > 0 for w in others):
            return writes[i]
    return None


def _values(model: ScheduleModel, value: Lin, everything: frozenset[int]) -> frozenset[int]:
    """Return what an effect may set a state to."""
    if not value.terms:
        return frozenset((value.const,))
    low, high = model.store.range(value)
    return frozenset(v for v in everything if low <= v <= high)


def _variable(value: Lin | None) -> int | None:
    """Return the variable that a value is."""
    if value is None or value.const or len(value.terms) != 1 or value.terms[0][1] != 1:
        return None
    return value.terms[0][0]


# ------------------ How long a move lasts at least


class Lengths:
    """What is stated about the durations of activities and the values of parameters.

    :param variables: the parameters that are asked for.
    """

    def __init__(self, model: ScheduleModel, variables: Iterable[int]) -> None:
        self._model = model
        self._names = {var: name for name, (var, _, _) in model.parameters.items()}
        self._with: dict[frozenset[tuple[int, int]], list[Form]] = {}
        self._others: dict[int, list[Form]] = {}
        asked = frozenset(variables)
        owners = _owners(model)
        for form in model.stated if asked else ():
            # of one activity, a clause says nothing that may hold for the sake of another
            found = asked & variables_in(form) if _of_one(form, owners) else None
            if not found:
                continue
            # what says nothing but of some values is looked at for these only
            items = frozenset(_unless(form))
            if items:
                self._with.setdefault(items, []).append(form)
                continue
            for var in found:
                self._others.setdefault(var, []).append(form)

    def least(self, activity: ActivityVars, values: Values) -> int:
        """Return how long an activity lasts at least with ``values``; INFINITE if it cannot.

        Assumes: a clause of one activity holds for the values that it names, whoever else is there.
        """
        least = max(activity.least, self._by_fluents(activity, values))
        some = [*values.items()]
        parts = (p for n in range(len(some)) for p in itertools.combinations(some, n + 1))
        forms = [form for part in parts for form in self._with.get(frozenset(part), ())]
        forms += [form for var in values for form in self._others.get(var, ())]
        least = max([least, *(implied_length(form, activity, values) for form in forms)])
        return least if activity.most is None or least <= activity.most else INFINITE

    def _by_fluents(self, activity: ActivityVars, values: Values) -> int:
        """Return the duration's lower bound where it is told by fluents that never change."""
        duration = self._model.variables.told.get(activity.name)
        if duration is None:
            return 0
        known = {self._names[var]: value for var, value in values.items() if var in self._names}
        least = self._worth(duration.lower, known)
        return 0 if least is None else least + duration.is_left_open()

    def _worth(self, node: FNode, known: Mapping[str, int]) -> int | None:
        """Return what an expression is worth; ``None`` if that is not known."""
        kind, model = node.node_type, self._model
        if kind is Op.INT_CONSTANT:
            return int(node.constant_value())
        if kind is Op.OBJECT_EXP:
            return model.world.objects[node.object().name]
        if kind is Op.PARAM_EXP:
            return known.get(node.parameter().name)
        parts = [self._worth(a, known) for a in node.args]
        numbers = [p for p in parts if p is not None]
        if len(numbers) < len(parts):
            return None
        if kind is Op.PLUS:
            return sum(numbers)
        if kind is Op.FLUENT_EXP and node.fluent().name not in model.states.dynamic:
            return model.states.var(node.fluent(), tuple(numbers)).initial
        return None


def _owners(model: ScheduleModel) -> dict[int, str]:
    """Return whose variables, and literals of absence, are whose."""
    # nothing for those of the problem
    found = {var: name.rpartition(".")[0] for name, (var, _, _) in model.parameters.items()}
    for activity in model.states.activities:
        found[~activity.present] = activity.name
        for time in (activity.start, activity.end):
            found.update((var, activity.name) for var, _ in time.terms)
    return found


def _of_one(form: Form, owners: Mapping[int, str]) -> bool:
    """Return whether a form is no clause of parts that speak of several activities."""
    if form.__class__ is not tuple or form[0] != "|":
        return True
    known = set[str]()
    for part in form[1:]:
        if part.__class__ is int:
            # a literal that is a variable is no absence
            known.add(owners.get(part, "") if part < 0 else "")
        elif part.__class__ is Cmp:
            known.update(owners.get(var, "") for var, _ in part.terms)
    return len(known - {""}) < 2


def _unless(form: Form) -> Iterable[tuple[int, int]]:
    """Yield (variable, value) of which a clause says nothing if the variable is another one."""
    parts = form[1:] if form.__class__ is tuple and form[0] == "|" else ()
    told = (value_told(part, "!=") for part in parts)
    yield from (item for item in told if item is not None)


def find_visits(model: ScheduleModel, route: Route) -> None:
    """Find the places to which one of some moves has to be made.

    A visit begins when such a move ends, so nothing may need a rest after it.

    Assumes: one of some moves is there in every schedule, all of them lead to one place, and none
    is odd.
    """
    if route.gap > 0:
        return
    moves: dict[Literal, list[Move]] = {}
    for move in route.moves:
        if move.name not in route.odd:
            moves.setdefault(model.world.activities[move.name].present, []).append(move)
    clauses = [parts_of("|", form) for form in model.stated]
    clauses += [*model.exact.values(), *((p,) for p in moves if p == TRUE)]
    visited = set()
    for every in clauses:
        places = set[int]()
        for part in every:
            some = _leading(model, part, moves)
            if some is None:
                break
            places |= some
        else:
            visited |= places if len(places) == 1 else set()
    known = {next(iter(places)) for _, places in route.stops if len(places) == 1}
    for place in sorted(visited - known):
        route.visits.append((f"visit {place} of {route.key}", frozenset((place,))))
    route.late |= {name for name, _ in route.visits}


def _leading(
    model: ScheduleModel, part: Form, moves: dict[Literal, list[Move]]
) -> frozenset[int] | None:
    """Return where the traveller has come if ``part`` holds: "this move is made" (with these
    values of its parameters); nowhere, if it cannot hold; ``None``, if it says anything else.
    """
    parts = parts_of("&", part)
    literals = [p for p in parts if p.__class__ is int]
    values = [v for p in parts if (v := value_told(p, "==")) is not None]
    if any(model.store.never(literal) for literal in literals):
        return frozenset()
    mine = next((moves[literal] for literal in literals if literal in moves), None)
    if mine is None:
        return None
    # whatever else it says, one of the moves is made that it does not exclude
    return frozenset(
        m.to for m in mine if all(dict(m.values).get(var, v) == v for var, v in values)
    )


# ------------------ What moves of one traveller need of other states


def find_entries(model: ScheduleModel, route: Route, changes: list[Mover]) -> None:
    """Find what every change into a place needs of other state variables (open doors), itself or as
    it comes from another such place.

    Assumes: every move into a place needs the same, or begins where every move needs it, too, and
    what holds once holds from then on; it does not hold at first, and no move provides it.

    :param changes: all that the traveller makes one at a time.
    """
    into: dict[int, list[Move]] = {}
    for move in route.moves:
        into.setdefault(move.to, []).append(move)
    movers = {change.activity.index for change in changes if change.activity is not None}
    needs = _needs(model, route, movers)
    asking: dict[Need, set[int]] = defaultdict(set)
    for move, some in needs.items():
        for need in some:
            asking[need].add(move.to)
    for need in sorted(asking, key=str):
        key, allowed = need
        state = model.states.vars[key]
        if state.initial in allowed:
            continue
        places = (into.keys() if state.lasts(allowed) else asking[need]) - route.free
        inner = places - {route.initial} if state.lasts(allowed) else set[int]()
        behind = _behind(into, needs, need, (places, inner))
        for place in sorted(behind if behind & asking[need] else ()):
            lead = min(needs[move].get(need, 0) for move in into[place])
            route.entries.setdefault(place, []).append(Entrance(key, allowed, max(0, lead)))


def _behind(
    into: dict[int, list[Move]], needs: Needs, need: Need, some: tuple[set[int], set[int]]
) -> set[int]:
    """Return the ``some[0]`` places to which nobody comes without that something was as is needed:
    every move there needs it, or begins where that is so, which may be ``some[1]``.
    """
    found, inner = some
    while True:
        kept = {
            place
            for place in found
            if all(need in needs[move] or move.origins <= inner for move in into[place])
        }
        if kept == found:
            return found
        found, inner = kept, inner & kept


Need = tuple[Key, frozenset[int]]
"""A state variable, and what it has to be."""
Needs = dict[Move, dict[Need, int]]
"""What each move needs of other state variables -> how long before what is done where it leads."""


def _needs(model: ScheduleModel, route: Route, movers: set[int]) -> Needs:
    asked: dict[int, list[tuple[Read, tuple[Key, frozenset[int]]]]] = {}
    for other in model.states.vars.values():
        if any(write.owner in movers for write in other.writes):
            continue  # a move may provide what it needs itself
        held = frozenset(other.held()) if other.values is not None else None
        for read in (*other.reads, *model.implied.get(other.key, ())):
            if read.owner in movers and read.allowed is not None and not read.guard_only:
                # however it is said what has to hold, it is the same of what may hold at all
                allowed = read.allowed if held is None else read.allowed & held
                asked.setdefault(read.owner or 0, []).append((read, (other.key, allowed)))
    found: Needs = {}
    for move in route.moves:
        activity = model.world.activities[move.name]
        some = asked.get(activity.index, ())
        true = _true(model, activity, move) if some else set()
        mine = found[move] = {}
        for read, need in some:
            before = _before_end(model, activity, move, read)
            if read.active in true and before >= 0:
                mine[need] = max(mine.get(need, 0), before + 1 + route.step)
    return found


def _before_end(model: ScheduleModel, activity: ActivityVars, move: Move, read: Read) -> int:
    """Return how long before the end of a move it needs something, at least."""
    before, most = model.states.difference(activity.end, read.lo)
    if before == most:
        return before
    # a move between certain places may last longer than its activity does at least
    since, latest = model.states.difference(read.lo, activity.start)
    return max(before, move.least - since) if since == latest else before


def _true(model: ScheduleModel, activity: ActivityVars, move: Move) -> set[Literal]:
    """Return what is true of a move that is made: it is present, with its parameters' values."""
    chosen = list(itertools.starmap(model.store.is_value, move.values))
    return {
        model.store.all_of([activity.present, *some])
        for size in range(len(chosen) + 1)
        for some in itertools.combinations(chosen, size)
    }


def find_still(model: ScheduleModel, place: StateVar, owners: frozenset[int]) -> Still:
    """Return what all ``owners`` of changes of a place keep as it is from their start to their
    end.

    Assumes: every move that has a midst keeps the state all through it.
    """
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


# ------------------ Routes inside a problem


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
        and isinstance(place := _place(model, timeline, cliques), RoutePlace)
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
class RoutePlace:
    """A state variable that tells where a traveller is: ``members`` (indices) are done one at a
    time with ``gap`` between them, and so are most of ``changes``.
    """

    state: StateVar
    gap: int
    members: frozenset[int]
    changes: list[Mover]

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
        if len(state.listed) > 2 and len(owners) > 2:
            place = _place(model, timeline, cliques)
            what = "what happens at its places, or its moves, are moves or stops of another"
            found[key] = place if isinstance(place, str) else what
    return found


def _place(model: ScheduleModel, timeline: Timeline, cliques: Cliques) -> RoutePlace | str:
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
    place = RoutePlace(state, gap, frozenset(members), changes)
    free = [c for c in changes if c.free]
    if 2 * len(free) > len(changes) or all(c.odd and len(c.targets) > 1 for c in changes):
        name = next(c.name for c in changes if c.odd)
        return f"{name} does not lead from a place at its start to one place in the end"
    values = state.listed
    if len(values) < 3 and any(c.origins >= values for c in changes):
        return "it is a switch that is set whatever it was"
    if not _stops(model, place)[0]:
        return "nothing that is kept apart from its moves happens at its places"
    return place


def _happens(model: ScheduleModel, owner: int | None) -> bool:
    """Return whether what changes or needs a state may be there at all."""
    return owner is None or not model.store.never(model.states.activity(owner).present)


def _route(model: ScheduleModel, place: RoutePlace, lengths: Lengths) -> Route:
    """Return the route of a traveller."""
    state = place.state
    bound = [c for c in place.changes if not c.free]
    moves = [move for change in bound for move in _moves(change, lengths)]
    owners = {w.owner for w in state.writes if not _happens(model, w.owner)} - {None}
    never = frozenset(model.states.activity(owner or 0).name for owner in owners)
    stops, late = _stops(model, place)
    rests = _rests(model, place, stops)
    anywhere = state.listed
    route = Route(
        state.key,
        place.gap,
        state.initial or 0,
        _final(model, state),
        moves,
        [*stops, *((name, anywhere) for name in sorted(rests))],
        rests,
        late | rests,
        odd={c.name: why for c in place.changes if (why := c.odd or _may_stay(c, lengths))},
        free=place.free,
        never=never,
        lag=_lag(bound),
    )
    find_visits(model, route)
    find_entries(model, route, bound)
    route.still = {} if place.free else find_still(model, state, place.owners)
    return route


def _lag(changes: list[Mover]) -> int:
    """Return the time from the end of a move until the next one, or a stop, may begin at least."""
    seen = 1 + min(c.delay for c in changes)
    return max(0, seen - any(c.touches for c in changes))


def _moves(change: Mover, lengths: Lengths) -> Iterator[Move]:
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


def _may_stay(change: Mover, lengths: Lengths) -> str:
    """Return why a change is no plain move if its variables let it lead back to where it begins:
    that is none of its moves, so it need not make one.

    Assumes: a move's variables do not let it lead back to where it begins, or its length does not.
    """
    if change.origin is None and (change.target is None or len(change.origins) != 1):
        return ""
    assert change.activity is not None
    for place in change.origins & change.targets:
        there = {var: place for var in (change.origin, change.target) if var is not None}
        if lengths.least(change.activity, there) < INFINITE:
            return "may stay where it is"
    return ""


def _stops(
    model: ScheduleModel, place: RoutePlace
) -> tuple[list[tuple[str, frozenset[int]]], frozenset[str]]:
    """Return the stops with their places, and which of them need these only after their start."""
    places: dict[int, frozenset[int]] = {}
    early = set()
    for read in place.state.reads:
        if read.owner is None or read.allowed is None or read.owner in place.owners:
            continue
        if read.owner in place.members and _happens(model, read.owner):
            activity = model.states.activity(read.owner)
            during = model.states.surely_during(read.owner, read.lo, read.hi)
            if read.active == activity.present and during:
                known = places.get(read.owner, read.allowed)
                # who may be put elsewhere meanwhile need not be at both
                both = known | read.allowed if place.free else known & read.allowed
                places[read.owner] = both
                if model.states.difference(read.lo, activity.start) == (0, 0):
                    early.add(read.owner)
    late = frozenset(model.states.activity(i).name for i in places.keys() - early)
    # what needs two places at once never happens
    return [(model.states.activity(i).name, p) for i, p in sorted(places.items()) if p], late


def _rests(
    model: ScheduleModel, place: RoutePlace, stops: list[tuple[str, frozenset[int]]]
) -> frozenset[str]:
    """Return what a traveller surely does wherever it is: what takes its turn, and neither a stop
    nor a move.
    """
    named, some = dict(stops), map(model.states.activity, place.members - place.owners)
    return frozenset(a.name for a in some if a.present == TRUE and a.name not in named)


def _final(model: ScheduleModel, state: StateVar) -> frozenset[int] | None:
    final: frozenset[int] | None = None
    for read in state.reads:
        if read.owner is None and read.lo == read.hi == model.states.far and read.allowed:
            final = read.allowed if final is None else final & read.allowed
    return final
