"""See to it that what was learned rejects the candidate schedule."""

from __future__ import annotations

from collections.abc import Sequence

from up_samp.model import GroupReport, ScheduledMotion
from up_samp.model.refinement import Refinement, Strength
from up_samp.refinement import holds, timed
from up_samp.search.context import Context, places_between
from up_samp.search.world import motion_key
from up_samp.upio import Itinerary


def or_exact(
    context: Context,
    itinerary: Itinerary,
    group: Sequence[ScheduledMotion],
    report: GroupReport,
    found: list[Refinement],
) -> list[Refinement]:
    """Return ``found``, with the exact cut added if nothing of it rejects the candidate."""
    if any(rejects(context, itinerary, r) for r in found):
        return found
    times = itinerary.schedule.times
    mine = {m.activity for m in group}
    first = min(m.start for m in group)
    late = {m.activity: m for m in group if motion_key(m) in report.late}
    exact = timed.as_timed(
        group,
        {a: context.units(report.late[motion_key(m)]) - first for a, m in late.items()},
        {
            t.activity: times.get(t.activity)
            for t in context.snapshot.tasks
            if t.activity not in mine
        },
        {
            c.activity: (c.object, times[c.activity][1] if c.activity in times else None)
            for c in context.snapshot.changes
            if c.activity not in mine
        },
        report.reason or "the group does not work as it is timed",
        strength=context.strength_of(report.seconds, len(group)) if late else Strength.HEURISTIC,
    )
    return [*found, exact]


def rejects(context: Context, itinerary: Itinerary, refinement: Refinement) -> bool:
    """Return whether a refinement forbids the candidate schedule."""

    def places(name: str, first: int, last: int) -> set[str]:
        return places_between(itinerary, context.snapshot, name, first, last)

    return not holds(refinement.statement, itinerary.schedule, places)
