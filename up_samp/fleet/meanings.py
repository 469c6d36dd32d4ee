"""What the activities of a fleet's UP problem stand for.

Their names are for people: robots, places and orders may be called as they like, so that nothing
can be read from the name of an activity.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem


class Kind(enum.Enum):
    """What happens in an activity."""

    MOVE = "move"
    CARRY = "carry"
    PICKUP = "pick"
    DELIVERY = "deliver"
    TASK = "task"
    OPEN = "open"
    CLOSE = "close"
    CHARGE = "charge"
    SKIP = "skip"
    LEAVE = "leave out"


@dataclass(frozen=True)
class Meaning:
    """``what`` (an order, a task, a door, a charger's place; none for moves) happens, by ``robot``
    (none: by no robot).
    """

    kind: Kind
    what: str = ""
    robot: str = ""


@dataclass(frozen=True, eq=False)
class Written:
    """A fleet's UP problem, and what its activities (by name) stand for."""

    problem: SchedulingMotionProblem
    meanings: Mapping[str, Meaning]

    def happening(self, activities: Iterable[Mapping[str, Any]]) -> Iterator[tuple[Meaning, Any]]:
        """Yield what a plan's ``activities`` (dictionaries) stand for, with each of them."""
        return ((self.meanings[a["name"]], a) for a in activities)
