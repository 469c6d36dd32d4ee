"""Duties of robots beside the jobs assigned to them: to rest, charge, be somewhere in the end.

An assignment that leaves them out gives most to those who have least time for it. Like all that is
known before any schedule they are a guess: batteries are levels from which drives take and to which
stops at certain places give, so many units a second.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity

from up_samp.model import Body, Configuration
from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.scheduling.cpsat.encode.terms import least
from up_samp.search.fleet.jobs import Jobs, activity_locations, held_by, stand_told
from up_samp.upio.expressions import conditions_of
from up_samp.upio.movers import whereabouts


@dataclass(frozen=True)
class BatteryUse:
    """A robot's battery: at most ``full``, ``first`` at first (units); ``given``: a second, where
    it is charged.
    """

    first: float
    full: float
    given: Mapping[Configuration, float] = field(default_factory=dict)

    @property
    def pace(self) -> float:
        """How long charging a unit takes (s; 0 where nobody can)."""
        return 1.0 / max(self.given.values(), default=math.inf)


Taken = Mapping[tuple[Body, float, Configuration, Configuration], float]
"""(body, size of its battery, from, to) -> what a drive takes (units)."""


@dataclass(frozen=True)
class Duties:
    """By robot: where it has to be in the ``ends``, how long it ``rests`` (s), its battery, how
    many jobs it may have under way at once (``loads``, where it is more than one); what drives
    take; and, by robot and from where, the drives that bring it out of the way (``drives_home``).
    """

    ends: Mapping[str, Configuration] = field(default_factory=dict)
    rests: Mapping[str, float] = field(default_factory=dict)
    batteries: Mapping[str, BatteryUse] = field(default_factory=dict)
    loads: Mapping[str, int] = field(default_factory=dict)
    taken: Taken = field(default_factory=dict)
    drives_home: Mapping[tuple[str, Configuration], Sequence[str]] = field(default_factory=dict)


def duties_of(problem: SchedulingMotionProblem, snapshot: Snapshot, jobs: Jobs) -> Duties:
    """Return what robots have to do beside all jobs.

    A guess, which only says who gets which jobs: a robot does one thing at a time where what it
    does holds a resource that all its drives hold, and batteries are told by numbers that only
    its own activities change.
    """
    drives = {robot: [t.activity for t in tasks] for robot, tasks in snapshot.by_object.items()}
    work = jobs.of_members
    own = [a for a in problem.activities if not a.optional and a.name not in work]
    taken: dict[tuple[Body, float, Configuration, Configuration], float] = {}
    batteries = dict(_batteries(problem, snapshot, drives, taken))
    ends = dict(_ends(problem, snapshot))
    rests, loads = dict(_rests(problem, snapshot, own, drives)), loads_of(problem, jobs)
    return Duties(ends, rests, batteries, loads, taken, _drives_home(snapshot, jobs))


def _ends(
    problem: SchedulingMotionProblem, snapshot: Snapshot
) -> Iterator[tuple[str, Configuration]]:
    """Yield robots with the one place where they have to be in the end."""
    whose = whereabouts(problem)
    for span, conditions in conditions_of(problem._base).items():
        stands = [stand_told(c, whose) for c in conditions if span.lower.is_from_end()]
        for robot, place in filter(None, stands):
            yield robot, snapshot.configurations[place]


def _drives_home(snapshot: Snapshot, jobs: Jobs) -> dict[tuple[str, Configuration], list[str]]:
    """Return the drives that hang on no job, by robot and from where, that bring it back to where
    it is at first, if no job is done there: whoever has done its last one, or waits for the next
    one, may be in others' way.
    """
    found = defaultdict[tuple[str, Configuration], list[str]](list)
    pose, initial = snapshot.configurations, snapshot.initial
    every = [o for options in jobs.options for o in options]
    hang = {name for o in every for name in o.members}
    hang.update(name for name, some in jobs.needs.items() if some)
    stops = {stop for o in every for stop in o.stops}
    for task in sorted(snapshot.tasks, key=lambda task: task.activity):
        fixed = all(term.kind is TermKind.CONSTANT for term in task.terms)
        if fixed and task.activity not in hang:
            a, b = (pose[task.terms[i].name] for i in (0, -1))
            if a != b and b == pose[initial[task.object]] and b not in stops:
                found[task.object, a].append(task.activity)
    return dict(found)


def _rests(
    problem: SchedulingMotionProblem,
    snapshot: Snapshot,
    own: Collection[Activity],
    drives: Mapping[str, Collection[str]],
) -> Iterator[tuple[str, float]]:
    """Yield how long (s) robots do what is part of any plan, and of no job."""
    held = held_by(problem)
    for robot, names in drives.items():
        busy = frozenset.intersection(*(held.get(n, frozenset()) for n in names))
        mine = [least(a.duration) for a in own if busy & held[a.name] and a.name not in names]
        yield robot, float(sum(mine)) * snapshot.seconds_per_unit


def _batteries(
    problem: SchedulingMotionProblem,
    snapshot: Snapshot,
    drives: Mapping[str, Collection[str]],
    taken: dict[tuple[Body, float, Configuration, Configuration], float],
) -> Iterator[tuple[str, BatteryUse]]:
    """Yield robots with the level that their drives take from, and tell what is ``taken``."""
    pose, changes = snapshot.configurations, _changes(problem)
    lasts = {a.name: float(least(a.duration)) for a in problem.activities}
    stands = defaultdict[str, dict[str, Configuration]](dict)
    for name, (robot, place) in activity_locations(problem, snapshot).items():
        stands[robot][name] = pose[place]
    for robot, level in itertools.product(drives, changes):
        by = changes[level]
        most: Any = getattr(level.type, "upper_bound", None)
        driven = {n: by[n] for n in drives[robot] if n in by}
        given = {n: by[n] for n in stands[robot] if n in by}
        shared = most is None or by.keys() > driven.keys() | given.keys()
        if shared or max(driven.values(), default=0.0) >= 0.0:
            continue
        body, full = snapshot.objects[robot].body, float(most)
        for task in snapshot.tasks:
            if task.activity in driven and task.terms[0].kind is TermKind.CONSTANT:
                a, b = (pose[task.terms[i].name] for i in (0, -1))
                taken[body, full, a, b] = -driven[task.activity]
        unit, first = snapshot.seconds_per_unit, problem.initial_value(level).constant_value()
        paces = {stands[robot][n]: more / (max(lasts[n], 1.0) * unit) for n, more in given.items()}
        yield robot, BatteryUse(float(first), full, paces)


def loads_of(problem: SchedulingMotionProblem, jobs: Jobs) -> dict[str, int]:
    """Return how many jobs robots may have under way at once, where that is more than one: as often
    as what they take of numbers that only this robot's jobs change, and give back later, is there;
    three at most, for the stops of all these may follow each other in a problem that is thinned.
    """
    owners = {n: o.robot for options in jobs.options for o in options for n in o.members}
    found = Counter[str]()
    for fluent, by in _changes(problem).items():
        amounts = {name: amount for name, amount in by.items() if amount}
        robots = {owners.get(name) for name in amounts}
        low, high = (getattr(fluent.type, f"{end}_bound", None) for end in ("lower", "upper"))
        most, fewest = max(amounts.values(), default=0), min(amounts.values(), default=0)
        robot = robots.pop() if len(robots) == 1 else None
        if robot and fewest < 0 < most and low is not None and high is not None:
            found[robot] += int((high - low) / most)
    return {robot: min(many, 3) for robot, many in found.items() if many > 1}


def _changes(problem: SchedulingMotionProblem) -> dict[FNode, dict[str, float]]:
    """Return the numbers that activities change, and by how much each does in all (what is set
    counts as given).
    """
    found = defaultdict[FNode, dict[str, float]](lambda: defaultdict(float))
    for _, effect, activity in problem.all_effects():
        if effect.value.node_type in (Op.INT_CONSTANT, Op.REAL_CONSTANT):
            amount = float(effect.value.constant_value())
            name = getattr(activity, "name", "")
            found[effect.fluent][name] += -amount if effect.is_decrease() else amount
    return found
