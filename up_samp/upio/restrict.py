"""The scheduling problem that is left when it is decided which activities are present."""

from __future__ import annotations

from unified_planning.model import FNode
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.scheduling.chronicle import Chronicle

from up_samp.model import CandidateSchedule
from up_samp.model.snapshot import Snapshot
from up_samp.upio.relaxation import Relaxation


def restrict(
    relaxation: Relaxation, snapshot: Snapshot, schedule: CandidateSchedule
) -> SchedulingProblem:
    """Return the relaxation with all that was learned, with presence decided as in ``schedule``:
    present activities mandatory, others gone, static obstacles put.
    """
    problem = restricted(relaxation, schedule)
    _hold_static(snapshot, problem)
    return problem


def _hold_static(snapshot: Snapshot, problem: SchedulingProblem) -> None:
    """State for the present activities that static obstacles stay put."""
    activities = {a.name: a for a in problem.activities}
    manager = problem.environment.expression_manager
    tasks = [t for t in snapshot.tasks if t.activity in activities]
    for task in tasks:
        one = activities[task.activity]
        for change in snapshot.changes:
            if change.object in (task.static or ()) and change.activity in activities:
                other = activities[change.activity]
                problem.add_constraint(
                    manager.Or(manager.LE(other.end, one.start), manager.LE(one.end, other.end))
                )
        for drive in tasks:
            if drive.object in (task.static or ()):
                other = activities[drive.activity]
                problem.add_constraint(
                    manager.Or(manager.LE(other.end, one.start), manager.LE(one.end, other.start))
                )


def restricted(relaxation: Relaxation, schedule: CandidateSchedule) -> SchedulingProblem:
    """Return the relaxation with presence decided: present activities mandatory, others gone."""
    source = relaxation.problem
    target = source.clone()
    fix = _PresenceFixer(source, schedule)
    target._activities = []
    for activity in source.activities:
        if activity.name not in schedule.times:
            continue
        copy = Activity(activity.name, 1, False, _env=source.environment)
        activity._clone_to(copy)
        copy._duration = activity.duration
        fix.constraints(activity, copy)
        target._activities.append(copy)
    fix.constraints(source._base, target._base)
    return target


class _PresenceFixer:
    """Replaces presence by constants and drops what speaks of absent activities only."""

    def __init__(self, problem: SchedulingProblem, schedule: CandidateSchedule):
        self.manager = problem.environment.expression_manager
        self.present = set(schedule.times)
        self.memo: dict[FNode, FNode] = {}

    def constraints(self, source: Chronicle, target: Chronicle) -> None:
        """Copy constraints with presence decided."""
        target._constraints = []
        for constraint, scope in source._constraints:
            if any(self(s).is_false() for s in scope):
                continue
            fixed = self(constraint)
            if not fixed.is_true():
                target._constraints.append(
                    (fixed, [s for s in map(self, scope) if not s.is_true()])
                )

    def __call__(self, expression: FNode) -> FNode:
        done = self.memo.get(expression)
        if done is None:
            done = self.memo[expression] = self._fix(expression)
        return done

    def _fix(self, expression: FNode) -> FNode:
        m = self.manager
        if expression.is_present_exp():
            return m.Bool(expression.presence().container in self.present)
        if not expression.args:
            return expression
        arguments = [self(a) for a in expression.args]
        if expression.is_and():
            kept = [a for a in arguments if not a.is_true()]
            if any(a.is_false() for a in kept):
                return m.FALSE()
            return m.And(kept) if kept else m.TRUE()
        if expression.is_or():
            kept = [a for a in arguments if not a.is_false()]
            if any(a.is_true() for a in kept):
                return m.TRUE()
            return m.Or(kept) if kept else m.FALSE()
        if expression.is_not():
            if arguments[0].is_bool_constant():
                return m.Bool(not arguments[0].constant_value())
            return m.Not(arguments[0])
        if expression.is_implies():
            return self(m.Or(m.Not(expression.arg(0)), expression.arg(1)))
        if expression.is_iff() and any(a.is_bool_constant() for a in arguments):
            left, right = arguments
            constant, other = (left, right) if left.is_bool_constant() else (right, left)
            return other if constant.is_true() else self(m.Not(other))
        if tuple(arguments) == tuple(expression.args):
            return expression
        return m.create_node(
            node_type=expression.node_type,
            args=tuple(arguments),
            payload=expression._content.payload,
        )
