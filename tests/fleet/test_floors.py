"""Floors and lifts: robots drive on floors and ride between them."""

import itertools

import numpy as np
import pytest

from tests.fleet.test_rules import solved
from tests.shuffled import shuffled_fleet
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.files import write_problem_file
from up_samp.geometry import lay_out, write_map
from up_samp.upio import read_problem

FOOTPRINT = (0.8, 0.6)


def storey(folder, name, width=14.0, height=8.0):
    cells = np.zeros((round(height / 0.1), round(width / 0.1)), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    return write_map(folder, name, cells, 0.1)


ALONE = {"ground": [12.5, 4, 0], "first": [14.5, 4, 0]}


def house(folder, robots=1, home=True, stops=ALONE, **lift):
    """A pharmacy on the ground and a ward above it; the lift stands at the right of both. Robots
    have to come ``home`` in the end.
    """
    storey(folder, "low"), storey(folder, "high", width=16.0)
    fleet = Fleet(folder / "low.yaml")
    fleet.add_floor("first", folder / "high.yaml", 4.0)
    if stops is not None:
        fleet.add_lift("lift", stops, **{"seconds": 20, **lift})
    fleet.add_robot_type("agv", FOOTPRINT, model="omni", v_max=2.0, a_max=1.0, omega_max=2.0)
    for i in range(robots):
        fleet.add_place(f"home{i}", 2, 2 + 2 * i)
        fleet.add_robot(f"r{i}", "agv", f"home{i}", end=f"home{i}" if home else None)
    fleet.add_place("pharmacy", 6, 4)
    fleet.add_place("ward", 4, 4, floor="first")
    return fleet


def test_an_order_goes_up_by_the_lift(tmp_path):
    fleet = house(tmp_path)
    fleet.add_order("drugs", "pharmacy", "ward")
    assert [str(f) for f in fleet.check() if f.level.value != "note"] == []
    result, times = solved(fleet)
    up, down = (
        times["ride_r0_lift.ground_to_lift.first"],
        times["ride_r0_lift.first_to_lift.ground"],
    )
    assert up[1] - up[0] == down[1] - down[0] == 20
    assert times["pick_drugs_r0"][1] <= up[0]
    assert up[1] <= times["deliver_drugs_r0"][0] <= times["deliver_drugs_r0"][1] <= down[0]
    again = Fleet.from_file(fleet.save(tmp_path / "problem.yaml"))
    assert again.records.lifts == fleet.records.lifts
    assert {a.name for a in again.problem.activities} == {a.name for a in fleet.problem.activities}
    for picture in (fleet.draw(tmp_path / "site.png"), result.map(tmp_path / "map.png")):
        assert picture is not None


def test_a_lift_takes_one_robot_at_a_time(tmp_path):
    fleet = house(tmp_path, robots=2, home=False)
    for i in range(2):
        fleet.add_task(f"visit{i}", "ward", duration=2, robots=f"r{i}")
    result = fleet.solve(timeout=60, first_plan=True)
    assert result.plan is not None, result.explain()
    rides = sorted(
        (a["start"], a["end"]) for a in result.data["activities"] if a["name"].startswith("ride_")
    )
    assert len(rides) >= 2
    assert all(end <= start for (_, end), (start, _) in itertools.pairwise(rides))
    assert not result.outcome.history.refused  # who comes waits until who rides is gone


def test_who_comes_next_drives_up_while_the_cabin_rides(tmp_path):
    fleet = house(tmp_path, robots=2, home=False)
    fleet.add_place("other", 4, 6, floor="first")
    for i, place in enumerate(("ward", "other")):
        fleet.add_task(f"visit{i}", place, duration=2, robots=f"r{i}")
    result, times = solved(fleet)
    first, second = sorted(times[f"ride_r{i}_lift.ground_to_lift.first"] for i in range(2))
    drives = [t for n, t in times.items() if n.startswith("move_") and "_to_lift.ground" in n]
    assert all(end <= second[0] for _, end in drives)
    assert first[0] <= max(drives)[0] < first[1] < max(drives)[1]
    # who has gone by the lift is away for the others, and back only upstairs
    assert not result.outcome.history.refused


def test_who_may_not_ride_stays_below(tmp_path):
    fleet = house(tmp_path, robots=1, skills=["tall"])
    fleet.add_robot("r9", "agv", [2, 6, 0], skills=["tall"])
    fleet.add_order("drugs", "pharmacy", "ward")
    assert not [a.name for a in fleet.problem.activities if a.name.startswith("ride_r0")]
    _, times = solved(fleet)
    assert "deliver_drugs_r9" in times
    with pytest.raises(FleetError, match=r"lifts\.freight\.skills: no robot has 'wide'"):
        fleet.add_lift("freight", {"ground": [12, 2, 0], "first": [14, 2, 0]}, skills=["wide"])


def test_floors_are_told_by_name(tmp_path):
    fleet = house(tmp_path)
    with pytest.raises(FleetError, match=r"places\.attic\.floor: no floor 'second'"):
        fleet.add_place("attic", 2, 2, floor="second")
    with pytest.raises(FleetError, match=r"floors\.ground: is the floor of the problem's own map"):
        fleet.add_floor("ground", "low.yaml", 8)
    with pytest.raises(FleetError, match=r"floors\.mezzanine\.height: is that of 'first'"):
        fleet.add_floor("mezzanine", "low.yaml", 4.0)
    with pytest.raises(FleetError, match=r"stops: needs 2 or more, not 1"):
        fleet.add_lift("pit", {"ground": [12, 2, 0]})
    with pytest.raises(FleetError, match=r"a load with a footprint stays on its floor"):
        fleet.add_order("bed", "pharmacy", "ward", attached={"footprint": [1, 1]})


def test_a_floor_that_no_lift_stops_at_is_proven_out_of_reach(tmp_path):
    fleet = house(tmp_path)
    storey(tmp_path, "top")
    fleet.add_floor("second", tmp_path / "top.yaml", 8.0)
    fleet.add_place("attic", 4, 4, floor="second")
    fleet.add_task("look", "attic", duration=1)
    found = [str(f) for f in fleet.check() if f.level.value == "error"]
    assert found == ["error: look: no robot that may do it (r0) can reach its place"]


def test_doors_and_zones_count_on_their_own_floor(tmp_path):
    """A door and a zone at the same x and y one floor up are in nobody's way below."""
    fleet = house(tmp_path)
    fleet.add_zone("wet", [(5, 3), (7, 3), (7, 5), (5, 5)], keep_out="agv", floor="first")
    fleet.add_door(
        "gate", leaf=(0.4, 7.4), closed=(9, 4, 0), open=(9, 11.0, 0), opened_from="lift.first",
        floor="first", seconds=3,
    )  # fmt: skip
    fleet.add_task("here", "pharmacy", duration=1)
    fleet.add_task("there", "ward", duration=1)
    notes = [str(f) for f in fleet.check()]
    assert "note: ward: robot 'r0' gets there only once door 'gate' is open" in notes
    assert not any("pharmacy" in note for note in notes)
    _, times = solved(fleet)
    assert times["open_gate_r0"][0] >= times["ride_r0_lift.ground_to_lift.first"][1]


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_any_listing_has_the_same_optimum(seed, tmp_path):
    """Names, lifts, floors, jobs and places in any order, and robots at poses of their own."""
    fleet = house(tmp_path, home=False)
    fleet.add_robot("spare", "agv", [3, 6.5, 0.5], shift=(0, 300))
    fleet.add_lift("freight", {"ground": [12.5, 6.5, 0], "first": [14.5, 6.5, 0]}, seconds=40)
    fleet.add_order("drugs", "pharmacy", "ward", robots="r0", release=3)
    fleet.add_task("look", "pharmacy", duration=2, robots="spare")
    best = solved(fleet)[0].makespan
    told = shuffled_fleet(fleet.records, seed)
    assert told.records != fleet.records
    again = Fleet.from_file(write_problem_file(tmp_path / "other.yaml", told.records))
    assert solved(again)[0].makespan == best


def test_in_any_listing_floors_lie_in_one_row(tmp_path):
    """Planners see one grid: where a floor lies in it, motions are found by."""
    fleet, seen = house(tmp_path), set()
    fleet.add_place("attic", 4, 2, floor="first")
    fleet.add_robot("r9", "agv", "attic")
    for seed in range(6):
        told = shuffled_fleet(fleet.records, seed).records
        other = Fleet.from_file(write_problem_file(tmp_path / "other.yaml", told))
        snapshot, grid = lay_out(read_problem(other.problem, 1.0))
        seen.add((tuple(sorted(snapshot.configurations.values())), grid.blocked.tobytes()))
    assert len(seen) == 1


BIG = {"ground": [[12.5, 3, 0], [12.5, 4.5, 0]], "first": [[14.5, 3, 0], [14.5, 4.5, 0]]}


def rides_of(result):
    """(start, end, from, to) of each ride in a plan, sorted."""
    found = []
    for a in result.data["activities"]:
        if a["name"].startswith("ride_"):
            floors = [part.split(".")[1] for part in a["name"].split("_", 2)[2].split("_to_")]
            found.append((a["start"], a["end"], *floors))
    return sorted(found)


def test_a_lift_for_two_takes_them_together(tmp_path):
    """Who goes the same way at the same time rides along; others have to wait."""
    spans = {}
    for stops in (BIG, {floor: poses[:1] for floor, poses in BIG.items()}):
        fleet = house(tmp_path, robots=2, home=False, stops=stops)
        for i, y in enumerate((3, 5.5)):
            fleet.add_place(f"bed{i}", 4, y, floor="first")
            fleet.add_task(f"visit{i}", f"bed{i}", duration=2, robots=f"r{i}")
        result, _ = solved(fleet)
        spans[len(stops["ground"])] = rides_of(result)
        again = Fleet.from_file(fleet.save(tmp_path / "problem.yaml"))
        assert again.records.lifts == fleet.records.lifts
    (one, two), (alone, later) = spans[2][:2], spans[1][:2]
    assert one[:2] == two[:2]
    assert alone[1] <= later[0]


def test_one_cabin_never_goes_two_ways(tmp_path):
    fleet = house(tmp_path, robots=2, home=False, stops=BIG, seconds=40)
    fleet.add_place("bed", 4, 6, floor="first")
    fleet.add_robot("r2", "agv", "bed")
    fleet.add_task("up", "ward", duration=2, robots="r0")
    fleet.add_task("down", "pharmacy", duration=2, robots="r2")
    result, _ = solved(fleet)
    rides = rides_of(result)
    assert {ride[2:] for ride in rides} == {("ground", "first"), ("first", "ground")}
    for one, other in itertools.pairwise(rides):
        assert one[1] <= other[0] or (one[0], *one[2:]) == (other[0], *other[2:])


def test_a_ride_takes_longer_the_more_floors_it_passes(tmp_path):
    stops = {"ground": [12.5, 4, 0], "first": [14.5, 4, 0], "attic": [12.5, 4, 0]}
    fleet = house(tmp_path, stops=None)
    storey(tmp_path, "top")
    fleet.add_floor("attic", tmp_path / "top.yaml", 8.0)
    fleet.add_lift("lift", stops, seconds=10, per_floor=4)
    fleet.add_place("loft", 4, 4, floor="attic")
    fleet.add_task("look", "loft", duration=1)
    fleet.add_task("visit", "ward", duration=1, after="look")
    _, times = solved(fleet)
    lasted = {name: end - start for name, (start, end) in times.items() if "ride" in name}
    assert lasted["ride_r0_lift.ground_to_lift.attic"] == 18
    assert lasted["ride_r0_lift.attic_to_lift.first"] == 14


def test_a_lift_has_as_many_poses_on_each_floor(tmp_path):
    fleet = house(tmp_path)
    with pytest.raises(FleetError, match=r"freight\.stops: a pose for each robot .* on each floor"):
        fleet.add_lift("freight", {"ground": BIG["ground"], "first": BIG["first"][:1]})
