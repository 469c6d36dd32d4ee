"""What travellers have, carry and need beside the places where they are: states of their own
(forks, batteries), and states that are set back (doors that close by themselves).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from operator import inv

from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Cmp,
    Literal,
    conditional,
    difference_told,
    least_told,
    parts_of,
)
from up_samp.scheduling.cpsat.encode.states import Key, Read, StateVar
from up_samp.scheduling.cpsat.encode.terms import INFINITE, ActivityVars
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.route import Route, shorten

# ------------------ States that travellers need and that are set back again
# What opens a door for good is done once (:mod:`.dispatch`). A door that closes again has to be
# opened as often as somebody comes too late, so whoever schedules drives one by one has to know
# when it is open: what is done at a stop changes it, then and later, by what follows at a fixed
# time.


Held = tuple[Key, frozenset[int] | None, int, int]
"""What a move or a stop needs: a state that is one of some values (``None``: whatever it is), and
that nobody changes meanwhile; from its start + the first number to its end + the second one.
"""
Way = tuple[int, int]
"""(task, number of its way)."""
Change = tuple[Key, int, int]
"""A state, its new value, and when, counted from the start of what is done at a stop."""


def find_set_back(
    model: ScheduleModel,
    routes: list[Route],
    names: Mapping[str, Way],
    coming: Mapping[Literal, list[Way]],
) -> tuple[dict[str, list[Held]], dict[Way, list[Change]]]:
    """Return what moves and stops need of states that are set back, and who changes these.

    Assumes: stops alone change such a state, or what comes with one of them, at a fixed time after
    it; that comes whenever its stop does, but for the last time.

    :param names: of the stops, and which way to do a task each is.
    :param coming: which of these come with a presence.
    """
    activities = model.world.activities
    movers = frozenset[str]().union(*(route.movers for route in routes))
    known: dict[int | None, str] = {activities[n].index: n for n in (*movers, *names)}
    held: dict[str, list[Held]] = {}
    changes: dict[Way, list[Change]] = {}
    for state in model.states.vars.values():
        reads = [r for r in state.reads if r.owner in known]
        if not any(_is_in_vain(state, r) for r in reads if known[r.owner] in movers):
            continue
        made = _changes(model, state, names, coming)
        for way, some in made.items():
            changes.setdefault(way, []).extend(some)
        for read in reads if made else ():
            owner = activities[known[read.owner]]
            held.setdefault(owner.name, []).extend(_held(model, state.key, owner, read))
    return held, changes


def _is_in_vain(state: StateVar, read: Read) -> bool:
    """Return whether something has to be changed for a read, and may be changed back."""
    told = read.allowed
    return told is not None and state.initial not in told and not state.lasts(told)


def _changes(
    model: ScheduleModel,
    state: StateVar,
    names: Mapping[str, Way],
    coming: Mapping[Literal, list[Way]],
) -> dict[Way, list[Change]]:
    """Return how ways to do tasks change a state; nothing, if anything else may, or to what, or
    when, is not certain.
    """
    world, found = model.world.activities, dict[Way, list[Change]]()
    begins = {way: world[name].start.terms[0][0] for name, way in names.items()}
    later = _later_starts(model)
    for change in model.states.sure_changes(state):
        start, (since, latest) = change.owner.start.terms[0][0], change.since
        ways = coming.get(change.owner.present, ())
        after = [(w, gap) for w in ways if (gap := later.get((begins[w], start))) is not None]
        if change.adds or since < latest or len(after) != 1:
            return {}
        ((way, gap),) = after
        found.setdefault(way, []).append((state.key, change.value, gap + since))
    return found


def _held(model: ScheduleModel, key: Key, owner: ActivityVars, read: Read) -> Iterator[Held]:
    """Yield what a read asks, where it is surely asked, at times that are fixed."""
    first = model.states.difference(read.lo, owner.start)
    last = model.states.difference(read.hi, owner.end)
    if (read.active, *first, *last) == (owner.present, first[1], first[0], last[1], last[0]):
        yield key, read.allowed, first[0], last[0]


def _later_starts(model: ScheduleModel) -> dict[tuple[int, int], int]:
    """Return how much later than one start another one surely is, whenever both are."""
    absent = {a.start.terms[0][0]: ~a.present for a in model.world.activities.values()}
    found = dict.fromkeys(zip(absent, absent, strict=True), 0)
    for form in model.stated:
        *others, stated = sorted(parts_of("|", form), key=lambda part: part.__class__ is Cmp)
        equal = getattr(stated, "op", "") == "=="
        pair = difference_told(stated._replace(op="<=")) if equal else None
        if pair is None:
            continue
        one, then, gap = pair
        if {*others, *map(inv, stated.needs)} <= {absent.get(one), absent.get(then)}:
            found[one, then], found[then, one] = gap, -gap
    return found


# ------------------ What ways to do tasks ask of each other


@dataclass
class WayNeeds:
    """What one way to do a task asks besides its place: ``along``: the ways of others that come
    with it; ``first``: (way that comes before it, time from its start). Both are as stated.
    """

    along: list[Way] = field(default_factory=list)
    first: list[tuple[Way, int]] = field(default_factory=list)

    @property
    def ended(self) -> dict[Way, int]:
        """What comes with it and before it, and how long before (from start to start)."""
        return {way: gap for way, gap in self.first if way in self.along}


def ways_with(model: ScheduleModel, names: Mapping[str, Way]) -> dict[Literal, list[Way]]:
    """Return which ways to do tasks come with a literal (of a presence, say): by clauses of two.
    ``names`` are those of the stops.
    """
    own: dict[Literal, list[Way]] = {}
    for name, way in names.items():
        own.setdefault(model.world.activities[name].present, []).append(way)
    found = {literal: [*some] for literal, some in own.items()}
    for form in model.stated:
        parts = parts_of("|", form)
        if [part.__class__ for part in parts] == [int, int]:
            for one, other in (parts, parts[::-1]):
                found.setdefault(~one, []).extend(own.get(other, ()))
    return found


def find_needs(
    model: ScheduleModel, names: Mapping[str, Way], coming: Mapping[Literal, list[Way]]
) -> dict[Way, WayNeeds]:
    """Return what the ways to do tasks ask of each other; ``names`` are those of the stops, and
    ``coming`` with each literal.
    """
    activities = model.world.activities
    present = {way: activities[name].present for name, way in names.items()}
    needs = {w: WayNeeds([o for o in coming[p] if o != w]) for w, p in present.items()}
    starting: dict[int, list[Way]] = {}
    for name, way in names.items():
        starting.setdefault(activities[name].start.terms[0][0], []).append(way)
    for asked, gaps in gaps_told(model).items():
        for first in gaps.keys() & starting.keys():
            for last, gap in (later_than(gaps, first) if asked else gaps[first]).items():
                pairs = itertools.product(starting[first], starting.get(last, ()))
                for before, then in pairs:
                    if gap >= 0 and asked <= {present[before], present[then]}:
                        needs[then].first.append((before, gap))
    return needs


Gaps = dict[int, dict[int, int]]
"""(time, time) -> how much later than the first the other is, at least."""


def gaps_told(model: ScheduleModel) -> dict[frozenset[int], Gaps]:
    """Return the gaps between times that are stated, by the presences that they hang on."""
    found: dict[frozenset[int], Gaps] = {}
    for activity in model.world.activities.values():
        start, end = activity.start, activity.end
        if start.terms != end.terms:
            lasts = activity.least + start.const - end.const
            gaps = found.setdefault(frozenset({activity.present} - {TRUE}), {})
            gaps.setdefault(start.terms[0][0], {})[end.terms[0][0]] = lasts
    for asked, stated in filter(None, map(conditional, model.stated)):
        told = difference_told(stated)
        if told is not None:
            first, last, gap = told
            then = found.setdefault(asked, {}).setdefault(first, {})
            then[last] = max(gap, then.get(last, gap))
    return found


def releases_told(model: ScheduleModel) -> dict[int, dict[Literal, int]]:
    """Return when times are at the soonest, as is stated: always (``TRUE``), and by each presence
    on which that hangs alone.
    """
    found: dict[int, dict[Literal, int]] = {}
    for asked, stated in filter(None, map(conditional, model.stated)):
        told = least_told(stated)
        if told is not None and len(asked) <= 1:
            since, literal = found.setdefault(told[0], {}), min(asked, default=TRUE)
            since[literal] = max(told[1], since.get(literal, 0))
    return found


def later_than(gaps: Gaps, first: int) -> dict[int, int]:
    """Return how much later other times are than one, by all gaps between some."""
    later, changed = {first: 0}, {first}
    for _ in gaps:
        since, changed = changed, set()
        for one in since:
            for other, gap in gaps.get(one, {}).items():
                if later[one] + gap > later.get(other, -INFINITE):
                    later[other] = later[one] + gap
                    changed.add(other)
    del later[first]
    return later


# ------------------ States that one traveller alone changes
# By its stops (a fork that is taken, a battery that is charged), and by its moves, which take from
# it (the battery).


Takings = dict[tuple[int, int], int]
"""(place, place) -> what is taken on the way at least."""


@dataclass(frozen=True)
class OwnState:
    """A state that the traveller of one ``route`` (its number) alone changes, within ``least`` and
    ``most``: each stop between its start and the next thing that it does, to a value (``settings``)
    or by it (``gains``), and moves, which take from it (``takings``; none: they do not). ``reads``:
    the values that ways to do tasks ask for as they begin.
    """

    route: int
    initial: int
    least: int
    most: int
    gains: dict[Way, int]
    settings: dict[Way, int]
    takings: Takings
    reads: dict[Way, frozenset[int]]

    def after(self, value: int, way: Way) -> int | None:
        """Return its value after a task is done in one way; ``None`` if it cannot be done."""
        new = self.settings.get(way, value + self.gains.get(way, 0))
        fits = value in self.reads.get(way, (value,)) and self.least <= new <= self.most
        return new if fits else None

    def refilled_by(self, way: Way) -> bool:
        """Return whether who has little left has more after a task is done in one way."""
        return self.settings.get(way, self.least + self.gains.get(way, 0)) > self.least

    def taken(self, some: Iterable[int], others: Iterable[int]) -> int:
        """Return what is taken at least from one of some places to one of others."""
        targets = list(others)
        pairs = itertools.product(some, targets)
        least = min((self.takings.get(pair, INFINITE) for pair in pairs), default=0)
        return 0 if least >= INFINITE else least


def find_own_states(
    model: ScheduleModel, routes: list[Route], names: Mapping[str, Way]
) -> list[OwnState]:
    """Return the states that one traveller alone changes, and who sets and asks for what; ``names``
    are those of the stops at which it meets nobody.

    Assumes: what a stop sets is seen before its traveller does anything else, and its moves only
    take; who asks for a state excludes that it is set at that time.
    """
    found = (
        _own_state(model, number, route, state, names)
        for (number, route), state in itertools.product(
            enumerate(routes), model.states.vars.values()
        )
    )
    return [own for own in found if own is not None]


def _own_state(
    model: ScheduleModel, number: int, route: Route, state: StateVar, names: Mapping[str, Way]
) -> OwnState | None:
    mine = {name: names[name] for name, _ in route.stops if name in names}
    taken, gains, settings = dict[str, int](), dict[Way, int](), dict[Way, int]()
    first, last = 1, 0
    for change in model.states.sure_changes(state):
        name, value, late = change.owner.name, change.value, change.late[1]
        if change.since[0] < 0:
            return None
        if name in route.movers and change.adds and value <= 0:
            taken[name], last = taken.get(name, 0) - value, max(last, late)
            continue
        way = mine.get(name)
        # what is taken is not taken at the instant at which the next one gives something back
        soon = late < route.gap if change.adds and value < 0 else late <= route.gap
        if way is None or not soon or way in settings or (way in gains and not change.adds):
            return None
        if change.adds:
            gains[way] = gains.get(way, 0) + value
        else:
            settings[way] = value
        first, last = min(first, change.since[0]), max(last, late)
    if state.initial is None or not (taken or gains or settings):
        return None
    least, most = state.bounds
    if not taken:
        # what is given back and taken at one instant may be more meanwhile
        most -= sum(min(0, gain) for gain in gains.values())
        reads = _asked(model, state, mine)
        return OwnState(number, state.initial, least, most, gains, settings, {}, reads)
    # at its start a change is seen together with the end of what was before; who may be put
    # somewhere else gets there for nothing
    if first < 1 or last > 0 or route.free:
        return None
    return OwnState(number, state.initial, least, most, gains, settings, _takings(route, taken), {})


def _takings(route: Route, taken: Mapping[str, int]) -> Takings:
    """Return what is taken on the ways at least."""
    least = {hop: min(taken.get(m.name, 0) for m in moves) for hop, moves in route.hops.items()}
    places = {route.initial}.union(*least)
    least |= {(p, p): 0 for p in places}
    shorten(least, places)
    return least


def _asked(
    model: ScheduleModel, state: StateVar, mine: Mapping[str, Way]
) -> dict[Way, frozenset[int]]:
    """Return the values of which each stop, whenever it is there, finds a state to have one."""
    found: dict[Way, frozenset[int]] = {}
    for read in state.reads:
        owner = None if read.owner is None else model.states.activity(read.owner)
        if owner is None or owner.name not in mine or read.allowed is None:
            continue
        since = model.states.difference(read.lo, owner.start)[0]
        lasts = model.states.difference(read.hi, read.lo)[0]
        own = state.by_owner().get(read.owner, ())
        before = all(model.states.difference(w.time, read.lo)[0] >= 0 for w in own)
        # at its last instant a loose one does not exclude that others set it
        if read.active == owner.present and since >= 0 and lasts >= read.loose and before:
            way = mine[owner.name]
            found[way] = found.get(way, read.allowed) & read.allowed
    return found
