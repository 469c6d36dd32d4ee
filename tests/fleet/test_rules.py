"""What records ask for is what plans do: each rule against what must come of it."""

import math
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Polygon
from shapely.ops import unary_union

from up_samp.execution import Delays, dependencies_of, simulate
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.outlines import placed, swept
from up_samp.fleet.visits import Successions, moves_needed, visits_of
from up_samp.plotting.tracks import tracks_of
from up_samp.validation import validate_plan

MAPS = Path(__file__).parents[2] / "examples" / "maps"
FOOTPRINT = (1.2, 0.8)


def one_room(robots=1, capacity=1, **options):
    """The left room of two, no door; every drive is a few seconds."""
    fleet = Fleet(MAPS / "two_rooms.yaml", **options)
    fleet.add_robot_type(
        "agv", FOOTPRINT, model="omni", v_max=2.0, a_max=1.0, omega_max=2.0,
        capacity={"item": capacity},
    )  # fmt: skip
    for i in range(robots):
        fleet.add_place(f"home{i}", 2, 3 + 4 * i)
        fleet.add_robot(f"r{i}", "agv", f"home{i}", end=f"home{i}")
    fleet.add_place("a", 7, 3)
    fleet.add_place("b", 7, 12)
    fleet.add_place("c", 12, 12)
    return fleet


def solved(fleet, **params):
    result = fleet.solve(optimal=True, **{"relative": True, **params})
    assert result.status == "SOLVED_OPTIMALLY", result.explain()
    assert validate_plan(fleet.problem, result.plan, seconds_per_unit=result.seconds_per_unit).valid
    return result, {a["name"]: (a["start"], a["end"]) for a in result.data["activities"]}


def test_windows_services_and_order():
    fleet = one_room()
    fleet.add_order("o1", {"at": "a", "service": 4}, {"at": "b", "window": (40, 60)})
    fleet.add_task("t", "c", duration=5, after="o1")
    _, times = solved(fleet)
    assert times["pick_o1_r0"][1] - times["pick_o1_r0"][0] == 4
    assert times["deliver_o1_r0"][0] >= 40
    assert times["deliver_o1_r0"][1] <= times["t_r0"][0]


def test_priority_goes_first():
    for favoured in ("o1", "o2"):
        fleet = one_room()
        for name, place in (("o1", "a"), ("o2", "b")):
            fleet.add_order(name, place, "c", priority=int(name == favoured))
        _, times = solved(fleet)
        first = min(("o1", "o2"), key=lambda o: times[f"pick_{o}_r0"])
        assert first == favoured


@pytest.mark.parametrize(("penalty", "left"), [(5, ["far"]), (400, [])])
def test_what_is_optional_is_left_out_where_that_is_cheaper(penalty, left):
    fleet = one_room()
    fleet.add_order("near", "a", "b")
    fleet.add_order("far", "c", "a", optional=True, penalty=penalty)
    result, times = solved(fleet)
    assert result.left_out == left
    assert result.makespan == max(end for _, end in times.values())
    assert ("pick_far_r0" in times) == (not left)


def test_a_task_may_be_called_like_an_order_that_is_left_out():
    fleet = one_room()
    fleet.add_task("leave_out_press", duration=5)
    result = fleet.solve()
    assert [a["name"] for a in result.data["activities"]] == ["leave_out_press"], result.explain()
    assert result.left_out == []


@pytest.mark.parametrize("capacity", [1, 2])
def test_capacity_is_kept_and_used(capacity):
    fleet = one_room(capacity=capacity)
    for name in ("o1", "o2"):
        fleet.add_order(name, "b", "a")
    _, times = solved(fleet)
    picks = [times[f"pick_{o}_r0"] for o in ("o1", "o2")]
    drops = [times[f"deliver_{o}_r0"] for o in ("o1", "o2")]
    assert (max(picks)[0] < min(drops)[0]) == (capacity == 2)


def test_no_time_is_lost_between_a_delivery_and_the_next_pickup():
    fleet = one_room()
    fleet.add_order("o1", "a", {"at": "b", "service": 3})
    fleet.add_order("o2", "b", "c", after="o1")
    _, times = solved(fleet)
    assert times["pick_o2_r0"][0] == times["deliver_o1_r0"][1]


def test_skills_and_names_choose_the_robot():
    fleet = one_room(2)
    fleet.add_place("home9", 2, 12)
    fleet.add_robot("r9", "agv", "home9", skills="lift")
    fleet.add_task("heavy", "c", duration=3, skills="lift")
    fleet.add_task("light", "c", duration=3, robots="r1")
    result = fleet.solve(first_plan=True, query_seconds=0.15)
    assert {"heavy_r9", "light_r1"} <= {a["name"] for a in result.data["activities"]}


