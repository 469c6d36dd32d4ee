"""Following a plan by its clock: everybody starts when the plan says so, and looks at nobody.

The baseline that shows what dependencies are good for: late robots collide.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from up_samp.execution.build import Dependencies
from up_samp.execution.graph import PlannedTask
from up_samp.execution.lives import drives_of
from up_samp.execution.reports import Command, Do, Go, Hold


class Timetable:
    """Looks like an :class:`Executor`, but knows only planned times and each robot's own order."""

    def __init__(self, dependencies: Dependencies):
        self.tasks: Mapping[str, PlannedTask] = dependencies.graph.tasks
        self.drives = drives_of(dependencies.lives)
        self.ready = sorted(self.tasks, key=lambda n: self.tasks[n].planned)
        self.running: dict[str, set[str]] = {}
        self.spans: dict[str, tuple[float, float | None]] = {}
        self.now = 0.0

    @property
    def finished(self) -> bool:
        """Whether every activity is done."""
        return not self.ready and not self.running

    @property
    def left(self) -> tuple[int, int]:
        """How many activities have not begun, and how many are under way."""
        return len(self.ready), len(self.running)

    @property
    def awaits_time(self) -> bool:
        """Whether something begins later by nothing but the clock."""
        return any(self.tasks[name].planned[0] > self.now for name in self.ready)

    def times(self) -> dict[str, tuple[float, float | None]]:
        """Return when activities that have begun started and ended (s)."""
        return dict(self.spans)

    def update(self, robot: str, *, progress: float, now: float, motion: str | None = None) -> None:
        """Note where a robot is."""
        self.now = now
        for name, left in list(self.running.items()):
            if robot in left and name == (motion or name):
                drive = self.drives[name, robot]
                if progress >= drive.path.length - 1e-6:
                    left.discard(robot)
                    if not left:
                        self.done(name, now)

    def done(self, activity: str, now: float | None = None) -> None:
        """Note that a task is over."""
        self.now = self.now if now is None else now
        del self.running[activity]
        self.spans[activity] = (self.spans[activity][0], self.now)

    def commands(self, now: float | None = None) -> dict[str, Command]:
        """Return what everybody is to do now."""
        self.now = self.now if now is None else now
        busy = {who for name in self.running for who in self.tasks[name].who}
        for name in list(self.ready):
            task = self.tasks[name]
            if task.planned[0] <= self.now + 1e-9 and not busy.intersection(task.who):
                self.ready.remove(name)
                self.running[name] = set(task.moves)
                self.spans[name] = (self.now, None)
            busy.update(task.who)
        found: dict[str, Command] = {}
        for name in self.running:
            task = self.tasks[name]
            for who in task.moves:
                found[who] = Go(name, self.drives[name, who].path.length)
            if not task.moves:
                for who in task.who or (name,):
                    found[who] = Do(name)
        for task in self.tasks.values():
            for who in task.who:
                found.setdefault(who, Hold())
        return found

    def ceiling(self, motion: str, robot: str, now: float) -> float:
        """Return how far the plan is at ``now`` s (m): nobody is ahead of it."""
        times, s = self.drives[motion, robot].planned
        return float(np.interp(now, times, s))

    def waits_for(self, robot: str) -> tuple[str, ...]:
        """Return nobody: a timetable waits for no one."""
        return ()
