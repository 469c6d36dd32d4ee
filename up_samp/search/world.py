"""The world of an itinerary: who rests where and when, which motions may meet, and what motion
planners are asked about them.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    GroupQuery,
    PathQuery,
    PathReport,
    Placed,
    Rest,
    ScheduledMotion,
    TimedMotion,
    avoids,
)
from up_samp.model.graphs import reached
from up_samp.model.refinement import Strength
from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.motion import MotionService
from up_samp.motion.guides import TOUCHES
from up_samp.search.budget import Budget
from up_samp.search.facts import Facts, MotionCase
from up_samp.upio import Itinerary, trajectory_key


def motion_key(motion: ScheduledMotion) -> str:
    """Return the name of a motion's trajectory in a plan."""
    return trajectory_key(motion.activity, motion.constraint)


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
        if name in motion.moved | facts.drivers or not avoids(motion.avoid, name):
            continue
        resting = _resting_at(facts, itinerary, name, motion.start, motion.end)
        if resting is not None or name not in snapshot.moved_otherwise:
            found.append(facts.placed(name, resting or place))
    return tuple(found)


def _resting_at(facts: Facts, itinerary: Itinerary, name: str, start: int, end: int) -> str | None:
    """Return where ``name`` is all through (start, end), or None if it changes in between."""
    mine = (m for m in itinerary.motions if name in m.moved)
    if any(m.start < end and start < m.end for m in mine):
        return None
    periods = itinerary.periods(facts.snapshot, name)
    stays = [place for since, until, place in periods if since <= start and end <= until]
    return stays[-1] if stays else None


def rests_of(facts: Facts, itinerary: Itinerary) -> tuple[Rest, ...]:
    """Return all rests (s, plan time) of all objects. One that drives rests where it comes from
    until it has arrived.

    A load rests until its ride starts, and again from the ride's end on.
    """
    snapshot = facts.snapshot
    found = []
    for name in sorted(snapshot.initial):
        body = snapshot.objects[name].body
        leaves: dict[float, float]
        leaves = {m.end: m.start for m in itinerary.motions if name in m.moved - {m.object}}
        for since, end, place in itinerary.periods(snapshot, name):
            until = leaves.get(end, end)
            if since < until:
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
    timed, alone = [], []
    for motion in group:
        since, until = _presence(facts, itinerary, group, motion)
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
    rests = [
        r
        for r in (*rests_of(facts, itinerary), *alone)
        if r.since <= facts.seconds(window[1])
        and r.until >= facts.seconds(window[0])
        and not any(
            # an object is where its motions have it, while they do
            m.object == r.name and m.present_from < r.until and r.since < m.present_until
            for m in timed
        )
    ]
    return GroupQuery(tuple(timed), tuple(dict.fromkeys(rests)))


def _chain(
    group: Sequence[ScheduledMotion], motion: ScheduledMotion
) -> tuple[ScheduledMotion | None, ScheduledMotion | None]:
    """Return the motions of the same object before and after a motion in its group."""
    own = sorted((m for m in group if m.object == motion.object), key=lambda m: m.start)
    index = own.index(motion)
    before = own[index - 1] if index else None
    return before, own[index + 1] if index + 1 < len(own) else None


def _presence(
    facts: Facts, itinerary: Itinerary, group: Sequence[ScheduledMotion], motion: ScheduledMotion
) -> tuple[float, float]:
    """Return from when to when (s) the body of a motion is there."""
    before, after = _chain(group, motion)
    loads = {name for name, _ in motion.loads}
    low, first = (before.end, motion.start) if before else (-math.inf, -math.inf)
    high = after.start if after else math.inf
    # what sets it down where it begins, or takes it away from where it ends, or along
    jumps = [c.time for c in itinerary.changes if c.object == motion.object]
    along = (m for m in itinerary.motions if motion.object in m.moved - {m.object})
    jumps += [time for m in along for time in (m.start, m.end)]
    since = facts.seconds(max((t for t in jumps if low <= t <= motion.start), default=first))
    until = facts.seconds(min((t for t in jumps if motion.end <= t <= high), default=high))
    if not loads:
        return since, until
    # at rest beside its loads it is the same body, as long as nobody else takes one of them and
    # whoever keeps clear of it keeps clear of them
    others = [m for m in group if m.object != motion.object]
    same = all(avoids(m.avoid, *loads) for m in others)
    taken = [m.start for m in group if m is not motion and loads & m.moved]
    if before or not same or min(taken, default=math.inf) < motion.start:
        since = facts.seconds(motion.start)
    if after or not same or max(taken, default=-math.inf) >= motion.end:
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
    periods = itinerary.periods(snapshot, name)
    return {place for since, until, place in periods if since + 1 <= last and first <= until}