def test_a_machine_works_by_itself_one_at_a_time():
    fleet = one_room()
    fleet.add_resource("press")
    fleet.add_order("bring", "a", "b")
    fleet.add_task("first", duration=20, after="bring", resources="press")
    fleet.add_task("second", duration=20, resources="press")
    fleet.add_order("take", "b", "a", after="first")
    _, times = solved(fleet)
    assert times["deliver_bring_r0"][1] <= times["first"][0]
    assert times["first"][1] <= times["pick_take_r0"][0]
    assert times["first"][1] <= times["second"][0] or times["second"][1] <= times["first"][0]


def test_time_units_of_half_a_second():
    fleet = one_room(seconds_per_unit=0.5)
    fleet.add_task("t", "c", duration=1.5, window=(0, 100))
    result, times = solved(fleet)
    assert times["t_r0"][1] - times["t_r0"][0] == 3
    assert result.makespan == result.data["makespan"] / 2


def workshop(modes):
    fleet = one_room()
    fleet.add_place("in2", 12, 3)
    fleet.add_place("out2", 12, 6)
    fleet.add_resource("press")
    fleet.add_resource("mill")
    every = {
        "press": {"duration": 40, "input": "b", "resources": "press"},
        "mill": {"duration": 10, "input": "in2", "output": "out2", "resources": "mill"},
    }
    fleet.add_task("work", modes={m: every[m] for m in modes})
    fleet.add_order("bring", "a", {"task": "work"})
    fleet.add_order("take", {"task": "work"}, "c")
    return fleet


def test_a_task_is_done_on_one_of_several_machines():
    """The planner chooses, and parts are brought and fetched where it is done."""
    spans = {}
    for modes in (["press"], ["mill"], ["press", "mill"]):
        result, times = solved(workshop(modes))
        spans[tuple(modes)] = result.makespan
        done = next(t for t in ("work_press", "work_mill") if t in times)
        at = done.removeprefix("work_")
        assert times[f"deliver_bring_r0_at_{at}"][1] <= times[done][0]
        assert times[done][1] <= times[f"pick_take_r0_at_{at}"][0]
        drives = [n for n in times if n.startswith("move") and ("_in2" in n or "_b" in n)]
        assert all(("_in2" in n) == (at == "mill") for n in drives)
    press, mill, both = spans.values()
    assert mill < press
    assert both == mill


def test_modes_that_make_no_sense_are_refused():
    fleet = workshop(["mill"])
    fleet.add_task("plain", duration=3)
    for kind, options, text in (
        ("task", {}, r"tasks\[2\].duration: say how long it lasts"),
        ("task", {"duration": 1, "modes": {"x": {"duration": 2}}}, "or give it modes"),
        ("task", {"at": "a", "modes": {"x": {"duration": 2}}}, "modes are of machines"),
        ("task", {"modes": {"x": {"duration": 2, "input": "z"}}}, r"modes.x.input: no place 'z'"),
        ("order", {"pickup": {"task": "worc"}}, "no task 'worc'; did you mean 'work'"),
        ("order", {"pickup": {"task": "plain"}}, "task 'plain' has no modes; say where with at"),
        ("order", {"pickup": {}}, r"orders\[2\].pickup: name a place, or several"),
        (
            "order",
            {"pickup": {"task": "work"}, "attached": {"footprint": (1, 1)}},
            "goes to places",
        ),
    ):
        more = options if kind == "task" else {"pickup": "a", "delivery": "a", **options}
        add = {"task": fleet.add_task, "order": fleet.add_order}[kind]
        with pytest.raises(FleetError, match=text):
            add("new", **more)


def gated(closes, **options):
    """Two rooms; the door between them can be opened from both sides."""
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type(
        "agv", FOOTPRINT, model="diff", v_max=2.0, a_max=1.0, omega_max=2.0, reverse_cost=1
    )
    fleet.add_place("home", 9, 4)
    fleet.add_place("outer", 12, 4)
    fleet.add_place("inner", 18, 4)
    fleet.add_place("shelf", 21, 4)
    fleet.add_robot("r", "agv", "home", end="home")
    ends = {"closed": (15, 4, 0), "open": (15, 8, 0), "opened_from": ["outer", "inner"]}
    fleet.add_door("gate", (1, 3.8), **ends, closes=closes, **options)
    return fleet


def gate_of(result, when):
    (track,) = [t for t in tracks_of(result.data) if t.name == "gate"]
    return track.at(when)[1]


