"""Which activities need an object."""

from __future__ import annotations

import re

from unified_planning.model.motion import MotionActivity
from unified_planning.model.scheduling import Activity


def moves(activity: Activity, name: str) -> bool:
    """Return whether an activity drives an object or puts it elsewhere."""
    if not isinstance(activity, MotionActivity):
        return False
    driven = [c.movable for c in activity.motion_constraints]
    return any(
        n.is_object_exp() and n.object().name == name for n in (*driven, *activity.motion_effects)
    )


def involves(activity: Activity, name: str) -> bool:
    """Return whether an activity needs an object: it moves it, speaks of it, or is named after
    it.
    """
    if moves(activity, name):
        return True
    if re.search(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])", activity.name):
        return True
    nodes = [n for items in activity.conditions.values() for n in items]
    nodes += [e.fluent for items in activity.effects.values() for e in items]
    while nodes:
        node = nodes.pop()
        nodes += node.args
        if node.is_object_exp() and node.object().name == name:
            return True
    return False
