"""Jobs of which one robot or another does each, as constraints on presence say.

A *job* is an unconditional disjunction of presences. Each of its options draws along what has to be
present with it; together they are a robot's share of work, from where it first has to be to where
it ends.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model import Configuration
from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.scheduling.cpsat.encode.durations import least


@dataclass(frozen=True)
class Option:
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
    """When it has to be done at the latest (s)."""
    extras: frozenset[str] = frozenset()
    """What may be present only if it is done: a way home, say."""


@dataclass(frozen=True)
class Jobs:
    """All jobs of a problem, and who is drawn along by whom."""

    options: tuple[tuple[Option, ...], ...]
    needs: Mapping[str, frozenset[str]]
    """Activity -> those that have to be present with it."""

    def drawn(self, name: str) -> set[str]:
        """Return what has to be present with an activity, itself included."""
        found, todo = {name}, [name]
        while todo:
            for other in self.needs.get(todo.pop(), ()):
                if other not in found:
                    found.add(other)
                    todo.append(other)
        return found

    def without(self, gone: set[str]) -> set[str]:
        """Return everything that cannot be present without some activities, with these."""
        found = set(gone)
        needed: dict[str, list[str]] = defaultdict(list)
        for name, others in self.needs.items():
            for other in others:
                needed[other].append(name)
        todo = list(gone)
        while todo:
            for name in needed[todo.pop()]:
                if name not in found:
                    found.add(name)
                    todo.append(name)
        return found


def find_jobs(problem: SchedulingMotionProblem, snapshot: Snapshot) -> Jobs | None:
    """Return the jobs of a problem, or None where some option is no work of one robot in the plane.

    :param snapshot: of the same problem.
    """
    needs: dict[str, set[str]] = defaultdict(set)
    dues = _dues(problem)
    clauses: list[tuple[str, ...]] = []
    for names, conditions in _clauses(problem):
        if not conditions and len(names) > 1:
            clauses.append(names)
        elif len(conditions) == 1 and len(names) == 1:
            needs[conditions[0]].add(names[0])
    table = {name: frozenset(others) for name, others in needs.items()}
    tasks: dict[str, list[MotionTask]] = defaultdict(list)
    for task in snapshot.tasks:
        tasks[task.activity].append(task)
    lengths = {a.name: float(least(a.duration)) for a in problem.activities}
    found = []
    for names in clauses:
        options = [_option(name, table, tasks, lengths, snapshot) for name in names]
        if any(o is None for o in options):
            return None
        found.append(tuple(o for o in options if o is not None))
    return _with_extras(Jobs(tuple(found), table), dues) if found else None


def _with_extras(jobs: Jobs, dues: Mapping[str, float]) -> Jobs:
    """Return jobs whose options know when they are due and what else may come of them."""
    draws: dict[str, list[str]] = defaultdict(list)
    for name, others in jobs.needs.items():
        for other in others:
            draws[other].append(name)
    found = []
    for options in jobs.options:
        whole = []
        for option in options:
            extras = {n for m in option.members for n in draws[m]} - option.members
            due = min((dues.get(m, math.inf) for m in option.members), default=math.inf)
            whole.append(replace(option, due=due, extras=frozenset(extras)))
        found.append(tuple(whole))
    return Jobs(tuple(found), jobs.needs)


def _dues(problem: SchedulingMotionProblem) -> dict[str, float]:
    """Return the latest ends of activities that are stated as such (units)."""
    found: dict[str, float] = {}
    for owner in (problem._base, *problem.activities):
        for constraint, _ in owner._constraints:
            if constraint.node_type is not Op.LE:
                continue
            end, limit = constraint.args
            if end.is_timing_exp() and limit.is_int_constant():
                name = end.timing().timepoint.container
                if name is not None:
                    value = float(limit.constant_value())
                    found[name] = min(value, found.get(name, math.inf))
    return found


def _clauses(
    problem: SchedulingMotionProblem,
) -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Yield (names, conditions): one of the names is present if all conditions are."""
    for owner in (problem._base, *problem.activities):
        for constraint, scope in owner._constraints:
            names = _present(constraint.args if constraint.node_type is Op.OR else [constraint])
            conditions = _present([s for s in scope if not s.is_true()])
            if names is not None and conditions is not None:
                yield names, conditions


def _present(nodes: Sequence[FNode]) -> tuple[str, ...] | None:
    """Return whose presences some expressions are; None if one is something else."""
    if any(node.node_type is not Op.PRESENT_EXP for node in nodes):
        return None
    return tuple(node.presence().container for node in nodes)


def _option(
    leader: str,
    needs: Mapping[str, frozenset[str]],
    tasks: Mapping[str, list[MotionTask]],
    lengths: Mapping[str, float],
    snapshot: Snapshot,
) -> Option | None:
    members = Jobs((), needs).drawn(leader)
    driven = [task for name in sorted(members) for task in tasks.get(name, ())]
    robots = {task.object for task in driven}
    if len(robots) != 1 or any(task.terms[-1].kind is not TermKind.CONSTANT for task in driven):
        return None
    unit, pose = snapshot.seconds_per_unit, snapshot.configurations
    work = sum(lengths[name] * unit for name in members if name not in tasks)
    known = [t for t in driven if t.terms[0].kind is TermKind.CONSTANT]
    legs = tuple((pose[t.terms[0].name], pose[t.terms[-1].name]) for t in known)
    ends = {task.terms[-1].name for task in driven}
    begins = {task.terms[0].name for task in known}
    first = sorted(ends & begins) or sorted(begins - ends) or sorted(ends)
    last = sorted(ends - begins) or sorted(ends)
    (robot,) = robots
    return Option(leader, frozenset(members), robot, work, pose[first[0]], pose[last[0]], legs)
