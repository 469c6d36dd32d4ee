"""Zones with rules of driving and robots that are slow backwards: solved, judged, written, run."""

import json
import math

import numpy as np
import pytest

from tests.fleet.driving import hurried
from tests.usual import usually
from up_samp.execution import Delays, dependencies_of, simulate
from up_samp.execution.lives import lives_of
from up_samp.fleet import Fleet, FleetError, read_problem_file
from up_samp.fleet.checks import Level
from up_samp.fleet.outlines import rules_for
from up_samp.geometry.maps import write_map
from up_samp.io.files import read_plan
from up_samp.model import UnsupportedError
from up_samp.operate.planner import check_site
from up_samp.plotting import places_of
from up_samp.validation import validate_plan
from up_samp.validation.collisions import pieces_of

RING = [(-0.6, -0.35), (0.6, -0.35), (0.6, 0.35), (-0.6, 0.35)]
LIMITS = {"v_max": 1.5, "a_max": 0.7}
SLOW = [(4.5, 0), (6.0, 0), (6.0, 9), (4.5, 9)]


def hall(folder, **options):
    fleet = Fleet(write_map(folder, "hall", np.zeros((90, 160), dtype=bool), 0.1))
    fleet.add_robot_type("truck", RING, turning_radius=0.8, **LIMITS, **options)
    fleet.add_robot_type("cart", RING, model="diff", omega_max=0.8, **LIMITS)
    fleet.add_place("west", 2, 2.5)
    fleet.add_place("north", 3, 6.5)
    fleet.add_place("east", 12, 4.5)
    fleet.add_robot("t", "truck", "west", end="west")
    fleet.add_robot("c", "cart", "north", end="north")
    fleet.add_order("o1", "north", "east")
    fleet.add_order("o2", "east", "west")
    return fleet


def solved(fleet):
    """Its first plan, which is valid."""
    result = fleet.solve(timeout=300, first_plan=True, query_seconds=0.15)
    assert result.status.startswith("SOLVED"), result.explain()
    verdict = validate_plan(fleet.problem, result.plan)
    assert verdict.valid, verdict.violations
    return result


MIDDLE = [(5.0, 0), (9.0, 0), (9.0, 9), (5.0, 9)]


def stands(data, name, low, high):
    """For how long a robot stands with its middle between two x, on its drives (s)."""
    found = 0.0
    for motion in data["motions"]:
        rows = np.array(motion["samples"])
        still = np.abs(np.diff(rows[:, 1:], axis=0)).max(axis=1) < 1e-6
        here = (rows[:-1, 1] > low) & (rows[:-1, 1] < high) & (motion["object"] == name)
        found += float(np.diff(rows[:, 0])[still & here].sum())
    return found


def test_robots_wait_before_a_zone_without_stops_also_when_they_are_late(tmp_path):
    fleet = hall(tmp_path)
    fleet.add_zone("gap", MIDDLE, stopping="never")
    result = solved(fleet)
    assert all(stands(result.data, robot, 4.4, 9.6) == 0.0 for robot in "tc")
    (zone,) = next(o for o in result.data["objects"] if o["name"] == "t")["zones"]
    assert zone["stops"] is False
    assert not lives_of(result.data)["t"].body.kinematics.zones[0].stops
    found = dependencies_of(fleet.problem, result.data)
    for seed in range(3):
        run = simulate(found, result.data, Delays(slow=0.5, late=1.0), seed)
        assert run.finished, run.deadlock
        assert not run.broken


def test_nobody_has_business_in_a_zone_without_stops(tmp_path):
    fleet = hall(tmp_path)
    fleet.add_zone("gap", MIDDLE, stopping="never", robot_types="truck")
    fleet.add_place("inside", 7, 4.5)
    fleet.add_task("look", at="inside", duration=2, robots="c")
    assert fleet.problem.activities
    fleet.add_task("look2", at="inside", duration=2)
    assert "would stand in 'gap'" in " ".join(map(str, fleet.check()))
    with pytest.raises(FleetError, match=r"places.inside: .*truck.* would stand in 'gap'"):
        fleet.problem.activities  # noqa: B018