# ------------------ Where the objects of a candidate rest
# And who has to be gone before another one stays.


@dataclass(frozen=True)
class PlaceVisit:
    """An object rests at a pose, from its motion ``arrival`` (None: from the start) until its
    motion ``departure`` (None: for good).
    """

    object: str
    body: Body
    pose: Configuration
    arrival: str | None
    departure: str | None


def _visits(facts: Facts, itinerary: Itinerary) -> list[PlaceVisit]:
    """Return where the objects that drive rest, in a candidate."""
    by_object: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for motion in itinerary.motions:
        for name, place in motion.brings:
            by_object[name].append((motion.activity, place))
    snapshot = facts.snapshot
    found = []
    for name in sorted(facts.drivers):
        body = snapshot.objects[name].body
        pose = snapshot.configurations[snapshot.initial[name]]
        arrival = None
        for activity, place in by_object[name]:
            found.append(PlaceVisit(name, body, pose, arrival, activity))
            arrival, pose = activity, snapshot.configurations[place]
        found.append(PlaceVisit(name, body, pose, arrival, None))
    return found


def others_first(facts: Facts, service: MotionService, itinerary: Itinerary) -> dict[str, set[str]]:
    """Return for each motion to a place where its object stays for good which motions of others
    have to leave that place before.

    Who leaves again keeps nobody away for long: there, whoever can come first does.
    """
    found: dict[str, set[str]] = defaultdict(set)
    avoid = {m.activity: m.avoid for m in itinerary.motions}
    for pair in _meeting(facts, service, itinerary):
        for one, other in (pair, pair[::-1]):
            if one.departure is not None or one.arrival is None or other.departure is None:
                continue
            listed = avoid[one.arrival]
            if listed is None or other.object in listed:
                found[one.arrival].add(other.departure)
    return found


def contested(facts: Facts, service: MotionService, itinerary: Itinerary) -> set[str]:
    """Return the motions that end where another object has to be, too, at some time."""
    pairs = _meeting(facts, service, itinerary)
    return {visit.arrival for pair in pairs for visit in pair if visit.arrival is not None}


def _meeting(
    facts: Facts, service: MotionService, itinerary: Itinerary
) -> list[tuple[PlaceVisit, PlaceVisit]]:
    """Return the pairs of visits of two objects whose poses overlap, in a candidate."""
    at: dict[tuple[Body, Configuration], list[PlaceVisit]] = defaultdict(list)
    for visit in _visits(facts, itinerary):
        at[visit.body, visit.pose].append(visit)
    found: list[tuple[PlaceVisit, PlaceVisit]] = []
    for (key, some), (other, others) in itertools.combinations_with_replacement(at.items(), 2):
        if not near(*key, *other) or not service.overlap(*key, *other):
            continue
        if key == other:
            found += itertools.combinations(some, 2)
        else:
            found += itertools.product(some, others)
    return [(a, b) for a, b in found if a.object != b.object]


def near(body: Body, pose: Configuration, other: Body, there: Configuration) -> bool:
    """Return whether two placed bodies may overlap at all: a cheap test before the exact one."""
    if body.flies or other.flies:
        return True
    reach = sum(max(itertools.starmap(math.hypot, b.footprint)) for b in (body, other))
    return math.hypot(pose[0] - there[0], pose[1] - there[1]) <= reach


# ------------------ What surely rests where while a motion lasts
# Doors that its own robot has come through, say. A door that is opened and never shut again is open
# for good. Whoever is at a place to which no way leads while the door is shut has come through it,
# so whenever it leaves that place the door is open. A door that is a static obstacle and would
# block the way is open from the motion's start on. Cuts that hold while such a door stands open
# then hold always.


Where = Mapping[MotionTask, Mapping[str, str]]
"""Motions -> objects, and where they surely are from its start to its end."""


