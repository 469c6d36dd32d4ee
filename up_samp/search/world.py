"""The world of an itinerary: who rests where and when, and which motions may meet."""

from __future__ import annotations

import math
from collections.abc import Sequence

from up_samp.model import GroupQuery, Placed, Rest, ScheduledMotion, TimedMotion
from up_samp.search.context import Context
from up_samp.upio import Itinerary


def motion_key(motion: ScheduledMotion) -> str:
    """Return the name of a motion's trajectory in a plan."""
    return motion.activity if motion.constraint == 0 else f"{motion.activity}#{motion.constraint}"


def groups_of(motions: Sequence[ScheduledMotion]) -> list[tuple[ScheduledMotion, ...]]:
    """Return the parallel motion groups (Definition 11): motions chained by overlap in time."""
    groups: list[list[ScheduledMotion]] = []
    reach = -math.inf
    for motion in sorted(motions, key=lambda m: (m.start, m.end, m.activity)):
        if groups and motion.start <= reach:
            groups[-1].append(motion)
        else:
            groups.append([motion])
        reach = max(reach, motion.end)
    return [tuple(g) for g in groups]


def instant_obstacles(
    context: Context, itinerary: Itinerary, motion: ScheduledMotion
) -> tuple[Placed, ...]:
    """Return the objects that rest all through a motion's time and never drive (doors, props).

    Drivers are left to the group check: they may move away.
    """
    snapshot = context.snapshot
    found = []
    for name, place in snapshot.initial.items():
        if name == motion.object or name in context.drivers:
            continue
        if motion.avoid is not None and name not in motion.avoid:
            continue
        resting = _resting_at(context, itinerary, name, motion.start, motion.end)
        if resting is not None or name not in context.instant:
            pose = snapshot.configurations[resting or place]
            found.append(Placed(name, snapshot.objects[name].body, pose))
    return tuple(found)


def _resting_at(
    context: Context, itinerary: Itinerary, name: str, start: int, end: int
) -> str | None:
    """Return where ``name`` is all through (start, end), or None if it changes in between."""
    current = context.snapshot.initial[name]
    for since, place in itinerary.places(context.snapshot, name):
        if since <= start:
            current = place
        elif since < end:
            return None
    return current


def rests_of(context: Context, itinerary: Itinerary, moving: frozenset[str]) -> tuple[Rest, ...]:
    """Return all rests (s, plan time) of objects other than those in ``moving``."""
    snapshot = context.snapshot
    found = []
    for name in sorted(snapshot.initial):
        if name in moving:
            continue
        body = snapshot.objects[name].body
        periods = itinerary.places(snapshot, name)
        for index, (since, place) in enumerate(periods):
            until = periods[index + 1][0] if index + 1 < len(periods) else math.inf
            if until <= since:
                continue
            pose = snapshot.configurations[place]
            found.append(Rest(name, body, pose, context.seconds(since), context.seconds(until)))
    return tuple(found)


def group_query(
    context: Context, itinerary: Itinerary, group: Sequence[ScheduledMotion]
) -> GroupQuery:
    """Return the question whether the motions of ``group`` can be made as scheduled.

    Objects that move outside the group rest meanwhile. A robot that moves several times in the
    group is one chain: each motion holds its place until the next one is released.
    """
    snapshot = context.snapshot
    moving = frozenset(m.object for m in group)
    timed = []
    for motion in group:
        own = sorted((m for m in group if m.object == motion.object), key=lambda m: m.start)
        index = own.index(motion)
        timed.append(
            TimedMotion(
                name=motion_key(motion),
                object=motion.object,
                body=snapshot.objects[motion.object].body,
                poses=motion.poses,
                release=context.seconds(motion.start),
                due=context.seconds(motion.end),
                present_from=-math.inf if index == 0 else context.seconds(motion.start),
                present_until=(
                    math.inf if index + 1 == len(own) else context.seconds(own[index + 1].start)
                ),
                avoid=motion.avoid,
            )
        )
    window = (group[0].start, max(m.end for m in group))
    rests = tuple(
        r
        for r in rests_of(context, itinerary, moving)
        if r.since <= context.seconds(window[1]) and r.until >= context.seconds(window[0])
    )
    return GroupQuery(tuple(timed), rests)
