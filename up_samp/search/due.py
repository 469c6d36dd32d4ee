"""What is due too soon: told at once, with who begins where.

A scheduler finds out, too, but goes through all orders of what robots might do before.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property

from unified_planning.model import FNode, TimepointKind
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model import Configuration, check_time
from up_samp.model.graphs import reached
from up_samp.model.refinement import Refinement
from up_samp.model.snapshot import MotionTask, TermKind
from up_samp.refinement import rules
from up_samp.scheduling.cpsat.encode.terms import least
from up_samp.search.fleet.jobs import clauses_of, needs_in, stated_gaps
from up_samp.search.world import Motions
from up_samp.upio.expressions import constraints_of, statements


def due_too_soon(problem: SchedulingMotionProblem, motions: Motions) -> list[Refinement]:
    """Return proofs that activities are absent which have to end sooner than anybody can: what has
    to be present with them comes first, and who drives comes from where it is at first.
    """
    soonest, found = SoonestEnds(problem, motions), []
    for name, needed, at_end, latest in _latest(problem):
        check_time()
        if needed <= soonest.with_it(name):
            first = soonest.of(name)[at_end]
            if first > latest:
                what = "" if at_end else "begin: "
                why = f"{what}due at {latest}, {first} at the soonest{soonest.who(name)}"
                found.append(rules.impossible(name, why))
    return found


def _latest(
    problem: SchedulingMotionProblem,
) -> Iterator[tuple[str, frozenset[str | None], bool, int]]:
    """Yield (activity, what has to be present for it, whether it is its end, units at the latest),
    as constraints say.
    """
    for owner, constraint, scope in constraints_of(problem):
        mine = frozenset[str | None]() if owner is None else frozenset([owner])
        for part, needed in statements(constraint, scope):
            told = _limit(part)
            if told is not None:
                name, at_end, latest = told
                yield name, needed | mine, at_end, latest


def _limit(node: FNode) -> tuple[str, bool, int] | None:
    """Return (activity, whether it is its end, units) if ``node`` says that and nothing else."""
    if node.node_type not in (Op.LE, Op.LT):
        return None
    point, limit = node.args
    if point.node_type is not Op.TIMING_EXP or not limit.is_constant():
        return None
    timing, value = point.timing(), limit.constant_value()
    point, last = timing.timepoint, value - timing.delay
    if point.container is None or point.kind not in (TimepointKind.START, TimepointKind.END):
        return None
    latest = math.ceil(last) - 1 if node.node_type is Op.LT else math.floor(last)
    return str(point.container), point.kind is TimepointKind.END, latest


class SoonestEnds:
    """When activities begin and end at the soonest."""

    def __init__(self, problem: SchedulingMotionProblem, motions: Motions) -> None:
        self._problem, self._motions = problem, motions
        self._facts, self._snapshot = motions.facts, motions.facts.snapshot
        self._always = frozenset(a.name for a in problem.activities if not a.optional)

    @cached_property
    def _needs(self) -> Mapping[str, frozenset[str]]:
        return needs_in(clauses_of(self._problem))

    @cached_property
    def _before(self) -> Mapping[str, Mapping[str, int]]:
        found: dict[str, dict[str, int]] = {}
        for (first, then), units in stated_gaps(self._problem).items():
            found.setdefault(then, {})[first] = units
        return found

    @cached_property
    def _durations(self) -> Mapping[str, int]:
        return {a.name: least(a.duration) for a in self._problem.activities}

    def with_it(self, name: str) -> frozenset[str]:
        """Return what is present wherever an activity is, itself included."""
        return self._always.union(reached([name], lambda n: self._needs.get(n, ())))

    def of(self, name: str) -> tuple[int, int]:
        """Return when an activity begins and ends at the soonest (units)."""
        there = self.with_it(name)
        known: dict[str, tuple[int, int]] = {}

        def times(name: str, path: Collection[str]) -> tuple[int, int]:
            if name not in known:
                start, end = self._driven(name)
                for first, gap in self._before.get(name, {}).items():
                    if first in there and first not in path:  # in a ring nothing is left anyhow
                        start = max(start, times(first, {*path, name})[1] + gap)
                known[name] = start, max(end, start + self._lasts(name))
            return known[name]

        return times(name, {name})

    def who(self, name: str) -> str:
        """Return who drives for an activity, and from where."""
        some = sorted(n for n in self.with_it(name) if n not in self._always)
        drivers = {t.object for n in (name, *some) for t in self._snapshot.by_activity.get(n, ())}
        some = [f"{d} begins at {self._snapshot.initial[d]}" for d in sorted(drivers)]
        return f": {', '.join(some)}" if some else ""

    def _driven(self, name: str) -> tuple[int, int]:
        """Return when what drives for an activity may be there at the soonest, for its start and
        its end.
        """
        start = end = 0
        for task in self._snapshot.by_activity.get(name, ()):
            first, last = (self._comes(task, term) for term in (0, -1))
            start, end = max(start, first), max(end, last)
        return start, end

    def _lasts(self, name: str) -> int:
        """Return how long an activity lasts at least (units)."""
        lower_bound, pose = self._motions.service.lower_bound, self._snapshot.configurations
        units = self._durations[name]
        for task in self._snapshot.by_activity.get(name, ()):
            if all(term.kind is TermKind.CONSTANT for term in task.terms):
                body = self._snapshot.body(task.activity, task.index, task.object)
                poses = tuple(pose[term.name] for term in task.terms)
                units = max(units, self._facts.units(lower_bound(body, poses)))
        return units

    def _comes(self, task: MotionTask, term: int) -> int:
        """Return when a task's object may be at one of its places at the soonest (units), from
        where it begins, whatever it does before.

        Told of objects alone that nothing else moves, and that drive with one body: without a load
        they may get through where they do not with one.
        """
        name, snapshot = task.object, self._snapshot
        tasks = snapshot.by_object[name]
        bodies = {snapshot.body(t.activity, t.index, name) for t in tasks}
        place = task.terms[term]
        if (
            place.kind is not TermKind.CONSTANT
            or name in snapshot.moved_otherwise
            or len(bodies) > 1
        ):
            return 0
        ends: tuple[Configuration, Configuration] = (
            snapshot.configurations[snapshot.initial[name]],
            snapshot.configurations[place.name],
        )
        seconds = self._motions.service.lower_bound(bodies.pop(), ends)
        # it may come by all of its drives, one after the other
        return max(0, self._facts.units(seconds, len(tasks)))
