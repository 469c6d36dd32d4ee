"""Loads that travel with their robots: pallets on the floor, in the words of ``Fleet``."""

from pathlib import Path

import pytest
from matplotlib.text import Text
from shapely.geometry import Polygon

from tests.usual import usually
from up_samp.cli.solving import schedule_table
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.checks import Level
from up_samp.plotting import animation_html, places_of
from up_samp.plotting.tracks import tracks_of
from up_samp.validation import validate_plan

MAPS = Path(__file__).parents[2] / "examples" / "maps"
PALLET = (1.2, 1.0)
FORKS = [(-0.9, -0.4), (0.5, -0.4), (0.5, 0.4), (-0.9, 0.4)]


def floor(robots=1, footprint=(1.2, 0.8)):
    """Two rooms with an opening of 4 m between them."""
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type(
        "lift", footprint, model="diff", v_max=2.0, a_max=1.0, omega_max=2.0
    )  # fmt: skip
    for i in range(robots):
        fleet.add_place(f"home{i}", 2, 3 + 4 * i)
        fleet.add_robot(f"r{i}", "lift", f"home{i}", end=f"home{i}")
    for name, x, y in (("a", 7, 3), ("b", 7, 12), ("c", 12, 12), ("d", 12, 4), ("e", 25, 11)):
        fleet.add_place(name, x, y)
    return fleet


