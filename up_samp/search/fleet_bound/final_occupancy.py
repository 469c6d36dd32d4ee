"""Who stays where in the end: no more robots at a place than there is room for.

A robot that has done its last job stays where that ends, or drives on. Where two bodies overlap if
both stand at a place, and every drive that ends there heeds all other robots, only one of all
robots can be there when all is over. So a fleet that ends its jobs at fewer places than it has
robots has some drives more to make.

Robots at a place in the end are those that came there and did not leave. What comes and goes for
jobs is told by the ways to do them; a drive that is no part of a counted job is one *away* from
there, and takes its time beside all jobs. Where a drive is made only if one certain job is done in
one certain way, it is never such a drive; then a job may be done by several robots, each of which
takes its time.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from up_samp.model import avoids
from up_samp.model.snapshot import Snapshot
from up_samp.motion import MotionService
from up_samp.search.fleet.jobs import Jobs, WorkMode
from up_samp.search.fleet_bound.work import JobMode, JobWork, Leg

Away = tuple[int, str, str | None]
"""A kind of robots, the place that they drive away from, and where to (None: anywhere)."""


@dataclass(frozen=True)
class FinalOccupancy:
    """The ``places`` at each of which one robot stays in the end at most.

    ``aways``: drives from there that belong to no job that is counted (any of them may be the
    least), ``often``: how often there are such. ``repeated``: jobs that may be done several
    times, and how often at most. ``everybody``: whoever did a job stays at one of the places, or
    drove away from one.
    """

    places: frozenset[str] = frozenset()
    aways: Mapping[Away, tuple[Leg, ...]] = field(default_factory=dict)
    often: Mapping[Away, int] = field(default_factory=dict)
    repeated: Mapping[int, int] = field(default_factory=dict)
    everybody: bool = False


def final_occupancy(
    work: JobWork,
    snapshot: Snapshot,
    service: MotionService,
    ways: Sequence[JobMode],
    parts: tuple[Jobs, Sequence[Sequence[WorkMode]]] | None,
) -> FinalOccupancy:
    """Return where one robot at most stays in the end.

    Assumes: a robot comes to places by the drives of its jobs alone, and a place holds one in the
    end.

    :param parts: all jobs and those that are counted, by the numbers of the ``ways``; None where
        ways are not made of drives of their own, so that robots may drive anywhere in between.
    """
    robots = work.robots
    if not all(work.traced(r) for r in robots) or any(way.leaves is None for way in ways):
        return FinalOccupancy()
    staying = {p for way in ways for p in way.ends if _stays(way, p)}
    places = {p for p in sorted(staying) if _one_at_most(p, work, snapshot, service)}
    if parts is None:
        aways, often = _anywhere(work, places)
        told = all(places.issuperset(way.ends) for way in ways)
        return FinalOccupancy(frozenset(places), aways, often, everybody=told)
    repeated = _repeated(parts[1])
    inside = _inside(parts, repeated)
    found = defaultdict[Away, list[Leg]](list)
    for robot in robots:
        for task in work.drives(robot):
            begins = work.origins(task)
            if task.activity in inside or (begins is not None and not places.intersection(begins)):
                continue
            if begins is None or len(task.terms) > 2:
                # nothing is known of what it takes from there
                places -= places if begins is None else set(begins)
                continue
            for place in begins:
                if place != task.terms[-1].name:
                    away = work.kind_of[robot], place, task.terms[-1].name
                    found[away].append((work.body_of(task), place, task.terms[-1].name))
    kept = {away: some for away, some in sorted(found.items(), key=_ends) if away[1] in places}
    aways = {away: tuple(dict.fromkeys(some)) for away, some in kept.items()}
    often = {away: len(some) for away, some in kept.items()}
    told = all(_ends_there(way, places) for way in ways)
    return FinalOccupancy(frozenset(places), aways, often, repeated, told)


def _ends_there(way: JobMode, places: set[str]) -> bool:
    """Return whether a robot that came to a job from one of some places, or did it at all, is at
    one of them later.
    """
    assert way.leaves is not None
    staying = {p for p in way.ends if _stays(way, p)} & places
    later = {p for p in staying if p == way.goal or p in way.after}
    return bool(later) and not places.intersection(way.leaves)


def _ends(item: tuple[Away, object]) -> tuple[int, str, str]:
    kind, start, goal = item[0]
    return kind, start, goal or ""


def _stays(way: JobMode, place: str) -> bool:
    """Return whether a way comes to a place more often than it leaves it."""
    assert way.leaves is not None
    return way.ends.count(place) > way.leaves.count(place)


def _one_at_most(place: str, work: JobWork, snapshot: Snapshot, service: MotionService) -> bool:
    """Return whether two robots can never stay at a place at once, whoever comes there later."""
    pose = snapshot.configurations[place]
    bodies = {work.kind_of[r]: snapshot.objects[r].body for r in work.robots}
    if any(body.flies for body in bodies.values()):
        return False
    pairs = itertools.combinations_with_replacement(sorted(bodies), 2)
    if not all(service.overlap(bodies[a], pose, bodies[b], pose) for a, b in pairs):
        return False
    coming = (t for r in work.robots for t in work.drives(r) if t.terms[-1].name == place)
    return all(avoids(t.avoid, *(set(work.robots) - {t.object})) for t in coming)


def _anywhere(
    work: JobWork, places: set[str]
) -> tuple[dict[Away, tuple[Leg, ...]], dict[Away, int]]:
    """Return drives away from places to wherever robots of a kind may stop."""
    aways: dict[Away, tuple[Leg, ...]] = {}
    for kind, robot in sorted({k: r for r, k in work.kind_of.items()}.items()):
        stops = sorted(work.stops(kind))
        for place in sorted(places):
            legs = tuple((work.body(robot), place, goal) for goal in stops if goal != place)
            if legs:
                aways[kind, place, None] = legs
    # each robot drives away once at most after all of its jobs
    return aways, {away: work.sizes[away[0]] for away in aways}


def _repeated(counted: Sequence[Sequence[WorkMode]]) -> dict[int, int]:
    """Return the jobs whose options have no activities in common, and how many options."""
    found = {}
    for job, options in enumerate(counted):
        names = Counter(name for option in options for name in option.members)
        if max(names.values()) == 1:
            found[job] = len(options)
    return found


def _inside(
    parts: tuple[Jobs, Sequence[Sequence[WorkMode]]], repeated: Mapping[int, int]
) -> frozenset[str]:
    """Return the activities that are present only if the one option is, whose they are, of a job
    that is counted however often it is done.
    """
    jobs, counted = parts
    mine = {
        name: option.leader
        for job in sorted(repeated)
        for option in counted[job]
        for name in option.members
    }
    return frozenset(name for name, leader in mine.items() if leader in jobs.drawn(name))


def least(legs: Sequence[Leg], units: Callable[[Leg], int]) -> tuple[int, Leg]:
    """Return units of the shortest of some drives, and which one that is."""
    return min(((units(leg), leg) for leg in legs), key=lambda found: (found[0], found[1][1:]))
