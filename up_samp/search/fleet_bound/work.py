"""What doing a job takes a robot at least: ways to do jobs, by kinds of robots.

Robots of equal bodies are of one *kind*. A way is told with the drives that it is made of, so that
drives can be measured better later.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import Body
from up_samp.model.deadline import check_time
from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.motion import MotionService
from up_samp.scheduling.cpsat.encode.terms import least
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import Jobs, WorkMode, closed, held_by, stated_gaps
from up_samp.search.fleet_bound.timelines import (
    RobotTimeline,
    TimelineStop,
    carried,
    guaranteed_locations,
)

Leg = tuple[Body, str, str]
"""What is driven, from one configuration to another (names)."""
Units = Callable[[Leg], int]


def units_apart(facts: Facts, service: MotionService, name: str, start: str, goal: str) -> int:
    """Return units that an object takes from place to place at least, however many drives it makes.

    Assumes: nothing but its drives moves it.
    """
    pose, body = facts.snapshot.configurations, facts.bodies_on_tour[name]
    seconds = service.lower_bound(body, (pose[start], pose[goal]))
    return max(0, facts.units(seconds, len(facts.snapshot.by_object[name])))


@dataclass(frozen=True)
class JobMode:
    """One way in which robots of a ``kind`` (a number) do a ``job``: they come to ``goal`` from one
    of the ``origins`` (None: nothing is known of how they come), drive ``legs`` and are busy for
    some units beside that. Then they have come to the places ``ends``; to those ``after`` only
    after they had come to the goal. Beside an origin they have left the places ``leaves`` (None:
    it is not known which).
    """

    job: int
    kind: int
    busy: int
    legs: tuple[Leg, ...]
    body: Body
    goal: str | None
    ends: tuple[str, ...]
    after: frozenset[str]
    origins: frozenset[str] = frozenset()
    leaves: tuple[str, ...] | None = ()

    @property
    def froms(self) -> Sequence[str | None]:
        """The origins; None where it comes from anywhere, or is there."""
        return [None] if self.goal is None else sorted(self.origins)

    def drives(self, origin: str | None) -> tuple[Leg, ...]:
        """Return all drives if it comes from an origin."""
        if origin is None or self.goal is None:
            return self.legs
        return (*self.legs, (self.body, origin, self.goal))

    def units(self, origin: str | None, units: Units) -> int:
        """Return what it takes from an origin."""
        return self.busy + sum(units(leg) for leg in self.drives(origin))

    def from_places(self, origins: Collection[str]) -> JobMode:
        """Return the same from some places."""
        return replace(self, origins=frozenset(origins))

    def least(self, units: Units) -> int:
        """Return what it takes from wherever it takes least."""
        return min(self.units(origin, units) for origin in self.froms)


class JobWork:
    """What the options of all jobs take at least."""

    def __init__(
        self, problem: SchedulingMotionProblem, facts: Facts, service: MotionService, jobs: Jobs
    ) -> None:
        self._facts, self._service, self._jobs = facts, service, jobs
        start, body = facts.snapshot.initial, {n: o.body for n, o in facts.snapshot.objects.items()}
        self.robots = sorted({o.robot for options in jobs.options for o in options})
        bodies = list(dict.fromkeys(body[r] for r in self.robots))
        self.kind_of = {r: bodies.index(body[r]) for r in self.robots}
        self._of_kind = {k: [r for r in self.robots if body[r] == b] for k, b in enumerate(bodies)}
        self.sizes = Counter(self.kind_of.values())
        """How many robots there are of each kind."""
        self.starts = Counter((self.kind_of[r], start[r]) for r in self.robots)
        """How many of a kind begin where."""
        snapshot = facts.snapshot
        self._tasks, self._driven = snapshot.by_activity, snapshot.by_object
        self._durations = {a.name: least(a.duration) for a in problem.activities}
        self._units: dict[Leg, int] = {}
        self._left: dict[str, frozenset[str]] = {}
        self.gaps = stated_gaps(problem)
        self._in_turn = _in_turn(problem, jobs, self.robots)
        self._stands = guaranteed_locations(problem, snapshot)
        self.lines = {r: self._line(r) for r in self.robots if self.traced(r)}

    def ways(self, counted: Sequence[Sequence[WorkMode]]) -> list[JobMode]:
        """Return the ways to do some jobs; alike ones of robots of a kind are one."""
        found: dict[JobMode, set[str]] = defaultdict(set)
        for job, options in enumerate(counted):
            check_time()
            for option in options:
                way = self._way(job, option)
                found[way.from_places(())] |= way.origins
        return [way.from_places(some) for way, some in found.items()]

    def units(self, leg: Leg) -> int:
        """Return units that a drive takes at least."""
        known = self._units.get(leg)
        if known is None:
            known = self._units[leg] = self._bound(leg)
        return known

    def _bound(self, leg: Leg) -> int:
        """Return units that it takes at least from place to place, by whatever drives."""
        body, start, goal = leg
        pose = self._facts.snapshot.configurations
        return self._facts.units(self._service.lower_bound(body, (pose[start], pose[goal])))

    def drives(self, robot: str) -> Sequence[MotionTask]:
        """Return all drives of a robot."""
        return self._driven.get(robot, ())

    def comings(self, called: Collection[tuple[int, str]]) -> dict[tuple[int, str], int]:
        """Return by kind of robots and place what the drive takes at least that brings one there
        without a counted job.
        """
        found: dict[tuple[int, str], int] = {}
        for robot in self.robots:
            check_time()
            for task in self.drives(robot):
                at = self.kind_of[robot], task.terms[-1].name
                if at in called:
                    units = self._drive(task)
                    found[at] = min(found.get(at, units), units)
        return found

    def take(self, leg: Leg, units: int, *, over: Collection[str] = ()) -> None:
        """Take it that a drive takes some units at least, if it does not stop at one of the places
        ``over`` on its way.
        """
        snapshot = self._facts.snapshot
        body, start, goal = leg
        pose = snapshot.configurations
        for place in sorted(set(over) - {start, goal}):
            way = sum(math.dist(pose[place][:2], pose[end][:2]) for end in (start, goal))
            if way / body.kinematics.v_max < self._facts.seconds(units):
                units = min(
                    units, self.units((body, start, place)) + self.units((body, place, goal))
                )
        self._units[leg] = max(units, self.units(leg))

    def alone(self, way: JobMode) -> tuple[int, tuple[Leg, ...]]:
        """Return units until a job can be done at the soonest, if that is all that is done, and the
        drives of that: the robot has to come from where it begins. 0 where it may come otherwise.

        What the planner takes to come there directly is no bound: a robot may stop on its way, and
        a planner may be quicker with a stop.
        """
        robots = self._of_kind[way.kind]
        if way.goal is None or any(self.lines.get(robot) is None for robot in robots):
            return 0, ()
        initial, facts = self._facts.snapshot.initial, self._facts
        starts = {initial[robot]: robot for robot in robots}  # of one kind: anyone's body will do
        coming = min(
            units_apart(facts, self._service, robot, start, way.goal)
            for start, robot in starts.items()
        )
        later = tuple(leg for leg in way.legs if leg[-1] in way.after)
        # what it drives for the job before, over several places or not, may be how it comes
        told = way.after.issuperset(way.ends) or len(way.legs) + 1 == len(way.ends)
        return coming + way.busy * told + sum(map(self.units, later)), later

    def body(self, robot: str) -> Body:
        """Return the body that tells what a robot takes over any number of places."""
        return self._facts.bodies_on_tour[robot]

    def standing(self, name: str) -> int:
        """Return how long an activity lasts at least, if it is no drive."""
        return 0 if name in self._tasks else self._durations[name]

    def stops(self, kind: int) -> frozenset[str]:
        """Return the places where drives of a kind of robots end."""
        mine = (t for robot in self._of_kind[kind] for t in self.drives(robot))
        return frozenset(t.terms[-1].name for t in mine)

    def traced(self, robot: str) -> bool:
        """Return whether it is known where each drive of a robot ends, and only drives move it."""
        known = all(t.terms[-1].kind is TermKind.CONSTANT for t in self.drives(robot))
        return known and robot not in self._facts.snapshot.moved_otherwise

    def _way(self, job: int, option: WorkMode) -> JobMode:
        robot = option.robot
        driven = [t for name in sorted(option.members) for t in self._tasks.get(name, ())]
        direct = [t for t in driven if len(t.terms) == 2 and self._known_ends(t)]
        calls = [t for t in driven if t.terms[0].kind is not TermKind.CONSTANT]
        usable = len(calls) == 1 and self.traced(robot) and len(calls[0].terms) == 2
        origins = self.origins(calls[0]) if usable else ()
        call = calls[0] if origins else None
        busy = sum(self._drive(t) for t in driven if t not in direct and t is not call)
        busy += self._beside(option)
        legs = tuple((self.body_of(t), t.terms[0].name, t.terms[-1].name) for t in direct)
        ends = tuple(t.terms[-1].name for t in driven) if self.traced(robot) else ()
        begins = [t.terms[0] for t in driven if t is not call]
        known = all(term.kind is TermKind.CONSTANT for term in begins)
        leaves = tuple(term.name for term in begins) if known else None
        body, kind, nowhere = self.body(robot), self.kind_of[robot], frozenset[str]()
        way = JobMode(job, kind, busy, legs, body, None, ends, nowhere, nowhere, leaves)
        if call is None:
            return way
        goal, after = call.terms[-1].name, self._after(option, call, driven)
        body = self.body_of(call)
        return replace(way, body=body, goal=goal, after=after, origins=frozenset(origins))

    def _after(
        self, option: WorkMode, call: MotionTask, driven: Sequence[MotionTask]
    ) -> frozenset[str]:
        """Return the places to which an option comes only after it has come to its call's goal."""
        gaps = closed(self.gaps, option.members)
        sooner = {
            t.terms[-1].name
            for t in driven
            if t is not call and (call.activity, t.activity) not in gaps
        }
        return frozenset(t.terms[-1].name for t in driven) - sooner

    def _beside(self, option: WorkMode) -> int:
        """Return units that an option takes beside its drives: only what is done one after the
        other adds up.
        """
        if option.robot not in self._in_turn:
            return 0
        total = sum(self._durations[n] for n in option.members if n not in self._tasks)
        line = self.lines.get(option.robot)
        return total if line is None else total + line.idle(option.members)

    def _line(self, robot: str) -> RobotTimeline | None:
        """Return what a robot does one after the other; None where it may drive beside that."""
        names = self._in_turn.get(robot)
        if names is None or not all(t.activity in names for t in self.drives(robot)):
            return None
        stops = {name: self._stop(name, robot) for name in sorted(names)}
        for task in self.drives(robot):
            # of several drives it is not looked which is the first
            several = len(self._tasks[task.activity]) > 1
            stops[task.activity] = TimelineStop(None, None, True) if several else self._drives(task)
        return RobotTimeline(stops, self.gaps)

    def _stop(self, name: str, robot: str) -> TimelineStop:
        place = self._stands.places.get((name, robot))
        here = None if place is None else frozenset((place,))
        reads = self._stands.reads.get(name, frozenset())
        return TimelineStop(
            here, here, setting=self._stands.sets.get(name, frozenset()), reading=reads
        )

    def _drives(self, task: MotionTask) -> TimelineStop:
        name, first, last = task.activity, task.terms[0], task.terms[-1]
        fluent = first.name if first.kind is TermKind.FLUENT else ""
        loose = fluent in self._stands.fluents
        read = self._stands.reads.get(name, frozenset())
        return TimelineStop(
            frozenset(self.origins(task)),
            frozenset((last.name,)),
            drives=True,
            loose=loose and fluent not in read,
            setting=self._stands.sets.get(name, frozenset()),
            reading=read | {fluent} if loose else read,
        )

    def _known_ends(self, task: MotionTask) -> bool:
        return all(t.kind is TermKind.CONSTANT for t in (task.terms[0], task.terms[-1]))

    def body_of(self, task: MotionTask) -> Body:
        """Return what a drive drives, with its loads."""
        return self._facts.snapshot.body(task.activity, task.index, task.object)

    def _drive(self, task: MotionTask) -> int:
        if task.terms[-1].kind is not TermKind.CONSTANT:
            return 0
        body, goal = self.body_of(task), task.terms[-1].name
        return min((self.units((body, place, goal)) for place in self.origins(task)), default=0)

    def origins(self, task: MotionTask) -> tuple[str, ...]:
        """Return where a drive may begin, by the names that drives' ends have here."""
        first = task.terms[0]
        if first.kind is TermKind.CONSTANT:
            return (first.name,)
        left, alike = self._left_by_others(task.object), self._facts.snapshot.alike
        # where places are decided, the first name of all stands for a pose
        named = {alike.get(v, (v,))[0] for v in self._facts.choice(task, first).values}
        return tuple(sorted(named - left))

    def _left_by_others(self, robot: str) -> frozenset[str]:
        """Return the places of a robot that every arrival has a drive of its own away from: no
        other drive begins there (there would be more departures than arrivals).
        """
        if robot not in self._left:
            snapshot, traced = self._facts.snapshot, self.traced(robot)
            left = _places_left(snapshot, robot, self._jobs) if traced else frozenset()
            self._left[robot] = left
        return self._left[robot]


