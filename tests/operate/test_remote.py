"""Robots behind HTTP: driven by a plain client through real requests, in simulated time."""

import urllib.error

import pytest

pytest.importorskip("fastapi")

from tests.operate.days import NONE, Day
from tests.operate.http_robot import Client, HttpFloor
from tests.operate.test_doors import two_rooms
from up_samp.execution.floor import Delays
from up_samp.model import ProblemError
from up_samp.operate.remote import RemoteRobots
from up_samp.operate.simulated import Mishaps
from up_samp.server.floor import FloorPage


@pytest.fixture
def served(tmp_path):
    opened = []

    def serve(**options):
        day = Day(tmp_path, floor=HttpFloor, **options)
        day.clock.step = day.settings.tick
        page = FloorPage(day.operation, "127.0.0.1", 0)
        day.robots.client = client(page, page.drive)
        opened.extend((page, day.operation))
        return day, page

    yield serve
    for one in opened:
        one.close()


def client(page, token):
    return Client(page.told[0].partition(": ")[2].partition("/?")[0], token)


NOISY = Mishaps(Delays(noise=0.02))


@pytest.mark.long
def test_an_order_is_driven_over_http(served, tmp_path):
    day, page = served(robots=2, mishaps=NOISY)
    assert page.told[2].startswith("to drive robots: ")
    day.order("o0", "rack0", "dock1")
    day.order("o1", "shelf1", "dock0")
    day.run()
    assert day.verdict().good, day.story()
    assert {day.state("o0"), day.state("o1")} == {"done"}
    assert day.robots.levels == {"r0": 0.8, "r1": 0.8}
    assert day.robots.faults == []


@pytest.mark.long
def test_a_robot_that_opens_a_door_is_told_so(served, tmp_path):
    day, _ = served(fleet=two_rooms(tmp_path))
    day.order("o0", "rack0", "dock0")
    day.run()
    assert day.verdict().good, day.story()
    assert [h.kind for h in day.robots.handled] == ["open", "pick", "deliver"]


def test_a_port_that_another_program_has_is_told(served):
    day, page = served(robots=1)
    port = page._door.getsockname()[1]
    with pytest.raises(ProblemError, match=f"cannot be at 127.0.0.1, port {port}: .*in use"):
        FloorPage(day.operation, "127.0.0.1", port)


def test_who_is_silent_is_noted_and_goes_on(served):
    day, _ = served(robots=1)
    day.order("o0", "rack0", "dock1")
    robot = day.robots.robots["r0"]
    day.until(lambda: robot.s > 2.0)
    robot.broken = True
    stop = day.clock.now() + 12.0
    day.until(lambda: day.clock.now() > stop)
    assert day.robots.faults == [("r0", "nothing was heard of it for 10 s")]
    robot.broken = False
    day.run()
    assert day.verdict().good, day.story()


def test_a_command_is_there_as_soon_as_it_changes(served):
    day, page = served(robots=1)
    ask = client(page, page.drive)
    day.order("o0", "rack0", "dock1")
    day.until(lambda: day.robots.robots["r0"].s > 2.0)
    moving = ask("/v1/robots/r0/command", wait=0)
    assert moving["kind"] == "go"
    assert ask("/v1/robots/r0/command", after=moving["number"], wait=0) == moving
    day.operation.hold("r0", "a test")
    held = ask("/v1/robots/r0/command", after=moving["number"])
    assert (held["kind"], held["why"]) == ("hold", "held a test")
    assert held["number"] > moving["number"]


@pytest.mark.parametrize(
    ("right", "robot", "body", "status"),
    [
        ("read", "r0", {"pose": [1, 1, 0]}, 403),
        ("", "r0", {"pose": [1, 1, 0]}, 401),
        ("drive", "r7", {"pose": [1, 1, 0]}, 404),
        ("drive", "r0", {"pose": [1, 1]}, 422),
        ("drive", "r0", {"progress": 1.0}, 422),
        ("drive", "r0", {"battery": "full"}, 422),
        ("drive", "r0", {"done": 3}, 422),
        ("drive", "r0", {"speed": 3}, 422),
        ("write", "r0", {"pose": [1.5, 1.5, 0]}, 200),
    ],
)
def test_what_cannot_be_told_is_refused(served, right, robot, body, status):
    _, page = served(robots=1)
    ask = client(page, getattr(page, right) if right else "wrong")
    if status == 200:
        assert ask(f"/v1/robots/{robot}/reports", body) == {"taken": True}
        return
    with pytest.raises(urllib.error.HTTPError) as refused:
        ask(f"/v1/robots/{robot}/reports", body)
    with refused.value:
        assert refused.value.code == status


def test_numbers_of_another_process_are_not_met_again(tmp_path):
    site = two_rooms(tmp_path).records
    first = RemoteRobots(site).command("r0")["number"]
    assert RemoteRobots(site).command("r0")["number"] > first
    with pytest.raises(ProblemError, match="no robot 'r9'"):
        RemoteRobots(site).command("r9")


def test_a_day_goes_on_over_http_after_a_restart(served, tmp_path):
    day, page = served(robots=1, mishaps=NONE)
    day.order("o0", "rack0", "dock1")
    day.until(lambda: day.robots.robots["r0"].s > 3.0)
    page.close()
    floor, day.robots = day.robots, HttpFloor(day.fleet.records, NONE, 0)
    day.robots.robots = floor.robots
    day.clock.robots = day.robots
    day.restart()
    again = FloorPage(day.operation, "127.0.0.1", 0)
    try:
        assert again.drive == page.drive
        day.robots.client = client(again, again.drive)
        day.run()
        assert day.state("o0") == "done"
        assert day.verdict().good, day.story()
    finally:
        again.close()
        day.operation.close()