def surely_there(facts: Facts, service: MotionService) -> Where:
    """Return what surely rests where all through each motion: what its driver has come through, and
    static obstacles that it would not get past elsewise.

    Assumes: a thing is moved to one other place only, and a driver comes to places by its drives
    alone.
    """
    snapshot = facts.snapshot
    found: dict[MotionTask, dict[str, str]] = {}
    for (thing, then), driver in itertools.product(_once_and_for_all(facts), sorted(facts.drivers)):
        tasks = snapshot.by_object[driver]
        if any(t.kind is not TermKind.CONSTANT for task in tasks for t in task.terms):
            continue
        shut = [task for task in tasks if _is_shut(facts, service, task, thing)]
        behind = _from_behind(snapshot, driver, tasks, shut)
        for task in (*behind, *(t for t in shut if thing in (t.static or ()))):
            found.setdefault(task, {})[thing] = then
    return found


def _from_behind(
    snapshot: Snapshot, driver: str, tasks: Sequence[MotionTask], shut: list[MotionTask]
) -> list[MotionTask]:
    """Return the motions of a driver that begin where it only comes to by those that are shut at
    first; none where something else may take it elsewhere.
    """
    other = snapshot.moved_otherwise
    once = len({t.activity for t in tasks}) == len(tasks)
    if driver in other or not once:
        return []
    ends = {task: (task.terms[0].name, task.terms[-1].name) for task in tasks}
    passable = {ends[t] for t in set(tasks).difference(shut)}
    ways = set(ends.values())
    behind = sealed(snapshot.initial[driver], ways, ways - passable)
    return [task for task in tasks if ends[task][0] in behind]


def sealed(
    first: str, ways: Collection[tuple[str, str]], shut: Collection[tuple[str, str]]
) -> set[str]:
    """Return the places to which nobody comes from ``first`` on but by a way that is ``shut`` at
    first, at one step or another.
    """
    passable = [way for way in ways if way not in shut]
    open_to = reached([first], lambda here: (b for a, b in passable if a == here))
    return {place for way in ways for place in way} - open_to


def remaining(places: Mapping[str, str], case: MotionCase, there: Where) -> dict[str, str]:
    """Return which of the ``places`` (object -> configuration) do not go without saying while the
    motion of a case lasts.
    """
    sure = there.get(case.task, {})
    return {name: place for name, place in places.items() if sure.get(name) != place}


def _once_and_for_all(facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield objects that change their configuration for one other only, with that."""
    snapshot = facts.snapshot
    for thing in sorted(facts.instant):
        terms = [c.term for c in snapshot.changes if c.object == thing]
        names = {t.name for t in terms}
        if all(t.kind is TermKind.CONSTANT for t in terms) and len(names) == 1:
            (then,) = names
            if then != snapshot.initial[thing]:
                yield thing, then


def _is_shut(facts: Facts, service: MotionService, task: MotionTask, thing: str) -> bool:
    """Return whether it is proven that a motion cannot be made before a thing is moved (with all
    that is moved as it is).
    """
    initial = {t: facts.snapshot.initial[t] for t in facts.changed_together[thing]}
    closed = facts.heeded(task, initial)
    body = facts.snapshot.body(task.activity, task.index, task.object)
    poses = tuple(facts.snapshot.configurations[t.name] for t in task.terms)
    return bool(closed) and service.certificate(body, poses, closed) is not None


# ------------------ Questions to the motion planners about the motions of one problem


@dataclass(frozen=True)
class Motions:
    """Asks the motion service about motions of the problem, within the search's budget."""

    facts: Facts
    service: MotionService
    budget: Budget

    def path(self, query: PathQuery) -> PathReport:
        """Return the planner's path for a motion alone, within one query's time."""
        return self.service.plan(query, self.budget.query())

    def fastest(self, query: PathQuery, deadline: Deadline) -> tuple[PathReport, Strength]:
        """Return the planner's answer and what its duration is worth.

        Only a motion whose planner finished its search is the planner's fastest.
        """
        report = self.service.plan(query, deadline)
        return report, Strength.RELATIVE if report.complete else Strength.HEURISTIC

    def never_possible(self, cases: Sequence[MotionCase]) -> PathReport | None:
        """Return a proof that ``cases``, all of one motion, cannot be made, whatever moves where
        (None: there is none): by the map and by what nobody moves.
        """
        return self.service.certificate(
            *self.facts.signature(cases[0]), self.facts.fixed_for(cases)
        )

    @cached_property
    def there(self) -> Where:
        """What surely rests where whenever somebody leaves a place."""
        return surely_there(self.facts, self.service)


def touching(reason: str) -> str:
    """Return for people that a motion begins or ends in touch with something, if that is why the
    planners do not find it; a plan may begin so, but they keep clear by a hair.
    """
    return f"; {TOUCHES}: leave a millimetre between them" if TOUCHES in reason else ""