def _members(jobs: Jobs) -> Mapping[str, set[str]]:
    """Return by robot the members of all options that it has."""
    found: dict[str, set[str]] = defaultdict(set)
    for option in (option for options in jobs.options for option in options):
        found[option.robot] |= option.members
    return found


def _in_turn(
    problem: SchedulingMotionProblem, jobs: Jobs, robots: Sequence[str]
) -> dict[str, frozenset[str]]:
    """Return what a robot may do one after the other, by robot, where all of its work for jobs
    holds one resource for one.
    """
    held = held_by(problem)
    holders: dict[FNode, set[str]] = defaultdict(set)
    for name, resources in held.items():
        for resource in resources:
            holders[resource].add(name)
    mine = _members(jobs)
    found = {}
    for robot in robots:
        shared = frozenset.intersection(*(held[name] for name in mine[robot]))
        if shared:
            found[robot] = frozenset(holders[min(shared, key=str)])
    return found


def _places_left(snapshot: Snapshot, robot: str, jobs: Jobs) -> frozenset[str]:
    arrivals: dict[str, list[str]] = defaultdict(list)
    leaving: dict[str, set[str]] = defaultdict(set)
    for task in snapshot.by_object.get(robot, ()):
        first, last = task.terms[0], task.terms[-1]
        arrivals[last.name].append(task.activity)
        if first.kind is TermKind.CONSTANT and first.name != last.name:
            leaving[first.name].add(task.activity)
    found = set()
    for place, coming in arrivals.items():
        away = [jobs.drawn(name) & leaving[place] for name in coming]
        own = set().union(*away)
        if place != snapshot.initial[robot] and all(away) and len(own) == sum(map(len, away)):
            found.add(place)
    return frozenset(found)


