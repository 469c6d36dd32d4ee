"""The world of an itinerary: who rests where and when, and which motions may meet."""

from __future__ import annotations

import math
from collections.abc import Sequence

from up_samp.model import GroupQuery, Placed, Rest, ScheduledMotion, TimedMotion
from up_samp.model.snapshot import Snapshot
from up_samp.search.facts import Facts
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
    facts: Facts, itinerary: Itinerary, motion: ScheduledMotion
) -> tuple[Placed, ...]:
    """Return the objects that rest all through a motion's time and never drive (doors, pallets).

    Drivers are left to the group check: they may move away.
    """
    snapshot = facts.snapshot
    found = []
    for name, place in snapshot.initial.items():
        if name in motion.moved or name in facts.drivers:
            continue
        if motion.avoid is not None and name not in motion.avoid:
            continue
        resting = _resting_at(facts, itinerary, name, motion.start, motion.end)
        if resting is not None or not (name in facts.instant or name in facts.loads):
            found.append(facts.placed(name, resting or place))
    return tuple(found)


def _resting_at(facts: Facts, itinerary: Itinerary, name: str, start: int, end: int) -> str | None:
    """Return where ``name`` is all through (start, end), or None if it changes in between."""
    for motion in itinerary.motions:
        if name in motion.moved and motion.start < end and start < motion.end:
            return None
    current = facts.snapshot.initial[name]
    for since, place in itinerary.places(facts.snapshot, name):
        if since <= start:
            current = place
        elif since < end:
            return None
    return current


def rests_of(facts: Facts, itinerary: Itinerary, moving: frozenset[str]) -> tuple[Rest, ...]:
    """Return all rests (s, plan time) of objects other than those in ``moving``.

    A load rests until its ride starts, and again from the ride's end on.
    """
    snapshot = facts.snapshot
    found = []
    for name in sorted(snapshot.initial):
        if name in moving:
            continue
        body = snapshot.objects[name].body
        leaves = {m.end: m.start for m in itinerary.motions if name in m.moved - {m.object}}
        periods = itinerary.places(snapshot, name)
        for index, (since, place) in enumerate(periods):
            until = periods[index + 1][0] if index + 1 < len(periods) else math.inf
            until = leaves.get(int(until), until) if math.isfinite(until) else until
            if until <= since:
                continue
            pose = snapshot.configurations[place]
            found.append(Rest(name, body, pose, facts.seconds(since), facts.seconds(until)))
    return tuple(found)


def group_query(facts: Facts, itinerary: Itinerary, group: Sequence[ScheduledMotion]) -> GroupQuery:
    """Return the question whether the motions of ``group`` can be made as scheduled.

    Objects that move outside the group rest meanwhile. A robot that moves several times in the
    group is one chain: each motion holds its place until the next one is released. With loads it is
    another body: it is that one from its activity's start to its end, and rests alone before and
    after.
    """
    moving = frozenset(m.object for m in group)
    timed, alone = [], []
    for motion in group:
        since, until = _presence(facts, group, motion)
        timed.append(
            TimedMotion(
                name=motion_key(motion),
                object=motion.object,
                body=facts.body(motion),
                poses=motion.poses,
                release=facts.seconds(motion.start),
                due=facts.seconds(motion.end),
                present_from=since,
                present_until=until,
                avoid=motion.avoid,
            )
        )
        if motion.loads:
            alone += _around(facts, group, motion, since, until)
    window = (group[0].start, max(m.end for m in group))
    rests = tuple(
        r
        for r in (*rests_of(facts, itinerary, moving), *alone)
        if r.since <= facts.seconds(window[1]) and r.until >= facts.seconds(window[0])
    )
    return GroupQuery(tuple(timed), rests)


def _chain(
    group: Sequence[ScheduledMotion], motion: ScheduledMotion
) -> tuple[ScheduledMotion | None, ScheduledMotion | None]:
    """Return the motions of the same object before and after a motion in its group."""
    own = sorted((m for m in group if m.object == motion.object), key=lambda m: m.start)
    index = own.index(motion)
    before = own[index - 1] if index else None
    return before, own[index + 1] if index + 1 < len(own) else None


def _presence(
    facts: Facts, group: Sequence[ScheduledMotion], motion: ScheduledMotion
) -> tuple[float, float]:
    """Return from when to when (s) the body of a motion is there."""
    before, after = _chain(group, motion)
    loads = {name for name, _ in motion.loads}
    since, until = facts.seconds(motion.start), math.inf
    if before is None:
        since = -math.inf
    if after is not None:
        until = facts.seconds(after.start)
    if not loads:
        return since, until
    # at rest beside its loads it is the same body, as long as nobody else takes one of them and
    # whoever keeps clear of it keeps clear of them
    others = [m for m in group if m is not motion and m.object != motion.object]
    same = all(m.avoid is None or loads <= m.avoid for m in others)
    taken = [m for m in group if m is not motion and loads & m.moved]
    if before is not None or not same or any(m.start < motion.start for m in taken):
        since = facts.seconds(motion.start)
    if after is not None or not same or any(m.start >= motion.end for m in taken):
        until = facts.seconds(motion.end)
    return since, until


def _around(
    facts: Facts,
    group: Sequence[ScheduledMotion],
    motion: ScheduledMotion,
    since: float,
    until: float,
) -> list[Rest]:
    """Return where an object rests without its loads before and after a ride."""
    before, after = _chain(group, motion)
    body = facts.snapshot.objects[motion.object].body
    found = []
    if before is None and math.isfinite(since):
        found.append((motion.poses[0], -math.inf, since))
    if before is not None and before.loads:
        found.append((motion.poses[0], facts.seconds(before.end), since))
    if math.isfinite(until):
        next_start = math.inf if after is None else facts.seconds(after.start)
        if after is None or not after.loads:
            found.append((motion.poses[-1], until, next_start))
    return [Rest(motion.object, body, p, low, high) for p, low, high in found if low < high]


def places_between(
    itinerary: Itinerary, snapshot: Snapshot, name: str, first: int, last: int
) -> set[str]:
    """Return the configurations that object ``name``'s state has during [first, last].

    As PDDL 2.1 reads it: a change at t is seen from t + 1 on.
    """
    periods = itinerary.places(snapshot, name)
    found = set()
    for index, (since, place) in enumerate(periods):
        until = periods[index + 1][0] if index + 1 < len(periods) else math.inf
        if since + 1 <= last and first <= until:
            found.add(place)
    return found
