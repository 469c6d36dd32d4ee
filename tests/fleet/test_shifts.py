"""Shifts, breaks, release times, jobs that recur, and what is unloaded first."""

import itertools

import pytest

from tests.fleet.test_rules import one_room, solved
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.spelled_out import in_numbers, spelled_out


def test_a_robot_starts_at_a_pose_of_its_own(tmp_path):
    fleet = one_room()
    fleet.add_robot("extra", "agv", [12, 3, 0.5])
    fleet.add_order("o1", "a", "b", robots="extra")
    result, times = solved(fleet)
    assert "deliver_o1_extra" in times
    first = min((m for m in result.data["motions"]), key=lambda m: m["samples"][0][0])
    assert first["object"] == "extra"
    assert first["samples"][0][1:4] == pytest.approx([12, 3, 0.5])
    again = Fleet.from_file(fleet.save(tmp_path / "problem.yaml"))
    assert again.records == fleet.records
    with pytest.raises(FleetError, match=r"robots\.odd\.start: name a place, or give a pose"):
        fleet.add_robot("odd", "agv", [1, 2])


def test_nothing_happens_outside_a_shift():
    fleet = one_room()
    fleet.add_robot("late", "agv", [12, 3, 0], end="c", shift=[50, 200])
    fleet.add_order("o1", "a", "b", robots="late")
    _, times = solved(fleet)
    mine = {name: span for name, span in times.items() if "late" in name}
    assert min(start for start, _ in mine.values()) >= 50
    assert max(end for _, end in mine.values()) <= 200


def test_a_shift_that_is_too_short_is_told():
    fleet = one_room()
    fleet.add_robot("short", "agv", [12, 3, 0], shift=[10, 14])
    fleet.add_order("o1", "a", "b", robots="short")
    (finding,) = [f for f in fleet.check() if f.subject == "o1"]
    assert finding.level.value == "error"
    assert "the shifts of short end before they could" in finding.what
    with pytest.raises(FleetError, match=r"robots\.back\.shift: ends at 10 s, before it beg"):
        fleet.add_robot("back", "agv", [12, 7, 0], shift=[20, 10])


def test_a_robot_rests_in_its_break():
    fleet = one_room()
    fleet.add_robot("one", "agv", [12, 3, 0], breaks=[{"duration": 30, "window": [5, 45]}])
    fleet.add_order("o1", "a", "b", robots="one")
    _, times = solved(fleet)
    start, end = times["break_one_1"]
    assert (start >= 5, end <= 45, end - start) == (True, True, 30)
    others = [span for name, span in times.items() if "one" in name and "break" not in name]
    assert all(b <= start or a >= end for a, b in others)
    with pytest.raises(FleetError, match=r"window: ends at 0 s, before it begins at 20 s"):
        fleet.add_task("look", "a", duration=1, window=[20, 0])
    with pytest.raises(FleetError, match=r"breaks\[0\]\.window: 0 s to 5 s is too short for 9 s"):
        fleet.add_robot("two", "agv", [12, 7, 0], breaks=[{"duration": 9, "window": [0, 5]}])


def test_a_robots_battery_begins_at_its_own_level():
    fleet = one_room()
    fleet.add_robot_type(
        "small", (1.2, 0.8), model="omni", battery={"capacity": 100, "per_metre": 1}
    )
    fleet.add_robot("low", "small", [12, 3, 0], level=3)
    fleet.add_order("o1", "a", "b", robots="low")
    assert fleet.solve(timeout=20).status == "UNSOLVABLE_PROVEN"
    with pytest.raises(FleetError, match=r"robots\.over\.level: is more than the capacity 100"):
        fleet.add_robot("over", "small", [12, 7, 0], level=101)
    with pytest.raises(FleetError, match=r"robots\.r9\.level: robots of its type have no battery"):
        fleet.add_robot("r9", "agv", [12, 7, 0], level=1)


def test_what_recurs_is_as_many_jobs(tmp_path):
    fleet = one_room(objective={"tardiness": 1})
    fleet.add_task("tick", "b", duration=2, repeat={"every": 30, "times": 2}, due=20, release=5)
    fleet.add_task("tock", "c", duration=2, repeat={"every": 30, "times": 2}, after="tick")
    assert in_numbers(fleet.records).endswith(" robot, 0 orders, 4 tasks")
    again = Fleet.from_file(fleet.save(tmp_path / "problem.json"))
    assert again.records == fleet.records
    result, times = solved(again)
    begins = [times[f"{name}_r0"][0] for name in ("tick", "tick_2")]
    assert all(begin >= 5 + 30 * i for i, begin in enumerate(begins))
    for i in ("", "_2"):
        assert times[f"tick{i}_r0"][1] <= times[f"tock{i}_r0"][0]
    assert result.costs == {"tardiness": 0}
    with pytest.raises(FleetError, match=r"the id 'tick_2' is taken by tasks\[0\]"):
        fleet.add_task("tick_2", "a", duration=1)


