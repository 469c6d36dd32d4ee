"""What plans of a fleet cost by term: told, judged, and no worse than what brute force finds."""

import itertools
import math
import re
from collections import Counter

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.fleet.test_fleet import two_rooms
from up_samp.cli import main
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.build import TERMS
from up_samp.fleet.files import PROBLEM, write_starter
from up_samp.fleet.records import Weights
from up_samp.io import plan_from_dict, read_plan
from up_samp.model import SampError
from up_samp.validation import terms_of, validate_plan, value_of


@pytest.fixture(autouse=True)
def _silent(monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)


def hall(objective, **options):
    """A robot, a dock and two shelves on one side of the gate."""
    fleet = two_rooms(objective=objective, **options)
    fleet.add_place("shelfC", 3, 11)
    return fleet


def test_every_term_has_a_weight_and_what_is_left_out_its_penalty():
    assert set(TERMS) == {*vars(Weights()), "left_out"}


def test_costs_are_told_by_term_and_proven():
    fleet = hall({"tardiness": 10, "driving": 0.5, "makespan": 0.1})
    fleet.add_task("soon", at="shelfC", duration=5, due=10, weight=2)
    fleet.add_task("late", at="dock", duration=4, due=500)
    result = fleet.solve(optimal=True, timeout=120)
    assert result.status == "SOLVED_OPTIMALLY", result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    ends = {a["name"]: a["end"] for a in result.data["activities"]}
    (soon,) = (end for name, end in ends.items() if "soon" in name)
    drives = [a for a in result.data["activities"] if a["name"].startswith("move")]
    driven = sum(a["end"] - a["start"] for a in drives)
    told = {
        "makespan": 0.1 * result.makespan,
        "tardiness": 10 * 2 * max(0, soon - 10),
        "driving": 0.5 * driven,
        "left_out": 0,
    }
    assert result.costs == pytest.approx({k: v for k, v in told.items() if k in result.costs})
    assert sum(result.costs.values()) == pytest.approx(float(value_of(fleet.problem, result.plan)))
    # what is due first is done first, though the dock is on the way
    assert soon < min(end for name, end in ends.items() if "late" in name)
    assert f"it costs {sum(told.values()):g}: " in result.explain()


def test_seconds_count_whatever_the_unit():
    costs = []
    for unit in (1.0, 0.5):
        fleet = hall({"completion": 1}, seconds_per_unit=unit)
        fleet.add_task("one", at="shelfC", duration=6)
        result = fleet.solve(optimal=True, timeout=120)
        assert result.status == "SOLVED_OPTIMALLY", result.explain()
        costs.append(sum(result.costs.values()))
    assert costs[1] <= costs[0] <= costs[1] + 4  # each of a few activities is rounded up


@pytest.mark.parametrize(("penalty", "left"), [(1, ["o1"]), (1000, [])])
def test_work_is_left_out_where_that_costs_less(penalty, left):
    fleet = hall({"driving": 1})
    fleet.add_order("o1", "shelfC", "dock", optional=True, penalty=penalty)
    result = fleet.solve(patience=math.inf, timeout=60)
    assert result.left_out == left, result.explain()
    assert result.costs["left_out"] == (penalty if left else 0)


def test_a_robot_that_costs_stays_where_it_is():
    fleet = hall({"robots": 1000, "completion": 1})
    fleet.add_place("home2", 3, 6)
    fleet.add_robot("r2", "agv", "home2", end="home2")
    fleet.add_task("one", at="shelfC", duration=6)
    fleet.add_task("two", at="dock", duration=6)
    result = fleet.solve(patience=math.inf, timeout=60)
    assert result.costs["robots"] == 1000, result.explain()
    assert len({m["object"] for m in result.data["motions"]}) == 1


@pytest.mark.parametrize(
    ("objective", "said"),
    [
        ({}, "give a weight above 0 to one of makespan, tardiness"),
        ({"speed": 1}, r"^objective\.speed: give v_max, in m/s$"),
        ({"tardiness": -1}, "should be 0 or more"),
        ("fast", "give makespan, none, or weights"),
    ],
)
def test_wrong_objectives_are_named(objective, said):
    with pytest.raises(FleetError, match=said):
        two_rooms(objective=objective).solve(timeout=60)


def test_a_due_time_that_does_not_count_is_told():
    fleet = two_rooms()
    fleet.add_order("o1", "shelfA", "dock", due=20)
    fleet.add_task("look", at="dock", duration=5, due=900)
    result = fleet.solve(timeout=60)
    late = next(a["end"] for a in result.data["activities"] if a["name"].startswith("deliver")) - 20
    assert f"o1 ends {late} s after it is due" in result.explain().splitlines()
    assert "look ends" not in result.explain()


