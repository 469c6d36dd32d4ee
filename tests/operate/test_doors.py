"""A door that has to be opened first: by a robot, once, and everybody drives through afterwards."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from shapely.geometry import box

from tests.operate.days import Day
from up_samp import Fleet
from up_samp.geometry.maps import write_map
from up_samp.model import ProblemError
from up_samp.operate.choice import BACK, body_at
from up_samp.operate.judge import contacts

pytest.importorskip("fastapi")
from up_samp.server.floor import floor_data, site_data


def two_rooms(folder, seconds=2, robots=2):
    cells = np.zeros((100, 200), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    cells[:, 99:102] = True
    cells[30:60, 99:102] = False
    fleet = Fleet(write_map(folder, "rooms", cells, 0.1), name="rooms", margin=0.12)
    fleet.add_robot_type(
        "agv", (0.8, 0.6), model="diff", v_max=1.5, a_max=0.7, omega_max=1.5, reverse_cost=1
    )
    for k in range(robots):
        fleet.add_place(f"home{k}", 1.5, 1.5 + 2.0 * k)
        fleet.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}")
    fleet.add_place("button", 7.5, 7.5)
    fleet.add_place("dock0", 5.0, 8.5)
    fleet.add_place("rack0", 15.0, 3.0)
    fleet.add_place("rack1", 15.0, 7.0)
    fleet.add_door(
        "gate", leaf=(0.3, 2.8), closed=(10.05, 4.5, 0), open=(9.0, 8.2, 0), opened_from="button",
        seconds=seconds,
    )  # fmt: skip
    return fleet


def test_a_door_is_opened_once_and_others_wait_before_it(tmp_path):
    day = Day(tmp_path, fleet=two_rooms(tmp_path, seconds=20))

    def gate():
        return floor_data(day.operation)["doors"]["gate"]

    try:
        assert site_data(day.operation)["doors"]["gate"][2] == [0.15, 1.4]
        assert gate() == {
            "pose": [10.05, 4.5, 0], "open": False, "waiting": [], "shut": False,
        }  # fmt: skip
        day.order("o0", "rack0", "dock0", robots=["r0"])
        day.order("o1", "rack1", "dock0", robots=["r1"])
        seen = []
        day.until(lambda: seen.append(gate()) or seen[-1]["waiting"], 300)
        day.until(lambda: floor_data(day.operation)["robots"]["r0"]["what"].startswith("does"))
        assert np.allclose(day.operation.pose("r0"), (7.5, 7.5, 0.0), atol=0.02)
        day.until(lambda: seen.append(gate()) or seen[-1]["open"], 300)
        assert any(s["waiting"] for s in seen)
        assert all(not s["open"] for s in seen[:-1])
        assert seen[-1]["pose"] == [9.0, 8.2, 0]
        assert seen[-1]["waiting"] == []
        day.order("o2", "rack0", "dock0")
        day.run()
        assert gate() == seen[-1]
        assert len([h for h in day.robots.handled if h.kind == "open"]) == 1
        assert day.verdict().good, day.story()
        early = [
            replace(h, end=h.end + 15.0) if h.kind == "open" else h for h in day.robots.handled
        ]
        drives, initial = day.robots.drives, day.robots.initial
        met = contacts(day.fleet.records, initial, drives, early)
        assert {(c.one, c.other) for c in met} <= {("r0", "gate"), ("r1", "gate")}
        assert met  # who drives through before it is open is seen
    finally:
        day.operation.close()


def beyond(day):
    """Return whether anybody is in the second room, or in the doorway."""
    return any(day.robots.pose(r)[0] > 9.5 for r in day.robots.robots)


def passed(day, seconds):
    stop, found = day.clock.now() + seconds, []
    day.until(lambda: found.append(beyond(day)) or day.clock.now() >= stop)
    return any(found)


@pytest.mark.long
def test_nobody_drives_through_a_door_that_is_out_of_order(tmp_path):
    day = Day(tmp_path, fleet=two_rooms(tmp_path))
    try:
        day.order("o0", "rack0", "dock0", robots=["r0"])
        day.until(lambda: math.dist(day.robots.pose("r0"), (1.5, 1.5, 0)) > 1.0)
        day.operation.close_door("gate")
        day.order("o1", "dock0", "button", robots=["r1"])
        assert not passed(day, 90.0)
        assert floor_data(day.operation)["doors"]["gate"]["shut"]
        assert day.state("o1") == "done"
        assert day.state("o0") != "done"
        day.operation.close_door("gate", BACK)
        day.run(900)
        assert day.state("o0") == "done"
        opens = [h for h in day.robots.handled if h.kind == "open"]
        assert len(opens) == 1
        assert day.verdict().good, day.story()
    finally:
        day.operation.close()


@pytest.mark.parametrize("restarted", [pytest.param(False, marks=pytest.mark.long), True])
def test_who_is_to_drive_through_an_open_door_that_goes_out_of_order_drives_home(
    tmp_path, restarted
):
    """It stands before the door: it neither stays there, nor goes on once the door is closed."""
    day = Day(tmp_path, fleet=two_rooms(tmp_path, robots=1))
    try:
        day.order("o0", "rack0", "dock0")
        day.until(lambda: day.robots.handled and day.robots.pose("r0")[0] > 7.8, 300)
        day.operation.close_door("gate")
        day.until(lambda: day.robots.pose("r0")[0] < 2.0, 60)
        assert day.state("o0") == "waiting"
        if restarted:
            day.restart()
        since = day.clock.now()
        day.operation.close_door("gate", BACK)
        day.run(300)
        opened = [h.end for h in day.robots.handled if h.kind == "open"][1]
        assert opened > since
        assert day.verdict().good, day.story()
        rows = [row for drive in day.robots.drives for row in drive.rows]
        assert all(x < 9.6 for t, x, *_ in rows if t < opened)
    finally:
        day.operation.close()


def test_a_day_may_be_stopped_after_any_step(tmp_path):
    """Time alone lets drives end and begin, too: who goes on knows of it without a report."""
    day = Day(tmp_path, fleet=two_rooms(tmp_path, robots=1))
    try:
        day.order("o0", "rack0", "dock0")
        day.until(lambda: day.robots.handled and day.robots.pose("r0")[0] > 7.8, 300)
        day.operation.close_door("gate")
        for _ in range(60):
            day.step()
            day.restart()
        day.until(lambda: day.robots.pose("r0")[0] < 2.0, 60)
    finally:
        day.operation.close()


@pytest.mark.parametrize("x", [8.2, 9.5])
def test_who_is_before_or_in_a_door_that_is_mended_at_once_keeps_clear_of_its_leaf(tmp_path, x):
    day = Day(tmp_path, fleet=two_rooms(tmp_path, robots=2))
    try:
        day.order("o0", "rack0", "dock0", robots=["r0"])
        day.until(lambda: day.robots.handled and day.robots.pose("r0")[0] > x, 300)
        day.operation.close_door("gate")
        stop = day.clock.now() + 3.0
        day.until(lambda: day.clock.now() >= stop)
        closed = box(9.9, 3.1, 10.2, 5.9)
        assert not body_at(day.fleet.records, "r0", day.robots.pose("r0")).intersects(closed)
        day.operation.close_door("gate", BACK)
        day.order("o1", "rack1", "dock0", robots=["r1"])  # who can open it again, from this side
        day.run(400)
        assert day.verdict().good, day.story()
        opened = [h.end for h in day.robots.handled if h.kind == "open"][1]
        for drive in day.robots.drives:
            rows = [row for row in drive.rows if stop <= row[0] < opened]
            bodies = (body_at(day.fleet.records, drive.robot, row[1:]) for row in rows)
            assert not any(body.intersects(closed) for body in bodies)
    finally:
        day.operation.close()


def test_an_opening_is_not_begun_at_a_door_that_is_out_of_order(tmp_path):
    day = Day(tmp_path, fleet=two_rooms(tmp_path))
    try:
        with pytest.raises(ProblemError, match="no door 'gone'"):
            day.operation.close_door("gone")
        day.order("o0", "rack0", "dock0")
        day.until(lambda: day.operation.meanings)
        day.operation.close_door("gate")
        told = day.operation.executor.withdrawn
        assert list(told.values()) == ["door 'gate' is out of order"]
        assert day.operation.executor.state.limits  # those that lead through it end before
        day.restart()
        assert day.operation.shut == {"gate": "out of order"}
        assert day.operation.executor.withdrawn == told
    finally:
        day.operation.close()


@pytest.mark.parametrize("seed", [0])
def test_who_set_out_while_a_door_was_out_of_order_heeds_its_leaf_once_it_is_mended(tmp_path, seed):
    """It swings to where somebody drives then: nobody was to move it when that was planned."""
    rng = random.Random(f"mended {seed}")
    fleet = two_rooms(tmp_path, seconds=1, robots=0)
    fleet.add_robot_type("slow", (0.8, 0.6), model="diff", v_max=0.2, omega_max=1.5, reverse_cost=1)
    fleet.add_place("far", 5.6, 8.2)
    for name, kind, x, y in rng.sample((("r0", "slow", 1.5, 8.0), ("r1", "agv", 7.5, 4.5)), 2):
        fleet.add_place(f"at_{name}", x, y)
        fleet.add_robot(name, kind, start=f"at_{name}", end=f"at_{name}")
    swung = replace(fleet.records.doors["gate"], open=(rng.uniform(3.5, 3.7), 7.6, 0.0))
    fleet._hold(replace(fleet.records, doors={"gate": swung}))
    day = Day(tmp_path, fleet=fleet, seed=seed)
    try:
        operation = day.operation
        operation.close_door("gate")
        operation.add({"id": "t0", "at": "far", "duration": 2, "robots": ["r0"]})
        day.until(lambda: (w := operation.executor.state.of_object.get("r0")) and w.told > 0.3, 60)
        operation.close_door("gate", BACK)
        operation.add({"id": "t1", "at": "rack1", "duration": 2, "robots": ["r1"]})
        day.run()
        assert any(h.kind == "open" for h in day.robots.handled)
        assert day.verdict().good, (day.verdict(), day.story())
    finally:
        day.operation.close()
