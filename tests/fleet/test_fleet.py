"""``Fleet`` and problem files: one code path, errors that say where, plans that are valid."""

import itertools
import json
import random
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from unified_planning.model.motion import SchedulingMotionProblem

import up_samp
from up_samp.cli import main
from up_samp.fleet import Fleet, FleetError, files, read_problem_file, write_problem_file
from up_samp.fleet.checks import Level, check_fleet
from up_samp.fleet.files import PROBLEM, json_schema, write_starter
from up_samp.fleet.fleet import solve_problem
from up_samp.model import ProblemError
from up_samp.validation import validate_plan

MAPS = Path(__file__).parents[2] / "examples" / "maps"


def two_rooms(**options):
    fleet = Fleet(MAPS / "two_rooms.yaml", **options)
    fleet.add_robot_type(
        "agv", (1.2, 0.8), turning_radius=0.8, v_max=2.0, a_max=0.5, reverse_cost=1
    )
    fleet.add_place("home", 3, 3)
    fleet.add_place("dock", 8, 3)
    fleet.add_place("button", 11, 9)
    fleet.add_place("shelfA", 25, 11)
    fleet.add_place("shelfB", 25, 5)
    fleet.add_robot("r1", "agv", "home", end="home")
    fleet.add_door("gate", (1, 3.8), (15, 4, 0), (15, 8, 0), opened_from="button", seconds=2)
    return fleet


def test_a_fleet_is_solved_by_ordinary_engines_and_validators(tmp_path):
    fleet = two_rooms()
    fleet.add_order("o1", ["shelfA", "shelfB"], {"at": "dock", "service": 3})
    assert isinstance(fleet.problem, SchedulingMotionProblem)
    result = fleet.solve(optimal=True)
    assert result.status == "SOLVED_OPTIMALLY", result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    names = [a["name"] for a in result.data["activities"]]
    assert [n.rsplit("_r1")[0] for n in names if not n.startswith("move")] == [
        "open_gate", "pick_o1", "deliver_o1",
    ]  # fmt: skip
    # nothing is lost between moves and work: each begins as the one before it ends
    times = sorted((a["start"], a["end"]) for a in result.data["activities"])
    assert all(end == start for (_, end), (start, _) in itertools.pairwise(times))
    assert result.makespan == times[-1][1]
    for file in result.save(tmp_path):
        assert file.stat().st_size > 1000
    assert result.show(tmp_path / "page", browser=False).is_file()
    assert "no plan can take less than" in result.explain()


def test_unknown_engines_are_refused_before_anything_is_solved():
    class Unread:
        problem = None

    with pytest.raises(ProblemError, match=r"no engine 'samp-refine\[gurobi\]'; there are"):
        solve_problem(Unread(), 10, {"engine": "gurobi"})


def test_the_file_says_what_the_methods_say(tmp_path):
    fleet = two_rooms(name="same", seconds_per_unit=0.5)
    fleet.add_resource("lift", 2)
    fleet.add_zone("wet", [(20, 1), (22, 1), (22, 3)], keep_out="agv")
    fleet.add_order("o1", "shelfA", {"at": "dock", "window": (0, 300)}, priority=2)
    fleet.add_task("clean", "shelfB", duration=5, after="o1", resources="lift")
    for ending in ("yaml", "json"):
        file = fleet.save(tmp_path / f"problem.{ending}")
        again = Fleet.from_file(file)
        assert str(again.problem) == str(fleet.problem)
        assert again.records.orders == fleet.records.orders
    assert json.loads(file.read_text())["format"] == "up-samp-problem"


def test_errors_of_methods_name_the_thing_and_what_to_do():
    fleet = two_rooms()
    with pytest.raises(FleetError, match="no place 'shelfX'; did you mean 'shelfA'"):
        fleet.add_order("o1", "shelfX", "dock")
    assert fleet.records.orders == ()
    with pytest.raises(FleetError, match="needs 'lift', which no robot has"):
        fleet.add_order("o1", "shelfA", "dock", skills="lift")
    with pytest.raises(FleetError, match=r"orders\[0\].colour: there is no such key"):
        fleet.add_order("o1", "shelfA", "dock", colour="red")
    with pytest.raises(FleetError, match=r"robot_types.b.battery: should be a table"):
        fleet.add_robot_type("b", (1, 1), battery=100)
    with pytest.raises(FleetError, match=r"orders\[0\].attached: should be a table"):
        fleet.add_order("o1", "shelfA", "dock", attached=(1, 1))
    with pytest.raises(FleetError, match="is there already"):
        fleet.add_place("home", 1, 1)
    with pytest.raises(FleetError, match=r"the name is taken by places\.home"):
        fleet.add_resource("home")
    with pytest.raises(FleetError, match="no robot that may do it can carry 2 item"):
        fleet.add_order("o1", "shelfA", "dock", load={"item": 2})
    with pytest.raises(FleetError, match="penalty"):
        fleet.add_order("o1", "shelfA", "dock", optional=True)
    with pytest.raises(FleetError, match="too short for 20 s"):
        fleet.add_task("t", "shelfA", duration=20, window=(0, 10))
    with pytest.raises(FleetError, match="give each a place of its own"):
        fleet.add_robot("r2", "agv", "home")


