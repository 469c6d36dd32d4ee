"""What a failed group tells: small, general refinements where there are any, exact ones else.

Tried in this order, the first that rejects the candidate wins: a motion that waits for a door; a
motion slowed by what rests in its way; two motions that meet, for a whole range of start offsets;
the group just as it was timed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

from up_samp.model import (
    FixedMotion,
    GroupQuery,
    GroupReport,
    Outcome,
    PathQuery,
    Rest,
    ScheduledMotion,
    TimedMotion,
    Trajectory,
)
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.motion.spacetime import earliest_arrival
from up_samp.refinement import rules
from up_samp.search.context import Context
from up_samp.search.exact import or_exact, rejects
from up_samp.search.prepare import opened
from up_samp.search.world import motion_key, rests_of
from up_samp.upio import Itinerary

LONG_BEFORE = 1000.0
"""Seconds by which a motion is released early to learn how long it takes after a door opens."""


def learn(
    context: Context,
    itinerary: Itinerary,
    group: Sequence[ScheduledMotion],
    query: GroupQuery,
    report: GroupReport,
) -> list[Refinement]:
    """Return refinements that reject the candidate's group."""
    scheduled = {motion_key(m): m for m in group}
    timed = {m.name: m for m in query.motions}
    if not context.params.small_cuts:
        return [_paper_cut(context, itinerary, group, report)]
    if report.outcome is not Outcome.FOUND:
        names = sorted(report.conflict or scheduled)
        motions = [scheduled[n] for n in names]
        blockers = _blocking(context, itinerary, report, motions)
        why = report.reason or "no trajectories found in time"
        cut = rules.group_fails(motions, blockers, context.movers, why)
        return or_exact(context, itinerary, group, report, [cut])
    found: list[Refinement] = []
    for name in sorted(report.late, key=lambda n: (timed[n].release, n)):
        motion = (context, itinerary, scheduled[name], timed[name])
        attempts = (
            partial(_door_cuts, *motion),
            partial(_rest_cuts, *motion),
            partial(_pair_cuts, context, scheduled, timed, name, report),
        )
        found += _first_violated(context, itinerary, attempts)
        if context.deadline.expired():
            break
    found = found or [_timing_cut(context, itinerary, group, report)]
    return or_exact(context, itinerary, group, report, found)


def _first_violated(
    context: Context,
    itinerary: Itinerary,
    attempts: Iterable[Callable[[], list[Refinement]]],
) -> list[Refinement]:
    for attempt in attempts:
        found = attempt()
        if any(rejects(context, itinerary, r) for r in found):
            return found
    return []


# ------------------------------------------------------------------------ doors and rests
def _door_cuts(
    context: Context, itinerary: Itinerary, motion: ScheduledMotion, timed: TimedMotion
) -> list[Refinement]:
    """Return how long before its end a motion needs a door to have opened."""
    found = []
    for name in sorted(context.instant):
        if motion.avoid is not None and name not in motion.avoid:
            continue
        for since, place, until in _periods(context, itinerary, name):
            if not (since <= motion.start and motion.start < until <= motion.end):
                continue
            if context.returns_to(name, place):
                continue
            rest = Rest(
                name,
                context.snapshot.objects[name].body,
                context.snapshot.configurations[place],
                -math.inf,
                0.0,
            )
            early = replace(timed, release=-LONG_BEFORE, due=math.inf, present_from=-math.inf)
            arrival = arrival_of(context, early, rests=(rest,))
            if arrival is not None and arrival > 0:
                why = f"after {name} has left {place} the motion still takes {arrival:.2f} s"
                found.append(
                    opened(
                        context,
                        motion.activity,
                        name,
                        place,
                        context.units(arrival),
                        why,
                        strength=Strength.RELATIVE,
                        layer=Layer.TEMPORAL,
                    )
                )
    return found


def _periods(context: Context, itinerary: Itinerary, name: str) -> list[tuple[float, str, float]]:
    """Return (since, configuration, until) in units."""
    places = itinerary.places(context.snapshot, name)
    ends = [since for since, _ in places[1:]] + [math.inf]
    return [(since, place, until) for (since, place), until in zip(places, ends, strict=True)]


def _rest_cuts(
    context: Context, itinerary: Itinerary, motion: ScheduledMotion, timed: TimedMotion
) -> list[Refinement]:
    """Return that objects which rest in the way all the time make a motion slower."""
    window = (context.seconds(motion.start), context.seconds(motion.end))
    busy = {m.object for m in itinerary.motions if m.start <= motion.end and m.end >= motion.start}
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
    return [rules.slower_while(motion.activity, units, blockers, context.movers, why)]


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


# ---------------------------------------------------------------------------------- pairs
def _pair_cuts(
    context: Context,
    scheduled: dict[str, ScheduledMotion],
    timed: dict[str, TimedMotion],
    name: str,
    report: GroupReport,
) -> list[Refinement]:
    """Return an interaction profile of the late motion with one that it meets."""
    if not context.params.profiles:
        return []
    late = scheduled[name]
    others = [
        n
        for n in sorted(scheduled, key=lambda n: (n not in report.conflict, n))
        if scheduled[n].object != late.object
        and scheduled[n].start <= late.end
        and late.start <= scheduled[n].end
    ]
    for other in others:
        if context.deadline.expired():
            break
        first, second = sorted((name, other), key=lambda n: (scheduled[n].start, n))
        cut = _pair_cut(context, scheduled[first], scheduled[second], timed[first], timed[second])
        if cut is not None:
            return [cut]
    return []


