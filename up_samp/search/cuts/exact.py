"""See to it that what was learned rejects the candidate schedule."""

from __future__ import annotations

from up_samp.model.refinement import Refinement
from up_samp.model.snapshot import Snapshot
from up_samp.refinement import holds, rules, timed
from up_samp.search.cuts.protocol import Failure
from up_samp.search.world import places_between
from up_samp.upio import Itinerary


def or_exact(failure: Failure, found: list[Refinement]) -> list[Refinement]:
    """Return ``found``, with the exact cut added if nothing of it rejects the candidate."""
    snapshot, group = failure.facts.snapshot, failure.group
    if any(rejects(failure.itinerary, failure.facts.snapshot, r) for r in found):
        return found
    times = failure.itinerary.schedule.times
    mine = {m.activity for m in group}
    exact = timed.as_timed(
        group,
        failure.arrivals(group),
        {t.activity: times.get(t.activity) for t in snapshot.tasks if t.activity not in mine},
        {
            c.activity: (c.object, times[c.activity][1] if c.activity in times else None)
            for c in snapshot.changes
            if c.activity not in mine
        },
        failure.report.reason or "the group does not work as it is timed",
        strength=failure.strength,
    )
    # where others rest hangs on their decisions, too
    itinerary = failure.itinerary
    given = {pair for motion in itinerary.motions for pair in motion.given}
    given |= {pair for change in itinerary.changes for pair in change.given}
    return [*found, rules.only_given(exact, tuple(sorted(given)))]


def rejects(itinerary: Itinerary, snapshot: Snapshot, refinement: Refinement) -> bool:
    """Return whether a refinement forbids the candidate schedule."""

    def places(name: str, first: int, last: int) -> set[str]:
        return places_between(itinerary, snapshot, name, first, last)

    return not holds(refinement.statement, itinerary.schedule, places)
