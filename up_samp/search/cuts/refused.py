"""Cuts from a refusal: what the validator has against a plan that the search took for valid.

The search and the validator mean the same, but the search does not look at everything before: it
may learn from the verdict that something is set onto an object that rests (*proven*: the two
overlap whatever the motions), or that some activities do not go together as they are timed
(*heuristic*: a different motion might have done).
"""

from __future__ import annotations

from collections.abc import Sequence

from up_samp.model import Violation
from up_samp.model.refinement import Refinement
from up_samp.refinement import rules, timed
from up_samp.search.facts import Facts
from up_samp.upio import Itinerary


def cuts_from(
    facts: Facts, itinerary: Itinerary, refusals: Sequence[Violation]
) -> list[Refinement]:
    """Return refinements that forbid the itinerary's schedule, one for each refusal."""
    found: dict[object, Refinement] = {}
    for refusal in refusals:
        cut = _set_onto(facts, itinerary, refusal) or _as_timed(facts, itinerary, refusal)
        found[cut.statement] = cut
    return list(found.values())


def _set_onto(facts: Facts, itinerary: Itinerary, refusal: Violation) -> Refinement | None:
    """State that an object must not be set to where another one rests, if that is it."""
    if refusal.kind != "collision" or len(refusal.activities) != 1 or len(refusal.objects) != 2:
        return None
    (activity,), (thing, other) = refusal.activities, refusal.objects
    change = next(
        (c for c in itinerary.changes if c.activity == activity and c.object == thing), None
    )
    if change is None:
        return None
    sets = {c.activity for c in facts.snapshot.changes if c.object == other}
    moves = set(facts.snapshot.movers[other]) - sets
    times = itinerary.schedule.times
    before = [(times[a][1], a) for a in moves | sets if a in times and times[a][1] <= change.time]
    setter = max(before)[1] if before else None
    cut = timed.set_onto(
        activity,
        setter,
        {m: times.get(m) for m in sorted(moves)},
        {s: times.get(s) for s in sorted(sets)},
        refusal.what,
    )
    return rules.only_given(cut, itinerary.given)


def _as_timed(facts: Facts, itinerary: Itinerary, refusal: Violation) -> Refinement:
    """State that the activities of a refusal, with what moved its objects last, do not go
    together as they are timed; all that are present where it names none.
    """
    times = itinerary.schedule.times
    names = {a for a in refusal.activities if a in times}
    if names:
        last = max(times[a][1] for a in names)
        for thing in refusal.objects:
            movers = facts.snapshot.movers.get(thing, frozenset()) - names
            names |= {m for m in movers if m in times and times[m][0] <= last}
    cut = timed.exactly_as_timed({n: times[n] for n in sorted(names or times)}, refusal.what)
    return rules.only_given(cut, itinerary.given)
