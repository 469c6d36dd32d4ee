"""From a schedule of the routing relaxation to one with moves."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.encode.states import Key
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.route import Move, Route, Still, Timed

Changes = dict[str, list[tuple[Key, int]]]
"""Activity -> the state variables that it changes, and when: counted from its end."""
Events = list[tuple[Key, int]]


def expand(
    routes: list[Route], schedule: CandidateSchedule, changes: Changes | None = None
) -> CandidateSchedule:
    """Return ``schedule`` with moves put in, as early as they may happen.

    Direct moves are given to legs first; who comes too late for one takes a detour, and so does who
    would be on the way while something changes that moves keep as it is.
    """
    times = dict(schedule.times)
    events = [
        (key, schedule.times[name][1] + delay)
        for name, some in (changes or {}).items()
        if name in schedule.times
        for key, delay in some
    ]
    for route in routes:
        _expand(route, times, events)
    for name in (name for route in routes for name, _ in route.visits):
        times.pop(name, None)
    return CandidateSchedule(times, schedule.parameters)


def changes_by_name(model: ScheduleModel) -> Changes:
    """Return what each activity changes at a known time."""
    changes: Changes = {}
    for key, state in model.states.vars.items():
        for write in state.writes if not state.numeric else ():
            if write.owner is not None:
                owner = model.states.activity(write.owner)
                low, high = model.states.difference(write.time, owner.end)
                if low == high:
                    changes.setdefault(owner.name, []).append((key, low))
    return changes


def calm(still: Still, events: Iterable[tuple[Key, int]], start: int, length: int) -> int:
    """Return the first time from ``start`` on at which nothing changes during a move."""
    spans = sorted(
        (time - still[key][0], still[key][1] - still[key][0])
        for key, time in events
        if key in still
    )
    for time, more in spans:
        if start < time < start + length + more:
            start = time
    return start


def _expand(route: Route, times: dict[str, tuple[int, int]], events: Events) -> None:
    stops = sorted((times[n], n, places) for n, places in route.stops if n in times)
    goals = [(start, end, places) for (start, end), _, places in stops]
    rests = [route.rest(name) for _, name, _ in stops]
    if route.home is not None:
        goals.append((0, 0, route.home))
        rests.append(route.step)
    ways: list[list[Move] | None] = []
    here, used = route.initial, set[str]()
    legs = []
    for _, _, places in goals:
        # direct moves first: detours must not take them away from other legs
        found = None if here in places or not places else route.way(here, places)
        direct = found is not None and len(found[1]) == 1 and found[1][0].name not in used
        legs.append((here, places))
        ways.append(found[1] if direct and found else None)
        if direct and found:
            used.add(found[1][0].name)
        if found is not None:
            here = found[1][-1].to
    for i, (origin, places) in enumerate(legs):
        if ways[i] is None and places and origin not in places:
            found = route.way(origin, places, used) or route.way(origin, places)
            ways[i] = found[1] if found else []
            used.update(m.name for m in ways[i] or ())
    free = 0
    for (origin, places), (start, end, _), moves, rest in zip(
        legs, goals, ways, rests, strict=True
    ):
        timed = _timed(route, moves or [], free, events)
        if timed and end and timed[-1][0] + timed[-1][1].least + rest > start:
            banned = used - {move.name for _, move in timed}
            wait = partial(calm, route.still, events)
            other = route.soonest(origin, places, banned, free, wait)
            if other and _arrival(other) < _arrival(timed):
                timed = other
                used.update(move.name for _, move in timed)
        for begin, move in timed:
            times[move.name] = (begin, begin + move.least)
            free = begin + move.least + route.step
        free = max(end + route.gap, start, free)


def _arrival(timed: Timed) -> int:
    return timed[-1][0] + timed[-1][1].least


def _timed(route: Route, moves: list[Move], free: int, events: Events) -> Timed:
    """Return moves as early as nothing changes during each."""
    timed = []
    for move in moves:
        begin = calm(route.still, events, free, move.least)
        timed.append((begin, move))
        free = begin + move.least + route.step
    return timed
