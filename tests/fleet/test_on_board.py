"""Loads that are on robots when the plan begins."""

import re

import numpy as np
import pytest

from tests.fleet.modern import Modern
from tests.fleet.test_physics import told
from tests.fleet.witness import NoWitnessError, fleet_of
from up_samp import Fleet
from up_samp.fleet import FleetError, read_problem_file, write_problem_file
from up_samp.geometry.maps import write_map
from up_samp.model import UnsupportedError
from up_samp.operate.planner import check_site

ABOARD = {"on": "r1"}
ONE, TWO = {"item": 1}, {"item": 2}


def hall(folder, **options):
    """One robot in an empty hall of 12 m x 6 m, and three places in a row."""
    cells = np.zeros((60, 120), bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    fleet = Fleet(write_map(folder, "hall", cells, 0.1))
    fleet.add_robot_type("agv", footprint=(0.6, 0.4), model="omni", **options)
    fleet.add_robot("r1", "agv", start=(1.5, 1.5, 0.0))
    for k in range(3):
        fleet.add_place(f"p{k}", 3.0 + 3.0 * k, 3.0, 0.0)
    return fleet


def course(fleet):
    """Return what is picked up and delivered, one after the other, in the best plan."""
    result = fleet.solve(timeout=30)
    done = sorted((a["start"], a["name"]) for a in result.data["activities"])
    return [name for _, name in done if name.startswith(("pick", "deliver"))]


def test_who_has_no_room_delivers_first(tmp_path):
    """On the way to the farthest place it passes the one at which there is more to pick up."""
    for capacity, first in ((ONE, "deliver_o1_r1"), (TWO, "pick_o2_r1")):
        fleet = hall(tmp_path, capacity=capacity)
        fleet.add_order("o1", ABOARD, "p2")
        fleet.add_order("o2", "p0", "p2")
        assert course(fleet)[0] == first


@pytest.mark.parametrize("unloading", ["any", "lifo"])
def test_what_is_picked_up_lies_above(unloading, tmp_path):
    fleet = hall(tmp_path, capacity=TWO, unloading=unloading)
    fleet.add_order("below", ABOARD, {"at": "p1", "window": [8, 300]})
    fleet.add_order("above", "p0", "p2", release=1)
    done = course(fleet)
    if unloading == "any":
        assert done == ["pick_above_r1", "deliver_below_r1", "deliver_above_r1"]
    else:
        last = done.index("deliver_below_r1")
        assert done.index("deliver_above_r1") < last or done.index("pick_above_r1") > last


def test_rules_of_jobs_are_about_the_delivery(tmp_path):
    fleet = hall(tmp_path, capacity=TWO)
    fleet.add_order("o2", "p1", "p2")
    fleet.add_order("o1", ABOARD, "p0", after="o2")
    assert course(fleet)[-1] == "deliver_o1_r1"


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ({"pickup": {"on": "r2"}}, r"^orders\[0\]\.pickup\.on: no robot 'r2'; there are r1$"),
        ({"pickup": {"on": "r1", "service": 3}}, r"pickup: has happened: beside on: r1"),
        ({"pickup": {"on": "r1", "at": "p1"}}, r"name a place, or several \(at\), .* \(on\)"),
        ({"delivery": {"on": "r1"}}, r"delivery: says where the load goes"),
        ({"optional": True, "penalty": 3}, r"is on r1: what is on board at first .* not optional"),
        ({"attached": {"footprint": [0.5, 0.5]}}, r"is on r1: .* has no footprint"),
        ({"repeat": {"every": 9, "times": 2}}, r"is on r1: .* once"),
        ({"load": {"item": 2}}, r"capacity"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_told(order, said, tmp_path):
    fleet = hall(tmp_path)
    with pytest.raises(FleetError, match=said):
        fleet.add_order(**{"id": "o1", "pickup": ABOARD, "delivery": "p1"} | order)


def test_what_does_not_fit_or_lies_anyhow_is_told(tmp_path):
    for options, said in (
        ({"capacity": ONE}, r"robots\.r1: has 2 item on board at first; see capacity"),
        ({"capacity": TWO, "unloading": "lifo"}, r"robots\.r1: which lies above, 'o1' or 'o2'\?"),
    ):
        fleet = hall(tmp_path, **options)
        fleet.add_order("o1", ABOARD, "p1")
        fleet.add_order("o2", ABOARD, "p2")
        with pytest.raises(FleetError, match=said):
            fleet.problem()


def test_a_day_does_not_begin_with_it(tmp_path):
    fleet = hall(tmp_path)
    fleet.add_order("o1", ABOARD, "p1")
    with pytest.raises(UnsupportedError, match="'o1' is on a robot at first: not operated yet"):
        check_site(fleet.records)


def aboard(made):
    return any("on" in o["pickup"] for o in made["orders"] if isinstance(o["pickup"], dict))


def test_generators_draw_it(tmp_path):
    drawn = [Modern(seed, tmp_path).spec for seed in range(30)]
    assert sum(map(aboard, drawn)) > 3


def known(first, last, folder):
    """Return what is wrong with answers to fleets with a known plan that have loads on board."""
    findings = {}
    for seed in range(first, last):
        try:
            if aboard(fleet_of(seed, folder).spec):
                findings[seed] = told(seed, folder)
        except NoWitnessError:
            continue
    return findings


def test_plans_hold_on_the_floor_and_proofs_against_a_witness(tmp_path):
    findings = known(0, 3, tmp_path)
    assert len(findings) > 1
    assert not any(findings.values()), findings


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 400, 50))
def test_many_do(first, tmp_path):
    findings = known(first, first + 50, tmp_path)
    assert len(findings) > 3
    assert not any(findings.values()), findings


@pytest.mark.parametrize("key", ["on", '"on"', "'on'"])
def test_files_say_so_without_quotes(key, tmp_path):
    """YAML 1.1 reads a plain ``on`` as true."""
    fleet = hall(tmp_path)
    fleet.add_order("o1", ABOARD, "p1")
    write_problem_file(tmp_path / "p.yaml", fleet.records)
    text = (tmp_path / "p.yaml").read_text()
    told = re.sub(r"""["']on["']:""", f"{key}:", text)
    assert f"{key}: r1" in told
    (tmp_path / "p.yaml").write_text(told)
    assert read_problem_file(tmp_path / "p.yaml").orders[0].pickup.on == "r1"