def test_only_costs_are_told_by_term():
    fleet = two_rooms()
    fleet.add_task("one", at="dock", duration=2)
    with pytest.raises(SampError, match="objective of several terms"):
        _ = fleet.solve(timeout=60).costs


def test_another_engine_says_that_it_does_not_know_them():
    fleet = hall({"tardiness": 1})
    fleet.add_task("one", at="shelfC", duration=6, due=3)
    with OneshotPlanner(name="aries") as planner:
        assert not planner.supports(fleet.problem.kind)


def test_a_file_weighs_terms(tmp_path, capsys):
    write_starter(tmp_path)
    text = PROBLEM.replace("objective: makespan ", "objective: {tardiness: 10, driving: 0.1} ")
    text = text.replace("delivery: dockA}", "delivery: dockA, due: 5, weight: 3}")
    text = re.sub(r"  - {id: o[23].*\n", "", text)
    (tmp_path / "problem.yaml").write_text(text)
    fleet = Fleet.from_file(tmp_path / "problem.yaml")
    again = Fleet.from_file(fleet.save(tmp_path / "again.yaml"))
    assert again.records == fleet.records
    file = str(tmp_path / "problem.yaml")
    assert main(["solve", file, "--first", "--out", str(tmp_path / "plan")]) == 0
    told = capsys.readouterr()
    assert re.search(r"cost [0-9.]+ \(proven bound", told.out)
    assert re.search(r"ends [0-9]+ s after it is due", told.out)
    assert re.search(r"it costs [0-9.]+ of tardiness, [0-9.]+ of driving", told.out)
    data = read_plan(tmp_path / "plan" / "plan.json")
    assert data["dependencies"]["edges"]
    assert not re.search(r"cost \S* ?[0-9]+/[0-9]", told.err)
    plan = plan_from_dict(fleet.problem, data)
    assert validate_plan(fleet.problem, plan).valid
    assert set(terms_of(fleet.problem, plan)) == {"tardiness", "driving"}


def busy(result):
    """How long each robot drives and works in a plan, by the names of activities."""
    found = Counter()
    for a in result.data["activities"]:
        found[re.search(r"r\d", a["name"]).group()] += a["end"] - a["start"]
    return found


def pair(objective, *robots):
    """Two tasks for two robots, the second of which is further away and slower."""
    fleet = hall(objective)
    costs = {"used": 3, "per_km": 50, "per_hour": 36}
    fleet.add_robot_type("cart", (0.8, 0.6), model="omni", v_max=0.7, costs=costs)
    fleet.add_place("home2", 3, 8)
    fleet.add_robot("r2", "cart", "home2")
    for number, place in enumerate(("shelfC", "dock")):
        who = robots[number : number + 1]
        fleet.add_task(f"t{number}", at=place, duration=9, robots=who)
    return fleet


def test_work_is_shared_as_evenly_as_it_can_be():
    found = {}
    for robots in (*itertools.product(("r1", "r2"), repeat=2), ()):
        result = pair({"busiest": 1}, *robots).solve(optimal=True, timeout=60)
        assert result.status == "SOLVED_OPTIMALLY", result.explain()
        found[robots] = result.costs["busiest"]
        assert found[robots] == max(busy(result).values())
    assert found.pop(()) == min(found.values())


def test_robots_cost_what_their_type_says():
    result = pair({"cost": 2, "completion": 0.001}, "r2", "r2").solve(timeout=60)
    ways = [m["samples"] for m in result.data["motions"]]
    metres = sum(math.dist(a[1:3], b[1:3]) for way in ways for a, b in itertools.pairwise(way))
    drives = [a for a in result.data["activities"] if a["name"].startswith("move")]
    hours = sum(a["end"] - a["start"] for a in drives) / 3600
    wanted = 2 * (3 + 50 * metres / 1000 + 36 * hours)
    assert result.costs["cost"] == pytest.approx(wanted, abs=0.01)
    # the other one costs nothing
    assert pair({"cost": 1}).solve(patience=math.inf, timeout=60).costs["cost"] == 0
    with pytest.raises(FleetError, match="cost: say what robots cost, as costs of a type"):
        hall({"cost": 1}).solve(timeout=60)
    with pytest.raises(FleetError, match="energy: say what drives take, as battery of a type"):
        hall({"energy": 1}).solve(timeout=60)
