"""Jobs that come before others, and robots that charge in between, in large problems."""

import pytest

from tests.fleet.test_rules import one_room
from up_samp.search.fleet.assignment import Assignment, in_stated_order
from up_samp.validation import validate_plan


@pytest.mark.parametrize(
    ("tours", "earlier", "told"),
    [
        ({"a": [0, 1], "b": [2, 3]}, {}, {"a": [0, 1], "b": [2, 3]}),
        ({"a": [0, 1], "b": [2, 3]}, {0: {1}}, {"a": [1, 0], "b": [2, 3]}),
        # either robot would wait for the other one's last job
        ({"a": [0, 1], "b": [2, 3]}, {0: {3}, 2: {1}}, {"a": [1, 0], "b": [2, 3]}),
        ({"a": [0, 1], "b": [2, 3]}, {0: {1}, 1: {0}}, {"a": [0, 1], "b": [2, 3]}),
        ({"a": [0, 1], "b": [2]}, {0: {9}, 1: {2}}, {"a": [0, 1], "b": [2]}),
    ],
)
def test_tours_follow_one_order_of_all_jobs(tours, earlier, told):
    steps = {robot: [(j, 0) for j in tour] for robot, tour in tours.items()}
    found = in_stated_order(Assignment(None, steps), earlier, {})
    assert {robot: [j for j, _ in tour] for robot, tour in found.tours.items()} == told


def test_dealt_out_jobs_keep_priorities_and_robots_charge_for_them():
    fleet = one_room(robots=0)
    battery = {"capacity": 100, "per_metre": 1.0, "level": 20, "reserve": 5}
    fleet.add_robot_type("small", (1.2, 0.8), model="omni", v_max=2.0, battery=battery)
    fleet.add_place("plug", 7, 13.5, charger={"per_second": 10.0, "step": 5})
    fleet.add_place("d", 12, 3)
    for i, y in enumerate((3, 8)):
        fleet.add_place(f"home{i}", 2, y)
        fleet.add_robot(f"r{i}", "small", f"home{i}", end=f"home{i}")
    for i, (there, back) in enumerate([("a", "d"), ("b", "c"), ("d", "a"), ("c", "b")]):
        fleet.add_order(f"o{i}", there, back, priority=i)
    result = fleet.solve(timeout=60, first_plan=True, tuning={"large": 1})
    assert result.plan is not None, result.explain()
    assert result.outcome.history.rounds == []  # found as it was assigned
    assert validate_plan(fleet.problem, result.plan).valid
    begun = {
        a["name"].split("_")[1]: a["start"]
        for a in result.data["activities"]
        if a["name"].startswith("pick")
    }
    assert sorted(begun, key=lambda o: begun[o]) == ["o3", "o2", "o1", "o0"]
    assert any(a["name"].startswith("charge") for a in result.data["activities"])
