"""What AGVs of VDA 5050 are told arrives, whatever is lost, and nothing that they were told before
is driven that is not to be driven any more. Simulated AGVs, in simulated time.
"""

import itertools
import math
from contextlib import closing
from functools import partial

import numpy as np
import pytest

from tests.operate.days import NONE, Day
from tests.operate.sites import hall
from tests.operate.wire import AgvFloor
from up_samp import Fleet
from up_samp.geometry.maps import write_map
from up_samp.operate.store import Store


def quiet(site, mishaps, seed, **spoken):
    return AgvFloor(site, mishaps, seed, lost=0.0, twice=0.0, late=0.0, **spoken)


@pytest.fixture
def day(tmp_path):
    made = Day(tmp_path, robots=1, mishaps=NONE, floor=quiet)
    yield made
    made.operation.close()


def kinds(message):
    return [a["actionType"] for a in message.get("actions", ())]


def losing_once(day, chosen):
    """Lose the first message of each sort; ``chosen(kind, message)`` tells which ("": of none)."""
    lost = []

    def lose(_name, kind, message):
        sort = chosen(kind, message)
        if not sort or sort in lost:
            return False
        lost.append(sort)
        return True

    day.robots.wire.lose = lose
    return lost


def drives(day, metres=2.0):
    agv = day.robots.agvs["r0"]
    start = day.robots.initial["r0"]
    day.until(lambda: math.dist(agv.pose[:2], start[:2]) > metres and agv.ahead, 60)
    return agv


def stands(day, seconds=3.0):
    """Let some time pass; return whether the robot stood in its last second."""
    agv, end = day.robots.agvs["r0"], day.clock.now() + seconds
    day.until(lambda: day.clock.now() >= end)
    return {tuple(p) for t, *p in agv.trace if t >= end - 1.0} == {tuple(agv.pose)}


def good(day, refused=0):
    verdict = day.verdict()
    assert verdict.good, (verdict, day.story())
    assert len(day.robots.agvs["r0"].refused) <= refused


def test_orders_and_updates_that_are_lost_are_sent_again(day):
    lost = losing_once(day, lambda kind, m: kind == "order" and f"{m['orderUpdateId']}")
    day.order("o0", "rack0", "dock2")
    day.run()
    assert day.state("o0") == "done"
    assert {"0", "1"} <= {*lost}
    good(day, refused=100)  # updates that follow one that was lost


@pytest.mark.parametrize("lost", ["", "startPause", "stopPause"])
def test_a_pause_and_its_end_arrive(day, lost):
    day.order("o0", "rack0", "dock2")
    drives(day)
    seen = losing_once(day, lambda _kind, m: lost if lost in kinds(m) else "")
    day.operation.hold("r0")
    assert stands(day)
    day.operation.release("r0")
    day.run()
    assert seen == [lost] * bool(lost)
    good(day)


@pytest.mark.parametrize("again", [False, True])
def test_who_was_paused_by_somebody_there_stays_paused(day, again):
    """By a button on it, say, before this process began: nobody here knows why."""
    agv = day.robots.agvs["r0"]
    agv.paused = True
    day.order("o0", "rack0", "dock2")
    day.until(lambda: agv.orders, 60)
    if again:
        day.restart()
    assert stands(day, 5.0)
    assert "stopPause" not in agv.told
    assert ("r0", "somebody else has paused it: it goes on once they let it") in day.robots.faults
    agv.paused = False
    day.run()
    good(day)


def test_who_is_paused_goes_on_after_a_restart(day):
    day.order("o0", "rack0", "dock2")
    agv = drives(day)
    day.operation.hold("r0")
    assert stands(day)
    day.restart()
    assert stands(day)  # it is still held
    assert agv.paused
    day.operation.release("r0")
    day.run()
    good(day)


def test_an_order_that_was_never_acknowledged_is_cancelled_before_another(day):
    """It may be on its way: the robot would drive it, and refuse the next one."""
    day.order("o0", "rack0", "dock2")
    day.robots.wire.lose = lambda _name, kind, _message: kind == "order"
    day.until(lambda: day.operation.meanings)
    for _ in range(20):
        day.operation.step()
    agv = day.robots.agvs["r0"]
    assert not agv.orders
    day.operation.leave("r0", "by hand", tuple(agv.pose))
    day.operation.join("r0", tuple(agv.pose))
    day.robots.wire.lose = lambda *_: False
    day.run()
    assert agv.told.count("cancelOrder") == 1
    assert agv.orders[0]["orderId"].endswith("#2")
    good(day)


def test_what_was_released_is_taken_back_where_people_are(day):
    day.order("o0", "rack0", "dock2")
    agv = drives(day)
    released = agv.ahead[-1][1]["nodePosition"]
    there = released["x"], released["y"]
    assert math.dist(there, agv.pose[:2]) > 2.0
    corners = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    day.operation.block("people", [(x + there[0], y + there[1]) for x, y in corners])
    day.run()
    assert min(math.dist(there, p[:2]) for _, *p in agv.trace) > 0.5 + 0.3
    assert "cancelOrder" in agv.told
    assert day.state("o0") == "done"
    good(day)


