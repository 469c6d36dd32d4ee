"""A late motion whose goal another object has just left: what it has to wait for."""

from __future__ import annotations

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import Refinement
from up_samp.search.cases import MotionCase, case_of
from up_samp.search.context import Context
from up_samp.search.cuts.failure import Failure
from up_samp.search.handover import are_apart, handover


def handover_cuts(failure: Failure, late: str) -> list[Refinement]:
    """Return the gaps to whoever leaves the late motion's goal before it arrives, stated for all
    pairs of motions that are the same to the motion planner.
    """
    context = failure.context
    coming = failure.scheduled[late]
    if not context.params.profiles or coming.constraint or context.history.restarts:
        return []  # after a restart, proofs are asked for: guesses would only be dropped again
    found = []
    for other in failure.scheduled.values():
        if leaves_for(context, other, coming):
            for one, two in _same_pairs(failure, other, coming):
                cut = handover(context, one, two, context.deadline)
                found += [] if cut is None else [cut]
    return found


def leaves_for(context: Context, other: ScheduledMotion, coming: ScheduledMotion) -> bool:
    """Return whether ``other`` begins where ``coming`` ends, before that one arrives."""
    mine, theirs = context.body(coming), context.body(other)
    if other.object == coming.object or other.constraint or other.start > coming.end:
        return False
    if len(coming.poses[-1]) != 3 or len(other.poses[0]) != 3:
        return False
    return context.service.overlap(theirs, other.poses[0], mine, coming.poses[-1])


def _same_pairs(
    failure: Failure, other: ScheduledMotion, coming: ScheduledMotion
) -> list[tuple[MotionCase, MotionCase]]:
    context = failure.context
    own = case_of(context.snapshot, other), case_of(context.snapshot, coming)
    if not are_apart(*own):
        return []
    if not context.params.equivalents:
        return [own]
    pairs = [(x, y) for x in context.like(other) for y in context.like(coming) if are_apart(x, y)]
    return pairs if own in pairs else [own, *pairs]