# ------------------ Jobs as what robots do at places, where nothing tells how they come there
# Where it is not told which drives belong to a job, it is still told where its parts are done.
# Each part follows another one, or the robot's start, and from one place to the next the robot has
# to drive somehow. So each part is looked at as a job of its own, done in one of the ways of its
# robots.


Part = tuple[tuple[str, ...], str, str]
"""Activities that follow each other, where they begin and where they end."""


def items_of(
    problem: SchedulingMotionProblem,
    jobs: Jobs,
    work: JobWork,
    counted: Sequence[Sequence[WorkMode]],
) -> list[JobMode] | None:
    """Return the ways to do all parts of some jobs, numbered anew; None where it is not known where
    some part is done, or a robot does several things at a time.

    Assumes: where all parts of a job are done is told, and its robot does one thing at a time.
    """
    pairs, mine = carried(problem, jobs.needs, work.gaps), _members(jobs)
    found: list[JobMode] = []
    number = 0
    for options in counted:
        check_time()
        split = _alike([_parts(work, mine[option.robot], option, pairs) for option in options])
        if split is None:
            split = _alike([_parts(work, mine[option.robot], option, {}) for option in options])
        if split is None:
            return None
        for option, parts in zip(options, split, strict=True):
            line = work.lines[option.robot]
            assert line is not None
            for at, part in enumerate(parts):
                idle = line.idle(option.members) if at == 0 else 0
                found.append(_way(work, option.robot, number + at, part, idle))
        number += len(split[0])
    return _with_origins(work, found)