FAULTY = """\
format: up-samp-problem
version: 1
map: m.yaml
robot_types: {agv: {footprint: [1.2], v_max: fast}}
robots: {r1: {type: agv, start: home}}
places:
  home: [3, 3, 0]
  dock: [3, 3]
"""


def test_errors_of_files_give_file_line_and_place(tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text(FAULTY)
    with pytest.raises(FleetError) as caught:
        read_problem_file(file)
    lines = str(caught.value).splitlines()
    assert lines[0].startswith(f"{file}:4: robot_types.agv.footprint: give [length, width]")
    assert lines[1].startswith(f"{file}:4: robot_types.agv.v_max: ")
    assert lines[2] == f"{file}:8: places.dock: a pose is [x, y, theta]"
    file.write_text(FAULTY.replace("[3, 3]", "3, 3").replace("robots:", "robot:"))
    with pytest.raises(FleetError, match=r"places.dock: a pose is") as caught:
        read_problem_file(file)
    assert "robot: there is no such key; did you mean 'robots'?" in str(caught.value)
    good = FAULTY.replace("[1.2], v_max: fast", "[1.2, 1]").replace("[3, 3]", "[6, 3, 0]")
    file.write_text(good + "orders:\n  - id: o1\n    pickup: docks\n    delivery: home\n")
    with pytest.raises(FleetError, match=r"p.yaml:11: orders\[0\].pickup: no place 'docks'; did"):
        read_problem_file(file)


def test_every_single_damage_is_told_with_a_line(tmp_path):
    """Whatever one value of a good file is replaced by, the answer is records or a FleetError."""
    data = yaml.safe_load(PROBLEM)
    rng = random.Random(4)
    refused = 0
    for _ in range(150):
        damaged = json.loads(json.dumps(data))
        node, parent, key = damaged, None, None
        while isinstance(node, dict | list) and node and rng.random() < 0.85:
            parent, key = (
                node,
                rng.choice(list(node) if isinstance(node, dict) else range(len(node))),
            )
            node = parent[key]
        if parent is None:
            continue
        parent[key] = rng.choice([None, -1, "nonsense", [], {}, [1], {"a": 1}, True, 1e400, 0])
        file = tmp_path / "p.json"
        file.write_text(yaml.safe_dump(damaged))
        said = _complaint(file)
        refused += bool(said)
        assert all(line.startswith(f"{file}:") for line in said.splitlines())
    assert refused > 80


def _complaint(file):
    try:
        read_problem_file(file)
    except FleetError as error:
        return str(error)
    return ""


def test_alias_bombs_and_odd_yaml_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "FILE_LIMITS", replace(files.FILE_LIMITS, file_bytes=200_000))
    file = tmp_path / "p.yaml"
    levels = ["a: &a0 [x, x, x, x, x, x, x, x, x]"]
    levels += [f"b{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 10)]
    for text, what in (
        ("\n".join(levels), "too large"),
        ("a: &a [*a]", "too large|nested"),
        ("a: 1\na: 2", "there twice"),
        ("1: 2", "must be text"),
        ("a: !!python/object:os.system {}", "p.yaml"),
        ("[" * 5000, "nested|not readable"),
        ("a: [1", "not readable"),
        ("- 1", "keys such as"),
    ):
        file.write_text(text)
        with pytest.raises(FleetError, match=what):
            read_problem_file(file)


def test_the_schema_is_that_of_the_reader(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    shipped = Path(up_samp.__file__).parent / "fleet" / "problem.schema.json"
    assert json.loads(shipped.read_text()) == json_schema(), "run scripts/schema.py"
    validator = jsonschema.Draft202012Validator(json_schema())
    jsonschema.Draft202012Validator.check_schema(json_schema())
    good = yaml.safe_load(PROBLEM) | {"map": str(MAPS / "two_rooms.yaml")}
    assert not list(validator.iter_errors(good))
    assert read_problem_file(_written(tmp_path, good))
    for change in (
        {"colour": 1},
        {"places": {"home": [1, 2]}},
        {"orders": [{"id": "o", "pickup": "a"}]},
        {"robot_types": {"agv": {"footprint": [1, -1]}}},
        {"version": 2},
    ):
        bad = good | change
        assert list(validator.iter_errors(bad)), change
        with pytest.raises(FleetError):
            read_problem_file(_written(tmp_path, bad))


def _written(folder, data):
    file = folder / "problem.json"
    file.write_text(json.dumps(data))
    return file


def test_new_check_and_solve(tmp_path, capsys):
    folder = tmp_path / "mine"
    assert main(["new", str(folder)]) == 0
    assert main(["new", str(folder)]) == 2
    assert "is there already" in capsys.readouterr().err
    file = folder / "problem.yaml"
    assert main(["check", str(file)]) == 0
    out = capsys.readouterr().out
    assert "only once door 'gate' is open" in out
    assert "2 robots, 3 orders, 0 tasks: 0 errors, 0 warnings" in out
    assert (folder / "problem.check.png").stat().st_size > 5000
    command = ["solve", str(file), "--first", "--out", str(tmp_path / "plan")]
    assert main(command) == 0
    assert "valid: the independent validator found nothing wrong" in capsys.readouterr().out
    assert json.loads((tmp_path / "plan" / "plan.json").read_text())["makespan"] > 60


def test_check_tells_what_is_in_walls_and_what_is_out_of_reach(tmp_path, capsys):
    write_starter(tmp_path)
    file = tmp_path / "problem.yaml"
    text = file.read_text().replace("shelf1: [25, 4, 0]", "shelf1: [29.6, 4, 0]")
    text = text.replace("dockB: [9, 13, 0]", "dockB: [3.5, 12.6, 0]")
    file.write_text(text + "zones: {gap: {polygon: [[17, 0.1], [18, 0.1], [18, 15.9], [17, 15.9]],"
                    " keep_out: agv}}\n")  # fmt: skip
    findings = check_fleet(read_problem_file(file), tmp_path)
    said = [str(f) for f in findings]
    assert any("shelf1" in s and "stand in a wall" in s for s in said)
    assert any("overlaps" in s and "dockB" in s and "home2" in s for s in said)
    errors = {f.subject for f in findings if f.level is Level.ERROR}
    assert {"o1", "o2", "o3", "shelf1"} <= errors
    assert main(["check", str(file)]) == 1


def test_check_tells_degrees_and_ends_that_are_shared():
    fleet = two_rooms()
    fleet.add_place("turned", 5, 12, -90)
    fleet.add_place("home2", 3, 13)
    fleet.add_robot("r2", "agv", "home2", end="home")
    fleet.add_task("t", "turned", duration=1)
    said = [str(f) for f in fleet.check()]
    assert "error: home: robots 'r1' and 'r2' have to end here; give each its own end" in said
    assert any("turned: its heading -90 is more than a full turn: headings are in rad" in s
               for s in said)  # fmt: skip


def test_the_package_comes_without_it(tmp_path):
    code = (
        "import up_samp, sys; print('pydantic' in sys.modules); up_samp.Fleet; print(up_samp.Fleet)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["False", "<class 'up_samp.fleet.fleet.Fleet'>"]


def test_what_is_written_can_be_read(tmp_path):
    write_starter(tmp_path)
    records = read_problem_file(tmp_path / "problem.yaml")
    assert read_problem_file(write_problem_file(tmp_path / "again.yaml", records)) == records
    shutil.copy(tmp_path / "again.yaml", tmp_path / "third.yml")
    assert read_problem_file(tmp_path / "third.yml") == records


def test_an_unsolvable_one_is_explained(tmp_path, capsys):
    file = MAPS.parent / "unsolvable.yaml"
    assert main(["check", str(file), "--out", str(tmp_path / "a.png")]) == 1
    out = capsys.readouterr().out
    assert "can never get there from 'home' (proven): nobody can open 'gate'" in out
    assert "error: o1: no robot that may do it (r1) can reach its pickup" in out
    assert main(["solve", str(file)]) == 1
    assert "nobody can open 'gate'" in capsys.readouterr().out
    result = Fleet.from_file(file).solve()
    assert result.plan is None
    assert "nobody can open 'gate'" in result.explain()
