"""What is left of an activity that has begun."""

from __future__ import annotations

import math

from unified_planning.environment import Environment
from unified_planning.model import TimepointKind
from unified_planning.model.motion import MotionActivity
from unified_planning.model.scheduling import Activity

from up_samp.execution.graph import At, Event
from up_samp.execution.values import ValuesNow


def begun(activity: Activity, values: ValuesNow, environment: Environment) -> Activity:
    """Return an activity that has begun: mandatory, and only what is left of it."""
    name, state, unit = activity.name, values.state, values.unit
    drives = isinstance(activity, MotionActivity)
    kind = MotionActivity if drives else Activity
    copy = kind(name, 1, False, _env=environment)
    activity._clone_to(copy)
    start = state.fired[Event(At.START, name)]
    gone = values.since * unit - start
    if state.graph.tasks[name].moves:
        upper = activity.duration.upper
        most = None
        if upper.is_int_constant():
            most = upper.int_constant_value() - math.floor(gone / unit)
        whole = max(1, most if most is not None else 1)
        longest = max(w.travel.whole for w in state.ways_of[name])
        copy.set_duration_bounds(1, max(whole, 2 * math.ceil(longest / unit) + 10))
    else:
        left = state.graph.tasks[name].expected - gone
        copy.set_fixed_duration(max(1, math.ceil(left / unit - 1e-9)))
    copy._effects = {
        t: e for t, e in activity.effects.items() if t.timepoint.kind != TimepointKind.START
    }
    # what was asked at the start was so; it is kept where it still is, for schedulers that
    # find their way by it
    copy._conditions = {}
    for span, nodes in activity.conditions.items():
        at_start = span.upper.timepoint.kind == TimepointKind.START
        kept = [n for n in nodes if not at_start or values.holds(n)]
        if kept:
            copy._conditions[span] = kept
    if drives:
        copy._motion_constraints = list(activity._motion_constraints)
        copy._motion_constraints_set = set(activity._motion_constraints_set)
        copy._motion_effects = dict(activity._motion_effects)
    return copy