def test_a_type_that_does_not_turn_on_the_spot_drives_curves(tmp_path):
    fleet = Fleet(write_map(tmp_path, "hall", np.zeros((90, 160), dtype=bool), 0.1))
    fleet.add_robot_type("roll", RING, model="diff", omega_max=0.8, pivoting="never", **LIMITS)
    fleet.add_robot("p", "roll", [6, 2.0, 0])
    fleet.add_place("south", 6, 5.5, 3.14)
    fleet.add_task("back", at="south", duration=1, robots="p")
    result = solved(fleet)
    rows = np.concatenate([m["samples"] for m in result.data["motions"] if m["object"] == "p"])
    moves = np.abs(np.diff(rows[:, 1:], axis=0))
    way, turn = np.hypot(moves[:, 0], moves[:, 1]), moves[:, 2]
    assert turn.sum() > 3.0
    assert (turn <= way * 0.8 / 1.5 * 1.01 + 1e-6).all()
    with pytest.raises(FleetError, match="an omni may turn where it drives"):
        fleet.add_robot_type("o", RING, model="omni", pivoting="never")


def top_speeds(data, name, low, high):
    """The fastest that a robot drives with its middle between two x, and anywhere else."""
    inside, outside = [0.0], [0.0]
    for motion in data["motions"]:
        if motion["object"] == name:
            rows = np.array(motion["samples"])
            speed = np.hypot(*np.diff(rows[:, 1:3], axis=0).T) / np.diff(rows[:, 0])
            here = (rows[:-1, 1] > low) & (rows[1:, 1] < high)
            inside.extend(speed[here])
            outside.extend(speed[~here])
    return max(inside), max(outside)


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    """A hall with zones in which robots are slow, two over one another (and listed backwards), and
    a car that is slow backwards; its first plan.
    """
    fleet = hall(tmp_path_factory.mktemp("slow"), reverse="slow", reverse_v_max=0.3)
    fleet.add_zone("wider", SLOW, v_max=0.6)
    fleet.add_zone("ramp", [(8, 0), (9, 0), (9, 9), (8, 9)], v_max=0.3, robot_types="cart")
    fleet.add_zone("crossing", SLOW, v_max=0.5)
    return fleet, solved(fleet)


def test_robots_are_slow_where_a_zone_says_so_and_every_file_says_it(tmp_path, slow):
    fleet, result = slow
    for robot, ramp in (("t", 1.0), ("c", 0.3)):
        inside, free = top_speeds(result.data, robot, 4.5, 6.0)
        assert inside <= 0.5 * 1.001
        assert free > 1.0 or robot == "c"
        assert (top_speeds(result.data, robot, 8, 9)[0] <= 0.3 * 1.001) == (ramp < 1)
    fleet.save(tmp_path / "problem.json")
    written = json.loads((tmp_path / "problem.json").read_text())
    assert written["zones"]["ramp"]["v_max"] == 0.3
    assert read_problem_file(tmp_path / "problem.json").zones == fleet.records.zones
    result.save(tmp_path / "out")
    read = read_plan(tmp_path / "out" / "plan.json")
    zones = [[zone["v_max"] for zone in o["zones"]] for o in read["objects"][:2]]
    assert zones == [[0.5, 0.6], [0.5, 0.6, 0.3]]
    lives = lives_of(read)
    assert [len(lives[n].body.kinematics.zones) for n in ("t", "c")] == [2, 3]


def test_who_is_slow_backwards_drives_so(slow):
    result = slow[1]
    truck = next(o for o in result.data["objects"] if o["name"] == "t")
    assert truck["reverse_v_max"] == 0.3
    for motion in result.data["motions"]:
        if motion["object"] == "t":
            rows = np.array(motion["samples"])
            pieces = pieces_of(rows[:, 0], rows[:, 1:])
            assert np.max(-pieces.along / pieces.dt) <= 0.3 * 1.001