def _pair_cut(
    context: Context,
    a: ScheduledMotion,
    b: ScheduledMotion,
    timed_a: TimedMotion,
    timed_b: TimedMotion,
) -> Refinement | None:
    """Return the pair's cut for the widest range of offsets that still rejects the candidate."""
    offset = b.start - a.start
    slack_b, slack_a = b.end - a.start, a.end - b.start

    def second_end(at: int) -> int | None:
        return _arrival_behind(context, timed_a, timed_b, at)

    def first_end(at: int) -> int | None:
        return _arrival_behind(context, timed_b, timed_a, -at)

    ends = second_end(offset), first_end(offset)
    if ends[0] is None or ends[1] is None or ends[0] <= slack_b or ends[1] <= slack_a:
        return None
    reach = max(a.end - a.start, b.end - b.start)
    low = _widest(offset, -1, reach, lambda d: (second_end(d) or 0) > slack_b)
    high = _widest(offset, +1, reach, lambda d: (first_end(d) or 0) > slack_a)
    if low > high:
        return None
    needed_b, needed_a = second_end(low), first_end(high)
    assert needed_b is not None
    assert needed_a is not None
    why = f"{a.activity} and {b.activity} meet when started {low} to {high} units apart"
    return rules.pair_meets(a.activity, b.activity, (low, high), needed_b, needed_a, why)


def _widest(offset: int, step: int, reach: int, works: Callable[[int], bool]) -> int:
    """Return the offset farthest from ``offset`` on one side at which ``works`` still holds.

    ``works`` is monotone: who starts earlier never arrives later.
    """
    good, size = offset, 1
    while size <= reach and works(offset + step * size):
        good = offset + step * size
        size *= 2
    bad = offset + step * size
    while abs(bad - good) > 1:
        middle = (good + bad) // 2
        if works(middle):
            good = middle
        else:
            bad = middle
    return good


def _arrival_behind(
    context: Context, leader: TimedMotion, follower: TimedMotion, offset: int
) -> int | None:
    """Return the follower's earliest end (units after the leader's start) when it gives way.

    Only the two are there, and the leader drives its fastest motion.
    """
    trajectory = _fastest(context, leader)
    if trajectory is None:
        return None
    fixed = FixedMotion(
        leader.name,
        leader.object,
        leader.body,
        trajectory,
        trajectory.start,
        trajectory.end,
    )
    moved = replace(
        follower,
        release=context.seconds(offset),
        due=math.inf,
        present_from=context.seconds(offset),
        present_until=math.inf,
    )
    arrival = arrival_of(context, moved, fixed=(fixed,))
    return None if arrival is None else context.units(arrival)


def _fastest(context: Context, motion: TimedMotion) -> Trajectory | None:
    """Return the motion's fastest trajectory with nobody else there, from time 0."""
    report = context.service.plan(
        PathQuery(motion.body, motion.poses), context.deadline.within(context.query_seconds)
    )
    return report.trajectory


def arrival_of(
    context: Context,
    motion: TimedMotion,
    rests: tuple[Rest, ...] = (),
    fixed: tuple[FixedMotion, ...] = (),
) -> float | None:
    """Return the motion's earliest arrival (s) among these, or None if none was found."""
    # due at once: then it looks for the earliest arrival, not for any in time
    hasty = replace(motion, due=motion.release)
    deadline = context.deadline.within(context.query_seconds)
    report = earliest_arrival(context.service, hasty, rests, fixed, deadline)
    # what a search that was cut short found need not be the earliest: it says nothing
    if report.trajectory is None or deadline.expired():
        return None
    return report.trajectory.end


# --------------------------------------------------------------------------- exact timings
def _timing_cut(
    context: Context,
    itinerary: Itinerary,
    group: Sequence[ScheduledMotion],
    report: GroupReport,
) -> Refinement:
    names = set(report.conflict) | set(report.late)
    motions = [m for m in group if motion_key(m) in names]
    first = min(m.start for m in motions)
    arrivals = {
        m.activity: context.units(report.late[motion_key(m)]) - first
        for m in motions
        if motion_key(m) in report.late
    }
    blockers = _blocking(context, itinerary, report, motions)
    why = f"{', '.join(sorted(arrivals))} cannot arrive in time among the others"
    strength = context.strength_of(report.seconds, len(group))
    return rules.group_timing(motions, arrivals, blockers, context.movers, why, strength=strength)


def _blocking(
    context: Context,
    itinerary: Itinerary,
    report: GroupReport,
    motions: Sequence[ScheduledMotion],
) -> dict[str, str]:
    start = min(m.start for m in motions)
    found = {}
    for name in sorted(report.blockers):
        if not context.movers.get(name):
            continue
        found[name] = itinerary.place_at(context.snapshot, name, start)
    return found


def _paper_cut(
    context: Context,
    itinerary: Itinerary,
    group: Sequence[ScheduledMotion],
    report: GroupReport,
) -> Refinement:
    """Return the paper's group refinement, with every rival and every other object's place."""
    start = min(m.start for m in group)
    moving = {m.object for m in group}
    places = {}
    for name in sorted(context.snapshot.moved()):
        if name in moving:
            continue
        places[name] = itinerary.place_at(context.snapshot, name, start)
    rivals = sorted({t.activity for t in context.snapshot.tasks})
    if report.outcome is not Outcome.FOUND:
        return rules.paper_geometric(
            group,
            rivals,
            places,
            report.reason or "no trajectories for the group",
            layer=Layer.GROUP,
            strength=Strength.HEURISTIC,
        )
    arrivals = {
        m.activity: context.units(report.late[motion_key(m)]) - start
        for m in group
        if motion_key(m) in report.late
    }
    why = "the group needs more time"
    strength = context.strength_of(report.seconds, len(group))
    return rules.paper_temporal(
        group, rivals, arrivals, places, why, layer=Layer.GROUP, strength=strength
    )