def test_who_has_given_up_its_order_goes_on_once_it_is_held_and_released(day):
    day.order("o0", "rack0", "dock2")
    agv = drives(day)
    agv.reboot()
    assert stands(day)
    (fault,) = day.robots.faults
    assert fault[0] == "r0"
    assert "it has given up 'move" in fault[1]
    assert fault[1] in day.story()
    day.operation.hold("r0")
    assert stands(day)
    day.operation.release("r0")
    day.run()
    assert any(o["orderId"].endswith("~1") for o in agv.orders)
    good(day, refused=1)  # an update on its way when it gave up


def test_who_stands_elsewhere_than_its_plan_has_it_is_planned_from_there(day):
    day.order("o0", "rack0", "dock2")
    agv = drives(day)
    day.robots.put("r0", (5.0, 7.0, 0.5))
    day.run()
    assert day.state("o0") == "done"
    assert f"{agv.name} stands elsewhere" in day.story(500)
    good(day, refused=1)


def test_robots_that_drive_sideways_are_told_how_they_turn(tmp_path):
    free = np.zeros((80, 120), dtype=bool)
    fleet = Fleet(write_map(tmp_path, "free", free, 0.1), name="free", margin=0.12)
    fleet.add_robot_type("agv", (0.9, 0.5), model="omni", v_max=1.2, a_max=0.8, omega_max=1.0)
    fleet.add_place("home0", 2.0, 2.0)
    fleet.add_place("rack0", 9.0, 5.0, 1.5)
    fleet.add_place("dock0", 4.0, 6.0, -1.0)
    fleet.add_robot("r0", "agv", start="home0")
    day = Day(tmp_path, fleet=fleet, floor=quiet)
    try:
        day.order("o0", "rack0", "dock0")
        day.run()
        (first, *_), agv = day.robots.agvs["r0"].orders, day.robots.agvs["r0"]
        nodes = [n["nodePosition"] for n in first["nodes"]]
        gaps = [math.dist((a["x"], a["y"]), (b["x"], b["y"])) for a, b in itertools.pairwise(nodes)]
        assert max(gaps) <= 0.25 + 0.01
        assert agv.refused == []
        assert day.verdict().good
    finally:
        day.operation.close()


def test_robots_that_drive_from_node_to_node_are_told_when_they_drive_backwards(tmp_path):
    """They drive head first otherwise, and stand half a turn off their path."""
    straight = partial(quiet, version="2.0.0", spacing=0.25)
    day = Day(tmp_path, fleet=hall(tmp_path, 1), mishaps=NONE, floor=straight)
    try:
        day.order("o0", "rack0", "dock2")
        day.run()
        agv = day.robots.agvs["r0"]
        (drive,) = day.robots.drives
        _, x, y, theta = np.array(drive.rows).T
        ahead = np.diff(x) * np.cos(theta[1:]) + np.diff(y) * np.sin(theta[1:])
        assert -ahead[ahead < 0].sum() > 0.5  # m
        assert "held" not in day.story(500)
        assert (day.robots.faults, agv.refused) == ([], [])
        good(day)
    finally:
        day.operation.close()


@pytest.mark.parametrize("over", [True, False])
def test_what_an_agv_did_yesterday_is_not_what_it_is_to_do_today(tmp_path, over):
    """It was taken for done, or its old way for the new one: what it knows of was called alike."""
    folders = [tmp_path / "one", tmp_path / "two"]
    for folder in folders:
        folder.mkdir()
        with closing(Store(folder / "day.db")) as store, store:
            store.keep("mark", f".{folder.name}")  # as days by real clocks have one
    day = Day(folders[0], robots=1, mishaps=NONE, floor=quiet)
    work = {"id": "o0", "at": "home0" if over else "rack0", "duration": 4}
    day.operation.add(work)
    agv = day.robots.agvs["r0"]
    day.until(lambda: day.operation.idle if over else agv.pose[0] > 3.0)
    day.operation.close()
    floor, before = day.robots, len(agv.handled)
    if not over:
        floor.put("r0", floor.initial["r0"])
        agv.order = agv.orders[0]  # it has stopped, and still knows of it
    floor.restart()
    floor._told_at, floor.wire.last, floor.wire.there = 0.0, {}, []  # its clock begins anew
    again = Day(folders[1], robots=1, mishaps=NONE, floor=lambda *_: floor)
    try:
        told = len(agv.orders)
        again.operation.add(work)
        again.run()
        assert len(agv.handled) == before + 1
        assert agv.orders[told]["orderId"].endswith("#1.two")
        assert agv.refused == []
        assert again.verdict().lost == ()
    finally:
        again.operation.close()
