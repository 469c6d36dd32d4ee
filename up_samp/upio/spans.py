"""Intervals as UP scripts write them: their ends may be bare timepoints."""

from __future__ import annotations

from typing import Any

from unified_planning.model import Timepoint, Timing
from unified_planning.model.timing import TimeInterval


def with_timings(span: TimeInterval) -> TimeInterval:
    """Return the interval with timings as its ends.

    ``ClosedTimeInterval(a.start, a.end)`` holds bare timepoints, which have no ``delay``: UP takes
    it, and its ``problem.kind`` crashes on it.
    """
    lower, upper = _timing(span.lower), _timing(span.upper)
    if lower is span.lower and upper is span.upper:
        return span
    return TimeInterval(lower, upper, span.is_left_open(), span.is_right_open())


def _timing(end: Any) -> Timing:
    return Timing(0, end) if isinstance(end, Timepoint) else end


def has_bare_ends(problem: Any) -> bool:
    """Return whether some interval of a scheduling problem ends at a bare timepoint: then UP cannot
    compute the problem's kind.
    """
    spans = (s for c in (problem._base, *problem.activities) for s in c.conditions)
    return any(with_timings(span) is not span for span in spans)
