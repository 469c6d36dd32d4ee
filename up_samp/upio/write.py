"""Write refinements into the relaxation through the UP problem API: one function a statement."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unified_planning.model import FNode, Timing
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import TimePointInterval

from up_samp.model.refinement import (
    Absent,
    Anchor,
    Apart,
    Clause,
    Differs,
    Elsewhere,
    Exclusive,
    Lasts,
    Overlap,
    Refinement,
    Requires,
    TimeRef,
)
from up_samp.upio.relaxation import Relaxation
from up_samp.upio.spans import inner, whole


def write_refinement(relaxation: Relaxation, refinement: Refinement) -> None:
    """Add what ``refinement`` says to the relaxation's problem."""
    statement = refinement.statement
    _WRITERS[type(statement)](relaxation, statement)


def _write_clause(relaxation: Relaxation, clause: Clause) -> None:
    manager = relaxation.problem.environment.expression_manager
    known = relaxation.literals
    for literal in clause.literals:
        if literal not in known:
            known[literal] = _LITERALS[type(literal)](relaxation, literal)
    parts = [known[literal] for literal in clause.literals]
    relaxation.problem.add_constraint(manager.Or(parts) if parts else manager.FALSE())


def _write_lasts(relaxation: Relaxation, lasts: Lasts) -> None:
    activity = relaxation.activities[lasts.activity]
    bounds = activity.duration
    if bounds.lower.is_int_constant() and bounds.upper.is_int_constant():
        low, high = bounds.lower.constant_value(), bounds.upper.constant_value()
        if bounds.is_right_open():
            high -= 1
        if lasts.at_least <= low:
            return
        if lasts.at_least <= high:
            activity.set_duration_bounds(lasts.at_least, high)
            return
        _forbid(relaxation, activity)
        return
    manager = relaxation.problem.environment.expression_manager
    longer = manager.LE(manager.Plus(activity.start, lasts.at_least), activity.end)
    activity.add_constraint(longer)


def _forbid(relaxation: Relaxation, activity: Activity) -> None:
    manager = relaxation.problem.environment.expression_manager
    relaxation.problem.add_constraint(
        manager.Not(activity.present) if activity.optional else manager.FALSE()
    )


def _write_requires(relaxation: Relaxation, requires: Requires) -> None:
    manager = relaxation.problem.environment.expression_manager
    activity = relaxation.activities[requires.activity]
    early = relaxation.early[requires.object]
    end = TimePointInterval(Timing(-early, activity.end))
    span = end if requires.at_end else inner(activity, early)
    place = manager.ObjectExp(relaxation.problem.object(requires.configuration))
    away = manager.Not(manager.Equals(relaxation.state[requires.object], place))
    activity.add_condition(span, away)


def _write_exclusive(relaxation: Relaxation, place: Exclusive) -> None:
    """A unary resource: taken at each arrival's end, given back a unit after departures start.

    Who leaves still rests there at that instant, so nobody else has come by then: not even who
    only passes through and leaves at once.
    """
    problem = relaxation.problem
    free = problem.add_fluent(
        f"samp_free_{place.name}",
        problem.environment.type_manager.IntType(0, 1),
        default_initial_value=0 if place.taken else 1,
    )
    relaxation.places.add(free)
    manager = problem.environment.expression_manager

    def when(*given: str) -> FNode:
        if not given:
            return manager.TRUE()
        variable, value = given
        chosen = manager.ParameterExp(relaxation.variable(variable))
        return manager.Equals(chosen, manager.ObjectExp(problem.object(value)))

    for name, *given in (*((n,) for n in sorted(place.arrivals)), *sorted(place.coming)):
        activity = relaxation.activities[name]
        activity.add_decrease_effect(activity.end, free, 1, when(*given))
    for name, *given in (*((n,) for n in sorted(place.departures)), *sorted(place.leaving)):
        activity = relaxation.activities[name]
        # who goes from one of the configurations to another may be back at once
        back = Timing(place.back_at(name), activity.start)
        activity.add_increase_effect(back, free, 1, when(*given))


