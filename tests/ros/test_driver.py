"""What a robot is told when: the bridge's driver by itself, with a path that turns and reverses."""

import importlib
import math
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FAR = 1.0 + math.pi / 2 + 1.0
PATH = {
    "motion": "move",
    "progress": 0.0,
    "pieces": [
        {"direction": "forward", "poses": [[0, 0, 0, 0], [1, 1, 0, 0]]},
        {"direction": "turn", "poses": [[1, 1, 0, 0], [1 + math.pi / 2, 1, 0, math.pi]]},
        {"direction": "backward",
         "poses": [[1 + math.pi / 2, 1, 0, math.pi], [FAR, 2, 0, math.pi]]},
    ],
}  # fmt: skip


class Floor:
    """A link whose command is set by the test."""

    def __init__(self, kind="go", **command):
        self.say(kind, **command)
        self.heard = []

    def say(self, kind, **command):
        self.command_now = {"number": getattr(self, "command_now", {"number": 0})["number"] + 1,
                            "kind": kind, **command}  # fmt: skip

    def command(self, robot, after, wait):
        return self.command_now

    def path(self, robot):
        return PATH

    def report(self, robot, told):
        self.heard.append(told)


class Robot:
    """Navigation that comes to a goal where the test says so."""

    def __init__(self):
        self.here, self.told, self.ended = (0.0, 0.0, 0.0), [], None

    def pose(self):
        return self.here

    def battery(self):
        return 42.0

    def follow(self, poses, ended):
        self.told.append(("follow", poses[-1]))
        self.ended, self.goal = ended, poses[-1]

    def turn(self, angle, ended):
        self.told.append(("turn", round(angle, 6)))
        self.ended, self.goal = ended, (*self.here[:2], self.here[2] + angle)

    def stop(self):
        self.told.append(("stop",))

    def work(self, command, ended):
        self.told.append(("work", command["activity"]))
        self.ended, self.goal = ended, self.here

    def planned(self, poses):
        self.way = poses

    def come(self, good=True):
        self.here = self.goal if good else self.here
        self.ended(good)


@pytest.fixture
def drive(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "ros"))
    module = importlib.import_module("up_samp_ros.driver")

    def begin(**command):
        floor, robot, time = Floor(**command), Robot(), [0.0]
        return floor, robot, time, module.Driver("r0", floor, robot, lambda: time[0], 0.0)

    return begin


def test_pieces_are_driven_one_after_the_other(drive):
    floor, robot, _, driver = drive(motion="move", until=FAR)
    for _ in range(3):
        driver.step()
        driver.step()
        robot.come()
    driver.step()
    assert robot.told == [
        ("follow", (1.0, 0.0, 0.0)), ("turn", round(math.pi, 6)), ("follow", (2.0, 0.0, math.pi)),
    ]  # fmt: skip
    assert robot.way[0] == (0.0, 0.0, 0.0)
    assert floor.heard[-1] == {
        "pose": [2.0, 0.0, 3.1416], "battery": 42.0, "motion": "move", "done": "move",
    }  # fmt: skip
    assert "done" not in floor.heard[-2]


def test_a_goal_grows_with_what_may_be_driven(drive):
    floor, robot, _, driver = drive(motion="move", until=0.4)
    driver.step()
    floor.say("go", motion="move", until=0.42)
    driver.step()
    floor.say("go", motion="move", until=0.6)
    driver.step()
    assert [p[0] for _, p in robot.told] == pytest.approx([0.4, 0.6])
    robot.come()
    driver.step()
    driver.step()
    assert len(robot.told) == 2
    floor.say("go", motion="move", until=1.0 + math.pi / 4)
    driver.step()
    robot.come()
    driver.step()
    assert robot.told[-1] == ("turn", round(math.pi / 2, 6))


def test_what_may_not_be_driven_any_more_is_taken_back(drive):
    floor, robot, _, driver = drive(motion="move", until=0.9)
    driver.step()
    robot.here = (0.5, 0.0, 0.0)
    floor.say("go", motion="move", until=0.7)
    driver.step()
    assert robot.told[-1][1][0] == pytest.approx(0.7)
    floor.say("go", motion="move", until=0.3)
    driver.step()
    driver.step()
    assert robot.told[-1] == ("stop",)
    assert robot.told.count(("stop",)) == 1
    floor.say("go", motion="move", until=0.9)
    driver.step()
    assert robot.told[-1][1][0] == pytest.approx(0.9)


def test_a_goal_that_fails_is_given_again_after_a_while(drive):
    _, robot, time, driver = drive(motion="move", until=1.0)
    driver.step()
    robot.come(good=False)
    driver.step()
    driver.step()
    assert len(robot.told) == 1
    time[0] = 1.1
    driver.step()
    assert len(robot.told) == 2


def test_work_is_done_once_and_told_when_it_may_end(drive):
    floor, robot, _, driver = drive(kind="do", activity="pick", seconds=2.0, may_end=False)
    driver.step()
    driver.step()
    robot.come()
    driver.step()
    assert robot.told == [("work", "pick")]
    assert "done" not in floor.heard[-1]
    floor.say("do", activity="pick", seconds=2.0, may_end=True)
    driver.step()
    assert floor.heard[-1]["done"] == "pick"


def test_too_large_a_tolerance_is_said(drive):
    _, robot, _, driver = drive(motion="move", until=FAR)
    driver.step()
    robot.come()
    robot.here = (0.8, 0.0, 0.0)
    driver.step()
    assert "0.20 m from its goal" in driver.problem
