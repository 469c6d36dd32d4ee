"""Tours that are decided: their motions, and when everything happens."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

from up_samp.model import CandidateSchedule, Trajectory
from up_samp.motion.fleet.timed_path import TimedPath


@dataclass(frozen=True)
class Decided:
    """All tours of a candidate: its ``schedule`` and, by activity, ``runs`` and when they are
    (start, end; units). ``needless`` are last motions that nobody needs: their robots are in
    nobody's way where they stand before.
    """

    schedule: CandidateSchedule
    runs: Mapping[str, TimedPath]
    pins: Mapping[str, tuple[int, int]]
    keys: Mapping[str, str]
    """What their trajectories are called in a plan."""
    needless: frozenset[str] = frozenset()

    def ends(self) -> dict[str, float]:
        """Return when each robot's last motion that is needed ends (s)."""
        found: dict[str, float] = defaultdict(float)
        for name, run in self.runs.items():
            arrival = 0.0 if name in self.needless else run.arrival
            found[run.object] = max(found[run.object], arrival)
        return dict(found)

    def cost(self, steep: int) -> tuple[int, float]:
        """Return the makespan of what is needed and the sum of its ends to the power ``steep``:
        less is better.
        """
        ends = self.ends()
        return self.lean().makespan, math.fsum(end**steep for end in ends.values())

    def lean(self) -> CandidateSchedule:
        """Return the schedule without what is needless."""
        times = {n: t for n, t in self.schedule.times.items() if n not in self.needless}
        return CandidateSchedule(times, self.schedule.parameters)

    def trajectories(self) -> dict[str, Trajectory]:
        """Return all motions that are needed by their names in a plan."""
        return {
            self.keys[name]: run.timing.trajectory
            for name, run in self.runs.items()
            if name not in self.needless
        }
