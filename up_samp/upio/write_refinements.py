"""Write refinements into the relaxation through the UP problem API: one function a statement."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from unified_planning.model import FNode, Timing
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import ClosedTimeInterval, TimePointInterval

from up_samp.model.refinement import (
    Absent,
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
from up_samp.upio.expressions import inner, present, whole, whole_bounds
from up_samp.upio.relaxation import Relaxation


def write_refinement(relaxation: Relaxation, refinement: Refinement) -> None:
    """Add what ``refinement`` says to the relaxation's problem."""
    statement = refinement.statement
    _WRITERS[type(statement)](relaxation, statement)


def _write_clause(relaxation: Relaxation, clause: Clause) -> None:
    known, manager = relaxation.literals, relaxation.manager
    for literal in clause.literals:
        if literal not in known:
            known[literal] = _LITERALS[type(literal)](relaxation, literal)
    parts = [known[literal] for literal in clause.literals]
    relaxation.problem.add_constraint(manager.Or(parts) if parts else manager.FALSE())


def _write_lasts(relaxation: Relaxation, lasts: Lasts) -> None:
    activity, manager = relaxation.activities[lasts.activity], relaxation.manager
    (low, high), least = whole_bounds(activity.duration), lasts.at_least
    if low is None or high is None:
        longer = manager.LE(manager.Plus(activity.start, least), activity.end)
        activity.add_constraint(longer)
        return
    if least > high:
        relaxation.problem.add_constraint(_absent(relaxation, Absent(activity.name)))
    elif least > low:
        activity.set_duration_bounds(least, high)


def _write_requires(relaxation: Relaxation, requires: Requires) -> None:
    activity = relaxation.activities[requires.activity]
    early = relaxation.early[requires.object]
    end = TimePointInterval(Timing(-early, activity.end))
    span = end if requires.at_end else inner(activity, early)
    activity.add_condition(span, _away(relaxation, requires))


def _away(relaxation: Relaxation, told: Requires | Elsewhere) -> FNode:
    manager = relaxation.manager
    state, place = relaxation.state[told.object], relaxation.place(told.configuration)
    return manager.Not(manager.Equals(state, place))


def _write_exclusive(relaxation: Relaxation, place: Exclusive) -> None:
    """A unary resource: taken at each arrival's end, given back a unit after departures start.

    Who leaves still rests there at that instant, so nobody else has come by then: not even who
    only passes through and leaves at once.
    """
    problem, manager = relaxation.problem, relaxation.manager
    free = problem.add_fluent(
        f"samp_free_{place.name}",
        problem.environment.type_manager.IntType(0, 1),
        default_initial_value=0 if place.taken else 1,
    )
    relaxation.places.add(free)

    def told(
        always: Iterable[str], some: Iterable[tuple[str, str, str]]
    ) -> Iterator[tuple[Activity, FNode]]:
        yield from ((relaxation.activities[name], manager.TRUE()) for name in sorted(always))
        for name, variable, value in sorted(some):
            chosen = manager.Equals(relaxation.variable(variable), relaxation.place(value))
            yield relaxation.activities[name], chosen

    for activity, condition in told(place.arrivals, place.coming):
        activity.add_decrease_effect(activity.end, free, 1, condition)
    for activity, condition in told(place.departures, place.leaving):
        # who goes from one of the configurations to another may be back at once
        back = Timing(place.back_at(activity.name), activity.start)
        activity.add_increase_effect(back, free, 1, condition)


def _absent(relaxation: Relaxation, literal: Absent) -> FNode:
    activity, manager = relaxation.activities[literal.activity], relaxation.manager
    return manager.Not(activity.present) if activity.optional else manager.FALSE()


def _apart(relaxation: Relaxation, literal: Apart) -> FNode:
    manager, units = relaxation.manager, literal.at_least
    earlier, later = _timepoint(relaxation, literal.earlier), _timepoint(relaxation, literal.later)
    if units >= 0:
        difference = manager.LE(manager.Plus(earlier, units), later)
    else:
        difference = manager.LE(earlier, manager.Plus(later, -units))
    return _with_presence(relaxation, difference, literal)


def _elsewhere(relaxation: Relaxation, literal: Elsewhere) -> FNode:
    """The paper's CHCONF with fluents: an auxiliary activity that needs the object elsewhere.

    Where the main one itself sets the object elsewhere at its end, its witness, to which that is
    another activity's change, looks until a unit before that, and from a unit earlier on (whoever
    changes the object just then overlaps the main one, and clauses give way to that, too).
    """
    problem, manager = relaxation.problem, relaxation.manager
    main, number = relaxation.activities[literal.activity], len(relaxation.elsewhere)
    twin = Activity(f"samp_elsewhere_{number}", 1, True, _env=problem.environment)
    twin._set_duration_constraint(main.duration)
    early = relaxation.early[literal.object]
    span = whole(twin, early)
    if main.name in relaxation.snapshot.movers[literal.object]:
        span = ClosedTimeInterval(Timing(-early, twin.start), Timing(-early - 1, twin.end))
    twin.add_condition(span, _away(relaxation, literal))
    for mine, other in ((twin.start, main.start), (twin.end, main.end)):
        twin.add_constraint(manager.LE(mine, other))
        twin.add_constraint(manager.LE(other, mine))
    if main.optional:
        problem.add_constraint(manager.Implies(twin.present, main.present))
    problem._activities.append(twin)
    relaxation.elsewhere[twin.name] = main.name
    return twin.present


def _overlap(relaxation: Relaxation, literal: Overlap) -> FNode:
    manager, rival = relaxation.manager, relaxation.activities[literal.rival]
    others = [relaxation.activities[n] for n in literal.others]
    not_after = manager.Or([manager.LE(rival.start, a.end) for a in others])
    not_before = manager.Or([manager.LE(a.start, rival.end) for a in others])
    return _with_presence(relaxation, manager.And(not_after, not_before), literal)


def _differs(relaxation: Relaxation, literal: Differs) -> FNode:
    manager = relaxation.manager
    chosen = manager.Equals(relaxation.variable(literal.variable), relaxation.place(literal.value))
    return manager.Not(chosen)


def _timepoint(relaxation: Relaxation, ref: TimeRef) -> Any:
    activity = relaxation.activities[ref.activity]
    return activity.end if ref.at_end else activity.start


def _with_presence(relaxation: Relaxation, expression: FNode, literal: Apart | Overlap) -> FNode:
    there = present(*(relaxation.activities[name] for name in sorted(set(literal.activities))))
    return relaxation.manager.And([*there, expression]) if there else expression


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
