"""Batteries: drives take from them, chargers give, and nobody runs out."""

import dataclasses
import itertools
from pathlib import Path

import pytest

from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.batteries import Meter, levels, pieces_of
from up_samp.fleet.build import write_problem
from up_samp.fleet.meanings import Kind, Meaning
from up_samp.validation import validate_plan

MAPS = Path(__file__).parents[2] / "examples" / "maps"


def floor(capacity, *, charger=True, **battery):
    """Two orders, which take 30 m and 45 m with the ways to them and home."""
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type(
        "agv", (1.2, 0.8), model="diff", v_max=2.0, a_max=1.0, omega_max=2.0,
        battery={"capacity": capacity, "per_metre": 1.0, "reserve": 2, **battery},
    )  # fmt: skip
    fleet.add_place("home", 2, 3)
    fleet.add_place("plug", 2, 12.5, charger={"per_second": 2.0, "step": 10} if charger else None)
    for name, x, y in (("a", 7, 3), ("b", 12, 12), ("c", 25, 4)):
        fleet.add_place(name, x, y)
    fleet.add_robot("r", "agv", "home", end="home")
    fleet.add_order("o1", "a", "b")
    fleet.add_order("o2", "c", "b")
    return fleet


def test_a_robot_charges_where_it_has_to():
    fleet = floor(60)
    result = fleet.solve(timeout=300, first_plan=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    charges = [a["name"] for a in result.data["activities"] if a["name"].startswith("charge_r")]
    assert charges
    course = levels(fleet.records, result.written, result.data)["r"]
    assert all(2 - 1e-6 <= level <= 60 + 1e-6 for _, level in course)
    assert "the battery of r falls to" in result.explain()
    driven = sum(
        ((q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2) ** 0.5
        for m in result.data["motions"]
        for p, q in zip(m["samples"], m["samples"][1:], strict=False)
    )
    assert course[-1][1] == pytest.approx(60 - driven + 20 * len(charges), abs=0.5)


@pytest.mark.usefixtures("unexplained")
def test_a_full_battery_is_not_charged_as_one_drives_off():
    """Both drives together take more than a battery holds, and there is no way back between."""
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type(
        "agv", (1.2, 0.8), model="diff", v_max=2.0, a_max=1.0, omega_max=2.0,
        battery={"capacity": 40, "per_metre": 1.0},
    )  # fmt: skip
    fleet.add_place("plug", 2, 12.5, charger={"per_second": 2.0, "step": 10})
    fleet.add_place("b", 12, 12)
    fleet.add_place("c", 25, 4)
    fleet.add_robot("r", "agv", "plug")
    fleet.add_order("o", "c", "b")
    assert fleet.solve().status == "UNSOLVABLE_PROVEN"


@pytest.mark.long
def test_with_a_large_battery_nobody_charges():
    fleet = floor(100)
    result = fleet.solve(optimal=True)
    assert not any(a["name"].startswith("charge_") for a in result.data["activities"])
    assert result.makespan <= 70


@pytest.mark.usefixtures("unexplained")
def test_without_a_charger_there_is_no_plan():
    assert floor(60, charger=False).solve().status == "UNSOLVABLE_PROVEN"


@pytest.mark.long
@pytest.mark.usefixtures("unexplained")
def test_seconds_count_as_well_as_metres():
    assert floor(100, charger=False, per_second=2.0).solve().status == "UNSOLVABLE_PROVEN"


def test_levels_that_make_no_sense_are_refused():
    with pytest.raises(FleetError, match=r"battery.level: is more than the capacity 60"):
        floor(60, level=80)
    with pytest.raises(FleetError, match=r"battery.reserve: the reserve is 61, and 60 are there"):
        floor(60, reserve=61)
    with pytest.raises(FleetError, match=r"battery.volts: there is no such key"):
        floor(60, volts=48)


def test_large_reserves_and_small_steps_are_taken():
    """Drives that take less than the reserve are stated; what takes too much is left out."""
    fleet = floor(60, reserve=40, level=60)
    names = {a.name for a in fleet.problem.activities}
    assert "move_r_home_to_a" in names
    assert "move_r_home_to_c" not in names  # 23 m: more than the 20 that may be taken
    with pytest.raises(FleetError, match=r"places.plug.charger: a step gives 20; .* takes 10 from"):
        floor(60, reserve=50)


def test_steps_too_small_to_be_counted_are_refused():
    """They were counted as a thousandth of the battery, more than they give."""
    with pytest.raises(FleetError, match=r"gives 20, less than 1/1000 .* \(30000\)"):
        floor(30000)


@pytest.mark.long
@pytest.mark.parametrize(("robots", "orders"), [(2, 3), (3, 3)])
def test_several_robots_that_have_to_charge(robots, orders):
    fleet = Fleet(MAPS / "two_rooms.yaml")
    battery = {"capacity": 100, "level": 40, "per_metre": 1.0, "reserve": 5}
    fleet.add_robot_type(
        "agv", (1.2, 0.8), model="diff", v_max=2.0, a_max=1.0, omega_max=2.0, battery=battery
    )
    fleet.add_place("plug", 5, 14, charger={"per_second": 2.0, "step": 10})
    for name, x, y in (("dock", 12, 12), ("shelf", 7, 3), ("store", 25, 4), ("rack", 25, 12)):
        fleet.add_place(name, x, y)
    for i in range(robots):
        fleet.add_place(f"home{i}", 2, 3 + 2.5 * i)
        fleet.add_robot(f"r{i}", "agv", f"home{i}", end=f"home{i}")
    ways = [("shelf", "dock"), ("store", "dock"), ("rack", "shelf")]
    for i, (pickup, delivery) in enumerate(ways[:orders]):
        fleet.add_order(f"o{i}", pickup, delivery)
    result = fleet.solve(timeout=240, first_plan=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    charged = {a["name"].split("_")[1] for a in result.data["activities"] if "charge" in a["name"]}
    assert len(charged) >= 2


def test_a_way_that_was_not_found_in_time_takes_what_no_way_takes_less_of(monkeypatch):
    monkeypatch.setattr(Meter, "_way", lambda *_: None)
    fleet = floor(100, per_second=2.0)
    meter = Meter(fleet.records, fleet.folder)
    assert meter.drive("r", "home", "a") == 100  # 5 m, 2.5 s: 10 of 100


def test_charges_count_for_who_charged_whatever_things_are_called():
    """Activities of "r" at "x_at_y" and of "r_at_x" at "y" would be called the same."""
    fleet = Fleet(MAPS / "two_rooms.yaml")
    battery = {"capacity": 100, "level": 20, "per_metre": 1.0}
    fleet.add_robot_type("agv", (1.2, 0.8), model="omni", v_max=2.0, a_max=1.0, battery=battery)
    for i, (robot, place) in enumerate((("r", "x_at_y"), ("r_at_x", "y"))):
        fleet.add_place(place, 3, 3 + 8 * i, charger={"per_second": 1.0, "step": 10})
        fleet.add_robot(robot, "agv", place)
    written = write_problem(fleet.records, fleet.folder)
    for robot, place in itertools.product(("r", "r_at_x"), ("x_at_y", "y")):
        steps = [
            name
            for name, meaning in written.meanings.items()
            if meaning == Meaning(Kind.CHARGE, place, robot)
        ]
        done = [{"name": name, "end": 10 * k} for k, name in enumerate(steps[:3], start=1)]
        plan = {"seconds_per_unit": 1.0, "activities": done, "motions": []}
        course = levels(fleet.records, written, plan)
        assert course.pop(robot) == [(0.0, 20), (10.0, 30), (20.0, 40), (30.0, 50)]
        assert [*course.values()] == [[(0.0, 20)]]


def charges_of(result):
    """(length, what the level becomes) of each charge in a plan, in their order."""
    done = sorted(
        (a["start"], a["end"]) for a in result.data["activities"] if a["name"].startswith("charge_")
    )
    return [end - start for start, end in done]


def refill(level, need, per_metre=1.0, **charger):
    """A robot at its plug with so much in its battery, which has to drive so far (m)."""
    fleet = Fleet(MAPS / "two_rooms.yaml")
    battery = {"capacity": 100, "per_metre": per_metre, "level": level}
    battery["curve"] = [[50, 0.5], [80, 0.1]]
    fleet.add_robot_type("agv", (1.2, 0.8), model="omni", v_max=2.0, battery=battery)
    fleet.add_place("plug", 2, 3, charger=charger)
    fleet.add_place("there", 2 + need, 3)
    fleet.add_robot("r", "agv", "plug")
    fleet.add_task("look", "there", duration=1)
    return fleet


def test_a_battery_is_swapped_for_a_full_one():
    fleet = refill(3, 10, swap=25)
    result = fleet.solve(optimal=True, timeout=120)
    assert result.status == "SOLVED_OPTIMALLY", result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    assert charges_of(result) == [25]
    course = [level for _, level in levels(fleet.records, result.written, result.data)["r"]]
    assert max(course) == 100
    assert course[-1] == pytest.approx(90, abs=0.5)


def test_a_fuller_battery_charges_slower():
    """A step of 5 s gives 10 below half, and half of that from there on."""
    for level, need, steps in ((2, 11.8, 1), (2, 12.1, 2)):
        fleet = refill(level, need, per_second=2.0, step=5)
        result = fleet.solve(optimal=True, timeout=120)
        assert result.status == "SOLVED_OPTIMALLY", result.explain()
        assert validate_plan(fleet.problem, result.plan).valid
        assert charges_of(result) == [5] * steps
    kind, place = fleet.records.robot_types["agv"], fleet.records.places["plug"]
    told = [(p.gives, p.top, p.times) for p in pieces_of(kind.battery, place.charger)]
    assert told == [(100, 500, 5), (50, 800, 6), (10, 1000, 20)]


def test_a_battery_that_is_half_full_begins_slower():
    """48 are there and 50 needed: a quick step, which gives 10 up to 50, is not to be had."""
    fleet = refill(48, 12.5, per_metre=4.0, per_second=2.0, step=5)
    result = fleet.solve(optimal=True, timeout=120)
    assert result.status == "SOLVED_OPTIMALLY", result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    charges = [a for a in result.data["activities"] if a["name"].startswith("charge_")]
    assert [a["name"] for a in charges] == ["charge_r_at_plug_1_6"]  # after five quick ones
    course = [level for _, level in levels(fleet.records, result.written, result.data)["r"]]
    assert course == pytest.approx([48, 53, 3], abs=0.5)


def test_what_is_wrong_with_chargers_and_curves_is_told():
    for charger in ({}, {"per_second": 2.0, "swap": 25}):
        with pytest.raises(FleetError, match=r"places\.plug\.charger: say what it gives"):
            refill(3, 10, **charger)
    with pytest.raises(FleetError, match=r"a step gives 0.05, less than 1/1000 .* longer step"):
        refill(3, 10, per_second=0.1, step=5)
    with pytest.raises(FleetError, match=r"battery\.curve: has levels that rise"):
        floor(60, curve=[[50, 0.5], [40, 0.1]])
    with pytest.raises(FleetError, match=r"curve"):
        floor(60, curve=[[50, 1.5]])


@pytest.mark.parametrize("model", ["diff", "car"])
def test_who_would_rather_not_back_up_is_metered_by_a_quick_search(monkeypatch, model):
    """A way that is found with little work is about as long as the one that is driven; where it
    would lead backwards, one ahead is looked for as well.
    """
    fleet = floor(100)
    records = fleet.records
    kind = dataclasses.replace(records.robot_types["agv"], model=model, reverse_cost=None)
    records = dataclasses.replace(records, robot_types={"agv": kind})
    places = list(records.places)
    quick = Meter(records, fleet.folder)
    found = {p: quick.length("r", *p) for p in itertools.permutations(places, 2)}
    monkeypatch.setattr("up_samp.fleet.batteries.quick_way", lambda *_: None)
    whole = Meter(records, fleet.folder)
    for pair, (metres, seconds) in found.items():
        expected = whole.length("r", *pair)
        assert metres == pytest.approx(expected[0], rel=0.05), pair
        assert seconds == pytest.approx(expected[1], rel=0.05), pair
