"""Robots behind HTTP: whoever drives one asks what it is to do, and tells where it is.

What a robot is to do is one command at a time, with a number, and is there as long as it holds: so
nothing is lost where an answer is, and whoever has been away just asks again. Paths are told once.
The requests are those of :mod:`up_samp.server.floor`; a client is in the folder ``ros/``.
"""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le

from up_samp.execution.executor import Executor
from up_samp.execution.reports import Command, Do, Go, Hold, Report
from up_samp.fleet.fields import NUMBER, STRICT, Pose
from up_samp.fleet.files import read_record
from up_samp.fleet.records import FleetRecords
from up_samp.model import ProblemError
from up_samp.motion.fleet.paths import Path
from up_samp.operate.horizon import driven_before
from up_samp.operate.stitch import whole_motion
from up_samp.operate.upkeep import action_of
from up_samp.operate.zones import stretches_told

Message = dict[str, Any]


@dataclass(frozen=True)
class RobotTold:
    """What a robot tells: its ``pose`` (x, y, theta) or its ``progress`` (m) along ``motion``, that
    an activity or a motion is ``done``, the level of its ``battery`` (percent of a full one), and
    how far (m) it may be from where it tells to be, as it knows itself (``error``).
    """

    __pydantic_config__ = STRICT
    motion: str = ""
    progress: Annotated[float, NUMBER] | None = None
    pose: Pose | None = None
    done: str = ""
    battery: Annotated[float, Ge(0), Le(100), NUMBER] | None = None
    error: Annotated[float, Ge(0), NUMBER] | None = None


class RemoteRobots:
    """The robots of a site whose drivers ask and tell; every thread may do so. Of whom nothing was
    heard for 10 s that is noted.
    """

    silent = 10.0

    def __init__(self, site: FleetRecords) -> None:
        self.site = site
        self.faults: list[tuple[str, str]] = []
        self.levels: dict[str, float] = {}
        # not the numbers of another process: who asks for what comes after one of those is answered
        first = time.time_ns() // 1000
        nothing = {"number": first, "kind": "hold", "why": "nothing is known yet"}
        self._commands: dict[str, Message] = dict.fromkeys(site.robots, nothing)
        self._inbox: queue.SimpleQueue[tuple[str, RobotTold]] = queue.SimpleQueue()
        self._heard: dict[str, float] = {}
        self._executor: Executor

    # ------------------------------------------------------------------ for the loop

    def follow(self, executor: Executor) -> None:
        """Know the motions of another plan."""
        self._executor = executor

    def tell(self, commands: Mapping[str, Command], now: float) -> None:
        """Let robots do something else from now on."""
        for robot in self._commands.keys() & commands.keys():
            before = self._commands[robot]
            found = self._told(commands[robot])
            if {**found, "number": before["number"]} != before:
                self._commands[robot] = {**found, "number": before["number"] + 1}

    def _told(self, command: Command) -> Message:
        """Return a command as JSON would hold it."""
        match command:
            case Hold(waiting_for):
                return {"kind": "hold", "why": "; ".join(waiting_for)}
            case Go(motion, until):
                return {"kind": "go", "motion": motion, "until": round(until, 4)}
            case Do(name, may_end):
                kind, what = action_of(self._executor.plan, name)
                told = {"activity": name, "action": kind, "order": what, "may_end": may_end}
                seconds = self._executor.state.graph.tasks[name].expected
                return {"kind": "do", "seconds": seconds, **told}

    def reports(self, now: float) -> list[Report]:
        """Return what robots have told since the last call; who tells nothing is at fault."""
        found = []
        for _ in range(self._inbox.qsize()):
            robot, told = self._inbox.get()
            self._heard[robot] = now
            if told.battery is not None:
                self.levels[robot] = told.battery / 100.0
            if told.pose or told.progress is not None:
                where = (told.motion, told.progress, told.pose)
                found.append(Report(robot, now, *where, error=told.error))
            if told.done:
                found.append(Report(robot, now, told.done, done=True))
        for robot in self._commands:
            if now > self._heard.setdefault(robot, now) + self.silent:
                self._heard[robot] = math.inf
                self.faults.append((robot, f"nothing was heard of it for {self.silent:g} s"))
        return found

    # ------------------------------------------------------------------ for who drives

    def command(self, robot: str) -> Message:
        """Return what a robot is to do: ``go`` along the path of a ``motion``, not beyond ``until``
        (m), ``do`` something where it stands (``seconds``; not over before it ``may_end``), or
        ``hold``.

        :raises ProblemError: where there is no such robot.
        """
        if robot not in self._commands:
            raise ProblemError(f"there is no robot '{robot}'")
        return self._commands[robot]

    def path(self, robot: str) -> Message:
        """Return the path of the motion that a robot is to drive now: ``pieces``, each driven in
        one ``direction`` (``forward``, ``backward``, ``turn`` on the spot, or ``any``), no faster
        than ``speed`` (m/s), and with ``poses`` [s, x, y, theta], s being the progress (m); and the
        ``progress`` that it told last.

        :raises ProblemError: where it is not to drive.
        """
        name, executor = self.command(robot).get("motion", ""), self._executor
        motion = next((m for m in executor.plan["motions"] if m["activity"] == name), None)
        if motion is None:
            raise ProblemError(f"'{robot}' is not to drive anywhere now")
        begun = driven_before(motion) + max(0.0, executor.state.ways[name, robot].progress)
        pieces = pieces_told(motion, executor.drives[name, robot].path)
        return {"motion": name, "progress": round(begun, 4), "pieces": pieces}

    def take(self, robot: str, told: Message) -> None:
        """Take in what a robot tells, see :class:`RobotTold`.

        :raises ProblemError: where something in it cannot be read.
        """
        self.command(robot)
        found: RobotTold = read_record(RobotTold, told)
        if found.progress is not None and not found.motion:
            raise ProblemError("progress is along a 'motion': name it")
        self._inbox.put((robot, found))

    def close(self) -> None:
        """Nothing is open."""


def pieces_told(motion: Mapping[str, Any], path: Path) -> list[Message]:
    """Return the pieces of a motion of a plan, by progress since its robot began it."""
    whole = whole_motion(motion)
    times = [row[0] for row in whole["samples"]]
    return [
        {
            "direction": piece.direction,
            "speed": round(speed, 3),
            "poses": np.column_stack(
                [np.interp(piece.rows[:, 0], times, whole["progress"]), piece.rows[:, 1:]]
            ).round(4).tolist(),
        }
        for piece, _, _, speed in stretches_told(whole, path)
    ]  # fmt: skip
