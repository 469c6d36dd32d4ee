"""What moves of one traveller need of other states: doors, rooms behind them, what holds still."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.forms import Literal
from up_samp.scheduling.cpsat.encode.statevars import Key, Read, StateVar
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.routing.changes import Change
from up_samp.scheduling.cpsat.routing.route import Entry, Move, Route, Still

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel


def find_entries(model: ScheduleModel, route: Route, changes: list[Change]) -> None:
    """Find what every change into a place needs of other state variables (open doors).

    Assumes: every move into a place needs the same, it does not hold at first, and no move provides
    it.

    :param changes: all that the traveller makes one at a time.
    """
    into: dict[int, list[Move]] = {}
    for move in route.moves:
        into.setdefault(move.to, []).append(move)
    movers = {change.activity.index for change in changes if change.activity is not None}
    needs = _needs(model, route, movers)
    for place, moves in into.items():
        if place in route.free:
            continue
        common = set.intersection(*(set(needs[move]) for move in moves))
        for key, allowed in sorted(common, key=str):
            if model.states.vars[key].initial in allowed:
                continue
            lead = min(needs[move][key, allowed] for move in moves)
            route.entries.setdefault(place, []).append(Entry(key, allowed, max(0, lead)))
    _find_closed_off(model, route, needs)


Needs = dict[Move, dict[tuple[Key, frozenset[int]], int]]
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
    chosen = [model.store.is_value(var, value) for var, value in move.values]
    return {
        model.store.all_of([activity.present, *some])
        for size in range(len(chosen) + 1)
        for some in itertools.combinations(chosen, size)
    }


def _find_closed_off(model: ScheduleModel, route: Route, needs: Needs) -> None:
    """Find the places to which there is no way but by moves that all need the same (rooms behind
    a door): to come there, one of these has been made before.

    Assumes: a place has no way to it but by moves that need the same.
    """
    for key, allowed in sorted({need for some in needs.values() for need in some}, key=str):
        if model.states.vars[key].initial in allowed:
            continue
        free = [m for m in route.moves if (key, allowed) not in needs[m]]
        leads = [some[key, allowed] for some in needs.values() if (key, allowed) in some]
        reached, size = {route.initial, *route.free}, 0
        while size < len(reached):
            size = len(reached)
            reached |= {m.to for m in free if m.origins & reached}
        for place in sorted({m.to for m in route.moves} - reached):
            known = route.entries.setdefault(place, [])
            if not any((e.state, e.allowed) == (key, allowed) for e in known):
                known.append(Entry(key, allowed, max(0, min(leads))))


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
