"""What a motion needs when only this or that is in its way."""

from __future__ import annotations

from dataclasses import replace

from up_samp.model import (
    Deadline,
    FixedMotion,
    Outcome,
    PathQuery,
    Rest,
    TimedMotion,
    Trajectory,
)
from up_samp.motion.fleet import earliest_arrival
from up_samp.search.context import Context


def arrival_of(
    context: Context,
    motion: TimedMotion,
    rests: tuple[Rest, ...] = (),
    fixed: tuple[FixedMotion, ...] = (),
    *,
    enough: float | None = None,
    deadline: Deadline | None = None,
) -> float | None:
    """Return the motion's earliest arrival (s) among these, or None if none was found.

    An arrival by ``enough`` (s) is good enough, and then the first that is found is returned.
    """
    # due at once: then it looks for the earliest arrival, not for any in time
    early = replace(motion, due=motion.release if enough is None else enough)
    limit = (deadline or context.deadline).within(context.query_seconds)
    report = earliest_arrival(context.service, early, rests, fixed, limit)
    # what a search that was cut short found need not be the earliest: it says nothing
    if report.outcome is not Outcome.FOUND or report.trajectory is None or not report.complete:
        return None
    return report.trajectory.end


def fastest(context: Context, motion: TimedMotion) -> Trajectory | None:
    """Return the motion's fastest trajectory with nobody else there, from time 0; None where none
    was found, or the search for it was not finished.
    """
    report = context.service.plan(
        PathQuery(motion.body, motion.poses), context.deadline.within(context.query_seconds)
    )
    return report.trajectory if report.complete else None
