"""A problem with some of its optional activities only: who does what is decided, or nearly so."""

from __future__ import annotations

import copy
from collections.abc import Collection

from unified_planning.model.motion import MotionActivity, SchedulingMotionProblem

from up_samp.model import CandidateSchedule
from up_samp.upio.restrict import PresenceFixer


def thinned(problem: SchedulingMotionProblem, keep: Collection[str]) -> SchedulingMotionProblem:
    """Return a problem without the optional activities that are not in ``keep``: they are absent.

    Each of its schedules is one of ``problem``. It takes time in proportion to what is left, and
    to the number of activities.
    """
    names = {a.name for a in problem.activities if not a.optional or a.name in keep}
    hollow = copy.copy(problem)
    hollow._activities, hollow._motion_activities = [], []
    target = hollow.clone()
    present = CandidateSchedule({name: (0, 0) for name in names})
    fix = PresenceFixer(problem, present, frozenset(names))
    for activity in problem.activities:
        if activity.name in names:
            kept = activity.clone()
            fix.constraints(activity, kept)
            target._activities.append(kept)
            if isinstance(kept, MotionActivity):
                target._motion_activities.append(kept)
    fix.constraints(problem._base, target._base)
    return target
