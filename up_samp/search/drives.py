"""How long drives take by the motion planner, asked for one pair of poses at a time, and kept.

Bounds of drives know nothing of what a planner cannot do: they are quick to find and hold for any
planner. The planner's own durations are asked for only where something hangs on them. Motions of
equal bodies, and the same way back where a planner may drive it backwards in time, are one motion
to the service, which remembers them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model import Body, Configuration, Deadline, Outcome, PathQuery
from up_samp.motion import MotionService

Pair = tuple[Body, Configuration, Configuration]


@dataclass(frozen=True)
class Drive:
    """What a drive takes (s) with nobody else there. ``complete``: the planner finished its search,
    so that it is the planner's fastest; else it is only some drive.
    """

    seconds: float
    complete: bool


@dataclass
class Drives:
    """Drives of one problem, by body, start and goal.

    :param query: the longest (s) that one drive is looked for.
    """

    service: MotionService
    query: float = 2.0
    asked: int = 0
    """So many drives were asked of the planner so far."""
    _known: dict[Pair, Drive | None] = field(default_factory=dict)

    def drive(
        self, body: Body, start: Configuration, goal: Configuration, deadline: Deadline
    ) -> Drive | None:
        """Return what a drive takes, None where the planner found none in time."""
        pair = body, start, goal
        if pair not in self._known:
            if start != goal:
                self.asked += 1
            self._known[pair] = self._planned(pair, deadline)
        return self._known[pair]

    def _planned(self, pair: Pair, deadline: Deadline) -> Drive | None:
        body, start, goal = pair
        if start == goal:
            return Drive(0.0, complete=True)
        query = PathQuery(body, (start, goal), ())
        report = self.service.plan(query, deadline.within(self.query))
        if report.outcome is not Outcome.FOUND or report.trajectory is None:
            return None
        return Drive(float(report.trajectory.duration), report.complete)