def _alike(split: Sequence[list[Part] | None]) -> list[list[Part]] | None:
    """Return the parts of all options of a job if they are as many; None where they are not."""
    known = [parts for parts in split if parts is not None]
    same = len(known) == len(split) and len({len(parts) for parts in known}) == 1
    return known if same else None


def _with_origins(work: JobWork, ways: Sequence[JobMode]) -> list[JobMode]:
    """Return each way once, with the places where its kind of robots may come from."""
    places = defaultdict[int, set[str]](set)
    for kind, place in work.starts:
        places[kind].add(place)
    for way in ways:
        places[way.kind].update(way.ends)
    return [way.from_places(places[way.kind]) for way in dict.fromkeys(ways)]


Pairs = Mapping[str, tuple[str, object]]
"""By activity that gives something away: which one takes it, and a fluent of all such (see
:func:`.timelines.carried`)."""


def _takes_and_gives(mine: set[str], pairs: Pairs, line: RobotTimeline, option: WorkMode) -> bool:
    """Return whether an option is to take something and to give it away, and nothing else that its
    robot does for jobs (``mine``) can be in between.
    """
    given = [name for name in option.members if name in pairs]
    if len(option.members) != 2 or len(given) != 1:
        return False
    taker, fluent = pairs[given[0]]
    alike = {
        name for giver, (other, said) in pairs.items() if said == fluent for name in (giver, other)
    }
    return taker in option.members and mine <= alike <= line.stops.keys()


