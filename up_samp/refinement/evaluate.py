"""Does a schedule satisfy a statement? Used to see that a refinement rejects its schedule."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

from up_samp.model import CandidateSchedule
from up_samp.model.refinement import (
    Absent,
    Anchor,
    Apart,
    Clause,
    Differs,
    Elsewhere,
    Exclusive,
    Lasts,
    Literal,
    Overlap,
    Requires,
    Statement,
    TimeRef,
)

Places = Callable[[str, int, int], Collection[str]]
"""``places(object, first, last)``: where the object's state is during [first, last] (units), if
it is set at the end of what moves it."""


def holds(
    statement: Statement,
    schedule: CandidateSchedule,
    places: Places,
) -> bool:
    """Return whether ``schedule`` satisfies ``statement``."""
    if isinstance(statement, Clause):
        return any(_true(x, schedule, places) for x in statement.literals)
    if isinstance(statement, Lasts):
        if statement.activity not in schedule.times:
            return True
        start, end = schedule.times[statement.activity]
        return end - start >= statement.at_least
    if isinstance(statement, Requires):
        return _meets_requirement(statement, schedule, places)
    return _fits_place(statement, schedule)


def _meets_requirement(statement: Requires, schedule: CandidateSchedule, places: Places) -> bool:
    if statement.activity not in schedule.times:
        return True
    start, end = schedule.times[statement.activity]
    first, last = (end, end) if statement.at_end else (start + 1, end - 1)
    return statement.configuration not in places(statement.object, first, last)


def _fits_place(statement: Exclusive, schedule: CandidateSchedule) -> bool:
    def decided(some: Iterable[tuple[str, str, str]]) -> list[str]:
        return [a for a, variable, value in some if schedule.parameters.get(variable) == value]

    times = schedule.times
    arrivals = [*statement.arrivals, *decided(statement.coming)]
    departures = [*statement.departures, *decided(statement.leaving)]
    changes = [(times[a][1], 1) for a in arrivals if a in times]
    changes += [(times[a][0] + statement.back_at(a), -1) for a in departures if a in times]
    level = 1 if statement.taken else 0
    for time in sorted({t for t, _ in changes}):
        level += sum(step for t, step in changes if t == time)
        if level > 1:
            return False
    return True


def _true(literal: Literal, schedule: CandidateSchedule, places: Places) -> bool:
    times = schedule.times
    if isinstance(literal, Absent):
        return literal.activity not in times
    if isinstance(literal, Apart):
        if literal.earlier.activity not in times or literal.later.activity not in times:
            return False
        difference = _time(literal.later, schedule) - _time(literal.earlier, schedule)
        return difference >= literal.at_least
    if isinstance(literal, Differs):
        return schedule.parameters.get(literal.variable) != literal.value
    if isinstance(literal, Elsewhere):
        if literal.activity not in times:
            return False
        start, end = times[literal.activity]
        return literal.configuration not in places(literal.object, start + 1, end)
    return _overlaps(literal, schedule)


def _overlaps(literal: Overlap, schedule: CandidateSchedule) -> bool:
    times = schedule.times
    if literal.rival not in times or any(a not in times for a in literal.activities):
        return False
    start, end = times[literal.rival]
    return any(start <= times[a][1] for a in literal.activities) and any(
        times[a][0] <= end for a in literal.activities
    )


def _time(ref: TimeRef, schedule: CandidateSchedule) -> int:
    start, end = schedule.times[ref.activity]
    return start if ref.end is Anchor.START else end
