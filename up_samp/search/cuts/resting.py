"""What a late motion tells of doors that it waits for and of objects that rest in its way."""

from __future__ import annotations

import math
from dataclasses import replace

from up_samp.model import Rest, ScheduledMotion, TimedMotion, avoids
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.refinement import rules
from up_samp.refinement.rules import Reason
from up_samp.search.cuts.protocol import Failure
from up_samp.search.facts import Facts
from up_samp.search.motions import Motions
from up_samp.search.statements.unreachable import opened
from up_samp.search.world import rests_of
from up_samp.upio import Itinerary

LONG_BEFORE = 1000.0
"""Seconds by which a motion is released early to learn how long it takes after a door opens."""


def door_cuts(failure: Failure, late: str) -> list[Refinement]:
    """Return how long before its end a motion needs a door to have opened."""
    facts, itinerary = failure.facts, failure.itinerary
    motion, timed = failure.scheduled[late], failure.timed[late]
    found = []
    for name in sorted(facts.instant):
        if not avoids(motion.avoid, name):
            continue
        for since, place, until in _periods(facts, itinerary, name):
            if not (since <= motion.start and motion.start < until <= motion.end):
                continue
            if facts.returns_to(name, place):
                continue
            cut = _door_cut(failure.motions, motion, timed, name, place)
            found += [] if cut is None else [cut]
    return found


def _door_cut(
    motions: Motions, motion: ScheduledMotion, timed: TimedMotion, name: str, place: str
) -> Refinement | None:
    facts, door = motions.facts, motions.facts.placed(name, place)
    rest = Rest(name, door.body, door.pose, -math.inf, 0.0)
    early = replace(timed, release=-LONG_BEFORE, due=math.inf, present_from=-math.inf)
    arrival = motions.arrival(early, rests=(rest,))
    if arrival is None or arrival <= 0:
        return None
    why = f"after {name} has left {place} the motion still takes {arrival:.2f} s"
    return opened(
        facts,
        facts.case(motion),
        name,
        place,
        facts.units(arrival),
        Reason(why, Layer.TEMPORAL, Strength.RELATIVE),
    )


def _periods(facts: Facts, itinerary: Itinerary, name: str) -> list[tuple[float, str, float]]:
    """Return (since, configuration, until) in units."""
    places = itinerary.places(facts.snapshot, name)
    ends = [since for since, _ in places[1:]] + [math.inf]
    return [(since, place, until) for (since, place), until in zip(places, ends, strict=True)]


def rest_cuts(failure: Failure, late: str) -> list[Refinement]:
    """State that objects which rest in the way all the time make a motion slower."""
    facts, itinerary = failure.facts, failure.itinerary
    motion, timed = failure.scheduled[late], failure.timed[late]
    window = (facts.seconds(motion.start), facts.seconds(motion.end))
    meanwhile = (m for m in itinerary.motions if m.start <= motion.end and m.end >= motion.start)
    busy = {name for m in meanwhile for name in m.moved}
    rests = [
        r
        for r in rests_of(facts, itinerary, frozenset(busy))
        if r.since <= window[0] and r.until >= window[1]
    ]
    movable = [r for r in rests if facts.movers[r.name]]
    if not movable:
        return []
    arrival = failure.motions.arrival(timed, rests=tuple(rests))
    if arrival is None or arrival <= timed.due + 1e-6:
        return []
    needed = _needed_rests(failure.motions, timed, rests, movable)
    blockers = {r.name: itinerary.place_at(facts.snapshot, r.name, motion.start) for r in needed}
    units = facts.units(arrival - timed.release)
    why = f"with {', '.join(sorted(blockers))} resting in its way the motion takes {units} units"
    cut = rules.slower_while(motion.activity, units, blockers, facts.movers, why)
    return [rules.only_given(cut, motion.given)]


def _needed_rests(
    motions: Motions, timed: TimedMotion, rests: list[Rest], movable: list[Rest]
) -> list[Rest]:
    """Return a smaller set of rests that still makes the motion late (deletion filter)."""
    kept = list(rests)
    needed = []
    for rest in movable:
        without = [r for r in kept if r is not rest]
        arrival = motions.arrival(timed, rests=tuple(without))
        if arrival is not None and arrival <= timed.due + 1e-6:
            needed.append(rest)
        else:
            kept = without
    return needed or movable