@pytest.mark.parametrize(("closes", "openings"), [(60, 1), (12, 2)])
def test_a_door_closes_again(closes, openings):
    fleet = gated(closes, times=2)
    fleet.add_task("look", "shelf", duration=6)
    result, times = solved(fleet)
    opened = sorted(end for name, (_, end) in times.items() if name.startswith("open_gate"))
    assert len(opened) == openings
    assert gate_of(result, opened[0] - 0.5) == 4
    for end in opened:
        later = [t for t in (end + 0.5, end + closes - 0.5) if t < result.makespan]
        assert all(gate_of(result, t) == 8 for t in later)
        if end + closes < result.makespan:
            assert gate_of(result, end + closes + 0.5) == 4
    # what is over is not prolonged by a door that has yet to close
    assert result.makespan == max(end for name, (_, end) in times.items() if "close" not in name)


def test_a_door_that_closes_before_the_way_back_needs_a_button_there():
    fleet = gated(12)
    fleet.add_task("look", "shelf", duration=6)
    assert fleet.solve(timeout=300).status == "UNSOLVABLE_PROVEN"  # it may be opened once only
    with pytest.raises(FleetError, match="a door that stays open is opened once; say closes"):
        gated(None, times=2)


def test_a_door_that_moves_stops_only_who_comes_near():
    fleet = gated(60)
    fleet.add_robot_type(
        "cart", FOOTPRINT, model="diff", v_max=0.4, a_max=0.5, omega_max=1.0, reverse_cost=1
    )
    fleet.add_place("west", 3, 12)
    fleet.add_place("east", 9, 12)
    fleet.add_robot("c", "cart", "west")
    fleet.add_task("look", "shelf", duration=6, robots="r")
    fleet.add_task("clean", "east", duration=1, robots="c")
    result, _ = solved(fleet)
    moved = [c["time"] for c in result.data["changes"] if c["object"] == "gate"]
    met = {
        m["object"]
        for m in result.data["motions"]
        if any(m["samples"][0][0] < t < m["samples"][-1][0] for t in moved)
    }
    assert met == {"c"}
    # the area that it keeps clear of has all poses of the leaf, and the drives through it do not
    area = Polygon(swept((1, 3.8), (15, 4, 0), (15, 8, 0)))
    assert area.equals(Polygon([(14.5, 2.1), (15.5, 2.1), (15.5, 9.9), (14.5, 9.9)]))
    tracks = {t.name: t for t in tracks_of(result.data)}
    bodies = {
        who: [Polygon(tracks[who].outline(tracks[who].at(0.25 * i))) for i in range(300)]
        for who in ("r", "c")
    }
    assert [any(map(area.intersects, bodies[who])) for who in ("r", "c")] == [True, False]


@pytest.mark.parametrize("turn", [1.6, -0.3, math.pi, -math.pi, 3.13, 3.0])
def test_what_a_door_sweeps_holds_its_leaf_all_the_way(turn):
    """A leaf on a hinge at one of its corners, which no pose of it names."""
    leaf, hinge = (2.0, 0.1), np.array([3.0, 4.0])

    def at(angle):
        c, s = math.cos(angle), math.sin(angle)
        return (*(hinge + np.array([[c, -s], [s, c]]) @ np.array([1.0, 0.05])), angle)

    area = Polygon(swept(leaf, at(0.4), at(0.4 + turn)))
    # half a turn may be one to the left or to the right
    ways = (turn, -turn) if abs(turn) > 3.1 else (turn,)
    leaves = [Polygon(placed(leaf, at(0.4 + t * k / 500))) for t in ways for k in range(501)]
    assert all(area.buffer(1e-9).covers(x) for x in leaves)
    assert unary_union(leaves).convex_hull.area > 0.99 * area.area


def inside(plan, polygon, when):
    return [
        t.name
        for t in tracks_of(plan)
        if t.moves and polygon.intersects(Polygon(placed(FOOTPRINT, t.at(when))))
    ]


def test_a_zone_holds_no_more_than_it_says_and_keeps_out_whom_it_names():
    crowd = [(5, 1), (9, 1), (9, 13.5), (5, 13.5)]
    fleet = one_room(2)
    fleet.add_zone("busy", crowd, max_robots=1)
    fleet.add_task("t1", "a", duration=5, robots="r0")
    fleet.add_task("t2", "b", duration=5, robots="r1")
    result, _ = solved(fleet)
    polygon = Polygon(crowd)
    ticks = [0.25 * i for i in range(int(4 * result.makespan) + 1)]
    counts = [len(inside(result.data, polygon, t)) for t in ticks]
    assert max(counts) == 1
    keys = {text.get_text() for text in result.map().get_figure().legends[0].get_texts()}
    assert "zone" in keys  # an area, and no body that hides the floor
    assert "door, or other object, at first" not in keys
    free = one_room(2)
    free.add_task("t1", "a", duration=5, robots="r0")
    free.add_task("t2", "b", duration=5, robots="r1")
    quick, _ = solved(free)
    assert quick.makespan < result.makespan
    crowded = [len(inside(quick.data, polygon, 0.25 * i)) for i in range(int(4 * quick.makespan))]
    assert max(crowded) == 2