def test_without_slow_zones_it_is_quicker_and_no_plan_of_the_problem_with_them(tmp_path):
    free, fleet = hall(tmp_path), hall(tmp_path)
    fleet.add_zone("crossing", SLOW, v_max=0.5)
    other = solved(free)
    broken = validate_plan(fleet.problem, other.plan).violations
    assert {v.kind for v in broken} >= {"zone-speed"}
    assert any(v.activities and v.objects and v.time is not None for v in broken)


def test_where_a_zone_lies_is_no_place_to_be_named(tmp_path):
    fleet = hall(tmp_path)
    fleet.add_zone("around", [(1, 1.5), (3, 1.5), (3, 3.5), (1, 3.5)], v_max=0.5)
    assert set(places_of(fleet.problem)) == {"west", "north", "east"}


def test_who_is_late_is_slow_in_zones_all_the_same(slow):
    # the judge of what was driven sees who is not
    assert any("zone-speed" in text for text in hurried(slow[0], slow[1].data, 3, 0.5))


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({}, "v_max"),
        ({"v_max": 0.5, "keep_out": "truck"}, "several zones"),
        ({"v_max": 0.5, "max_robots": 1}, "several zones"),
        ({"max_robots": 1, "robot_types": "truck"}, "heeds"),
        ({"v_max": 0.5, "robot_types": "lorry"}, "lorry"),
        ({"v_max": 0.0}, "v_max"),
    ],
)
def test_what_is_wrong_with_a_zone_is_said(tmp_path, options, what):
    with pytest.raises(FleetError, match=what):
        hall(tmp_path).add_zone("z", SLOW, **options)


def test_a_lane_and_what_a_second_backwards_counts_go_with_plans(tmp_path):
    fleet = hall(tmp_path, reverse_cost=2.5)
    fleet.add_lane("main", [(2, 7.5), (10, 7.5), (10, 3.0)], prefer=4.0, robot_types="truck")
    fleet.save(tmp_path / "problem.json")
    again = read_problem_file(tmp_path / "problem.json")
    assert again.lanes == fleet.records.lanes
    assert again.robot_types["truck"].reverse_cost == 2.5
    truck, cart = (rules_for(fleet.records, kind) for kind in ("truck", "cart"))
    assert not cart
    assert [sorted(np.round(zone.polygon, 6).tolist()) for zone in truck] == [
        [[1.5, 7.0], [1.5, 8.0], [10.5, 7.0], [10.5, 8.0]],
        [[9.5, 2.5], [9.5, 8.0], [10.5, 2.5], [10.5, 8.0]],
    ]
    solved(fleet).save(tmp_path / "out")
    kinematics = lives_of(read_plan(tmp_path / "out" / "plan.json"))["t"].body.kinematics
    assert kinematics.lanes == truck
    assert kinematics.back_cost == 2.5


@pytest.mark.parametrize(
    ("points", "options", "what"),
    [
        ([(1, 1)], {}, "points"),
        ([(1, 1), (1, 1), (2, 2)], {}, "twice in a row"),
        ([(1, 1), (2, 2)], {"prefer": 1.0}, "prefer"),
        ([(1, 1), (2, 2)], {"width": 0.0}, "width"),
        ([(1, 1), (2, 2)], {"robot_types": "lorry"}, "lorry"),
        ([(1, 1), (2, 2)], {"floor": "attic"}, "attic"),
    ],
)
def test_what_is_wrong_with_a_lane_is_said(tmp_path, points, options, what):
    fleet = hall(tmp_path)
    with pytest.raises(FleetError, match=what):
        fleet.add_lane("main", points, **options)


