"""Small cuts: general refinements where there are any, exact ones else.

A failed group's attempts are tried in order; the first that rejects the candidate wins. If none
does, the group is forbidden just as it was timed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from up_samp.model import PathQuery, ScheduledMotion
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.cuts.protocol import Alike, Alone, Failure, or_exact, rejecting
from up_samp.search.facts import Facts
from up_samp.search.knowledge import Knowledge
from up_samp.search.motions import Motions
from up_samp.search.statements.durations import duration_of
from up_samp.search.statements.unreachable import blocked_while
from up_samp.search.world import remaining

Attempt = Callable[[Failure, str], list[Refinement]]
"""Returns what may be learned from one late motion (by its name) of a failed group."""


@dataclass(frozen=True)
class SmallCuts:
    """Groups shrunk to what conflicts, with only the rivals that matter; other sets of cuts answer
    the same questions. ``alike``: for which motions a cut is stated; ``first_only``: whether a
    check ends with the first refinement, as in the paper.
    """

    alike: Alike
    attempts: tuple[Attempt, ...] = ()
    first_only: bool = False

    def unobstructed(
        self, motions: Motions, knowledge: Knowledge, motion: ScheduledMotion
    ) -> list[Refinement]:
        """Return what the motion's duration among fixed obstacles tells."""
        cases = motions.facts.like(motion)
        return duration_of(motions, knowledge, cases, motions.budget.query())

    def no_path(self, motions: Motions, alone: Alone) -> list[Refinement]:
        """Return what it tells that a motion found no path, without a proof: it and all alike must
        not be made while the blockers rest there.
        """
        return blocked(motions.facts, alone)

    def too_slow(self, motions: Motions, alone: Alone, units: int) -> list[Refinement]:
        """Return what it tells that a motion takes ``units`` alone: it and all alike take that long
        while the blockers rest there.
        """
        movers, why, strength = motions.facts.snapshot.movers, alone.why, alone.strength
        places = _that_delay(motions, alone, units)
        found = []
        for case in alone.cases:
            left = remaining(places, case, motions.there)
            cut = (
                rules.slower_while(case.activity, units, left, movers, why, strength=strength)
                if left
                else rules.lasts(case.activity, units, why, layer=Layer.TEMPORAL, strength=strength)
            )
            found.append(rules.only_given(cut, case.given))
        return found

    def group(self, failure: Failure) -> list[Refinement]:
        """Return refinements that reject a group which failed together."""
        if not failure.found:
            return or_exact(failure, [_together_cut(failure)])
        found: list[Refinement] = []
        for name in sorted(failure.report.late, key=lambda n: (failure.timed[n].release, n)):
            tried = (attempt(failure, name) for attempt in self.attempts)
            snapshot = failure.facts.snapshot
            found += next((t for t in tried if rejecting(failure.itinerary, snapshot, t)), [])
            if failure.motions.budget.deadline.expired():
                break
        return or_exact(failure, found or [_timing_cut(failure)])


def _that_delay(motions: Motions, alone: Alone, units: int) -> dict[str, str]:
    """Return the blockers (with their places) that let the motion take ``units``, none too many: a
    cut that names fewer of them holds more often, and proves more.
    """
    body = motions.facts.body(alone.motion)
    kept, places = alone.obstacles, dict(alone.places)
    for name in sorted(alone.places):
        if alone.strength is Strength.HEURISTIC or motions.budget.deadline.expired():
            break
        fewer = tuple(o for o in kept if o.name != name)
        query = PathQuery(body, alone.motion.poses, fewer)
        report, strength = motions.fastest(query, motions.budget.query())
        found = report.trajectory
        if found is None or strength is Strength.HEURISTIC:
            continue
        if motions.facts.units(found.duration) >= units:
            kept = fewer
            del places[name]
    return places


def blocked(facts: Facts, alone: Alone) -> list[Refinement]:
    """State that the motion and all alike must not be made while the blockers rest there."""
    return blocked_while(facts, alone.cases, alone.places, alone.why, alone.strength)


def _together_cut(failure: Failure) -> Refinement:
    """State that motions do not go together: as they are timed at first; what fails at other
    offsets, too, is kept apart whatever the offsets.
    """
    names = failure.report.conflict or set(failure.scheduled)
    motions = [m for name, m in failure.scheduled.items() if name in names]
    why = failure.report.reason or "no trajectories found in time"
    together = frozenset(m.activity for m in motions)
    known = failure.knowledge.failed_together
    rule = rules.not_together if together in known else rules.group_fails
    known.add(together)
    return rule(motions, failure.blockers(motions), failure.facts.snapshot.movers, why)


def _timing_cut(failure: Failure) -> Refinement:
    motions = failure.conflict
    arrivals = failure.arrivals(motions)
    why = f"{', '.join(sorted(arrivals))} cannot arrive in time among the others"
    return rules.group_timing(
        motions,
        arrivals,
        failure.blockers(motions),
        failure.facts.snapshot.movers,
        why,
        rivals=failure.rivals(motions),
        strength=failure.strength,
    )
