import csv
import itertools
import json
import math

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.export.plans import door_plan, straight
from tests.handmade import write_map
from up_samp.cli import main
from up_samp.export import FORMATS, export_plan
from up_samp.export.steps import pieces_of, wrapped
from up_samp.export.vda5050 import nurbs
from up_samp.io import write_plan
from up_samp.io.precision import PRECISION
from up_samp.model import ProblemError, UnsupportedError


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_tables_hold_the_plan_in_seconds(tmp_path):
    schedule, trajectories, changes = export_plan(door_plan(), "csv", tmp_path)
    assert [r["activity"] for r in rows(schedule)] == ["go_r0", "open_door_r0", "back_r0", "go_r1"]
    assert (rows(schedule)[1]["start"], rows(schedule)[1]["end"]) == ("8", "10")
    assert rows(schedule)[0]["drives"] == "r0"
    samples = [s for m in door_plan()["motions"] for s in m["samples"]]
    told = [[float(r[k]) for k in ("t", "x", "y", "theta")] for r in rows(trajectories)]
    assert told == samples
    assert rows(changes)[0]["object"] == "door"
    assert float(rows(changes)[0]["t"]) == 10


def test_pandas_reads_tables_as_numbers(tmp_path):
    pandas = pytest.importorskip("pandas")
    schedule, trajectories, changes = map(
        pandas.read_csv, export_plan(door_plan(), "csv", tmp_path)
    )
    assert schedule[["start", "end"]].dtypes.map(pandas.api.types.is_numeric_dtype).all()
    numbers = trajectories[["t", "x", "y", "theta"]]
    assert numbers.dtypes.map(pandas.api.types.is_numeric_dtype).all()
    assert not numbers.isna().any().any()
    driven = trajectories[trajectories.activity == "go_r1"]
    assert driven.t.is_monotonic_increasing
    assert driven.x.iloc[-1] == 11.0
    assert changes.t.tolist() == [10.0]


def test_tables_tell_flyers_and_drivers_in_one_form(tmp_path):
    plan = door_plan()
    flight = [[t, 0.5 + t, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0] for t in (0.5, 7.5)]
    plan["motions"][0]["samples"] = flight
    _, trajectories, changes = export_plan(plan, "csv", tmp_path)
    table = rows(trajectories)
    assert table[1]["z"] == "3.0"
    back = next(r for r in table if r["activity"] == "go_r1")
    turned = 2 * math.atan2(float(back["qz"]), float(back["qw"]))
    assert turned == pytest.approx(math.pi)
    assert rows(changes)[0]["qw"] == "1.0"


