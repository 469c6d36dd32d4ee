"""What one robot does when: commands of the floor become goals of its navigation, and where it is
and what it has done is told. Nothing of ROS is in here.

A command holds until there is another one. A path is driven piece by piece: forwards, backwards, or
turning on the spot. A piece is a goal up to where the robot may go now; each time that it may go
farther, a longer goal takes the place of the one before. Who hears nothing from the floor for a
while stops: it might be held.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from up_samp_ros.link import Link, LostError

Pose = tuple[float, float, float]
Ended = Callable[[bool], None]
"""Called with whether a goal was come to."""

PATIENCE = 2.0
"""Seconds without a word from the floor after which a robot stops."""
FARTHER = 0.05
"""m by which a goal has to be farther than the one before to take its place."""
AGAIN = 1.0
"""Seconds after which a goal that failed is given again."""
SPACING = 0.05
"""m between two poses of a path."""
THERE = 0.01
"""m that are the same place."""
NEAR = 0.1
"""m from a goal at which a robot may stand that has come to it."""
WINDOW = 2.0
"""m of its path in which a robot is looked for, from where it was on."""
TURNED = 0.2
"""m that count as much as a radian between two poses."""


class Base(Protocol):
    """A robot's navigation, as :mod:`up_samp_ros.node` has it by Nav2."""

    def pose(self) -> Pose | None:
        """Return where the robot is in the map's frame (x, y in m, heading in rad), if known."""

    def battery(self) -> float | None:
        """Return the level of its battery (percent of a full one), if it tells."""

    def follow(self, poses: Sequence[Pose], ended: Ended) -> None:
        """Follow a path, instead of what it does now."""

    def turn(self, angle: float, ended: Ended) -> None:
        """Turn on the spot by an angle (rad, to the left), instead of what it does now."""

    def stop(self) -> None:
        """Stop now; no goal is left, and none of those before ends any more."""

    def work(self, command: dict[str, Any], ended: Ended) -> None:
        """Do what is to be done at a place."""

    def planned(self, poses: Sequence[Pose]) -> None:
        """Show the way to the end of the motion."""


@dataclass
class Piece:
    """A part of a path that is driven in one direction: rows (s, x, y, theta)."""

    direction: str
    rows: list[list[float]]

    @property
    def end(self) -> float:
        """Where it ends (m)."""
        return self.rows[-1][0]

    def at(self, s: float) -> Pose:
        """Return the pose at a progress (m)."""
        progress = [row[0] for row in self.rows]
        k = min(max(bisect.bisect_left(progress, s), 1), len(self.rows) - 1)
        a, b = self.rows[k - 1], self.rows[k]
        share = min(1.0, max(0.0, (s - a[0]) / (b[0] - a[0]))) if b[0] > a[0] else 1.0
        x, y, theta = (a[i] + share * (b[i] - a[i]) for i in (1, 2, 3))
        return x, y, theta

    def nearest(self, pose: Pose, since: float) -> float:
        """Return the progress (m) of the point of it, from ``since`` on, that is nearest."""

        def far(s: float) -> tuple[float, float]:
            here = self.at(s)
            turned = abs(math.remainder(here[2] - pose[2], math.tau))
            return math.dist(here[:2], pose[:2]) + TURNED * turned, s

        span = max(0.0, min(self.end - since, WINDOW))
        count = max(1, round(span / THERE))
        return min((since + span * i / count for i in range(count + 1)), key=far)

    def part(self, low: float, high: float) -> list[Pose]:
        """Return the poses from one progress to another, both included."""
        count = max(1, math.ceil((high - low) / SPACING))
        return [self.at(low + (high - low) * i / count) for i in range(count + 1)]


@dataclass
class Goal:
    """What the robot's navigation was told last: to come to ``until`` (m) in a piece."""

    piece: int
    until: float
    ended: bool | None = None
    """Whether it has come there (None: it is still on its way)."""