def solved(fleet):
    result = fleet.solve(optimal=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    return result, {a["name"]: (a["start"], a["end"]) for a in result.data["activities"]}


def shapes_at(result, when):
    tracks = tracks_of(result.data)
    return {t.name: Polygon(t.outline(t.at(when))) for t in tracks if t.at(when) is not None}


@pytest.mark.parametrize("order", ["steel", "s" * 75])
def test_people_read_names_as_they_gave_them(order):
    fleet = floor()
    fleet.add_order(order, "a", "d", attached={"footprint": PALLET})
    result = fleet.solve(first_plan=True)
    read = [schedule_table(result.data), animation_html(result.data).partition("const scene")[2]]
    for ax in (result.map(), result.gantt()):
        read += [text.get_text() for text in ax.figure.findobj(Text)]
    texts = "\n".join(read)
    assert "load of s" in texts
    assert "@" not in texts
    assert places_of(fleet.problem).keys() >= {"a", "d"}


def test_a_pallet_rides_and_stands_where_it_was_put():
    fleet = floor()
    fleet.add_order("o1", "a", "d", attached={"footprint": PALLET})
    fleet.add_order("o2", "b", "c", attached={"footprint": PALLET})
    result, times = solved(fleet)
    for order, origin, to in (("o1", "a", "d"), ("o2", "b", "c")):
        ride = times[f"carry_{order}_r0_{origin}_to_{to}"]
        assert times[f"pick_{order}_r0"][1] <= ride[0]
        assert ride[1] <= times[f"deliver_{order}_r0"][0]
        rides = [m for m in result.data["motions"] if m["activity"].startswith(f"carry_{order}")]
        middle = rides[0]["samples"]
        world = shapes_at(result, middle[len(middle) // 2][0])
        assert world["r0"].within(world[f"load@{order}"].buffer(0.2))
    goal = shapes_at(result, 1e5)["load@o1"].centroid
    assert (goal.x, goal.y) == pytest.approx((12, 4), abs=1e-3)


@pytest.mark.long
def test_a_robot_drives_round_pallets_but_under_its_own():
    fleet = floor()
    fleet.add_order("o1", "a", "e", attached={"footprint": PALLET})
    fleet.add_place("way", 4.5, 3)
    fleet.add_order("late", "way", "c", attached={"footprint": PALLET}, after="o1")
    result, _ = solved(fleet)
    for motion in result.data["motions"]:
        if motion["activity"] != "move_r0_home0_to_a@o1":
            continue
        for row in motion["samples"][::5]:
            world = shapes_at(result, row[0])
            assert world["r0"].intersection(world["load@late"]).area < 1e-6
    last = shapes_at(result, motion["samples"][0][0])
    assert last["r0"].area > 0


@pytest.mark.parametrize("ahead", usually(0.7, of=(0.7, 0.9, 1.0)))
def test_a_truck_carries_before_itself(ahead):
    """Its forks are under the pallet, touch it, or are 10 cm away: then it drives round to it."""
    fleet = floor(footprint=FORKS)
    fleet.add_order("o", "a", "e", attached={"footprint": (0.8, 1.2), "offset": (ahead, 0.0, 0.0)})
    result, _ = solved(fleet)
    (ride,) = result.data["rides"]
    assert ride["offset"] == [ahead, 0.0, 0.0]
    come = next(m for m in result.data["motions"] if m["activity"] == "move_r0_home0_to_a@o")
    worlds = [shapes_at(result, row[0]) for row in come["samples"][::5]]
    into = [w["r0"].intersection(w["load@o"]).area > 1e-6 for w in worlds]
    assert any(into) == (ahead < 0.9)


def test_a_load_too_wide_for_the_opening_is_told_by_check_and_by_solve():
    fleet = floor()
    fleet.add_order("wide", "b", "e", attached={"footprint": (4.6, 4.6)})
    errors = [str(f) for f in fleet.check() if f.level is Level.ERROR]
    assert errors == [
        "error: wide: no robot that may do it (r0) gets through with its load (proven)"
    ]
    assert fleet.solve().status == "UNSOLVABLE_PROVEN"
    # as a load that only counts, it goes through
    bare = floor()
    bare.add_order("wide", "b", "e")
    solved(bare)


@pytest.mark.long
def test_pallets_at_the_same_place_get_out_of_each_others_way():
    """o2's pallet stands where o1's is to be put: it has to go first."""
    fleet = floor(2)
    fleet.add_order("o1", "a", "b", attached={"footprint": PALLET})
    fleet.add_order("o2", "b", "c", attached={"footprint": PALLET})
    result, times = solved(fleet)
    first = next(v for k, v in times.items() if k.startswith("carry_o2"))
    then = next(v for k, v in times.items() if k.startswith("carry_o1"))
    assert first[0] < then[1]
    for when in range(0, int(result.makespan) + 1):
        world = shapes_at(result, float(when))
        assert world["load@o1"].intersection(world["load@o2"]).area < 1e-6


def test_a_load_stands_at_one_place_and_goes_to_another():
    fleet = floor()
    with pytest.raises(FleetError, match=r"orders\[0\].pickup: its load stands at one place"):
        fleet.add_order("o", ["a", "b"], "c", attached={"footprint": PALLET})
    with pytest.raises(FleetError, match=r"orders\[0\].delivery: its load stands at 'a' already"):
        fleet.add_order("o", "a", ["a", "b"], attached={"footprint": PALLET})
    with pytest.raises(FleetError, match=r"orders\[0\].attached.footprint"):
        fleet.add_order("o", "a", "b", attached={"footprint": [1.0]})


@pytest.mark.long
def test_a_load_is_handed_over_and_brought_back():
    """r0 may not go where r1 may: one puts the pallet down, the other takes it on, and back."""
    fleet = floor(2)
    fleet.add_order("out", "a", ["c", "d"], attached={"footprint": PALLET}, robots="r0")
    fleet.add_order("on", ["c", "d"], "b", attached="out", robots="r1")
    fleet.add_order("back", "b", "a", attached="on", robots="r1")
    result = fleet.solve(timeout=300, first_plan=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    rides = sorted((m["samples"][0][0], m["activity"]) for m in result.data["motions"]
                   if m["activity"].startswith("carry"))  # fmt: skip
    middle = rides[0][1][-1]
    assert [name for _, name in rides] == [
        f"carry_out_r0_a_to_{middle}", f"carry_on_r1_{middle}_to_b", "carry_back_r1_b_to_a",
    ]  # fmt: skip
    assert {r["object"] for r in result.data["rides"]} == {"load@out"}
    last = shapes_at(result, 1e5)["load@out"].centroid
    assert (last.x, last.y) == pytest.approx((7, 3), abs=1e-3)


def test_who_takes_a_load_on_is_told_what_is_wrong():
    fleet = floor()
    fleet.add_order("o", "a", "b", attached={"footprint": PALLET})
    fleet.add_order("count", "a", "b")
    for pickup, delivery, attached, text in (
        ("c", "d", "o", r"orders\[2\].pickup: 'o' does not put its load at 'c', but at 'b'"),
        ("b", "d", "p", r"orders\[2\].attached: no other order 'p'; there are count, o"),
        ("b", "d", "count", "order 'count' has no load with a footprint"),
        ("b", "b", "o", "its load stands at 'b' already; deliver it elsewhere"),
    ):
        with pytest.raises(FleetError, match=text):
            fleet.add_order("next", pickup, delivery, attached=attached)
    fleet.add_order("next", "b", "c", attached="o")
    with pytest.raises(FleetError, match="order 'next' takes the load of 'o', too; only one can"):
        fleet.add_order("other", "b", "d", attached="o")


def test_loads_that_overlap_at_first_are_told():
    fleet = floor()
    fleet.add_place("near", 7.5, 3)
    fleet.add_order("o1", "a", "b", attached={"footprint": PALLET})
    fleet.add_order("o2", "near", "c", attached={"footprint": PALLET})
    text = "error: o1: the load of 'o1' and the load of 'o2' would overlap at first"
    assert text in [str(f) for f in fleet.check()]


def laden(zone):
    """A beam that rides across its robot, and a zone of one robot that only the beam touches."""
    fleet = floor()
    fleet.add_zone("z", zone, max_robots=1)
    fleet.add_order("o", "a", "d", attached={"footprint": (0.7, 2.0)})
    return fleet


def test_a_load_in_a_zone_counts_its_robot_for_the_ride_only():
    """Its robot does not touch the zone without it, neither before the ride nor after."""
    fleet = laden([(6.5, 3.6), (7.5, 3.6), (7.5, 4.6), (6.5, 4.6)])
    solved(fleet)
    fleet = laden([(11.5, 4.6), (12.5, 4.6), (12.5, 6), (11.5, 6)])
    fleet.add_place("in", 12, 6.2)
    fleet.add_robot("other", "lift", "b")
    fleet.add_task("t", "in", duration=2, robots="other", after="o")
    solved(fleet)


def test_who_stands_under_a_load_has_come_to_its_end():
    fleet = floor()
    fleet.add_robot("r", "lift", "b", end="d")
    fleet.add_order("o", "a", "d", attached={"footprint": PALLET}, robots="r")
    result, times = solved(fleet)
    assert times["deliver_o_r"][1] == result.makespan
