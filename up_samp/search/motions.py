"""Questions to the motion planners about the motions of one problem."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from up_samp.model import (
    Deadline,
    PathQuery,
    PathReport,
    TimedMotion,
    Trajectory,
)
from up_samp.model.refinement import Strength
from up_samp.motion import MotionService
from up_samp.motion.fleet import earliest_arrival
from up_samp.motion.fleet.coordination import order_decides
from up_samp.motion.guides import TOUCHES
from up_samp.search.budget import Budget
from up_samp.search.facts import Facts
from up_samp.search.world import Where, surely_there


@dataclass(frozen=True)
class Motions:
    """Asks the motion service about motions of the problem, within the search's budget."""

    facts: Facts
    service: MotionService
    budget: Budget

    def path(self, query: PathQuery) -> PathReport:
        """Return the planner's path for a motion alone, within one query's time."""
        return self.service.plan(query, self.budget.query())

    def fastest(self, query: PathQuery, deadline: Deadline) -> tuple[PathReport, Strength]:
        """Return the planner's answer and what its duration is worth.

        Only a motion whose planner finished its search is the planner's fastest.
        """
        report = self.service.plan(query, deadline)
        return report, Strength.RELATIVE if report.complete else Strength.HEURISTIC

    def fastest_alone(self, motion: TimedMotion) -> Trajectory | None:
        """Return the motion's fastest trajectory with nobody else there, from time 0; None where
        none was found, or the search for it was not finished.
        """
        report = self.path(PathQuery(motion.body, motion.poses))
        return report.trajectory if report.complete else None

    def arrival(
        self,
        motion: TimedMotion,
        leader: TimedMotion,
        drive: Trajectory,
        enough: float,
        deadline: Deadline,
    ) -> float | None:
        """Return the motion's earliest arrival (s) behind another one's ``drive``, or any by
        ``enough`` (s), with nobody else there; None if none was found.
        """
        early = replace(motion, due=enough)
        limit = deadline.within(self.budget.query_seconds)
        return earliest_arrival(self.service, early, leader, drive, limit)

    def order_decides(self, first: TimedMotion, second: TimedMotion) -> bool:
        """Return whether it decides everything which of two motions goes first where they meet."""
        return order_decides(self.service, first, second, self.budget.query())

    @cached_property
    def there(self) -> Where:
        """What surely rests where whenever somebody leaves a place."""
        return surely_there(self.facts, self.service)


def touching(reason: str) -> str:
    """Return for people that a motion begins or ends in touch with something, if that is why the
    planners do not find it; a plan may begin so, but they keep clear by a hair.
    """
    return f"; {TOUCHES}: leave a millimetre between them" if TOUCHES in reason else ""
