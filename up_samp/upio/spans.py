"""Intervals: those that conditions of the relaxation are about, and those of UP scripts, whose ends
may be bare timepoints.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unified_planning.model import FNode, Timepoint, Timing
from unified_planning.model.mixins.timed_conds_effs import TimedCondsEffs
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import (
    ClosedTimeInterval,
    DurationInterval,
    LeftOpenTimeInterval,
    OpenTimeInterval,
    RightOpenTimeInterval,
    TimeInterval,
)


def whole(activity: Activity, early: int = 0) -> TimeInterval:
    """Return when a state that is set ``early`` units before the ends of activities has to hold
    all through one of them, which may begin at the instant at which another one ends: an effect
    is seen from the next instant on.

    The ends are wrapped in timings: bare timepoints crash UP's ``problem.kind``.
    """
    if early:
        return ClosedTimeInterval(Timing(0, activity.start), Timing(-early, activity.end))
    return LeftOpenTimeInterval(Timing(0, activity.start), Timing(0, activity.end))


def rewritten(lasts: DurationInterval, rewrite: Callable[[FNode], FNode]) -> DurationInterval:
    """Return the bounds of a duration with each expression rewritten."""
    bounds = map(rewrite, (lasts.lower, lasts.upper))
    return DurationInterval(*bounds, lasts.is_left_open(), lasts.is_right_open())


def closed(activity: Activity) -> TimeInterval:
    """Return [start, end] of an activity: it begins after others that set what it needs."""
    return ClosedTimeInterval(Timing(0, activity.start), Timing(0, activity.end))


def nothing_but_an_instant(activity: Activity) -> TimeInterval:
    """Return the instant at which an activity of no length happens; nothing for any other one."""
    return ClosedTimeInterval(Timing(0, activity.end), Timing(0, activity.start))


def inner(activity: Activity, early: int = 0) -> TimeInterval:
    """Return when the effects of what ends within (start, end) happen: nothing, for an activity
    that lasts one unit.
    """
    if early:
        return RightOpenTimeInterval(Timing(0, activity.start), Timing(-early, activity.end))
    return OpenTimeInterval(Timing(0, activity.start), Timing(0, activity.end))


def with_timings(span: TimeInterval) -> TimeInterval:
    """Return the interval with timings as its ends.

    ``ClosedTimeInterval(a.start, a.end)`` holds bare timepoints, which have no ``delay``: UP takes
    it, and its ``problem.kind`` crashes on it.
    """
    lower, upper = _timing(span.lower), _timing(span.upper)
    if lower is span.lower and upper is span.upper:
        return span
    return TimeInterval(lower, upper, span.is_left_open(), span.is_right_open())


def conditions_of(chronicle: TimedCondsEffs) -> dict[TimeInterval, list[FNode]]:
    """Return the conditions of an activity or of the problem itself by their intervals, each of
    which is there once, however it was written.
    """
    found: dict[TimeInterval, list[FNode]] = {}
    for span, conditions in chronicle.conditions.items():
        same = found.setdefault(with_timings(span), [])
        same += [c for c in conditions if c not in same]
    return found


def own_end(timing: Timing | Timepoint, activity: Activity) -> tuple[bool, object] | None:
    """Return whether a timing counts from an activity's end (else from its start), and the delay;
    None for a timing of the whole plan or of another activity.
    """
    told = _timing(timing)
    if told.is_global() or told.timepoint.container not in (None, activity.name):
        return None
    return told.is_from_end(), told.delay


def asks_at_start(span: TimeInterval, activity: Activity, least: int) -> bool:
    """Return whether a condition over an interval always asks for something right when an activity
    starts, at that instant or at the next one.

    :param least: units that the activity lasts at least.
    """
    upper = own_end(span.upper, activity)
    if own_end(span.lower, activity) != (False, 0) or upper is None:
        return False
    from_end, delay = upper
    length = delay + (least if from_end else 0) if isinstance(delay, int) else -1
    return length >= span.is_left_open() + span.is_right_open()


def _timing(end: Any) -> Timing:
    return Timing(0, end) if isinstance(end, Timepoint) else end


def has_bare_ends(problem: Any) -> bool:
    """Return whether some interval of a scheduling problem ends at a bare timepoint: then UP cannot
    compute the problem's kind.
    """
    spans = (s for c in (problem._base, *problem.activities) for s in c.conditions)
    return any(with_timings(span) is not span for span in spans)