def test_what_recurs_until_some_time_is_released_no_later(tmp_path):
    fleet = one_room()
    fleet.add_task("tick", "b", duration=2, repeat={"every": 0.1, "until": 5.3}, release=5)
    fleet.add_task("tock", "c", duration=2, repeat={"every": 30, "times": 4}, after="tick")
    tasks = spelled_out(Fleet.from_file(fleet.save(tmp_path / "p.json")).records).task_of
    assert [tasks[f"tick{i}"].release for i in ("", "_2", "_3", "_4")] == pytest.approx(
        [5.0, 5.1, 5.2, 5.3]
    )
    assert "tick_5" not in tasks
    assert tasks["tock_3"].after == ("tick_3",)  # they recur as often
    fleet.add_task("once", "b", duration=2, repeat={"every": 30, "until": 29})
    assert "once_2" not in spelled_out(fleet.records).task_of
    (tmp_path / "orders.csv").write_text(
        "id;pickup;delivery;repeat.every;repeat.until\nbin;a;b;20;60\n"
    )
    text = fleet.save(tmp_path / "p.json").read_text()
    (tmp_path / "p.json").write_text(text.replace("{", '{"orders": "orders.csv",', 1))
    assert len(spelled_out(Fleet.from_file(tmp_path / "p.json").records).orders) == 4


@pytest.mark.parametrize(
    ("repeat", "what"),
    [
        ({"every": 9}, r"repeat: say how often .*times.*until.* one of the two"),
        ({"every": 9, "times": 2, "until": 30}, r"repeat: say how often .* one of the two"),
        ({"every": 9, "until": 4}, r"repeat: ends at 4 s, before the first one .* at 5 s"),
        ({"every": 1e-6, "until": 1e9}, r"more than 1000 times .* limit of repeats"),
    ],
)
def test_until_when_something_recurs_is_said_in_one_way_and_bounded(repeat, what):
    with pytest.raises(FleetError, match=what):
        one_room().add_task("tick", "b", duration=2, release=5, repeat=repeat)


def test_what_came_last_goes_first():
    """Along a row of pickups and deliveries, one pass is best where anything may come off first."""
    spans, makespans = {}, {}
    for unloading in ("any", "lifo"):
        fleet = one_room(robots=0)
        fleet.add_robot_type(
            "fork", (1.2, 0.8), model="omni", capacity={"item": 2}, unloading=unloading
        )
        fleet.add_robot("f", "fork", [7, 2, 0])
        for name, y in (("p1", 4), ("p2", 7), ("d1", 10), ("d2", 13)):
            fleet.add_place(name, 9, y)
        fleet.add_order("o1", "p1", "d1")
        fleet.add_order("o2", "p2", "d2")
        result, times = solved(fleet)
        makespans[unloading] = result.makespan
        spans[unloading] = [
            (times[f"pick_{o}_f"][0], times[f"deliver_{o}_f"][0]) for o in ("o1", "o2")
        ]
    (a, b), (c, d) = spans["any"]
    assert a < c < b < d
    for (a, b), (c, d) in itertools.permutations(spans["lifo"], 2):
        assert not a < c < b < d
    assert makespans["any"] < makespans["lifo"]


def test_energy_and_distance_are_terms():
    fleet = one_room(robots=0, objective={"energy": 1, "distance": 0.5})
    fleet.add_robot_type(
        "small", (1.2, 0.8), model="omni", battery={"capacity": 1000, "per_metre": 2}
    )
    fleet.add_robot("near", "small", [7, 5, 0])
    fleet.add_robot("far", "small", [2, 12, 0])
    fleet.add_order("o1", "a", "c")
    result, times = solved(fleet)
    assert "deliver_o1_near" in times
    assert result.costs["energy"] >= 2 * (2 + 9)
    assert 0 <= result.costs["energy"] - 4 * result.costs["distance"] < 5  # counted in grains of 1


TABLE = """id;pickup;pickup.service;delivery;due;load.item;after;optional
o1;a;4;b c;60;1;;no

o2;b;;c;;1;o1;
"""


def test_orders_come_from_a_table(tmp_path):
    fleet = one_room(objective={"tardiness": 1})
    file = fleet.save(tmp_path / "problem.yaml")
    (tmp_path / "orders.csv").write_text(TABLE, encoding="utf-8-sig")
    file.write_text(file.read_text() + "orders: orders.csv\n")
    read = Fleet.from_file(file)
    fleet.add_order("o1", {"at": "a", "service": 4}, ["b", "c"], due=60)
    fleet.add_order("o2", "b", "c", after="o1")
    assert read.records.orders == fleet.records.orders


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("id,pickup\no1,a,b\n", r"orders\.csv:2: 3 cells, for 2 columns"),
        ("pickup\na\n", r"orders\.csv:1: there is no column 'id'"),
        ("id,id\na,b\n", r"orders\.csv:1: the column 'id' is there twice"),
        ("id,pickup,delivery\n\no1,a,nowhere\n", r"orders\.csv:3: delivery: no place 'nowhere'"),
        ("id,pickup,delivery,dew\no1,a,b,7\n", r"orders\.csv:2: dew: there is no such key"),
        ("id,pickup,delivery,due\no1,a,b,soon\n", r"orders\.csv:2: due: should be a number"),
        ('id,pickup\n"o1,a\n', r"orders\.csv:2: not readable as CSV"),
    ],
)
def test_a_bad_table_is_told_by_its_line(tmp_path, text, told):
    file = one_room(objective={"tardiness": 1}).save(tmp_path / "problem.yaml")
    file.write_text(file.read_text() + "orders: orders.csv\n")
    with pytest.raises(FleetError, match="there is no file"):
        Fleet.from_file(file)
    (tmp_path / "orders.csv").write_text(text)
    with pytest.raises(FleetError, match=told):
        Fleet.from_file(file)
