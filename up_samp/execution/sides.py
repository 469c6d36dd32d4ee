"""Which components of the obstacles could be passed on either side."""

from __future__ import annotations

import math

from up_samp.execution.build import Dependencies
from up_samp.execution.lives import Stay
from up_samp.execution.meetings import Meeting
from up_samp.model import MotionModel

Key = tuple[str, str, int]
"""A component: the two objects and its number."""


def planned_sides(dependencies: Dependencies) -> dict[Key, bool]:
    """Return the components that could be passed on either side, with the plan's side."""
    parts: dict[Key, list[Meeting]] = {}
    for meeting in dependencies.meetings:
        for component in meeting.components:
            parts.setdefault((*meeting.pair, component), []).append(meeting)
    found = {}
    for key, meetings in parts.items():
        sides = {bool(s) for m in meetings for s in m.one_first[m.component == key[2]]}
        if len(sides) == 1 and all(_free(m) for m in meetings):
            found[key] = sides.pop()
    return found


def _free(meeting: Meeting) -> bool:
    """Return whether a meeting fixes no side by itself: no rest without beginning or end, nothing
    that is put elsewhere, no body that cannot wait on its way.
    """
    for life, piece in ((meeting.one, meeting.a), (meeting.other, meeting.b)):
        if life.body.kinematics.model is MotionModel.CONTROL or not life.drives:
            return False
        if isinstance(piece, Stay) and (
            math.isinf(piece.since) or math.isinf(piece.until) or piece.enter or piece.leave
        ):
            return False
    return True
