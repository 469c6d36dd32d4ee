"""What a failed group tells: small, general refinements where there are any, exact ones else.

Tried in this order, the first that rejects the candidate wins: a motion whose goal another object
has just left; a motion that waits for a door; a motion slowed by what rests in its way; two motions
that meet, for a whole range of start offsets; the group just as it was timed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

from up_samp.model.refinement import Refinement
from up_samp.refinement import rules
from up_samp.search.cuts import paper
from up_samp.search.cuts.exact import or_exact, rejects
from up_samp.search.cuts.failure import Failure
from up_samp.search.cuts.handovers import handover_cuts
from up_samp.search.cuts.profiles import pair_cuts
from up_samp.search.cuts.resting import door_cuts, rest_cuts


def learn(failure: Failure) -> list[Refinement]:
    """Return refinements that reject the candidate's group."""
    context = failure.context
    if not context.params.small_cuts:
        return [paper.group_cut(failure)]
    if not failure.found:
        return or_exact(failure, [_hopeless_cut(failure)])
    found: list[Refinement] = []
    for name in sorted(failure.report.late, key=lambda n: (failure.timed[n].release, n)):
        attempts = (
            partial(handover_cuts, failure, name),
            partial(door_cuts, failure, name),
            partial(rest_cuts, failure, name),
            partial(pair_cuts, failure, name),
        )
        found += _first_violated(failure, attempts)
        if context.deadline.expired():
            break
    return or_exact(failure, found or [_timing_cut(failure)])


def _first_violated(
    failure: Failure, attempts: Iterable[Callable[[], list[Refinement]]]
) -> list[Refinement]:
    for attempt in attempts:
        found = attempt()
        if any(rejects(failure.context, failure.itinerary, r) for r in found):
            return found
    return []


def _hopeless_cut(failure: Failure) -> Refinement:
    """Return that motions do not go together: as they are timed at first; what fails at other
    offsets, too, is kept apart whatever the offsets.
    """
    context = failure.context
    names = failure.report.conflict or set(failure.scheduled)
    motions = [m for name, m in failure.scheduled.items() if name in names]
    why = failure.report.reason or "no trajectories found in time"
    together = frozenset(m.activity for m in motions)
    rule = rules.not_together if together in context.hopeless else rules.group_fails
    context.hopeless.add(together)
    return rule(motions, failure.blockers(motions), context.movers, why)


def _timing_cut(failure: Failure) -> Refinement:
    motions = failure.conflict
    arrivals = failure.arrivals(motions)
    why = f"{', '.join(sorted(arrivals))} cannot arrive in time among the others"
    return rules.group_timing(
        motions,
        arrivals,
        failure.blockers(motions),
        failure.context.movers,
        why,
        rivals=failure.rivals(motions),
        strength=failure.strength,
    )
