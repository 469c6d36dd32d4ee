"""Every example solves, as its docstring says."""

import json
import runpy
from pathlib import Path

import pytest
from shapely.geometry import LineString, Polygon

from up_samp.cli import main

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
QUICK = {"door", "charging", "formation"}
MAPS = ROOT.parent.parent / "shared" / "data" / "maps" / "nav2"


def example_of(path):
    marks = [] if path.stem in QUICK else [pytest.mark.long]
    return pytest.param(path, id=path.stem, marks=marks)


def has_a_valid_plan(example, folder, capsys):
    assert main(["solve", str(example), "--first", "--out", str(folder)]) == 0
    assert "valid: the independent validator found nothing wrong" in capsys.readouterr().out
    plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    assert plan["makespan"] >= 1
    assert (folder / "animation.html").exists()
    return plan


@pytest.mark.parametrize("example", [example_of(e) for e in EXAMPLES if e.stem != "nav2_warehouse"])
def test_the_example_has_a_valid_plan(example, tmp_path, capsys):
    assert f"up-samp solve examples/{example.name}" in example.read_text(encoding="utf-8")
    has_a_valid_plan(example, tmp_path, capsys)


@pytest.mark.long
@pytest.mark.parametrize("name", ["depot", "tb3_sandbox"])
def test_the_example_of_a_ros_map_on_real_ones(name, tmp_path, capsys, monkeypatch):
    site = MAPS / f"{name}.yaml"
    if not site.is_file():
        pytest.skip(f"there is no map '{site}'")
    monkeypatch.setenv("ROS_MAP", str(site))
    plan = has_a_valid_plan(ROOT / "examples" / "ros_map.py", tmp_path, capsys)
    assert plan["map"]["yaml"].endswith(f"{name}.yaml")


@pytest.mark.long
def test_the_example_of_nav2s_warehouse(tmp_path, capsys, monkeypatch):
    if not (MAPS / "warehouse.yaml").is_file():
        pytest.skip(f"there is no map '{MAPS / 'warehouse.yaml'}'")
    monkeypatch.setenv("NAV2_MAPS", str(MAPS))
    has_a_valid_plan(ROOT / "examples" / "nav2_warehouse.py", tmp_path, capsys)


def test_two_robots_pass_each_other_in_the_bay(tmp_path, capsys):
    plan = has_a_valid_plan(ROOT / "examples" / "passing_place.py", tmp_path, capsys)
    highest = max(row[2] for motion in plan["motions"] for row in motion["samples"])
    assert highest > 3.0  # the corridor's middle is at 2.0 m


@pytest.mark.long
def test_carts_of_the_paint_shop_drive_through_the_gateway(tmp_path, capsys):
    example = ROOT / "examples" / "paint_shop.py"
    gateway = Polygon(runpy.run_path(str(example))["fleet"].records.zones["gateway"].polygon)
    between = gateway.intersection(LineString([(15, 0), (15, 16)]))  # where the wall is
    plan = has_a_valid_plan(example, tmp_path, capsys)
    ways = [LineString([r[1:3] for r in m["samples"]]) for m in plan["motions"]]
    assert any(way.intersects(between) for way in ways)


def test_there_are_examples():
    assert {e.stem for e in EXAMPLES} >= {
        "charging", "delays", "door", "drones", "mixed_fleet", "pallets", "passing_place",
        "nav2_warehouse", "ros_map", "shop", "swap", "traffic_rules", "warehouse",
    }  # fmt: skip
