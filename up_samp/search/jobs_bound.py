"""A lower bound from jobs: what has to be done at least, shared by all robots.

Each job is done by one of its options, and a robot drives one way at a time. So no plan is shorter
than what all jobs take their quickest robots, shared evenly, nor than what any one of them takes. A
robot comes to a job from one of the places where it may be then; where whatever brings it to a
place has a drive of its own away from there, no other drive begins there (there would be more
departures than arrivals).

A robot leaves a place as often as it has come there (one more often where it begins). So two jobs
cannot both begin where one other ended: which job begins where which one ended is an assignment
(as in the relaxation of routes; Carpaneto and Toth 1980), and who comes from anywhere else has been
brought there by another drive.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.optimize import linear_sum_assignment
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.model import Body, Configuration
from up_samp.model.deadline import check_time
from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.motion import MotionService
from up_samp.scheduling.cpsat.encode.durations import least
from up_samp.search.facts import Facts
from up_samp.search.jobs import Jobs, Option


def bound_by_jobs(
    problem: SchedulingMotionProblem, facts: Facts, service: MotionService, jobs: Jobs
) -> int:
    """Return units that no plan can beat."""
    work = _Work(problem, facts, service, jobs)
    done: set[str] = set()
    counted: list[tuple[Option, ...]] = []
    for options in jobs.options:
        members = set[str]().union(*(o.members for o in options))
        if members & done:
            continue  # one activity may be of use to two jobs
        done |= members
        counted.append(options)
    robots = {o.robot for options in jobs.options for o in options}
    if not counted:
        return 0
    costs = []
    for options in counted:
        check_time()
        costs.append(min(work.of(option) for option in options))
    total = max(sum(costs), _assigned(work, counted, facts.snapshot))
    return max(max(costs), -(-total // len(robots)))


def _assigned(work: _Work, counted: Sequence[tuple[Option, ...]], snapshot: Snapshot) -> int:
    """Return units that all jobs and the drives between them take together at least."""
    if not all(work.traced(o.robot) for options in counted for o in options):
        return 0
    supply: list[dict[str, str]] = [
        {robot: place} for robot, place in sorted(snapshot.initial.items()) if work.drives(robot)
    ]
    for options in counted:
        supply += work.arrivals(options)
    table = np.full((len(counted), len(supply) + len(counted)), np.inf)
    for row, options in enumerate(counted):
        check_time()
        for option in options:
            for place, cost in work.by_origin(option):
                for column, source in enumerate(supply):
                    if place is None or source.get(option.robot) == place:
                        table[row, column] = min(table[row, column], cost)
                # from a place where it came otherwise
                more = 0 if place is None else work.coming(option.robot, place)
                alone = len(supply) + row
                table[row, alone] = min(table[row, alone], cost + more)
    rows, columns = linear_sum_assignment(table)
    return int(table[rows, columns].sum())


class _Work:
    """What options take at least."""

    def __init__(
        self, problem: SchedulingMotionProblem, facts: Facts, service: MotionService, jobs: Jobs
    ) -> None:
        self._facts = facts
        self._tasks: dict[str, list[MotionTask]] = defaultdict(list)
        for task in facts.snapshot.tasks:
            self._tasks[task.activity].append(task)
        self._activities = {a.name: a for a in problem.activities}
        self._uses = {name: _resources(a) for name, a in self._activities.items()}

        @cache
        def lasts(body: Body, start: Configuration, goal: Configuration) -> int:
            return facts.units(service.lower_bound(body, start, goal))

        self._lasts = lasts
        self._jobs = jobs
        snapshot = facts.snapshot
        self._driven: dict[str, list[MotionTask]] = defaultdict(list)
        for task in snapshot.tasks:
            self._driven[task.object].append(task)
        self._moved = {*(c.object for c in snapshot.changes), *(r.load for r in snapshot.rides)}
        self._coming: dict[tuple[str, str], int] = {}
        self._left: dict[str, frozenset[str]] = {}
        self._apart: dict[str, bool] = {}

    def of(self, option: Option) -> int:
        """Return units for which an option keeps its robot busy at least."""
        driven = [t for name in sorted(option.members) for t in self._tasks.get(name, ())]
        total = sum(self._drive(task) for task in driven)
        if self._one_at_a_time(option.robot):
            others = [n for n in option.members if n not in self._tasks]
            total += sum(least(self._activities[n].duration) for n in others)
        return total

    def drives(self, robot: str) -> bool:
        """Return whether something drives a robot."""
        return robot in self._driven

    def traced(self, robot: str) -> bool:
        """Return whether it is known where each drive of a robot ends, and only drives move it."""
        tasks = self._driven.get(robot, ())
        known = all(t.terms[-1].kind is TermKind.CONSTANT for t in tasks)
        return known and robot not in self._moved

    def arrivals(self, options: Sequence[Option]) -> list[dict[str, str]]:
        """Return where a job brings its robot: for each of its drives the place, by robot."""
        found: list[dict[str, str]] = []
        for option in options:
            driven = [t for name in sorted(option.members) for t in self._tasks.get(name, ())]
            for number, task in enumerate(driven):
                if number == len(found):
                    found.append({})
                if option.robot in found[number]:
                    # two ways for one robot: whichever is taken
                    found.append({option.robot: task.terms[-1].name})
                else:
                    found[number][option.robot] = task.terms[-1].name
        return found

    def by_origin(self, option: Option) -> list[tuple[str | None, int]]:
        """Return what an option takes at least from each place where its one drive without a fixed
        start may begin; None stands for any place, where there is not just one.
        """
        whole = self.of(option)
        driven = [t for name in sorted(option.members) for t in self._tasks.get(name, ())]
        loose = [t for t in driven if t.terms[0].kind is not TermKind.CONSTANT]
        origins = self._origins(loose[0]) if len(loose) == 1 else None
        if not origins:
            return [(None, whole)]
        rest = whole - self._drive(loose[0])
        return [(place, rest + self._from(loose[0], place)) for place in origins]

    def coming(self, robot: str, place: str) -> int:
        """Return units that a robot drives at least to come to a place."""
        key = robot, place
        if key not in self._coming:
            tasks = [t for t in self._driven[robot] if t.terms[-1].name == place]
            self._coming[key] = min((self._drive(t) for t in tasks), default=0)
        return self._coming[key]

    def _one_at_a_time(self, robot: str) -> bool:
        """Return whether all that a robot may do for jobs holds one resource for one."""
        if robot not in self._apart:
            mine = {
                n for os in self._jobs.options for o in os if o.robot == robot for n in o.members
            }
            self._apart[robot] = bool(frozenset.intersection(*(self._uses[n] for n in mine)))
        return self._apart[robot]

    def _drive(self, task: MotionTask) -> int:
        if task.terms[-1].kind is not TermKind.CONSTANT:
            return 0
        origins = self._origins(task)
        return 0 if not origins else min(self._from(task, place) for place in origins)

    def _origins(self, task: MotionTask) -> tuple[str, ...] | None:
        """Return where a drive may begin, None where that is not known."""
        first = task.terms[0]
        if first.kind is TermKind.CONSTANT:
            return (first.name,)
        choice = self._facts.choices.get((task.activity, first, False))
        if choice is None:
            return None
        left = self._left_by_others(task.object)
        return tuple(v for v in choice.values if v not in left)

    def _from(self, task: MotionTask, place: str) -> int:
        """Return units that a drive from a place takes at least."""
        snapshot = self._facts.snapshot
        poses = snapshot.configurations
        body = snapshot.body(task.activity, task.index, task.object)
        return self._lasts(body, poses[place], poses[task.terms[-1].name])

    def _left_by_others(self, robot: str) -> frozenset[str]:
        """Return the places of a robot that every arrival has a drive of its own away from: no
        other drive begins there.
        """
        if robot not in self._left:
            traced, snapshot = self.traced(robot), self._facts.snapshot
            self._left[robot] = _places_left(snapshot, robot, self._jobs) if traced else frozenset()
        return self._left[robot]


def _places_left(snapshot: Snapshot, robot: str, jobs: Jobs) -> frozenset[str]:
    tasks = [t for t in snapshot.tasks if t.object == robot]
    arrivals: dict[str, list[str]] = defaultdict(list)
    leaving: dict[str, set[str]] = defaultdict(set)
    for task in tasks:
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


def _resources(activity: Activity) -> frozenset[str]:
    """Return the resources of one unit that an activity holds from its start to its end."""
    taken, given = set(), set()
    for timing, effects in activity.effects.items():
        for effect in effects:
            tpe = effect.fluent.type
            one = tpe.is_int_type() and (tpe.lower_bound, tpe.upper_bound) == (0, 1)
            if not one or timing.delay or not effect.value.is_int_constant():
                continue
            if effect.value.constant_value() != 1 or not effect.condition.is_true():
                continue
            if not all(argument.is_object_exp() for argument in effect.fluent.args):
                continue  # a parameter of this activity's own: another object elsewhere
            if effect.is_decrease() and timing.is_from_start():
                taken.add(str(effect.fluent))
            if effect.is_increase() and timing.is_from_end():
                given.add(str(effect.fluent))
    return frozenset(taken & given)
