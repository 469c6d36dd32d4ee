"""From a schedule of the collapsed problem to one with moves."""

from __future__ import annotations

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.routing.detection import Move, Route


def expand(routes: list[Route], schedule: CandidateSchedule) -> CandidateSchedule:
    """Return ``schedule`` with moves put in, as early as they may happen.

    Direct moves are given to legs first; who comes too late for one takes a detour.
    """
    times = dict(schedule.times)
    for route in routes:
        _expand(route, times)
    for name in (name for route in routes for name, _ in route.visits):
        times.pop(name, None)
    return CandidateSchedule(times, schedule.parameters)


def _expand(route: Route, times: dict[str, tuple[int, int]]) -> None:
    stops = sorted((times[n], n, places) for n, places in route.stops if n in times)
    goals = [(start, end, places) for (start, end), _, places in stops]
    if route.home is not None:
        goals.append((0, 0, route.home))
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
    for (start, end, _), moves in zip(goals, ways, strict=True):
        for move in moves or ():
            times[move.name] = (free, free + move.least)
            free += move.least + route.step
        free = max(end + route.gap, start, free)
