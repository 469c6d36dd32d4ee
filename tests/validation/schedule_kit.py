"""Judge schedules of scheduling problems, made by hand."""

from unified_planning.model import (
    ClosedTimeInterval,
    LeftOpenTimeInterval,
    OpenTimeInterval,
    RightOpenTimeInterval,
)
from unified_planning.plans import Schedule

from up_samp.validation import validate_schedule

INTERVALS = {
    "[]": ClosedTimeInterval,
    "()": OpenTimeInterval,
    "(]": LeftOpenTimeInterval,
    "[)": RightOpenTimeInterval,
}


def plan(problem, times, values=None):
    """``times``: activity -> (start, end) of the present ones."""
    assignment = dict(values or {})
    for a, (start, end) in times.items():
        assignment[a.start], assignment[a.end] = start, end
    return Schedule(list(times), assignment)


def judge(problem, times, values=None):
    return validate_schedule(problem, plan(problem, times, values))


def kinds(verdict):
    return {v.kind for v in verdict.violations}
