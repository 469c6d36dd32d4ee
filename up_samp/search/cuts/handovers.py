"""A late motion whose goal another object has just left: what it has to wait for."""

from __future__ import annotations

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import Refinement
from up_samp.search.cuts.protocol import Failure
from up_samp.search.facts import are_apart
from up_samp.search.motions import Motions
from up_samp.search.statements.handovers import handover


def handover_cuts(failure: Failure, late: str) -> list[Refinement]:
    """Return the gaps to whoever leaves the late motion's goal before it arrives, stated for all
    pairs of motions that are the same to the motion planner.
    """
    motions, knowledge = failure.motions, failure.knowledge
    coming = failure.scheduled[late]
    if coming.constraint or knowledge.history.restarts:
        return []  # after a restart, proofs are asked for: guesses would only be dropped again
    # a plan may be a moment away: what these gaps are may not take all the time that is left
    deadline = motions.budget.part("gaps at shared places")
    found = []
    for other in failure.scheduled.values():
        if leaves_for(motions, other, coming):
            pairs = failure.pairs_like(other, coming)
            for pair in pairs if are_apart(*pairs[0]) else ():
                cut = handover(motions, knowledge, pair, deadline)
                found += [] if cut is None else [cut]
    return found


def leaves_for(motions: Motions, other: ScheduledMotion, coming: ScheduledMotion) -> bool:
    """Return whether ``other`` begins where ``coming`` ends, before that one arrives."""
    mine, theirs = motions.facts.body(coming), motions.facts.body(other)
    if other.object == coming.object or other.constraint or other.start > coming.end:
        return False
    if len(coming.poses[-1]) != 3 or len(other.poses[0]) != 3:
        return False
    return motions.service.overlap(theirs, other.poses[0], mine, coming.poses[-1])