def test_a_recording_can_be_read_back(tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader")
    plan = door_plan()
    plan["map"]["yaml"] = str(write_map(tmp_path))
    (file,) = export_plan(plan, "mcap", tmp_path)
    read = [
        (m.channel.topic, m.log_time_ns / 1e9, m.ros_msg) for m in reader.read_ros2_messages(file)
    ]
    topics = {topic for topic, _, _ in read}
    assert topics == {"/map", "/tf", "/footprints", "/activities", "/r0/path", "/r1/path"}
    grid = next(m for topic, _, m in read if topic == "/map")
    assert len(grid.data) == grid.info.width * grid.info.height
    assert {0, 100} <= set(grid.data)
    where = {
        (round(time, 3), t.child_frame_id): t.transform.translation
        for topic, time, m in read
        if topic == "/tf"
        for t in m.transforms
    }
    assert where[0.0, "r0"].x == pytest.approx(1.0)
    assert where[9.9, "door"].y == pytest.approx(2.0)
    assert where[10.0, "door"].y == pytest.approx(9.0)
    assert where[24.0, "r1"].x == pytest.approx(11.0)
    shown = {t: [k.text for k in m.markers] for topic, t, m in read if topic == "/activities"}
    assert shown[8.0] == ["open door", "", ""]
    assert shown[24.0] == ["", "", ""]


@given(st.integers(2, 30), st.integers(0, 2**32 - 1))
def test_a_polyline_of_an_order_stays_near_all_points(count, seed):
    points = np.cumsum(np.random.default_rng(seed).normal(size=(count, 2)), axis=0) / 30
    told = nurbs(points)
    chosen = np.array([(p["x"], p["y"]) for p in told["controlPoints"]])
    assert len(told["knotVector"]) == len(chosen) + 2
    assert chosen[[0, -1]] == pytest.approx(points[[0, -1]], abs=1e-6)
    for point in points:
        gaps = []
        for a, b in itertools.pairwise(chosen):
            span = max(float((b - a) @ (b - a)), 1e-300)
            foot = a + np.clip((point - a) @ (b - a) / span, 0, 1) * (b - a)
            gaps.append(float(np.hypot(*(point - foot))))
        assert min(gaps) <= PRECISION.nurbs + 2e-6


def test_pieces_end_where_the_direction_changes():
    there, back = straight(0.0, 5.0, 0.0, 4.0), straight(5.0, 8.0, 4.0, 2.0)
    motion = {"activity": "go", "object": "r", "samples": there + back[1:]}
    first, second = pieces_of(motion)
    assert (first.direction, second.direction) == ("forward", "backward")
    assert first.length == pytest.approx(4.0)
    assert second.length == pytest.approx(2.0)
    assert first.rows[-1][1] == second.rows[0][1] == 4.0


def test_pieces_leave_rests_out_and_know_turns():
    samples = [[0, 0, 0, 0], [1, 0, 0, 1], [2, 0, 0, 1], [3, 0, 1, 1], [4, 0, 1, 1]]
    found = pieces_of({"activity": "go", "object": "r", "samples": samples})
    assert [p.direction for p in found] == ["turn", "any"]


def test_pieces_refuse_flights():
    flight = [[t, 0, 0, t, 0, 0, 0, 1] for t in (0.0, 1.0)]
    with pytest.raises(UnsupportedError, match="'up' moves 'drone' in space"):
        pieces_of({"activity": "up", "object": "drone", "samples": flight})


@pytest.mark.parametrize("angle", [0.0, math.pi, -math.pi, 3 * math.pi, 1e3, -7.0])
def test_wrapped_angles_point_the_same_way(angle):
    assert -math.pi <= wrapped(angle) <= math.pi
    assert math.cos(wrapped(angle) - angle) == pytest.approx(1.0, abs=1e-9)


def test_unknown_formats_are_named(tmp_path):
    with pytest.raises(ProblemError, match="'xml'; known are csv"):
        export_plan(door_plan(), "xml", tmp_path)


def test_the_command(tmp_path, capsys):
    plan = write_plan(tmp_path / "plan.json", door_plan())
    assert main(["export", str(plan), "--to", "csv", "--out", str(tmp_path / "out")]) == 0
    written = capsys.readouterr().out.split()
    assert len(written) == 3
    assert set(FORMATS) >= {"csv", "mcap"}


def test_a_folder_may_be_named_by_text(tmp_path):
    files = export_plan(door_plan(), "csv", str(tmp_path / "here"))
    assert all(file.is_file() for file in files)
    with pytest.raises(ProblemError, match="is a file; name a folder"):
        export_plan(door_plan(), "csv", str(files[0]))


def test_states_of_an_rmf_fleet_say_where_each_robot_is_every_second(tmp_path):
    plan = door_plan()
    plan["words"] = {"actions": {"go_r0": {"type": "pick", "parameters": {"for": "o1"}}}}
    (file,) = export_plan(plan, "rmf", tmp_path)
    updates = [json.loads(line) for line in file.read_text().splitlines()]
    assert {u["type"] for u in updates} == {"fleet_state_update"}
    states = [u["data"]["robots"] for u in updates]
    assert {frozenset(s) for s in states} == {frozenset({"r0", "r1"})}
    times = [s["r0"]["unix_millis_time"] for s in states]
    end = 1000 * plan["makespan"] * plan["seconds_per_unit"]
    assert times == [*range(0, int(end), 1000), round(end)]
    last = {m["object"]: m["samples"][-1] for m in plan["motions"]}
    for name, (_, *pose) in last.items():
        there = states[-1][name]["location"]
        assert [there["x"], there["y"], there["yaw"]] == pytest.approx(pose)
    begun = plan["motions"][0]["samples"][0][0]
    first = states[math.ceil(begun)]["r0"]
    assert (first["status"], first["task_id"]) == ("working", "o1")
    assert {s["r1"]["status"] for s in states} == {"idle", "working"}
    state = jsonschema.Draft202012Validator(RMF_STATE)
    for one in (robot for s in states for robot in s.values()):
        state.validate(one)


RMF_STATE = {
    "type": "object",
    "properties": {
        "name": {"type": "string"},
        "status": {"enum": ["idle", "charging", "working"]},
        "task_id": {"type": "string"},
        "unix_millis_time": {"type": "integer"},
        "location": {
            "type": "object",
            "properties": {
                "map": {"type": "string"},
                **{key: {"type": "number"} for key in ("x", "y", "yaw")},
            },
            "required": ["map", "x", "y", "yaw"],
        },
        "issues": {"type": "array", "maxItems": 0},
    },
    "additionalProperties": False,
}
"""What ``robot_state.json`` of ``rmf_api_msgs`` asks of what is written."""
