"""A problem's unit of time and its margin: from its file, or given for one solve."""

import json
from pathlib import Path

import pytest
import yaml

from up_samp.cli import main
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.batteries import Meter
from up_samp.validation import validate_plan

MAPS = Path(__file__).parents[2] / "examples" / "maps"


def floor(**settings):
    fleet = Fleet(MAPS / "two_rooms.yaml", **settings)
    fleet.add_robot_type("agv", (1.2, 0.8), model="omni", v_max=2.0, a_max=1.0)
    for name, x, y in (("home", 2, 3), ("a", 7, 3), ("b", 12, 12)):
        fleet.add_place(name, x, y)
    fleet.add_robot("r", "agv", "home")
    fleet.add_task("sweep", at="a", duration=3)
    return fleet


def spans(data, unit):
    return {a["name"]: (a["end"] - a["start"]) * unit for a in data["activities"]}


def test_a_problem_tells_its_margin(tmp_path):
    fleet = floor(margin=0.3, seconds_per_unit=0.5)
    again = Fleet.from_file(fleet.save(tmp_path / "problem.yaml"))
    assert again.settings == {"seconds_per_unit": 0.5, "margin": 0.3}
    result = again.solve(first_plan=True)
    assert (result.data["margin"], result.data["seconds_per_unit"]) == (0.3, 0.5)
    assert validate_plan(result.problem, result.plan).valid
    assert Fleet.from_file(floor().save(tmp_path / "usual.yaml")).settings["margin"] == 0.01


@pytest.mark.parametrize("margin", [-0.1, "wide", float("nan"), 1e9])
def test_a_margin_that_is_none_is_refused_by_name(margin):
    with pytest.raises(FleetError, match="margin"):
        floor(margin=margin)
    with pytest.raises(FleetError, match="margin"):
        floor().solve(margin=margin)


def test_other_settings_for_one_solve():
    """What lasts 3 s lasts 3 s in every unit; the problem itself stays as it was."""
    fleet = floor()
    for unit in (0.5, 1.5):
        result = fleet.solve(seconds_per_unit=unit, margin=0.2)
        assert result.data["margin"] == 0.2
        took = [s for name, s in spans(result.data, unit).items() if "sweep" in name]
        assert took == [3.0]
        assert validate_plan(result.problem, result.plan).valid
    assert fleet.settings == {"seconds_per_unit": 1.0, "margin": 0.01}
    with pytest.raises(FleetError, match="colour: is no setting"):
        fleet.with_settings(colour=1.0)


def test_energy_is_that_of_ways_with_the_margin():
    """Who keeps 1.5 m from walls does not cut the corner where the rooms meet."""
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type("agv", (1.2, 0.8), v_max=2.0, battery={"capacity": 90, "per_metre": 1.0})
    fleet.add_place("home", 5, 13)
    fleet.add_place("c", 24, 13)
    fleet.add_robot("r", "agv", "home")
    near, far = (
        Meter(fleet.with_settings(margin=m).records, MAPS).drive("r", "home", "c")
        for m in (0.01, 1.5)
    )
    assert far > 1.05 * near


def test_commands_take_settings(tmp_path, capsys):
    """A plan in another unit than the file's is judged and carried out in its own."""
    file, out = tmp_path / "problem.yaml", tmp_path / "out"
    floor().save(file)
    more = ["--seconds-per-unit", "0.5", "--margin", "0.2", "--out", str(out)]
    assert main(["solve", str(file), *more]) == 0
    data = json.loads((out / "plan.json").read_text())
    assert (data["margin"], data["seconds_per_unit"]) == (0.2, 0.5)
    assert [s for name, s in spans(data, 0.5).items() if "sweep" in name] == [3.0]
    assert main(["validate", str(file), str(out / "plan.json")]) == 0
    simulate = ["simulate", str(out / "plan.json"), "--problem", str(file), "--runs", "2"]
    assert main([*simulate, "--policy", "reorder"]) == 0
    capsys.readouterr()
    data["seconds_per_unit"] = 1
    (out / "plan.json").write_text(json.dumps(data))
    assert main(["validate", str(file), str(out / "plan.json")]) != 0
    assert "INVALID" in capsys.readouterr().out
    assert yaml.safe_load(file.read_text()).get("margin", 0.01) == 0.01
    assert main(["solve", str(file), "--margin", "-1"]) != 0
    assert "margin" in capsys.readouterr().err
