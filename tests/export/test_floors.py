"""Plans on several floors in other formats: each pose says which map it is on, or how high."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from up_samp.execution import with_dependencies
from up_samp.export import export_plan
from up_samp.fleet import Fleet
from up_samp.geometry import write_map

SCHEMAS = Path(__file__).parents[3] / "shared" / "data" / "vda5050"


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("house")
    low, high = (
        str(write_map(folder, name, np.zeros((80, 120), dtype=bool), 0.1))
        for name in ("low", "high")
    )
    fleet = Fleet(low)
    fleet.add_floor("first", high, height=4.0)
    fleet.add_lift("lift", {"ground": (9, 4, 0), "first": (10, 4, 0)}, seconds=5)
    fleet.add_robot_type("cart", (0.8, 0.6), model="omni")
    fleet.add_place("home", 3, 4)
    fleet.add_place("ward", 4, 5, floor="first")
    fleet.add_robot("r", "cart", "home")
    fleet.add_task("look", at="ward", duration=2)
    result = fleet.solve(timeout=60, first_plan=True)
    assert result.plan is not None, result.explain()
    return with_dependencies(fleet.problem, result.data)


def test_tables_say_on_which_floor_a_pose_is(plan, tmp_path):
    export_plan(plan, "csv", tmp_path / "out")
    with (tmp_path / "out" / "trajectories.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    floors = {row["activity"]: row["map"] for row in rows}
    assert "low" in next(m for a, m in floors.items() if a.startswith("move_r_home"))
    assert "high" in next(m for a, m in floors.items() if a.endswith("_to_ward"))
    with (tmp_path / "out" / "changes.csv").open(encoding="utf-8") as file:
        (ride,) = csv.DictReader(file)
    assert "high" in ride["map"]
    assert len({row["map"] for row in rows}) == 2


@pytest.mark.parametrize(("form", "schema"), [("vda5050", "2.1.0"), ("vda5050-3", "main")])
def test_orders_lead_from_map_to_map_by_the_lift(plan, tmp_path, form, schema):
    export_plan(plan, form, tmp_path)
    messages = [json.loads(f.read_text()) for f in sorted((tmp_path / "r").glob("*.json"))]
    file = SCHEMAS / schema / "order.schema"
    if file.exists():
        jsonschema = pytest.importorskip("jsonschema")
        for message in messages:
            jsonschema.Draft202012Validator(json.loads(file.read_text())).validate(message)
    nodes = {n["nodeId"]: n["nodePosition"] for m in messages for n in m["nodes"]}
    maps = [p["mapId"] for p in nodes.values()]
    assert set(maps) == {"low", "high"}
    assert maps == sorted(maps, reverse=True)
    (lift,) = [p for p in nodes.values() if p["mapId"] == "high" and p["x"] == 10.0]
    assert (lift["y"], lift["theta"]) == (4.0, 0.0)
    edges = {e["edgeId"]: e for m in messages for e in m["edges"]}
    (ride,) = [e for e in edges.values() if e["actions"]]
    assert ride["actions"][0]["actionType"].startswith("ride_r")
    assert "trajectory" not in ride
    for edge in (e for e in edges.values() if "trajectory" in e):
        # each drive begins and ends where the nodes around it are
        near = [n for m in messages for n in m["nodes"]
                if abs(n["sequenceId"] - edge["sequenceId"]) == 1]  # fmt: skip
        ends = {(p["x"], p["y"]) for p in (n["nodePosition"] for n in near)}
        points = edge["trajectory"]["controlPoints"]
        assert {(round(p["x"], 3), round(p["y"], 3)) for p in (points[0], points[-1])} == {
            (round(x, 3), round(y, 3)) for x, y in ends
        }
    releases = json.loads((tmp_path / "releases.json").read_text())
    assert {Path(f).stem for f in releases["maps"].values()} == {"low", "high"}


def test_legs_say_which_map_they_are_on(plan, tmp_path):
    (file,) = (f for f in export_plan(plan, "nav2", tmp_path) if f.suffix == ".yaml")
    data = yaml.safe_load(file.read_text())
    assert set(data["maps"]) == {"low", "high"}
    legs = data["legs"]
    (ride,) = [k for k, leg in enumerate(legs) if "lands" in leg]
    assert legs[ride]["lands"]["map"] == "high"
    assert legs[ride]["lands"]["pose"]["position"] == {"x": 10.0, "y": 4.0}
    driven = [(k, leg["map"]) for k, leg in enumerate(legs) if "path" in leg]
    assert all(name == ("low" if k < ride else "high") for k, name in driven)


def test_a_recording_shows_floors_above_each_other(plan, tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader")
    (file,) = export_plan(plan, "mcap", tmp_path)
    read = [(m.channel.topic, m.ros_msg) for m in reader.read_ros2_messages(file)]
    grids = {t: m.info.origin.position.z for t, m in read if t.startswith("/map")}
    assert grids == {"/map/low": 0.0, "/map/high": 4.0}
    heights = [t.transform.translation.z for topic, m in read if topic == "/tf"
               for t in m.transforms if t.child_frame_id == "r"]  # fmt: skip
    assert {heights[0], heights[-1]} == {0.0, 4.0}
    assert heights == sorted(heights)
    (path,) = [m for topic, m in read if topic == "/r/path"]
    assert {p.pose.position.z for p in path.poses} == {0.0, 4.0}
