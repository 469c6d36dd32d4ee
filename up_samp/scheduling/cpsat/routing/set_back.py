"""States that travellers need and that are set back again: doors that close by themselves.

What opens a door for good is done once (:mod:`.dispatch`). A door that closes again has to be
opened as often as somebody comes too late, so whoever schedules drives one by one has to know when
it is open: what is done at a stop changes it, then and later, by what follows at a fixed time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from operator import inv

from up_samp.scheduling.cpsat.encode.forms import Cmp, Literal, difference_told, parts_of
from up_samp.scheduling.cpsat.encode.states import Key, Read, StateVar
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.route import Route

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
    for write in state.writes:
        if model.store.never(write.active):
            continue
        owner = model.states.activity(write.owner or 0)
        start = owner.start.terms[0][0]
        ways = coming.get(owner.present, ())
        after = [(w, gap) for w in ways if (gap := later.get((begins[w], start))) is not None]
        since, latest = model.states.difference(write.time, owner.start)
        told = write.owner, write.active, write.add, write.value.terms, since, len(after)
        if told != (owner.index, owner.present, False, (), latest, 1):
            return {}
        ((way, gap),) = after
        found.setdefault(way, []).append((state.key, write.value.const, gap + since))
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
