"""Plans on maps with frames and on several floors: files, pictures, exports, execution."""

import copy
import json
import math
import re

import numpy as np
import pytest
from jsonschema import Draft7Validator
from matplotlib.figure import Figure
from unified_planning.model.motion import SE3
from unified_planning.shortcuts import LE, OneshotPlanner

from tests.search.test_several_maps import House, hall, lifted
from up_samp.execution import Delays, Executor, dependencies_of, simulate, with_dependencies
from up_samp.execution.judge import contacts_of
from up_samp.execution.simulate import Floor, simulation_of, solve_remaining
from up_samp.export import export_plan
from up_samp.io import contradictions, plan_from_dict, read_plan, result_to_dict, write_plan
from up_samp.io.files import check_plan
from up_samp.io.floors import maps_of, side_by_side
from up_samp.model import ProblemError
from up_samp.model.frames import Frame
from up_samp.plotting import animation_html, plot_map
from up_samp.plotting.background import ground_of
from up_samp.plotting.tracks import tracks_of
from up_samp.validation import validate_plan

HIGH = Frame(4.0, 1.0, 0.3)


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A robot takes the lift to the upper floor, where another one drives across."""
    folder = tmp_path_factory.mktemp("house")
    maps = [hall(folder, "low", height=1.7), hall(folder, "high", 0.05)]
    made = House(maps, [lifted(Frame(), 0.0), lifted(HIGH, 3.0)])
    for k in range(2):
        made.pose(f"w{k}", k, 1.5, 0.85, 0.0)
        made.pose(f"lift{k}", k, 10.5, 0.85, 0.0)
    made.pose("n1", 1, 6.0, 2.0, 0.0)
    made.robot("r0", "w0")
    made.robot("r1", "n1")
    out = made.move("out", "r0", "w0", "lift0")
    ride = made.problem.add_motion_activity("ride", 7)
    ride.add_motion_effect(made.robots["r0"], made.poses["lift1"])
    back = made.move("back", "r0", "lift1", "w1")
    made.move("aside", "r1", "n1", "lift1").add_deadline(9)
    made.move("clear", "r1", "lift1", "n1")
    made.problem.add_constraint(LE(out.end, ride.start))
    made.problem.add_constraint(LE(ride.end, back.start))
    return made


@pytest.fixture(scope="module")
def solved(house):
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(house.problem, timeout=60)
    assert result.plan is not None
    return result_to_dict(house.problem, result)


def test_a_plan_file_names_maps_frames_and_heights(house, solved, tmp_path):
    assert solved["minor"] == 2
    assert [m.height for m in maps_of(solved)] == [0.0, 3.0]
    assert solved["maps"][1]["frame"] == [4.0, 1.0, 0.3]
    numbers = {m["activity"]: m["map"] for m in solved["motions"]}
    assert numbers == {"out": 0, "back": 1, "aside": 1, "clear": 1}
    assert [c["map"] for c in solved["changes"]] == [1]
    again = read_plan(write_plan(tmp_path / "plan.json", solved))
    assert again == json.loads(json.dumps(solved))
    assert contradictions(house.problem, again) == []
    assert validate_plan(house.problem, plan_from_dict(house.problem, again)).valid


def test_a_plan_fits_its_schema(solved):
    from importlib.resources import files

    schema = json.loads(files("up_samp.io").joinpath("plan.schema.json").read_text())
    assert list(Draft7Validator(schema).iter_errors(solved)) == []


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda p: p["maps"][1].update(height=4.0), "height"),
        (lambda p: p["maps"][1].update(frame=[4.0, 1.0, 0.2]), "frame"),
        (lambda p: p["maps"].pop(), "the problem's is 'low.yaml', 'high.yaml'"),
        (lambda p: p["map"].update(height=1.0), "not the first"),
        (lambda p: p["motions"][0].update(map=1), "has map 1"),
        (lambda p: p["changes"][0].update(map=0), "has map 0"),
        (lambda p: p["objects"][0].update(map=1), "has map 1"),
    ],
)
def test_contradictions_about_maps_are_named(house, solved, spoil, text):
    plan = copy.deepcopy(solved)
    spoil(plan)
    assert any(text in said for said in contradictions(house.problem, plan))


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda p: p["motions"][0].update(map=2), "no map 2"),
        (lambda p: p["motions"][0].update(map="x"), "'map'"),
        (lambda p: p["maps"][0].update(frame=[1, 2]), "'frame'"),
        (lambda p: p.update(maps={}), "'maps'"),
    ],
)
def test_wrong_maps_are_refused(solved, spoil, text):
    plan = copy.deepcopy(solved)
    spoil(plan)
    with pytest.raises(ProblemError, match=text):
        check_plan(plan, "the plan")


def test_floors_are_drawn_beside_each_other(solved):
    ground = ground_of(solved)
    left, right, bottom, top = ground.extent
    assert len(ground.floors) == 2
    free = {}
    for track in tracks_of(ground.plan):
        for leg in track.legs:
            for x, y, _ in leg.poses[:: max(1, len(leg.poses) // 9)]:
                rows, cols = ground.pixels.shape[:2]
                row = int((top - y) / (top - bottom) * rows)
                col = int((x - left) / (right - left) * cols)
                free.setdefault(leg.activity, []).append(ground.pixels[row, col].min())
    assert set(free) == {"out", "back", "aside", "clear"}
    assert min(min(v) for v in free.values()) > 240  # they drive on what is drawn as free


def test_floors_have_panels_of_their_own(solved):
    """Each with its name, its own coordinates, and the names of what is on it alone."""
    first = plot_map(solved)
    figure = first.figure
    assert len(figure.axes) == 2
    names = [ax.get_title(loc="left") for ax in figure.axes]
    assert len(set(names)) == 2
    assert "m up" in names[1]
    assert "m up" not in names[0]
    ground = ground_of(solved)
    for ax, floor in zip(figure.axes, ground.floors, strict=True):
        assert (*ax.get_xlim(), *ax.get_ylim()) == pytest.approx(floor.extent)
        ticks = zip(ax.get_xticks(), ax.get_xticklabels(), strict=True)
        assert all(float(t.get_text()) == pytest.approx(at - floor.frame.x) for at, t in ticks)
    scene = json.loads(re.search(r"const scene = (.*);\n", animation_html(solved)).group(1))
    assert [floor["name"] for floor in scene["floors"]] == names
    assert [floor["extent"] for floor in scene["floors"]] == [
        pytest.approx(floor.extent, abs=1e-3) for floor in ground.floors
    ]


def test_panels_take_the_place_of_axes_that_are_given(solved):
    left, right = Figure().subplots(1, 2)
    assert plot_map(solved, ax=left).figure is right.figure
    assert len(right.figure.axes) == 3
    assert right in right.figure.axes


def test_floors_are_apart_in_execution(house, solved):
    """Nobody on one floor waits for somebody on another."""
    apart, frames = side_by_side(solved)
    assert frames[0] != frames[1]
    assert apart["motions"][0]["samples"][0][1:] != apart["motions"][-1]["samples"][0][1:]
    full = with_dependencies(house.problem, solved)
    assert full["minor"] == 5
    graph = dependencies_of(house.problem, solved).graph
    for edge in graph.edges:
        if edge.kind == "meeting":
            assert {event.activity for event in (edge.first, edge.then)} <= {
                "back", "aside", "clear", "ride"
            }  # fmt: skip
    run = simulate(dependencies_of(house.problem, solved), solved, Delays(slow=0.5), 1)
    assert contacts_of(run.record) == []
    poses = {m["activity"]: m["samples"][-1][1:] for m in run.record["motions"]}
    wanted = {m["activity"]: m["samples"][-1][1:] for m in solved["motions"]}
    for name, pose in wanted.items():
        assert np.allclose(poses[name], pose, atol=2e-3)


def test_exports_are_in_the_frame_of_the_map(tmp_path):
    frame = Frame(30.0, -7.0, 0.5)
    made = House([hall(tmp_path, "low")], [(frame.x, frame.y, frame.yaw)])
    made.pose("w0", 0, 1.5, 1.5, 0.0)
    made.pose("e0", 0, 9.5, 1.5, 0.0)
    made.robot("r0", "w0")
    made.move("go", "r0", "w0", "e0")
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(made.problem, timeout=60)
    plan = result_to_dict(made.problem, result)
    assert plan["map"]["frame"] == [30.0, -7.0, 0.5]
    assert contradictions(made.problem, plan) == []
    plan = with_dependencies(made.problem, plan)
    export_plan(plan, "nav2", tmp_path / "nav2")
    text = "".join(p.read_text() for p in (tmp_path / "nav2").rglob("*.yaml"))
    assert "9.5" in text
    assert str(round(frame.of((9.5, 1.5, 0.0))[0], 3)) not in text


@pytest.mark.parametrize("moment", ["out", "ride", "back"])
def test_what_is_left_of_a_plan_on_floors(house, solved, moment):
    """Planned anew on either floor and in the lift: everybody goes on from where they stand."""
    executor = Executor(solved, house.problem)
    floor = Floor(executor, Delays(slow=0.3), 4)
    while executor.phase(moment).value == "waiting":
        floor.step()
    for _ in range(20):
        floor.step()
    left = executor.remaining_problem()
    plan = solve_remaining(left, seconds=60)
    assert validate_plan(left.problem, plan_from_dict(left.problem, plan)).valid
    stands = {o["name"]: (o["initial"], o.get("map", 0)) for o in plan["objects"]}
    assert stands["r0"][1] == (1 if moment == "back" else 0)
    assert stands["r1"][1] == 1
    record = simulation_of(floor, solved, "staircase", 4).record
    for name, (pose, _) in stands.items():
        mine = [m for m in record["motions"] if m["object"] == name]
        last = mine[-1]["samples"][-1]
        if name not in left.stops and mine[-1]["activity"] != "out":
            assert np.allclose(pose[:2], last[1:3], atol=2e-3)


def test_nodes_of_orders_are_in_the_frames_of_their_maps(house, solved, tmp_path):
    export_plan(with_dependencies(house.problem, solved), "vda5050", tmp_path)
    orders = [json.loads(f.read_text()) for f in sorted((tmp_path / "r0").glob("*.json"))]
    told = [n["nodePosition"] for order in orders for n in order["nodes"]]
    ends = {(p["mapId"], round(p["x"], 2), round(p["y"], 2)) for p in told}
    own = {("low", 1.5, 0.85), ("low", 10.5, 0.85), ("high", 10.5, 0.85), ("high", 1.5, 0.85)}
    assert own <= ends


def test_frames_turn_both_ways():
    frame = Frame(1.0, -2.0, 2.2)
    pose = (3.0, 4.0, -0.4)
    assert np.allclose(frame.inverse.of(frame.of(pose)), pose)
    assert np.allclose(frame.after(Frame(*pose)).of((0, 0, 0)), frame.of(pose))
    turned = SE3(0, 0, 0, 0, 0, math.sin(1.1), math.cos(1.1))
    assert np.allclose(2 * math.atan2(turned.rz, turned.rw), frame.yaw)