@pytest.mark.parametrize("model", usually("car", of=("car", "diff")))
def test_robots_drive_ahead_where_nothing_is_said(tmp_path, model):
    shares, told = {}, {}
    for options in ({}, {"reverse_cost": 1}, {"reverse_cost": 1.5}):
        fleet = Fleet(write_map(tmp_path, "hall", np.zeros((90, 160), dtype=bool), 0.1))
        fleet.add_robot_type("truck", RING, model=model, **LIMITS, **options)
        for name, x, heading in (("west", 3, math.pi), ("east", 12, math.pi), ("middle", 8, 0.0)):
            fleet.add_place(name, x, 4.5, heading)
        fleet.add_robot("t", "truck", "west", end="west")
        fleet.add_order("o1", "east", "middle")
        result = fleet.solve(timeout=60, first_plan=True)
        driven = {True: 0.0, False: 0.0}
        for motion in result.data["motions"]:
            rows = np.array(motion["samples"])
            pieces = pieces_of(rows[:, 0], rows[:, 1:])
            for back in driven:
                driven[back] += float(np.abs(pieces.along[(pieces.along < 0) == back]).sum())
        shares[len(options), options.get("reverse_cost")] = driven[True] / sum(driven.values())
        told[options.get("reverse_cost")] = "prefer to drive ahead" in result.explain()
    assert shares[0, None] == shares[1, 1.5] < 0.4 < shares[1, 1]
    assert told == {None: True, 1: False, 1.5: True}


def test_who_says_what_a_second_backwards_counts_drives_backwards(tmp_path):
    for options in ({"model": "omni"}, {"reverse": "never"}, {"reverse_cost": 0.5}):
        with pytest.raises(FleetError, match="reverse_cost"):
            _ = hall(tmp_path, **{"reverse_cost": 2.0, **options}).problem


@pytest.mark.parametrize("options", [{"reverse": "slow"}, {"reverse_v_max": 0.3}])
def test_a_speed_backwards_goes_with_slow(tmp_path, options):
    with pytest.raises(FleetError, match="reverse_v_max"):
        _ = hall(tmp_path, **options).problem


def test_a_day_that_cannot_keep_them_says_so(tmp_path):
    fleet = hall(tmp_path, reverse="slow", reverse_v_max=0.3)
    fleet.add_zone("slowly", SLOW, v_max=0.5)
    check_site(fleet.records)
    fleet.add_zone("crossing", SLOW, stopping="never")
    with pytest.raises(UnsupportedError, match="crossing"):
        check_site(fleet.records)


def lanes(fleet):
    fleet.add_zone("eastbound", [(5, 0), (8, 0), (8, 4.5), (5, 4.5)], one_way=0.0)
    fleet.add_zone("westbound", [(5, 4.5), (8, 4.5), (8, 9), (5, 9)], one_way=math.pi)
    fleet.add_zone("still", [(10, 2), (14, 2), (14, 7), (10, 7)], pivoting="never")
    return fleet


def directions(fleet, result):
    """The directions that lanes are driven in, each the right one."""
    assert result.status.startswith("SOLVED"), result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    seen = set()
    for motion in result.data["motions"]:
        rows = np.array(motion["samples"])
        x, y = 0.5 * (rows[1:, 1:3] + rows[:-1, 1:3]).T
        step = np.diff(rows[:, 1])
        inside = (x > 5.1) & (x < 7.9)
        assert np.all(step[inside & (y < 4.4)] >= -1e-9)
        assert np.all(step[inside & (y > 4.6)] <= 1e-9)
        seen |= set(np.sign(step[inside]).tolist())
    return seen


@pytest.mark.parametrize("robot", usually("truck", of=("truck", "cart")))
def test_a_robot_keeps_to_lanes(tmp_path, robot):
    def alone():
        fleet = Fleet(write_map(tmp_path, "hall", np.zeros((90, 160), dtype=bool), 0.1))
        model = {"turning_radius": 0.8} if robot == "truck" else {"model": "diff", "omega_max": 0.8}
        fleet.add_robot_type(robot, RING, **model, **LIMITS)
        fleet.add_place("west", 2, 2.5)
        fleet.add_place("east", 12, 4.5)
        fleet.add_robot("r", robot, "west", end="west")
        fleet.add_order("o", "west", "east")
        return fleet

    fleet = lanes(alone())
    assert directions(fleet, fleet.solve(timeout=60, first_plan=True)) >= {-1.0, 1.0}
    # without the lanes it is another plan
    other = alone().solve(timeout=60, first_plan=True)
    assert "wrong-way" in {v.kind for v in validate_plan(fleet.problem, other.plan).violations}