def _parts(work: JobWork, mine: set[str], option: WorkMode, pairs: Pairs) -> list[Part] | None:
    """Return the parts of an option, as far as constraints tell in their order."""
    line = work.lines.get(option.robot)
    if line is None or not option.members <= line.stops.keys():
        return None
    before = {n: sum((m, n) in work.gaps for m in option.members) for n in option.members}
    order = sorted(option.members, key=lambda n: (before[n], n))
    if _takes_and_gives(mine, pairs, line, option):
        order.sort(key=lambda n: n in pairs)
        one, two = (_place(line, (n,)) for n in order)
        return None if one is None or two is None else [(tuple(order), one[1], two[2])]
    parts = [_place(line, (name,)) for name in order]
    return None if None in parts else [part for part in parts if part is not None]


def _place(line: RobotTimeline, names: tuple[str, ...]) -> Part | None:
    stop = line.stops[names[0]]
    if stop.begins is None or stop.ends is None or len(stop.begins) != 1 or len(stop.ends) != 1:
        return None
    return names, min(stop.begins), min(stop.ends)


def _way(work: JobWork, robot: str, job: int, part: Part, idle: int) -> JobMode:
    names, start, goal = part
    body = work.body(robot)
    busy = idle + sum(work.standing(name) for name in names)
    legs = ((body, start, goal),) if start != goal else ()
    return JobMode(job, work.kind_of[robot], busy, legs, body, start, (goal,), frozenset({goal}))
