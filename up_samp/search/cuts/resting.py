"""What a late motion tells of doors that it waits for and of objects that rest in its way."""

from __future__ import annotations

import math
from dataclasses import replace

from up_samp.model import Rest, ScheduledMotion, TimedMotion
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.cases import case_of
from up_samp.search.context import Context
from up_samp.search.cuts.arrivals import arrival_of
from up_samp.search.cuts.failure import Failure
from up_samp.search.prepare import opened
from up_samp.search.world import rests_of
from up_samp.upio import Itinerary

LONG_BEFORE = 1000.0
"""Seconds by which a motion is released early to learn how long it takes after a door opens."""


def door_cuts(failure: Failure, late: str) -> list[Refinement]:
    """Return how long before its end a motion needs a door to have opened."""
    context, itinerary = failure.context, failure.itinerary
    motion, timed = failure.scheduled[late], failure.timed[late]
    found = []
    for name in sorted(context.instant):
        if motion.avoid is not None and name not in motion.avoid:
            continue
        for since, place, until in _periods(context, itinerary, name):
            if not (since <= motion.start and motion.start < until <= motion.end):
                continue
            if context.returns_to(name, place):
                continue
            cut = _door_cut(context, motion, timed, name, place)
            found += [] if cut is None else [cut]
    return found


def _door_cut(
    context: Context, motion: ScheduledMotion, timed: TimedMotion, name: str, place: str
) -> Refinement | None:
    body, pose = context.snapshot.objects[name].body, context.snapshot.configurations[place]
    rest = Rest(name, body, pose, -math.inf, 0.0)
    early = replace(timed, release=-LONG_BEFORE, due=math.inf, present_from=-math.inf)
    arrival = arrival_of(context, early, rests=(rest,))
    if arrival is None or arrival <= 0:
        return None
    why = f"after {name} has left {place} the motion still takes {arrival:.2f} s"
    return opened(
        context,
        case_of(context.snapshot, motion),
        name,
        place,
        context.units(arrival),
        why,
        strength=Strength.RELATIVE,
        layer=Layer.TEMPORAL,
    )


def _periods(context: Context, itinerary: Itinerary, name: str) -> list[tuple[float, str, float]]:
    """Return (since, configuration, until) in units."""
    places = itinerary.places(context.snapshot, name)
    ends = [since for since, _ in places[1:]] + [math.inf]
    return [(since, place, until) for (since, place), until in zip(places, ends, strict=True)]


def rest_cuts(failure: Failure, late: str) -> list[Refinement]:
    """Return that objects which rest in the way all the time make a motion slower."""
    context, itinerary = failure.context, failure.itinerary
    motion, timed = failure.scheduled[late], failure.timed[late]
    window = (context.seconds(motion.start), context.seconds(motion.end))
    meanwhile = (m for m in itinerary.motions if m.start <= motion.end and m.end >= motion.start)
    busy = {name for m in meanwhile for name in m.moved}
    rests = [
        r
        for r in rests_of(context, itinerary, frozenset(busy))
        if r.since <= window[0] and r.until >= window[1]
    ]
    movable = [r for r in rests if context.movers[r.name]]
    if not movable:
        return []
    arrival = arrival_of(context, timed, rests=tuple(rests))
    if arrival is None or arrival <= timed.due + 1e-6:
        return []
    needed = _needed_rests(context, timed, rests, movable)
    blockers = {r.name: itinerary.place_at(context.snapshot, r.name, motion.start) for r in needed}
    units = context.units(arrival - timed.release)
    why = f"with {', '.join(sorted(blockers))} resting in its way the motion takes {units} units"
    cut = rules.slower_while(motion.activity, units, blockers, context.movers, why)
    return [rules.only_given(cut, motion.given)]


def _needed_rests(
    context: Context, timed: TimedMotion, rests: list[Rest], movable: list[Rest]
) -> list[Rest]:
    """Return a smaller set of rests that still makes the motion late (deletion filter)."""
    kept = list(rests)
    needed = []
    for rest in movable:
        without = [r for r in kept if r is not rest]
        arrival = arrival_of(context, timed, rests=tuple(without))
        if arrival is not None and arrival <= timed.due + 1e-6:
            needed.append(rest)
        else:
            kept = without
    return needed or movable