def test_each_lane_is_driven_one_way_by_two(tmp_path):
    fleet = lanes(hall(tmp_path))
    result = fleet.solve(timeout=120, first_plan=True)
    assert directions(fleet, result) >= {-1.0, 1.0}
    zones = next(o for o in result.data["objects"] if o["name"] == "t")["zones"]
    assert sorted(z.get("one_way", -1.0) for z in zones) == pytest.approx([-1.0, 0.0, math.pi])
    assert [z["pivots"] for z in zones if "pivots" in z] == [False]
    run = simulate(dependencies_of(fleet.problem, result.data), result.data, Delays(slow=0.8), 1)
    assert not run.broken, run.broken


def test_a_zone_is_on_one_floor(tmp_path):
    fleet = Fleet(write_map(tmp_path, "hall", np.zeros((90, 160), dtype=bool), 0.1))
    fleet.add_floor("first", write_map(tmp_path, "up", np.zeros((90, 160), dtype=bool), 0.1), 4.0)
    fleet.add_lift("lift", {"ground": (14, 6, 0), "first": (2, 6, 0)})
    fleet.add_robot_type("cart", RING, model="diff", **LIMITS)
    fleet.add_place("west", 2, 2.5)
    fleet.add_place("ward", 14, 2.5, floor="first")
    fleet.add_robot("c", "cart", "west")
    fleet.add_zone("below", [(4, 0), (6, 0), (6, 9), (4, 9)], v_max=0.4)
    fleet.add_zone("above", [(8, 0), (9, 0), (9, 9), (8, 9)], v_max=0.2, floor="first")
    fleet.add_order("drugs", "west", "ward")
    result = fleet.solve(timeout=300, first_plan=True)
    assert validate_plan(fleet.problem, result.plan).valid
    below, above = sorted(result.data["motions"], key=lambda m: m["samples"][0][0])
    for motion, low, high, most in ((below, 4, 6, 0.4), (above, 8, 9, 0.2)):
        data = {"motions": [motion]}
        assert top_speeds(data, "c", low, high)[0] <= most * 1.001
        other = (8, 9) if low == 4 else (4, 6)
        assert top_speeds(data, "c", *other)[0] > 0.9
    # side by side, too
    dependencies = dependencies_of(fleet.problem, result.data)
    run = simulate(dependencies, result.data, Delays(slow=0.8), 1)
    assert not run.broken, run.broken


def closed(folder, zones):
    """Two small rooms with one opening, and one-way zones in it: by name the heading, and from and
    to which y.
    """
    walls = np.zeros((24, 48), dtype=bool)
    walls[:6, 23:25] = walls[-6:, 23:25] = True
    fleet = Fleet(write_map(folder, "rooms", walls, 0.1))
    fleet.add_robot_type("cart", (0.6, 0.5), model="diff")
    fleet.add_place("home", 1.0, 1.2)
    fleet.add_place("there", 3.8, 1.2)
    fleet.add_robot("c", "cart", "home", end="home")
    fleet.add_task("look", "there", duration=2)
    for name, (heading, low, high) in zones.items():
        fleet.add_zone(name, [(1.9, low), (2.9, low), (2.9, high), (1.9, high)], one_way=heading)
    return fleet


@pytest.mark.parametrize("heading", [0.0, pytest.param(math.pi, marks=pytest.mark.long)])
def test_a_one_way_zone_over_the_only_opening_is_told_of(tmp_path, heading):
    fleet = closed(tmp_path, {"gap": (heading, 0, 2.4)})
    fleet.add_zone("slow", [(1.9, 0), (2.9, 0), (2.9, 2.4), (1.9, 2.4)], v_max=0.2)
    (found,) = [f for f in fleet.check() if "no drive of robot" not in f.what]
    assert (found.level, found.subject) == (Level.WARNING, "gap")
    assert ("from 'there' to 'home'" in found.what) == (heading == 0)


def test_a_way_there_and_a_way_back_are_no_matter(tmp_path):
    assert closed(tmp_path, {"in": (0.0, 0, 1.2), "out": (math.pi, 1.2, 2.4)}).check() == []
