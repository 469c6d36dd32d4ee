"""A floor on which one robot leaves its path, does not stop at once, and is put back later."""

import dataclasses
import math
import random

import numpy as np

from up_samp.execution import Delays, Executor
from up_samp.execution.judge import contacts_of
from up_samp.execution.simulate import Floor, simulation_of


@dataclasses.dataclass
class Loose:
    """``robot`` leaves its path after ``when`` s at ``speed`` m/s, turned by ``angle`` from where
    it heads. It does not heed commands for ``far`` m, stands for ``rest`` s and goes back.
    """

    robot: str
    when: float
    angle: float
    speed: float
    far: float
    rest: float = 8.0
    rows: list = dataclasses.field(default_factory=list)
    """[t, x, y, theta] off the path."""
    motion: str = ""
    gone: float = 0.0
    until: float | None = None
    """Until when it stands, once it does."""

    @property
    def off(self):
        return bool(self.rows) and self.motion != ""


class LooseFloor(Floor):
    """See :class:`Loose`. ``unavoidable`` are those who could not stop before they were in the way,
    when they were first told of it.
    """

    loose: Loose

    def drive(self, now, seconds):
        robot = self.robots[self.loose.robot]
        off = self._leaves(robot)
        if off:
            self._go_astray(robot)
            motion, robot.motion = robot.motion, None
        super().drive(now, seconds)
        if off:
            robot.motion = motion

    def _go_astray(self, robot):
        loose = self.loose
        if not loose.rows:
            self.home = self._pose(robot)
            loose.rows.append([self.now, *self.home])
            loose.motion, self.speed = robot.motion, loose.speed
            robot.v = 0.0
        held = robot.hold and loose.gone >= loose.far
        back = loose.until is not None and self.now >= loose.until
        if back:
            loose.gone = max(0.0, loose.gone - 0.5 * self.tick)
        else:
            self.speed = max(0.0, self.speed - 0.5 * self.tick) if held else self.speed
            loose.gone += self.speed * self.tick
        if self.speed == 0.0 and loose.until is None:
            loose.until = self.now + loose.rest
        x, y, theta = self.home
        way = theta + loose.angle
        here = (x + loose.gone * math.cos(way), y + loose.gone * math.sin(way), theta)
        loose.rows.append([self.now + self.tick, *here])
        robot.trace.append((self.now + self.tick, robot.s))
        if back and loose.gone == 0.0:
            loose.motion = ""

    def _state(self):
        return (*super()._state(), len(self.loose.rows))

    def _leaves(self, robot):
        if self.loose.rows:
            return self.loose.off
        return self.now >= self.loose.when and robot.motion is not None and robot.v > 0.3

    def _pose(self, robot):
        drive = self.executive.drives[robot.motion, robot.name]
        return tuple(float(v) for v in drive.path.poses_at(np.array([robot.s]))[0])

    def _tell(self, robot):
        if robot.name != self.loose.robot or not self.loose.off:
            super()._tell(robot)
            return
        pose = tuple(self.loose.rows[-1][1:])
        self.executive.update(robot.name, pose=pose, now=self.now, motion=robot.motion)
        for overrun in self.executive.overruns:
            self.unavoidable.update(overrun.met)
            for other in self.robots.keys() & set(overrun.held):
                self._too_late(self.robots[other])

    def _too_late(self, other):
        bar = self.executive.state.bars.get((other.motion, other.name))
        brake = other.v**2 / (2 * other.travel.accel) + 2 * self.tick * other.v if other.v else 0.0
        if bar is not None and other.s + brake > bar:
            self.unavoidable.add(other.name)


def run_loose(found, problem, plan, seed, *, executor=None):
    """One run with a robot off its path; ``None`` where none left it, else the floor, the
    simulation and who was hit while it drove: (robot, time).
    """
    r = random.Random(seed)
    executor = executor or Executor(plan, problem, dependencies=found)
    floor = LooseFloor(executor, Delays(slow=0.3), seed)
    names = sorted(floor.robots)
    floor.loose = Loose(
        r.choice(names), r.uniform(0.0, 0.6) * found.graph.planned, r.choice((-1, 1)) *
        r.uniform(1.0, 2.2), r.uniform(0.4, 1.0), r.uniform(0.2, 2.0),
    )  # fmt: skip
    floor.unavoidable = set()
    while floor.goes_on:
        floor.step()
    if not floor.loose.rows:
        return None
    run = simulation_of(floor, plan, "staircase", seed)
    return floor, run, driven_into(floor, run.record)


def driven_into(floor, record):
    """Who drove into the robot off its path."""
    loose = floor.loose
    begin, end = loose.rows[0][0], loose.rows[-1][0]
    for motion in record["motions"]:
        rows = motion["samples"]
        if motion["object"] == loose.robot and rows[0][0] <= begin <= rows[-1][0]:
            before, after = ([row for row in rows if row[0] < begin - 1e-6],
                             [row for row in rows if row[0] > end + 1e-6])  # fmt: skip
            motion["samples"] = [*before, *loose.rows, *after]
    found = []
    for contact in contacts_of(record):
        pair = {contact.one, contact.other}
        others = pair - {loose.robot}
        if len(others) == 2 or not begin <= contact.time <= end:
            found.append((pair, contact.time))
        elif moves(record, *others, contact.time) or set_down(record, *others, begin, end):
            found.append((others, contact.time))
    return found


def set_down(record, name, begin, end):
    """Whether something was set where it is between two times."""
    return any(c["object"] == name and begin <= c["time"] <= end for c in record["changes"])


def moves(record, robot, time):
    for motion in record["motions"]:
        rows = np.array(motion["samples"])
        if motion["object"] == robot and rows[0, 0] <= time <= rows[-1, 0]:
            now, then = (np.array([np.interp(t, rows[:, 0], rows[:, k]) for k in (1, 2)])
                         for t in (time - 0.2, time))  # fmt: skip
            return float(np.hypot(*(then - now))) > 0.01
    return False