class Driver:
    """One robot. ``clock`` tells seconds; ``wait`` is how long a request waits for a new command:
    a stop is heard of at once, and where the robot is is told that often.
    """

    def __init__(
        self,
        robot: str,
        link: Link,
        base: Base,
        clock: Callable[[], float],
        wait: float = 0.2,
    ) -> None:
        self.robot, self.link, self.base = robot, link, base
        self.clock, self.wait = clock, wait
        self.number = 0
        self.motion, self.pieces = "", list[Piece]()
        self.piece, self.gone = 0, 0.0
        self.goal: Goal | None = None
        self.working, self.over = "", ""
        self.moving = False
        self.problem = ""
        self._heard = self._failed = -math.inf

    def step(self) -> None:
        """Ask what is to be done, do it, and tell where the robot is."""
        self.problem = ""
        try:
            command = self.link.command(self.robot, self.number, self.wait)
            self.number = command["number"]
            self._obey(command)
            self.link.report(self.robot, self._told(command))
        except LostError as error:
            self.problem = str(error)
            if self.clock() > self._heard + PATIENCE:
                self._stop()
        else:
            self._heard = self.clock()

    def _obey(self, command: dict[str, Any]) -> None:
        if command["kind"] == "go":
            self._drive(command)
        elif command["kind"] == "do":
            self._work(command)
        else:
            self._stop()

    def _stop(self) -> None:
        """Stop, if anything is under way."""
        if self.moving:
            self.base.stop()
            self.moving, self.goal = False, None

    def _work(self, command: dict[str, Any]) -> None:
        name = command["activity"]
        if name in (self.working, self.over):
            return
        self._stop()
        self.working = name

        def ended(good: bool) -> None:
            if self.working == name:
                self.working, self.over = "", name if good else ""

        self.base.work(command, ended)

    # ------------------------------------------------------------------ driving

    def _drive(self, command: dict[str, Any]) -> None:
        if command["motion"] != self.motion:
            self._begin()
            if command["motion"] != self.motion:
                return  # there is another command by now
        pose = self.base.pose()
        if pose is None or self.finished:
            return
        self._note_end()
        if self.finished:
            return
        piece = self.pieces[self.piece]
        self.gone = piece.nearest(pose, self.gone)
        until = min(piece.end, command["until"])
        if self._is_new(until) and self.clock() >= self._failed + AGAIN:
            self._set_out(piece, pose, until)

    def _begin(self) -> None:
        """Take up the path of another motion."""
        self._stop()
        path = self.link.path(self.robot)
        self.motion = path["motion"]
        self.pieces = [Piece(p["direction"], p["poses"]) for p in path["pieces"]]
        self.gone, self._failed = path["progress"], -math.inf
        ends = [p.end for p in self.pieces]
        self.piece = min(bisect.bisect_right(ends, self.gone + THERE), max(0, len(ends) - 1))
        self.base.planned([pose for p in self.pieces for pose in p.part(p.rows[0][0], p.end)])

    @property
    def finished(self) -> bool:
        """Whether the whole motion is driven."""
        return self.piece >= len(self.pieces)

    def _note_end(self) -> None:
        """Go on with the next piece, or try again, where a goal has ended."""
        goal = self.goal
        if goal is None or goal.ended is None:
            return
        self.goal, self.moving = None, False
        if not goal.ended:
            self._failed = self.clock()
        elif goal.until >= self.pieces[goal.piece].end - THERE:
            self.piece = goal.piece + 1
            self.gone = goal.until
            self._doubt(self.pieces[goal.piece].at(goal.until))
        else:
            self.gone = goal.until

    def _doubt(self, goal: Pose) -> None:
        """Say so where the robot stands farther from a goal that it has come to than it should."""
        pose = self.base.pose()
        gap = 0.0 if pose is None else math.dist(pose[:2], goal[:2])
        if gap > NEAR:
            self.problem = f"it stands {gap:.2f} m from its goal: the goal's tolerance is too large"

    def _is_new(self, until: float) -> bool:
        """Return whether the robot is to come to another point than the one it was told."""
        goal = self.goal
        if goal is None:
            return until > self.gone + THERE
        farther = until - goal.until
        last = until >= self.pieces[self.piece].end - THERE and farther > THERE
        return last or not -THERE < farther < FARTHER

    def _set_out(self, piece: Piece, pose: Pose, until: float) -> None:
        """Give a goal, or stop where the robot is beyond it."""
        if until <= self.gone + THERE:
            self._stop()
            return
        goal = self.goal = Goal(self.piece, until)
        self.moving = True

        def ended(good: bool) -> None:
            goal.ended = good

        if piece.direction == "turn":
            here = piece.at(self.gone)[2]
            wrong = math.remainder(here - pose[2], math.tau)
            self.base.turn(piece.at(until)[2] - here + wrong, ended)
        else:
            self.base.follow(piece.part(self.gone, until), ended)

    def _told(self, command: dict[str, Any]) -> dict[str, Any]:
        """Return what is told of the robot."""
        told: dict[str, Any] = {}
        pose, battery = self.base.pose(), self.base.battery()
        if pose is not None:
            told["pose"] = [round(v, 4) for v in pose]
        if battery is not None:
            told["battery"] = battery
        if command.get("motion", "") == self.motion != "":
            told |= {"motion": self.motion} | ({"done": self.motion} if self.finished else {})
        if command["kind"] == "do" and command["activity"] == self.over and command["may_end"]:
            told["done"] = self.over
        return told
