"""The scheduling problem that is left when it is decided which activities are present."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Iterator
from functools import partial
from typing import TypeVar

from unified_planning.model.motion import MotionActivity, SchedulingMotionProblem
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.scheduling.chronicle import Chronicle

from up_samp.model import CandidateSchedule
from up_samp.upio.decided import Decided
from up_samp.upio.objective import objective_of, only_makespan
from up_samp.upio.relaxation import Relaxation

Problem = TypeVar("Problem", bound=SchedulingProblem)


def restrict(
    relaxation: Relaxation,
    schedule: CandidateSchedule,
    *,
    free: frozenset[str] = frozenset(),
) -> SchedulingProblem:
    """Return the relaxation with all that was learned, with presence decided as in ``schedule``:
    present activities mandatory, others gone, motions between the same configurations. Those that
    are ``free``, present or not, may be left out.
    """
    problem = _restricted(relaxation, schedule.times.keys() | free, free)
    _keep_decisions(relaxation, problem, schedule)
    return problem


def parts_for_engines(
    relaxation: Relaxation, schedule: CandidateSchedule | None
) -> Iterator[tuple[str, SchedulingProblem]]:
    """Yield what another engine is asked for a schedule of: what is present in ``schedule``, that
    with all that moves something, and the whole (nothing else without one); each with what it is in
    words. Nothing is optimised, and nothing is told of places that hold one object, which engines
    miscount.

    Each schedule of a part is one of the whole.
    """
    optional = {a.name for a in relaxation.problem.activities if a.optional}
    snapshot = relaxation.snapshot
    movers = snapshot.by_activity.keys() | {c.activity for c in snapshot.changes}
    movers &= optional
    twins = {twin.name for twin in relaxation.elsewhere.values()}
    everything = relaxation.activities.keys() | twins
    parts: dict[str, Callable[[], SchedulingProblem]]
    parts = {"the whole": partial(_restricted, relaxation, everything, optional)}
    if schedule is not None:
        wider = movers | twins | schedule.times.keys()
        parts = {
            "what our own scheduler drew": partial(restrict, relaxation, schedule),
            "that and all moves": partial(_restricted, relaxation, wider, movers | twins),
            **parts,
        }
    for what, made in parts.items():
        part = made()
        part.clear_quality_metrics()
        for activity in part.activities:
            for effects in activity._effects.values():
                effects[:] = [e for e in effects if e.fluent.fluent() not in relaxation.places]
        yield f"{what} ({len(part.activities)} of {len(everything)} activities)", part


def _keep_decisions(
    relaxation: Relaxation, problem: SchedulingProblem, schedule: CandidateSchedule
) -> None:
    """Keep the configurations of all motions: what is found out about them is for these."""
    manager = problem.environment.expression_manager
    for name in sorted({c.variable for c in relaxation.choices.values() if c.variable is not None}):
        value = schedule.parameters.get(name)
        owner = name.rpartition(".")[0]
        if isinstance(value, str) and (not owner or owner in schedule.times):
            variable = manager.ParameterExp(relaxation.variable(name))
            problem.add_constraint(
                manager.Equals(variable, manager.ObjectExp(problem.object(value)))
            )


def _restricted(
    relaxation: Relaxation, present: Collection[str], free: Collection[str]
) -> SchedulingProblem:
    """Return the relaxation with presence decided: present activities mandatory (but for those
    that are ``free``), others gone.
    """
    source = relaxation.problem
    target, fix = _left_of(source, present, free)
    if not only_makespan(source):
        objective = objective_of(source)
        assert objective is not None
        target.clear_quality_metrics()
        target.add_quality_metric(objective.decided(fix, present))
    return target


def thinned(problem: SchedulingMotionProblem, keep: Collection[str]) -> SchedulingMotionProblem:
    """Return a problem without the optional activities that are not in ``keep``: they are absent.

    Each of its schedules is one of ``problem``.
    """
    names = {a.name for a in problem.activities if not a.optional or a.name in keep}
    target, _ = _left_of(problem, names, names)
    return target


def _left_of(
    problem: Problem, present: Collection[str], free: Collection[str]
) -> tuple[Problem, Decided]:
    """Return a problem without the activities that are not ``present``, of which the ``free`` ones
    stay optional, and what tells what is left of expressions. It takes time in proportion to what
    is left, and to the number of activities.
    """
    hollow = copy.copy(problem)
    hollow._activities = []
    if isinstance(hollow, SchedulingMotionProblem):
        hollow._motion_activities = []
    target = hollow.clone()
    gone = [a for a in problem.activities if a.name not in present]
    fix = Decided(
        problem.environment,
        absent={a.name for a in gone},
        lost={p.name for a in gone for p in a.parameters},
        present={n for n in present if n not in free}
        | {a.name for a in problem.activities if not a.optional and a.name in present},
    )
    for activity in problem.activities:
        if activity.name not in present:
            continue
        kept = activity.clone()
        if kept.optional and kept.name not in free:
            kept._optional, kept._present = False, fix.manager.TRUE()
        _keep_constraints(fix, activity, kept)
        target._activities.append(kept)
        if isinstance(kept, MotionActivity):
            target._motion_activities.append(kept)
    _keep_constraints(fix, problem._base, target._base)
    return target, fix


def _keep_constraints(fix: Decided, source: Chronicle, target: Chronicle) -> None:
    """Copy constraints with presence decided."""
    target._constraints = []
    for constraint, scope in source._constraints:
        # a scope that is not known to be true does not bind
        kept = [fix(s, positive=False) for s in scope]
        if any(s.is_false() for s in kept):
            continue
        fixed = fix(constraint)
        if not fixed.is_true():
            target._constraints.append((fixed, [s for s in kept if not s.is_true()]))
