"""Doors that open as robots come: how long drives through them last, and when there are none."""

import pytest
from shapely.geometry import Polygon, box

from tests.fleet.test_rules import solved
from tests.shuffled import shuffled_fleet
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.files import write_problem_file
from up_samp.fleet.importers import map_from_polygons
from up_samp.fleet.outlines import placed

GATE = [(7.4, 3.4), (8.6, 3.4), (8.6, 5.6), (7.4, 5.6)]
FAR = [(x + 6, y) for x, y in GATE]
FOOTPRINT = (0.8, 0.6)


def rooms(folder, robots=1, **options):
    """Three rooms in a row with a gap between each two; what starts left goes right."""
    walls = [
        box(x - 0.1, low, x + 0.1, high) for x in (8, 14) for low, high in ((0, 3.4), (5.6, 9))
    ]
    free = box(0, 0, 22, 9)
    for wall in walls:
        free = free.difference(wall)
    fleet = Fleet(map_from_polygons(free, folder, "rooms", 0.1), **options)
    fleet.add_robot_type("agv", FOOTPRINT, model="omni", v_max=2.0, a_max=1.0, omega_max=2.0)
    for i in range(robots):
        fleet.add_robot(f"r{i}", "agv", [2, 2 + 2.5 * i, 0])
        fleet.add_place(f"near{i}", 5, 2 + 2.5 * i)
        fleet.add_place(f"middle{i}", 11, 2 + 2.5 * i)
        fleet.add_place(f"right{i}", 18, 2 + 2.5 * i)
    return fleet


def lasts(times, name):
    start, end = times[name]
    return end - start


def test_a_drive_through_a_door_takes_the_time_to_open(tmp_path):
    went = {}
    for opens_in in (None, 0, 7):
        fleet = rooms(tmp_path)
        if opens_in is not None:
            fleet.add_automatic_door("gate", GATE, opens_in=opens_in)
        fleet.add_task("here", "near0", duration=1)
        fleet.add_task("there", "middle0", duration=1, after="here")
        _, times = solved(fleet)
        went[opens_in] = lasts(times, "move_r0_near0_to_middle0")
        assert lasts(times, "move_r0_r0.start_to_near0") <= 4  # past no door
    assert went[0] == went[None]
    assert went[7] == went[0] + 7


def test_who_drives_past_keeps_clear_and_waits_for_nobody(tmp_path):
    """However long a door is shut: who does not come near it drives."""
    fleet = rooms(tmp_path)
    area = Polygon(GATE)
    fleet.add_automatic_door("gate", GATE, opens_in=60, shut=[0, 500])
    fleet.add_task("here", "near0", duration=1)
    result, _ = solved(fleet)
    assert result.makespan < 10
    poses = [row[1:4] for motion in result.data["motions"] for row in motion["samples"]]
    assert len(poses) > 2
    assert not any(area.intersects(Polygon(placed(FOOTPRINT, p))) for p in poses)


def test_nobody_drives_through_a_door_that_is_shut(tmp_path):
    fleet = rooms(tmp_path)
    fleet.add_automatic_door("gate", GATE, shut=[[3, 40], [50, 60]])
    fleet.add_task("there", "middle0", duration=1)
    fleet.add_task("back", "near0", duration=1, after="there")
    _, times = solved(fleet)
    assert times["move_r0_r0.start_to_middle0"][0] >= 40
    start, end = times["move_r0_middle0_to_near0"]
    assert end <= 50 or start >= 60


def test_doors_of_an_airlock_never_open_together(tmp_path):
    fleet = rooms(tmp_path, robots=2)
    for name, area in (("outer", GATE), ("inner", FAR)):
        fleet.add_automatic_door(name, area, opens_in=2, closes_in=3, airlock="lock")
    fleet.add_task("in", "right0", duration=1, robots="r0")
    fleet.add_task("half", "middle1", duration=1, robots="r1")
    _, times = solved(fleet)
    through, half = times["move_r0_r0.start_to_right0"], times["move_r1_r1.start_to_middle1"]
    assert half[1] <= through[0] or through[1] <= half[0]
    alone = rooms(tmp_path, robots=2)
    alone.add_task("in", "right0", duration=1, robots="r0")
    free = lasts(solved(alone)[1], "move_r0_r0.start_to_right0")
    assert through[1] - through[0] == free + 2 * (2 + 3)


def test_without_an_airlock_doors_open_at_any_time(tmp_path):
    fleet = rooms(tmp_path, robots=2)
    for name, area in (("outer", GATE), ("inner", FAR)):
        fleet.add_automatic_door(name, area, opens_in=2)
    fleet.add_task("in", "right0", duration=1, robots="r0")
    fleet.add_task("half", "middle1", duration=1, robots="r1")
    _, times = solved(fleet)
    one, other = times["move_r0_r0.start_to_right0"], times["move_r1_r1.start_to_middle1"]
    assert max(one[0], other[0]) < min(one[1], other[1])


def test_nobody_has_business_in_a_doorway(tmp_path):
    fleet = rooms(tmp_path)
    fleet.add_place("sill", 8, 4.5)
    fleet.add_automatic_door("gate", GATE)
    fleet.add_task("rest", "sill", duration=1)
    assert any("sill: at" in str(f) and "in 'gate'" in str(f) for f in fleet.check())
    with pytest.raises(FleetError, match=r"places\.sill: .* in 'gate'"):
        assert fleet.problem is None


def test_what_is_wrong_with_an_automatic_door_is_told(tmp_path):
    fleet = rooms(tmp_path)
    with pytest.raises(FleetError, match=r"gate\.closes_in: .* name its airlock"):
        fleet.add_automatic_door("gate", GATE, closes_in=3)
    with pytest.raises(FleetError, match=r"gate\.polygon: touches or crosses itself"):
        fleet.add_automatic_door("gate", [GATE[0], GATE[2], GATE[1], GATE[3]])
    with pytest.raises(FleetError, match=r"gate\.floor: no floor 'first'"):
        fleet.add_automatic_door("gate", GATE, floor="first")
    with pytest.raises(FleetError, match=r"gate\.shut: 9 s to 9 s is too short"):
        fleet.add_automatic_door("gate", GATE, shut=[9, 9])
    fleet.add_automatic_door("gate", GATE, airlock="lock")
    with pytest.raises(FleetError, match="only 'gate' is of the airlock 'lock'"):
        assert fleet.problem is None


@pytest.mark.long
def test_any_listing_has_the_same_optimum(tmp_path):
    fleet = rooms(tmp_path, robots=2)
    for name, area in (("outer", GATE), ("inner", FAR)):
        fleet.add_automatic_door(name, area, opens_in=1, closes_in=1, airlock="lock", shut=[5, 9])
    fleet.add_task("in", "right0", duration=1)
    fleet.add_task("half", "middle1", duration=1)
    best = solved(fleet)[0].makespan
    told = shuffled_fleet(fleet.records, 1)
    again = Fleet.from_file(write_problem_file(tmp_path / "other.yaml", told.records))
    assert solved(again)[0].makespan == best
    assert again.draw(tmp_path / "site.png") is not None
