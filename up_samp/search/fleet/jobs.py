"""Jobs and their modes: which work one robot or another may do, as constraints on presence say.

A *job* is an unconditional disjunction of presences. Each of these, with what has to be present
with it, is a *mode*: a robot's work, from where it first has to be to where it ends. Read before
that: the precedences and gaps between activities that the problem states, and where
activities without a drive of their own are done.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from graphlib import CycleError, TopologicalSorter

from unified_planning.model import FNode, TimepointKind
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity

from up_samp.model import Configuration
from up_samp.model.graphs import reached
from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.scheduling.cpsat.encode.terms import least
from up_samp.scheduling.cpsat.normal import decisions
from up_samp.upio.expressions import (
    constraints_of,
    end_before_start,
    fluent_told,
    own_end,
    start_before_start,
    statements,
)
from up_samp.upio.movers import whereabouts

Gaps = Mapping[tuple[str, str], int]
"""(a, b) -> units that are between the end of a and the start of b at least, if both are there."""
Gap = Callable[[str, str], int]


def stated_gaps(problem: SchedulingMotionProblem) -> dict[tuple[str, str], int]:
    """Return what constraints say of the end of one activity and the start of another one.

    Assumes: a comparison is conditional on the two activities alone, or on nothing.
    """
    found: dict[tuple[str, str], int] = {}
    for part, needed in _said(problem):
        told = end_before_start(part)
        if told is None:
            continue
        first, then, units = told
        if needed <= {first, then} and units >= 0:
            found[first, then] = max(units, found.get((first, then), 0))
    return found


def _said(problem: SchedulingMotionProblem) -> Iterator[tuple[FNode, frozenset[str | None]]]:
    """Yield what constraints say, part by part, each with what has to be present for it."""
    for owner, constraint, scope in constraints_of(problem):
        mine = frozenset[str | None]() if owner is None else frozenset([owner])
        for part, needed in statements(constraint, scope):
            yield part, needed | mine


def stated_precedences(
    problem: SchedulingMotionProblem, *, strictly: bool = False
) -> set[tuple[str, str]]:
    """Return pairs of activities of which one ends before the other starts, as constraints say
    (``strictly``: and not when the other one starts).
    """
    return {pair for pair, units in stated_gaps(problem).items() if units >= int(strictly)}


def held_by(problem: SchedulingMotionProblem) -> dict[str, frozenset[FNode]]:
    """Return by activity the resources of one unit that it alone holds from its start to its end.

    Nobody else may give or take them otherwise. What may last no time keeps nobody away: it can
    happen while another one holds them (a drive that lasts no time leads nowhere).

    Assumes: nobody gives or takes a resource but by a pair of effects from a start to an end.
    """
    held = {a.name: _held(a) for a in problem.activities}
    driven = {a.name for a in problem.motion_activities if a.motion_constraints}
    lasting = driven.union(a.name for a in problem.activities if least(a.duration) > 0)
    other = {effect.fluent.fluent() for _, effect in problem.base_effects}
    for activity in problem.activities:
        for effects in activity.effects.values():
            other |= {e.fluent.fluent() for e in effects if e.fluent not in held[activity.name]}
    return {
        name: frozenset(r for r in some if r.fluent() not in other and name in lasting)
        for name, some in held.items()
    }


def _held(activity: Activity) -> list[FNode]:
    """Return the resources that an activity takes first and gives back."""
    taken: dict[FNode, list[bool]] = defaultdict(list)
    for timing, effects in activity.effects.items():
        end = own_end(timing, activity)
        for effect in effects:
            tpe = effect.fluent.type
            one = tpe.is_int_type() and (tpe.lower_bound, tpe.upper_bound) == (0, 1)
            plain = one and effect.condition.is_true()
            plain = plain and effect.value.is_int_constant() and effect.value.constant_value() == 1
            # a parameter of its own would be another object elsewhere
            plain = plain and all(argument.is_object_exp() for argument in effect.fluent.args)
            takes = plain and effect.is_decrease() and end == (False, 0)
            gives = plain and effect.is_increase() and end == (True, 0)
            # what is neither is no pair
            taken[effect.fluent] += [takes] if takes or gives else [True, True]
    return [resource for resource, some in taken.items() if sorted(some) == [False, True]]


def idle_between(
    name: str, others: Iterable[str], needs: frozenset[str], gaps: Gaps, gap: Gap, *, after: bool
) -> int:
    """Return units in which a robot does nothing, right before it begins an activity, or right
    ``after`` it.

    Assumes: all that may come right before or after is named, and the robot does one thing at a
    time.

    :param others: all that may come right before it (or after it), as far as places tell.
    :param needs: what has to be present with the activity.
    :param gaps: of all that is told between these.
    :param gap: what is between two activities at least, of which the second comes right after.
    """
    along = {n for n in needs if ((name, n) if after else (n, name)) in gaps}
    if not along:
        return 0  # it may be the first, or the last, of all
    least: int | None = None
    for other in others:
        pair = (name, other) if after else (other, name)
        if other == name or pair[::-1] in gaps:
            continue
        if any(((n, other) if after else (other, n)) in gaps for n in along):
            continue  # something has to be between the two
        units = gap(*pair)
        least = units if least is None else min(least, units)
        if not least:
            break
    return least or 0


def closed(gaps: Gaps, names: Collection[str]) -> dict[tuple[str, str], int]:
    """Return the gaps between a few activities that are all there if one of them is, with those
    that follow over what lies between.
    """
    pairs = itertools.permutations(sorted(names), 2)
    found = {pair: gaps[pair] for pair in pairs if pair in gaps}
    for between, first, then in itertools.product(sorted(names), repeat=3):
        if (first, between) in found and (between, then) in found:
            found.setdefault((first, then), 0)
    return found


# ------------------ Where activities without a drive of their own are done, as their conditions say
# An activity with the condition that a robot's fluent (``up_samp.upio.movers``) equals some
# place is done there, by that robot.


Stand = tuple[str, str]
"""A robot and the configuration in which it is."""


def activity_locations(problem: SchedulingMotionProblem, snapshot: Snapshot) -> dict[str, Stand]:
    """Return who is where during the activities whose conditions tell that.

    Assumes: a condition holds all through an activity, and its fluent tells where one robot is.
    """
    told = stands_of(problem, snapshot).items()
    return {name: min(stands) for name, stands in told if len(stands) == 1}


def stands_of(problem: SchedulingMotionProblem, snapshot: Snapshot) -> dict[str, set[Stand]]:
    """Return who may be where during activities, as far as conditions that hold all through them
    tell: a door may be opened from one place or another.
    """
    whose = {f: who for f, who in whereabouts(problem).items() if who in snapshot.by_object}
    return {
        activity.name: {
            stand
            for span, conditions in activity.conditions.items()
            if own_end(span.lower, activity) and own_end(span.upper, activity)
            for condition in conditions
            for stand in _stands_told(condition, whose)
        }
        for activity in problem.activities
        if activity.name not in snapshot.by_activity
    }


def _stands_told(condition: FNode, whose: Mapping[FNode, str]) -> set[Stand]:
    """Return the stands of which a condition asks for one; none where it leaves anything else."""
    parts = condition.args if condition.is_or() else (condition,)
    told = {stand_told(part, whose) for part in parts}
    return set() if None in told else set(filter(None, told))


def stand_told(condition: FNode, whose: Mapping[FNode, str]) -> Stand | None:
    """Return what a condition of the form "fluent equals place" tells."""
    told = fluent_told(condition)
    if told is None or told[0] not in whose or not told[1].is_object_exp():
        return None
    return whose[told[0]], told[1].object().name


# ------------------ Jobs of which one robot or another does each, as constraints on presence say


_Way = tuple[str, Configuration, Configuration, tuple[tuple[Configuration, Configuration], ...]]
"""A robot, where its way begins and ends, and the drives in between."""


@dataclass(frozen=True)
class WorkMode:
    """One way to do a job: ``leader`` is present, and ``members`` with it. ``robot`` comes to
    ``entry``, drives ``legs`` (from, to) and works for ``work`` s beside that; then it is at
    ``exit``.
    """

    leader: str
    members: frozenset[str]
    robot: str
    work: float
    entry: Configuration
    exit: Configuration
    legs: tuple[tuple[Configuration, Configuration], ...] = ()
    due: float = math.inf
    """When it has to be done at the latest (units)."""
    release: int = 0
    """Before when some of it may not begin (units): it is taken to wait for that at its entry."""
    extras: frozenset[str] = frozenset()
    """What may be present only if it is done: a way home, say."""

    @property
    def stops(self) -> list[Configuration]:
        """Where its work is done: where it is entered, and where its legs end."""
        return [self.entry, *(b for _, b in self.legs)]


@dataclass(frozen=True)
class Jobs:
    """All jobs of a problem, and who is drawn along by whom."""

    options: tuple[tuple[WorkMode, ...], ...]
    needs: Mapping[str, frozenset[str]]
    """Activity -> those that have to be present with it."""
    crews: Mapping[int, int] = field(default_factory=dict)
    """Job -> the crew that it belongs to: see :func:`crews_of`."""
    open: frozenset[int] = frozenset()
    """Jobs that may be left out, or whose options are not told apart by their leaders, as places
    are to be chosen: no bound follows from those."""

    @property
    def of_members(self) -> dict[str, int]:
        """Activity -> the job that it is a part of (the last one, of several)."""
        some = enumerate(self.options)
        return {name: j for j, options in some for o in options for name in o.members}

    @property
    def bounding(self) -> Jobs:
        """Those from which bounds follow."""
        some = (options for j, options in enumerate(self.options) if j not in self.open)
        return Jobs(tuple(some), self.needs)

    def drawn(self, name: str) -> set[str]:
        """Return what has to be present with an activity, itself included."""
        return reached([name], lambda n: self.needs.get(n, ()))

    def without(self, gone: set[str]) -> set[str]:
        """Return everything that cannot be present without some activities, with these."""
        draws = self.draws
        return reached(gone, lambda name: draws.get(name, ()))

    @property
    def draws(self) -> dict[str, list[str]]:
        """Activity -> those that cannot be present without it."""
        found: dict[str, list[str]] = {}
        for name, others in self.needs.items():
            for other in others:
                found.setdefault(other, []).append(name)
        return found


def find_jobs(problem: SchedulingMotionProblem, snapshot: Snapshot) -> Jobs | None:
    """Return the jobs of a problem, or None where some option is no work of one robot in the plane.
    What stands for leaving a job out is left out itself: who assigns jobs has all of them done.

    Assumes: a disjunction of presences is said without a condition; what draws along is said of
    pairs.

    :param snapshot: of the same problem.
    """
    dues, stated = _dues(problem), [*clauses_of(problem)]
    several = [(names, conditions) for names, conditions in stated if len(names) > 1]
    clauses = [names for names, conditions in several if not conditions]
    # one of several that have to be present with something
    ways = {name for names, conditions in several if conditions for name in names}
    table = needs_in(stated)
    look = _Look(problem, snapshot, table)
    found, known, left_open = (
        list[tuple[WorkMode, ...]](),
        set[frozenset[frozenset[str]]](),
        set[int](),
    )
    for names in clauses:
        modes = [look.options(name) for name in names]
        if not any(modes) or not all(
            m or look.by_nobody(n) for n, m in zip(names, modes, strict=True)
        ):
            return None
        options = tuple(itertools.chain(*modes))
        work = frozenset(o.members for o in options)
        if work not in known:  # a pick and its delivery draw each other along: one job
            known.add(work)
            left_open |= set() if all(len(some) == 1 for some in modes) else {len(found)}
            found.append(options)
    jobs = Jobs(tuple(found), table, open=frozenset(left_open))
    jobs = replace(jobs, crews=crews_of(problem, jobs))
    return _with_extras(jobs, dues, ways) if found else None


def _with_extras(jobs: Jobs, dues: Mapping[str, float], ways: set[str]) -> Jobs:
    """Return jobs whose options know when they are due and what else may come of them."""
    draws, found = jobs.draws, []
    for options in jobs.options:
        whole = []
        for option in options:
            extras = {n for m in option.members for n in draws.get(m, ())} - option.members - ways
            due = min((dues.get(m, math.inf) for m in option.members), default=math.inf)
            whole.append(replace(option, due=due, extras=frozenset(extras)))
        found.append(tuple(whole))
    return replace(jobs, options=tuple(found))


def _dues(problem: SchedulingMotionProblem) -> dict[str, float]:
    """Return the latest ends of activities (units), whatever they are conditional on."""
    found = defaultdict[str, float](lambda: math.inf)
    for name, _, at_end, latest in limits_told(problem, latest=True):
        if at_end:
            found[name] = min(found[name], latest)
    return found


def limits_told(
    problem: SchedulingMotionProblem, *, latest: bool
) -> Iterator[tuple[str, frozenset[str | None], bool, int]]:
    """Yield (activity, what has to be present for it, whether it is its end, units at the
    ``latest``, or else at the soonest), as constraints say.
    """
    for part, needed in _said(problem):
        told = _limit(part, latest=latest)
        if told is not None:
            name, at_end, units = told
            yield name, needed, at_end, units


def _limit(node: FNode, *, latest: bool) -> tuple[str, bool, int] | None:
    """Return (activity, whether it is its end, units) if ``node`` says that and nothing else."""
    if node.node_type not in (Op.LE, Op.LT):
        return None
    sign = 1 if latest else -1  # the soonest is the latest back in time
    point, limit = node.args[::sign]
    if point.node_type is not Op.TIMING_EXP or not limit.is_constant():
        return None
    timing = point.timing()
    point, last = timing.timepoint, sign * (limit.constant_value() - timing.delay)
    if point.container is None or point.kind not in (TimepointKind.START, TimepointKind.END):
        return None
    units = math.ceil(last) - 1 if node.node_type is Op.LT else math.floor(last)
    return str(point.container), point.kind is TimepointKind.END, sign * units


StatedClause = tuple[tuple[str, ...], tuple[str, ...]]
"""(names, conditions): one of the names is present if all conditions are."""


def needs_in(clauses: Iterable[StatedClause]) -> dict[str, frozenset[str]]:
    """Return by activity what has to be present with it, as clauses say of pairs."""
    needs: dict[str, set[str]] = defaultdict(set)
    for names, conditions in clauses:
        if len(conditions) == 1 and len(names) == 1:
            needs[conditions[0]].add(names[0])
    return {name: frozenset(others) for name, others in needs.items()}


def clauses_of(problem: SchedulingMotionProblem) -> Iterator[StatedClause]:
    """Yield what constraints say of presences."""
    known = {activity.name for activity in problem.activities}
    for _, constraint, scope in constraints_of(problem):
        for clause in decisions(constraint, scope):
            if known.issuperset(name for name, _ in clause):
                names = tuple(name for name, positive in clause if positive)
                yield names, tuple(name for name, positive in clause if not positive)


def crews_of(problem: SchedulingMotionProblem, jobs: Jobs) -> dict[int, int]:
    """Return the crews that jobs belong to: those of which a part begins as a part of another one
    does, so that no robot can do two of them.
    """
    of = jobs.of_members
    crews = list(range(len(jobs.options)))
    for _, constraint, _ in constraints_of(problem):
        if not constraint.is_equals() or not all(a.is_timing_exp() for a in constraint.args):
            continue
        ends = [a.timing() for a in constraint.args]
        mine = [crews[of[n]] for e in ends if (n := e.timepoint.container) in of]
        begin = {(e.timepoint.kind, e.delay) for e in ends} == {(TimepointKind.START, 0)}
        if begin and len(mine) == 2:
            crews = [min(mine) if crew in mine else crew for crew in crews]
    return {j: crew for j, crew in enumerate(crews) if crews.count(crew) > 1}


def earlier_jobs(problem: SchedulingMotionProblem, jobs: Jobs) -> dict[int, set[int]]:
    """Return by job those before which it cannot be done by one robot: a part of it must not begin
    before a part of them does, or ends (whoever does which, where several may).
    """
    of = jobs.of_members
    found: dict[int, set[int]] = defaultdict(set)
    for _, constraint, scope in constraints_of(problem):
        for part, _ in statements(constraint, scope):
            told = end_before_start(part) or start_before_start(part)
            if told is None or told[2] < 0:
                continue
            first, then = (of.get(name) for name in told[:2])
            if first is not None and then is not None and first != then:
                found[then].add(first)
    return found


class _Look:
    """What a problem says of the work that an activity draws along."""

    def __init__(
        self,
        problem: SchedulingMotionProblem,
        snapshot: Snapshot,
        needs: Mapping[str, frozenset[str]],
    ) -> None:
        self._snapshot, self._needs = snapshot, Jobs((), needs)
        self._tasks = snapshot.by_activity
        self._lengths = {a.name: float(least(a.duration)) for a in problem.activities}
        self._stands = stands_of(problem, snapshot)
        self._then: dict[str, set[str]] = defaultdict(set)
        for first, then in stated_precedences(problem):
            self._then[first].add(then)
        self._since = dict.fromkeys(self._lengths, 0)
        for name, _, at_end, units in limits_told(problem, latest=False):
            start = units - at_end * int(self._lengths[name])
            self._since[name] = max(start, self._since[name])

    def by_nobody(self, leader: str) -> bool:
        """Return whether nothing that an activity draws along drives, or is done where a robot
        is.
        """
        members = self._needs.drawn(leader)
        return not any(n in self._tasks or self._stands.get(n) for n in members)

    def options(self, leader: str) -> list[WorkMode]:
        """Return the work that an activity draws along, in each of the ways in which its places may
        be chosen; nothing where it is not one robot's.
        """
        members = sorted(self._needs.drawn(leader))
        driven = [task for name in members for task in self._tasks.get(name, ())]
        unit = self._snapshot.seconds_per_unit
        work = sum(self._lengths[n] * unit for n in members if n not in self._tasks)
        since = max(self._since[name] for name in members)
        ways = [self._driven(driven)] if driven else self._by_places(members)
        if None in ways:
            return []
        some, lead = frozenset(members), partial(WorkMode, leader)
        return [
            lead(some, robot, work, entry, exit_, legs, release=since)
            for robot, entry, exit_, legs in filter(None, ways)
        ]

    def _by_places(self, members: Sequence[str], most: int = 16) -> list[_Way | None]:
        """Return the ways to do some activities, by where each is done; none if there would be
        more of them than that.
        """
        places = [sorted(self._stands.get(name, ())) for name in members]
        few = math.prod(map(len, places)) <= most
        chosen = itertools.product(*places) if few else ()
        return [self._standing(dict(zip(members, some, strict=True))) for some in chosen]

    def _driven(self, driven: Sequence[MotionTask]) -> _Way | None:
        """Return whose way some drives are, from where to where."""
        robots = {task.object for task in driven}
        if len(robots) != 1 or any(t.terms[-1].kind is not TermKind.CONSTANT for t in driven):
            return None
        pose = self._snapshot.configurations
        known = [t for t in driven if t.terms[0].kind is TermKind.CONSTANT]
        legs = tuple((pose[t.terms[0].name], pose[t.terms[-1].name]) for t in known)
        ends = {task.terms[-1].name for task in driven}
        begins = {task.terms[0].name for task in known}
        first = sorted(ends & begins) or sorted(begins - ends) or sorted(ends)
        last = sorted(ends - begins) or sorted(ends)
        return next(iter(robots)), pose[first[0]], pose[last[0]], legs

    def _standing(self, stands: Mapping[str, Stand]) -> _Way | None:
        """Return whose way it is to be where some activities are done, one after the other."""
        if len({robot for robot, _ in stands.values()}) != 1:
            return None
        # sorted: a set's order, which differs from process to process, would decide among equals
        before = {m: sorted(n for n in stands if m in self._then[n]) for m in sorted(stands)}
        try:
            order = list(TopologicalSorter(before).static_order())
        except CycleError:
            return None
        stops = [stands[name] for name in order]
        poses = [self._snapshot.configurations[place] for _, place in stops]
        legs = tuple((a, b) for a, b in itertools.pairwise(poses) if a != b)
        return stops[0][0], poses[0], poses[-1], legs
