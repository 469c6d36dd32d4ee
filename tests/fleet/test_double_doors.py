"""Doors with two leaves, which move together."""

import numpy as np
import pytest
from shapely.geometry import Polygon

from tests.fleet.test_rules import MAPS
from up_samp.execution import Delays, dependencies_of, simulate
from up_samp.fleet import Fleet, read_problem_file
from up_samp.fleet.files import write_problem_file
from up_samp.fleet.outlines import placed
from up_samp.fleet.picture import _fixtures
from up_samp.fleet.records import Door, FleetRecords, Storey
from up_samp.model import Deadline, UnsupportedError
from up_samp.model.refinement import Strength
from up_samp.operate.planner import check_site
from up_samp.search.params import Parameters
from up_samp.search.search import Wrapped
from up_samp.search.session import open_search
from up_samp.search.statements import unreachable
from up_samp.validation import validate_plan

LEAF = (0.6, 1.9)
UPPER, LOWER = ([15, 5, 0], [15, 7, 0]), ([15, 3, 0], [15, 1, 0])
"""Where the leaves are, closed and open: each slides along the wall."""


def site(*, single=False, button2=None, **options):
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type("agv", (1.0, 0.7), model="diff", v_max=2.0)
    for name, x, y in (("home", 12, 3), ("button", 11, 5), ("there", 19, 4)):
        fleet.add_place(name, x, y)
    fleet.add_robot("r", "agv", "home")
    buttons = ["button"]
    if button2 is not None:
        fleet.add_place("button2", *button2)
        buttons += ["button2"]
    if single:
        fleet.add_door("gate", (0.6, 3.8), (15, 4, 0), (15, 8, 0), opened_from=buttons, **options)
    else:
        fleet.add_door("gate", LEAF, *UPPER, opened_from=buttons, second=LOWER, **options)
    fleet.add_task("look", at="there", duration=2)
    return fleet


def test_both_leaves_are_open_before_anybody_drives_through(tmp_path):
    fleet = site()
    result = fleet.solve(timeout=120, first_plan=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(fleet.problem, result.plan, seconds_per_unit=1.0).valid
    data = result.data
    moved = {c["object"]: c for c in data["changes"]}
    assert {c["activity"] for c in data["changes"]} == {"open_gate_r"}
    assert moved["gate"]["configuration"][:2] == UPPER[1][:2]
    other = next(change for name, change in moved.items() if name != "gate")
    assert other["configuration"][:2] == LOWER[1][:2]
    (opened,) = [a["end"] for a in data["activities"] if a["name"] == "open_gate_r"]
    for motion in data["motions"]:
        for time, *pose in motion["samples"]:
            body = Polygon(placed((1.0, 0.7), pose))
            for leaf in (UPPER, LOWER):
                at = leaf[bool(time >= opened)]
                assert body.intersection(Polygon(placed(LEAF, at))).area < 1e-6
    found = dependencies_of(fleet.problem, data)
    run = simulate(found, data, Delays(slow=0.5, late=1.0), 1)
    assert run.finished
    assert not run.broken
    again = read_problem_file(write_problem_file(tmp_path / "again.yaml", fleet.records))
    assert np.allclose(again.doors["gate"].second, LOWER)


def test_one_leaf_alone_does_not_let_anybody_through():
    fleet = site()
    notes = " ".join(map(str, fleet.check()))
    assert "only once door 'gate' is open" in notes
    with pytest.raises(UnsupportedError, match="'gate' has two leaves"):
        check_site(fleet.records)


def barred(fleet):
    """What drives wait for, as it is stated before the first schedule."""
    wrapped = Wrapped("cpsat", {"workers": 1}, lambda *_: [], lambda *_: [], native=True)
    search = open_search(fleet.problem, wrapped, Parameters(), Deadline.after(600.0))
    stated = unreachable(search.motions)
    search.scheduler.close()
    assert all(one.strength is Strength.PROVEN for one in stated)
    return sorted(str(one.statement) for one in stated)


@pytest.mark.parametrize("options", [{}, {"closes": 8, "times": 2}])
def test_what_two_leaves_bar_together_is_stated_like_what_one_bars(options):
    """Neither bars the way alone. What is not stated was learned drive by drive."""
    double, single = site(**options), site(single=True, **options)
    stated = barred(double)
    assert len(stated) >= 4
    assert stated == barred(single)


@pytest.mark.parametrize("single", [pytest.param(True, marks=pytest.mark.long), False])
def test_a_door_that_closes_takes_as_long_with_two_leaves(single):
    fleet = site(single=single, closes=8, times=2, button2=(18, 5))
    fleet.add_task("back", at="home", duration=1, after="look")
    result = fleet.solve(timeout=300, first_plan=True)
    assert validate_plan(fleet.problem, result.plan, seconds_per_unit=1.0).valid
    assert result.makespan <= 40


def test_messages_say_the_other_leaf():
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type("agv", (1.0, 0.7), model="diff", v_max=2.0)
    for name, x, y in (("home", 12, 3), ("button", 11, 5), ("there", 19, 4), ("near", 14.2, 2)):
        fleet.add_place(name, x, y)
    fleet.add_robot("r", "agv", "home")
    fleet.add_robot("q", "agv", "near")
    slides = ([15, 3, 0], [14.2, 1.5, 0])  # into the robot that stands there
    fleet.add_door("gate", LEAF, *UPPER, opened_from="button", second=slides)
    fleet.add_task("look", at="there", duration=2, robots="r")
    told = []
    result = fleet.solve(timeout=2, progress=lambda event: told.append(event.message))
    texts = [result.explain(), *told]
    assert any("the other leaf of gate" in text for text in texts)
    assert not any("@" in text for text in texts)


def test_both_leaves_are_drawn():
    ends = ((2.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    door = Door((1.0, 0.1), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), ("p",), floor="up", second=ends)
    records = FleetRecords("map.yaml", floors={"up": Storey("up.yaml", 4.0)}, doors={"d": door})
    told = [(kind, corners.mean(axis=0)[0]) for _, kind, _, corners, _ in _fixtures(records)]
    shut, opened = ([x for kind, x in told if kind.endswith(end)] for end in ("closed", "open"))
    assert (shut, opened) == ([0.0, 2.0], [1.0, 3.0])