def _absent(relaxation: Relaxation, literal: Absent) -> FNode:
    manager = relaxation.problem.environment.expression_manager
    activity = relaxation.activities[literal.activity]
    return manager.Not(activity.present) if activity.optional else manager.FALSE()


def _apart(relaxation: Relaxation, literal: Apart) -> FNode:
    manager = relaxation.problem.environment.expression_manager
    earlier, later = _timepoint(relaxation, literal.earlier), _timepoint(relaxation, literal.later)
    if literal.at_least >= 0:
        difference = manager.LE(manager.Plus(earlier, literal.at_least), later)
    else:
        difference = manager.LE(earlier, manager.Plus(later, -literal.at_least))
    return _with_presence(
        relaxation, difference, {literal.earlier.activity, literal.later.activity}
    )


def _elsewhere(relaxation: Relaxation, literal: Elsewhere) -> FNode:
    """The paper's CHCONF with fluents: an auxiliary activity that needs the object elsewhere."""
    key = (literal.activity, literal.object, literal.configuration)
    if key not in relaxation.elsewhere:
        relaxation.elsewhere[key] = _auxiliary(relaxation, literal, len(relaxation.elsewhere))
    return relaxation.elsewhere[key].present


def _auxiliary(relaxation: Relaxation, literal: Elsewhere, number: int) -> Activity:
    problem = relaxation.problem
    manager = problem.environment.expression_manager
    main = relaxation.activities[literal.activity]
    twin = Activity(f"samp_elsewhere_{number}", 1, True, _env=problem.environment)
    twin._set_duration_constraint(main.duration)
    place = manager.ObjectExp(problem.object(literal.configuration))
    state = relaxation.state[literal.object]
    twin.add_condition(
        whole(twin, relaxation.early[literal.object]), manager.Not(manager.Equals(state, place))
    )
    for mine, other in ((twin.start, main.start), (twin.end, main.end)):
        twin.add_constraint(manager.LE(mine, other))
        twin.add_constraint(manager.LE(other, mine))
    if main.optional:
        problem.add_constraint(manager.Implies(twin.present, main.present))
    problem._activities.append(twin)
    return twin


def _overlap(relaxation: Relaxation, literal: Overlap) -> FNode:
    manager = relaxation.problem.environment.expression_manager
    rival = relaxation.activities[literal.rival]
    others = [relaxation.activities[n] for n in literal.activities]
    not_after = manager.Or([manager.LE(rival.start, a.end) for a in others])
    not_before = manager.Or([manager.LE(a.start, rival.end) for a in others])
    return _with_presence(
        relaxation, manager.And(not_after, not_before), {literal.rival, *literal.activities}
    )


def _differs(relaxation: Relaxation, literal: Differs) -> FNode:
    manager = relaxation.problem.environment.expression_manager
    variable = manager.ParameterExp(relaxation.variable(literal.variable))
    value = manager.ObjectExp(relaxation.problem.object(literal.value))
    return manager.Not(manager.Equals(variable, value))


def _timepoint(relaxation: Relaxation, ref: TimeRef) -> Any:
    activity = relaxation.activities[ref.activity]
    return activity.start if ref.end is Anchor.START else activity.end


def _with_presence(relaxation: Relaxation, expression: FNode, names: set[str]) -> FNode:
    manager = relaxation.problem.environment.expression_manager
    present = [
        relaxation.activities[n].present for n in sorted(names) if relaxation.activities[n].optional
    ]
    return manager.And([*present, expression]) if present else expression


_WRITERS: dict[type, Callable[[Relaxation, Any], None]] = {
    Clause: _write_clause,
    Lasts: _write_lasts,
    Requires: _write_requires,
    Exclusive: _write_exclusive,
}
_LITERALS: dict[type, Callable[[Relaxation, Any], FNode]] = {
    Absent: _absent,
    Apart: _apart,
    Elsewhere: _elsewhere,
    Overlap: _overlap,
    Differs: _differs,
}
