"""The bridge to ROS 2, without ROS: its node against fakes of rclpy's few calls, its driver against
a floor that is operated and served over HTTP, in simulated time.
"""

import importlib
import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("fastapi")

from tests.operate.days import Day
from tests.operate.http_robot import HttpFloor
from tests.operate.sites import hall
from tests.operate.test_doors import two_rooms
from tests.ros.fake_ros import World, install, xyt
from up_samp.execution.floor import Drive, Handled
from up_samp.server.floor import FloorPage

ROOT = Path(__file__).parents[2]


class RosFloor(HttpFloor):
    """The robots of an operation, driven by a bridge whose navigation is simulated."""

    def __init__(self, site, mishaps, seed):
        super().__init__(site, mishaps, seed)
        self.world = World(self.initial)
        self.node, self.now = None, 0.0
        self.works, self.done = {}, []

    def begin(self, node):
        self.node = node
        for driver in node.drivers:
            driver.wait, driver.clock = 0.0, lambda: self.now

    def step(self, now, seconds):
        self.now = round(now + seconds, 6)
        if self.node is None:
            return
        for driver in self.node.drivers:
            driver.step()
        self.world.step(self.now, seconds)
        for name in self.initial:
            for told in self.world.published.pop(f"{name}/up_samp/do", ()):
                work = json.loads(told.data)
                self.works[work["activity"]] = name, self.now, work
        for activity, (name, since, work) in [*self.works.items()]:
            if self.now >= since + work["seconds"]:
                del self.works[activity]
                self.done.append(Handled(work["action"], work["order"], name, since, self.now))
                string = sys.modules["std_msgs.msg"].String
                self.world.tell(f"{name}/up_samp/done", string(data=activity))

    @property
    def drives(self):
        return [Drive(n, "all", rows) for n, rows in self.world.rows.items() if rows]

    @property
    def handled(self):
        return self.done


@pytest.fixture
def bridged(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "ros"))
    opened = []

    def begin(fleet, **given):
        day = Day(tmp_path, fleet=fleet, floor=RosFloor)
        day.clock.step = day.settings.tick
        page = FloorPage(day.operation, "127.0.0.1", 0)
        opened.extend((page, day.operation))
        url = page.told[0].partition(": ")[2].partition("/?")[0]
        world = day.robots.world
        world.given = {"url": url, "token": page.drive, "work": "topic", **given}
        install(monkeypatch, world)
        for name in [n for n in sys.modules if n.startswith("up_samp_ros.")]:
            monkeypatch.delitem(sys.modules, name)
        day.robots.begin(importlib.import_module("up_samp_ros.node").BridgeNode())
        return day, page

    yield begin
    for one in opened:
        one.close()


@pytest.mark.long
def test_two_robots_do_their_orders_by_nav2(bridged, tmp_path):
    day, _ = bridged(hall(tmp_path, 2))
    world = day.robots.world
    world.fails = 1
    day.order("o0", "rack0", "dock1")
    day.order("o1", "shelf1", "dock0")
    day.run()
    verdict = day.verdict()
    assert verdict.good, (verdict, day.story())
    assert {day.state("o0"), day.state("o1")} == {"done"}
    assert {(name, kind) for name, kind, _ in world.sent} == {
        ("r0", "follow_path"), ("r1", "follow_path"),
    }  # fmt: skip
    shown = world.published["r0/plan"][0]
    assert shown.header.frame_id == "map"
    assert xyt(shown.poses[0].pose)[:2] == pytest.approx((1.5, 1.5), abs=0.01)
    assert day.robots.node.logged == []


@pytest.mark.long
def test_a_robot_opens_a_door_and_drives_through(bridged, tmp_path):
    day, _ = bridged(two_rooms(tmp_path))
    day.order("o0", "rack0", "dock0")
    day.run()
    assert day.verdict().good, day.story()
    assert [h.kind for h in day.robots.handled] == ["open", "pick", "deliver"]


def begun(bridged, tmp_path, **given):
    """A robot that drives."""
    day, page = bridged(hall(tmp_path, 1), **given)
    day.order("o0", "rack0", "dock1")
    pose = day.robots.world.poses["r0"]
    day.until(lambda: pose[0] > 4.0)
    return day, page, pose


def stands(day, pose, seconds=3.0):
    stop, before = day.clock.now() + seconds, list(pose)
    day.until(lambda: day.clock.now() >= stop)
    return before == pose


def test_who_is_held_stops_and_goes_on(bridged, tmp_path):
    day, _, pose = begun(bridged, tmp_path)
    day.operation.hold("r0")
    day.operation.step()
    assert stands(day, pose)
    day.operation.release("r0")
    day.run()
    assert day.verdict().good, day.story()


@pytest.mark.long
def test_who_hears_nothing_stops(bridged, tmp_path):
    day, _, pose = begun(bridged, tmp_path)
    (driver,) = day.robots.node.drivers
    url, driver.link.url = driver.link.url, "http://127.0.0.1:1"
    stop = day.clock.now() + 3.0
    day.until(lambda: day.clock.now() >= stop)
    assert "does not answer" in driver.problem
    assert not driver.moving
    assert stands(day, pose)
    driver.link.url = url
    day.run()
    assert day.verdict().good, day.story()


@pytest.mark.long
def test_a_bridge_that_begins_anew_goes_on(bridged, tmp_path):
    day, _, _ = begun(bridged, tmp_path)
    node = day.robots.node
    node.close()
    day.robots.begin(type(node)())
    day.run()
    assert day.verdict().good, day.story()
    assert [h.kind for h in day.robots.handled] == ["pick", "deliver"]


def test_a_level_is_told_and_all_are_held_by_a_service(bridged, tmp_path):
    day, page, _ = begun(bridged, tmp_path)
    world, node = day.robots.world, day.robots.node
    world.tell("r0/battery_state", sys.modules["sensor_msgs.msg"].BatteryState(percentage=0.5))
    day.operation.step()
    day.operation.step()
    assert day.robots.levels == {"r0": 0.5}
    assert world.services == {}
    world.given["operator_token"] = page.write
    again = type(node)()
    trigger = sys.modules["std_srvs.srv"].Trigger
    asked = served(page, lambda: world.services["up_samp/hold"](trigger(), trigger()))
    assert asked.success
    assert set(day.operation.held) == {"r0"}
    assert served(page, lambda: world.services["up_samp/release"](trigger(), trigger())).success
    assert not day.operation.held
    page._at = 0.0
    page.serve()
    again.show()
    names = [m.ns for m in world.published["up_samp/footprints"][-1].markers]
    assert names == ["", "r0"]


def served(page, do):
    """Return what a call returns that waits for the loop."""
    import threading

    found = []
    thread = threading.Thread(target=lambda: found.append(do()))
    thread.start()
    while thread.is_alive():
        page.serve()
        thread.join(0.01)
    return found[0]