def test_moves_are_as_many_as_may_be_needed():
    fleet = one_room()
    for i in range(3):
        fleet.add_order(f"o{i}", "a", "b")
    records = fleet.records
    needed = moves_needed(visits_of(records, "r0"), Successions(records, "r0"))
    assert needed["a", "b"] == 3
    assert needed["b", "a"] == 3
    assert needed["home0", "a"] == 2  # the start, and one rest there
    assert ("home0", "b") in needed  # rest while loaded
    assert ("a", "c") not in needed


def test_nobody_comes_back_to_its_start_where_nobody_may_park():
    fleet = one_room()
    fleet.add_place("corner", 12, 3, park=0)
    fleet.add_robot("r1", "agv", "corner", end="home0")
    fleet.add_order("o", "a", "b")
    records = fleet.records
    needed = moves_needed(visits_of(records, "r1"), Successions(records, "r1"))
    assert {to for _, to in needed} == {"a", "b", "home0"}


@pytest.mark.parametrize(
    ("options", "drives"),
    [
        ({"robots": "extra"}, False),
        ({}, True),
        ({"robots": "extra", "optional": True, "penalty": 9}, True),
    ],
)
def test_who_has_work_that_nobody_else_may_do_does_not_drive_home_first(options, drives):
    fleet = one_room(2)
    fleet.add_place("corner", 12, 3, park=0)
    fleet.add_robot("extra", "agv", "corner", end="c")
    fleet.add_order("o", "a", "b", **options)
    fleet.add_order("other", "a", "b", robots="r0")
    needed = moves_needed(visits_of(fleet.records, "extra"), Successions(fleet.records, "extra"))
    assert (("corner", "c") in needed) == drives
    assert ("b", "c") in needed


def test_a_zone_in_which_too_many_start_is_refused():
    fleet = one_room(2)
    fleet.add_zone("all", [(0, 0), (14, 0), (14, 15), (0, 15)], max_robots=1)
    fleet.add_task("t", "a", duration=1)
    with pytest.raises(FleetError, match="2 robots start in it; it takes 1"):
        fleet.problem  # noqa: B018


def test_names_with_underscores_may_run_into_each_other():
    """Two drives, and a task and a pickup, whose activities would be called alike."""
    fleet = one_room()
    for i, (name, y) in enumerate((("x", 5), ("home0_to_x", 7), ("x_to_b", 9))):
        fleet.add_place(name, 4 + i, y)
        fleet.add_task(f"t{i}", name, duration=1)
    fleet.add_task("t3", "b", duration=1)
    fleet.add_order("o", "a", "c")
    fleet.add_task("pick_o", "b", duration=1)
    names = [a.name for a in fleet.problem.activities]
    assert {"move_r0_home0_to_x_to_b", "move_r0_home0_to_x_to_b~2"} <= set(names)
    assert {"pick_o_r0", "pick_o_r0~2"} <= set(names)
    assert len(names) == len(set(names))


def test_who_turns_very_slowly_has_the_time():
    """Half a turn takes an hour; a drive used to be cut off after a quarter of one."""
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type("slow", FOOTPRINT, model="omni", omega_max=math.pi / 3600)
    fleet.add_place("home", 2, 3)
    fleet.add_place("a", 7, 3, math.pi)
    fleet.add_robot("r", "slow", "home")
    fleet.add_task("t", "a", duration=1)
    result = fleet.solve(first_plan=True)
    assert validate_plan(fleet.problem, result.plan).valid
    assert 3600 < result.makespan < 3700


def test_a_stop_has_several_windows():
    fleet = one_room(1)
    fleet.add_order("o", {"at": "a", "service": 4}, {"at": "b", "window": [[40, 60], [0, 6]]})
    result, times = solved(fleet)
    assert times["deliver_o_r0"] == (40, 41)
    found = dependencies_of(fleet.problem, result.data)
    run = simulate(found, result.data, Delays(), 0)
    assert run.finished
    assert run.broken == ()
    with pytest.raises(FleetError, match=r"delivery\.window: 5 s to 5\.5 s is too short for 1 s"):
        fleet.add_order("p", "a", {"at": "b", "window": [[40, 60], [5, 5.5]]})


def test_windows_that_all_close_too_soon_are_told():
    fleet = one_room(1)
    fleet.add_order("o", "a", {"at": "c", "window": [[0, 2], [3, 5]]})
    [finding] = [f for f in fleet.check() if "window" in f.what]
    assert "closes at 5 s; by the shortest drives it ends at" in finding.what
