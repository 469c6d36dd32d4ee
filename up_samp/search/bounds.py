"""The bounds of a search: the best plan so far, and what no plan can be better than."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from up_samp.model import CandidateSchedule, Trajectory
from up_samp.upio import SampSchedule


@dataclass(frozen=True)
class Incumbent:
    """A schedule with trajectories for all of its motions (by activity, s from the start), and the
    UP plan of both.
    """

    schedule: CandidateSchedule
    trajectories: Mapping[str, Trajectory]
    plan: SampSchedule


@dataclass
class Bounds:
    """Makespans in units: ``absolute`` is the best lower one that does not rest on the motion
    planner's durations. ``stated``: something that does was told to the scheduler.
    """

    lower: int = 0
    absolute: int = 0
    stated: bool = False
    beside: int = 0
    """What is known beside the scheduling problem that the scheduler is told."""
    stood: int = -1
    """The greatest lower bound that was doubted, and not refuted."""
    incumbent: Incumbent | None = None

    @property
    def relative(self) -> bool:
        """Whether the lower bound rests on the motion planner's durations."""
        return self.lower > self.absolute

    @property
    def upper(self) -> int | None:
        """Makespan of the best plan so far."""
        return None if self.incumbent is None else self.incumbent.schedule.makespan

    def raise_lower(self, units: int, *, relative: bool) -> None:
        """Take note of a lower bound; ``relative``: it rests on the planner's durations."""
        if not relative:
            self.absolute = max(self.absolute, units)
        self.lower = max(self.lower, units)

    def forget(self) -> None:
        """Drop the lower bounds."""
        self.lower = self.absolute = self.beside = 0

    @property
    def met(self) -> bool:
        """Whether the best plan meets the lower bound."""
        return self.upper is not None and self.upper <= self.lower

    def improves(self, schedule: CandidateSchedule) -> bool:
        """Return whether a plan with this schedule would be the best so far."""
        return self.upper is None or schedule.makespan < self.upper

    def keep(self, found: Incumbent) -> bool:
        """Make a valid plan the incumbent, if it is the best so far; return whether it is."""
        if not self.improves(found.schedule):
            return False
        self.incumbent = found
        return True
