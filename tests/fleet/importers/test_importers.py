"""Others' files become problem files that check, and solve."""

import itertools
import json
import math
import random
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml
from shapely.geometry import Point, Polygon

from tests.geometry.states import state_at
from up_samp.cli import main
from up_samp.fleet import Fleet, read_problem_file
from up_samp.fleet.fields import FILE_LIMITS
from up_samp.fleet.importers import Options, import_file, map_from_polygons
from up_samp.fleet.importers.layouts import LaneEdge, lane_zones, preferred_lanes
from up_samp.geometry import load_map
from up_samp.model import ProblemError, UnsupportedError
from up_samp.validation import validate_plan

SAMPLES = Path(__file__).parent / "samples"
SHARED = Path(__file__).parents[4] / "shared" / "data"


def imported(name, folder, **options):
    found = import_file(SAMPLES / name, folder, None, Options(**options))
    return read_problem_file(found.problem), found


def grid(folder, name="map.yaml"):
    return load_map(folder / name)


def test_a_movingai_map_keeps_its_cells(tmp_path):
    found = import_file(SAMPLES / "small.map", tmp_path, None, Options(cell=0.5))
    site = grid(tmp_path)
    assert site.size == pytest.approx((5.0, 3.0))
    # third cell from the left in the second row from the top, and the tree right of the middle
    assert state_at(site, 1.25, 2.25) == "free"
    assert state_at(site, 2.75, 2.25) == "occupied"
    assert state_at(site, 2.75, 1.25) == "free"
    assert found.problem.read_text().startswith("# a cell is 0.5 m")


@pytest.mark.long
def test_a_scenario_is_solved(tmp_path):
    records, _ = imported("small.scen", tmp_path, robots=2)
    assert records.places["start0"].pose == (1.5, 4.5, 0.0)
    assert records.places["goal1"].pose == (1.5, 1.5, 0.0)
    fleet = Fleet.from_file(tmp_path / "problem.yaml")
    result = fleet.solve(first_plan=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    ends = {m["object"]: m["samples"][-1][1:3] for m in result.data["motions"]}
    assert ends["r0"] == pytest.approx([8.5, 4.5])


def test_a_problem_of_the_league(tmp_path):
    records, _ = _league(tmp_path)
    assert [o.id for o in records.orders] == ["t0", "t1"]
    assert [t.id for t in records.tasks] == ["t2"]
    # location 31 is row 3, column 1: the third row from below
    assert records.places[records.orders[0].pickup.at[0]].pose == (1.5, 2.5, 0.0)
    assert main(["check", str(tmp_path / "problem.yaml")]) == 0


def _league(folder):
    found = import_file(SAMPLES / "small.json", folder, "league")
    return read_problem_file(found.problem), found


def test_the_leagues_own_problem(tmp_path):
    source = SHARED / "maps" / "lorr" / "room-example_150.json"
    if not source.is_file():
        pytest.skip(f"the League's files are not in {source.parent}")
    found = import_file(source, tmp_path, "league", Options(robots=3, jobs=2))
    records = read_problem_file(found.problem)
    assert (len(records.robots), len(records.orders)) == (3, 2)
    assert grid(tmp_path).size == (64.0, 64.0)


def test_maps_of_the_league_mark_ends_of_tasks(tmp_path):
    source = SHARED / "maps" / "lorr" / "warehouse_long_corridor_large.map"
    if not source.is_file():
        pytest.skip(f"the League's files are not in {source.parent}")
    import_file(source, tmp_path, None, Options(cell=0.25))
    text = source.read_text().split("map\n", 1)[1]
    free = sum(text.count(c) for c in ".SE")
    assert int((~grid(tmp_path).blocked).sum()) == free


def test_marks_of_the_league_are_free_floor(tmp_path):
    (tmp_path / "x.map").write_text("type octile\nheight 1\nwidth 4\nmap\n.SE@\n")
    import_file(tmp_path / "x.map", tmp_path / "out")
    states = [state_at(grid(tmp_path / "out"), x + 0.5, 0.5) for x in range(4)]
    assert states == ["free", "free", "free", "occupied"]


def test_stations_and_nodes_of_a_lif_layout(tmp_path):
    records, found = imported("small.lif.json", tmp_path)
    assert records.places["Rack_7"].pose == (0.0, 0.0, 1.57)
    assert records.places["n2"].pose == (8.0, 0.0, 0.0)
    assert records.places["node4711"].pose == (8.0, 5.0, 3.14)
    assert any("no walls" in note for note in found.notes)
    assert state_at(grid(tmp_path), 8.0, 5.0) == "free"
    schema = SHARED / "lif" / "LIF.schema"
    if schema.is_file():
        import jsonschema

        jsonschema.validate(
            json.loads((SAMPLES / "small.lif.json").read_text()), json.loads(schema.read_text())
        )
    maps = Path(__file__).parents[3] / "examples" / "maps"
    again = import_file(
        SAMPLES / "small.lif.json", tmp_path / "b", None, Options(map=maps / "corridor.yaml")
    )
    assert grid(tmp_path / "b").digest == load_map(maps / "corridor.yaml").digest
    assert not any("no walls" in note for note in again.notes)
    layout = json.loads((SAMPLES / "small.lif.json").read_text())
    layout["layouts"].append({**layout["layouts"][0], "layoutId": "upstairs"})
    (tmp_path / "two.lif.json").write_text(json.dumps(layout))
    notes = import_file(tmp_path / "two.lif.json", tmp_path / "c").notes
    assert "other layouts were left out: upstairs" in notes


def test_an_rmf_building(tmp_path):
    records, found = imported("small.building.yaml", tmp_path)
    # 400 pixels are 20 m: 0.05 m each; y points up
    assert records.places["tiny_charger"].pose == pytest.approx((8.0, -10.0, 0.0))
    assert records.places["tiny_charger"].park == 1
    assert records.places["tiny_charger"].charger.per_second == 0.05
    assert records.places["pantry"].charger is None
    assert any("once robots have a battery: tiny_charger" in note for note in found.notes)
    assert records.places["pantry"].park is None
    site = grid(tmp_path)
    assert state_at(site, 15.0, -6.0) == "occupied"
    assert state_at(site, 15.0, -10.0) == "free"  # the doorway
    assert state_at(site, 4.0, -10.0) in ("occupied", "outside")


def test_doors_of_an_rmf_building_open_as_robots_come(tmp_path):
    records, found = imported("small.building.yaml", tmp_path)
    door = records.automatic_doors["main_door"]
    assert door.opens_in == 3
    # it turns about its first end, (15, -9), by 90 degrees, from (15, -11) to (17, -9)
    area = Polygon(door.polygon)
    for x, y, inside in ((15, -10, True), (16.9, -9, True), (16.2, -10.2, True), (13, -10, False)):
        assert area.contains(Point(x, y)) is inside
    assert area.area == pytest.approx(math.pi, rel=0.15)
    assert any("open as robots come, in 3 s: say opens_in: main_door" in n for n in found.notes)
    fleet = Fleet.from_file(found.problem)
    fleet.add_robot("r", "agv", "tiny_charger")
    fleet.add_task("t", "pantry", duration=1)
    assert [str(f) for f in fleet.check() if f.level.value == "error"] == []


@pytest.mark.parametrize("seed", range(2))
def test_an_rmf_building_in_metres_and_listed_otherwise_is_the_same(tmp_path, seed):
    """With holes in its floor, over which nobody drives."""
    rng = random.Random(f"rmf {seed}")
    building = yaml.safe_load((SAMPLES / "small.building.yaml").read_text())
    level = building["levels"]["L1"]
    x, y, size = rng.randint(180, 240), rng.randint(120, 180), rng.choice((20, 40))
    corners = [(x, y), (x + size, y), (x + size, y + size), (x, y + size)]
    level["holes"] = [
        {"parameters": {}, "vertices": [len(level["vertices"]) + k for k in range(4)]}
    ]
    level["vertices"] += [[a, b, 0, ""] for a, b in corners]
    order = rng.sample(range(len(level["vertices"])), len(level["vertices"]))
    at = {old: new for new, old in enumerate(order)}
    other = json.loads(json.dumps(level))
    other["vertices"] = [
        [0.05 * v[0], -0.05 * v[1], *v[2:]] for v in map(level["vertices"].__getitem__, order)
    ]
    for key in ("walls", "lanes", "doors"):
        other[key] = [[at[a], at[b], *rest] for a, b, *rest in other[key]]
        rng.shuffle(other[key])
    for key in ("floors", "holes"):
        for area in other[key]:
            area["vertices"] = [at[k] for k in area["vertices"]]
    del other["measurements"]
    metres = {"coordinate_system": "cartesian_meters", "levels": {"L1": other}}
    read = []
    for name, told in (("pixels", building), ("metres", metres)):
        (tmp_path / f"{name}.building.yaml").write_text(yaml.safe_dump(told))
        found = import_file(tmp_path / f"{name}.building.yaml", tmp_path / name)
        records, site = read_problem_file(found.problem), grid(tmp_path / name)
        read.append((site.digest, records.places, records.automatic_doors, records.lanes))
        hole, beside = (0.05 * (x + size / 2), -0.05 * (y + size / 2)), (0.05 * (x - 5), -0.05 * y)
        assert state_at(site, *hole) == "occupied"
        assert state_at(site, *beside) == "free"
    assert read[0] == read[1]
    metres["coordinate_system"] = "wgs84"
    (tmp_path / "x.building.yaml").write_text(yaml.safe_dump(metres))
    with pytest.raises(UnsupportedError, match=r"x\.building\.yaml: coordinates of 'wgs84'"):
        import_file(tmp_path / "x.building.yaml", tmp_path / "x")


def test_robots_are_where_an_rmf_building_spawns_them(tmp_path):
    building = yaml.safe_load((SAMPLES / "small.building.yaml").read_text())
    building["levels"]["L1"]["vertices"][6][4]["spawn_robot_name"] = [1, "tiny bot"]
    (tmp_path / "x.building.yaml").write_text(yaml.safe_dump(building))
    records = read_problem_file(import_file(tmp_path / "x.building.yaml", tmp_path / "out").problem)
    assert {name: r.start for name, r in records.robots.items()} == {"tiny_bot": "tiny_charger"}


def test_edges_and_lanes_with_rules_are_zones(tmp_path):
    records, found = imported("small.lif.json", tmp_path)
    assert not records.lanes
    (zone,) = [z for z in records.zones.values() if z.one_way is not None]
    assert zone.one_way == 0.0
    assert sorted(zone.polygon) == [(0.5, -0.5), (0.5, 0.5), (7.5, -0.5), (7.5, 0.5)]
    assert any("lanes with rules are zones" in note for note in found.notes)
    text = (SAMPLES / "small.building.yaml").read_text()
    both = "[6, 7, {bidirectional: [4, true]}]"
    for lanes, ways, preferred in (
        (both, [], 1),
        ("[6, 7, {bidirectional: [4, false]}]", [0.0], 0),
        ("[7, 6, {}]", [math.pi], 0),
        ("[6, 7, {}]\n      - [7, 6, {}]", [], 1),
        ("[6, 7, {bidirectional: [4, true], speed_limit: [3, 0.4]}]", [None], 1),
    ):
        source = tmp_path / "other.building.yaml"
        source.write_text(text.replace(both, lanes))
        records = read_problem_file(import_file(source, tmp_path / "out").problem)
        found_ways = [z.one_way for z in records.zones.values()]
        assert len(records.lanes) == preferred
        assert found_ways == pytest.approx(ways) if ways != [None] else found_ways == ways
        speeds = [z.v_max for z in records.zones.values()]
        assert speeds == ([0.4] if ways == [None] else [None] * len(ways))


def test_edges_driven_both_ways_are_preferred_from_fork_to_fork():
    edges = [
        LaneEdge("a", (0.0, 0.0), (4.0, 0.0)),
        LaneEdge("b", (4.0, 0.0), (8.0, 1.0)),
        LaneEdge("b_back", (8.0, 1.0), (4.0, 0.0)),
        LaneEdge("c", (8.0, 1.0), (8.0, 6.0), v_max=0.5),
        LaneEdge("d", (8.0, 1.0), (12.0, 1.0)),
        LaneEdge("e", (12.0, 1.0), (12.0, 1.0)),
        LaneEdge("f", (0.0, 0.0), (0.0, 6.0), True),
    ]
    expected = {
        ((0.0, 0.0), (4.0, 0.0), (8.0, 1.0)),
        ((8.0, 1.0), (8.0, 6.0)),
        ((8.0, 1.0), (12.0, 1.0)),
    }
    for order in (edges, edges[::-1], edges[3:] + edges[:3]):
        lanes = preferred_lanes(order, {"way1", "a"})
        points = {tuple(map(tuple, lane["points"])) for lane in lanes.values()}
        assert {min(line, line[::-1]) for line in points} == expected
        assert len(lanes) == 3
        assert not {"way1", "a"} & set(lanes)
        assert lanes == preferred_lanes(edges, {"way1", "a"})


def test_long_lanes_are_cut_to_what_records_take():
    points = [(0.01 * k, (k % 2) * 0.01) for k in range(2 * FILE_LIMITS.corners + 5)]
    edges = [LaneEdge(f"e{k}", *ends) for k, ends in enumerate(itertools.pairwise(points))]
    lanes = [lane["points"] for lane in preferred_lanes(edges, ()).values()]
    assert [len(lane) for lane in lanes] == [FILE_LIMITS.corners, FILE_LIMITS.corners, 7]
    assert all(one[-1] == other[0] for one, other in itertools.pairwise(lanes))


def test_lanes_against_each_other_and_short_ones_are_told():
    edges = [
        LaneEdge("a", (0.0, 0.0), (8.0, 0.0), True),
        LaneEdge("b", (8.0, 0.5), (0.0, 0.5), True, 0.3),
        LaneEdge("c", (8.0, 0.0), (9.0, 0.0), True),
        LaneEdge("d", (0.0, 5.0), (0.0, 9.0), still=True),
        LaneEdge("e", (2.0, -4.0), (2.0, 4.0), True),
    ]
    for order in (edges, edges[::-1]):
        zones, notes = lane_zones(order)
        assert set(zones) == {"b", "d", "e"}  # what is left of b is its speed
        assert "one_way" not in zones["b"]
        assert zones["e"]["one_way"] == pytest.approx(math.pi / 2)
        assert zones["d"]["pivoting"] == "never"
        assert sum("left out: c" in note for note in notes) == 1
        assert any("a, b" in note or "b, a" in note for note in notes)


@pytest.mark.parametrize(
    ("traits", "inside", "outside"),
    [
        ({"type": [1, "hinged"], "motion_axis": [1, "end"]}, (13.2, -11), (16.2, -10)),
        ({"type": [1, "hinged"], "motion_direction": [2, -1]}, (13.2, -9), (16.2, -10)),
        ({"type": [1, "double_hinged"]}, (15.9, -9.1), (16.2, -10)),
        ({"type": [1, "double_hinged"]}, (15.9, -10.9), (14.8, -10)),
        ({"type": [1, "sliding"]}, (15, -10.9), (15.2, -10)),
        ({"type": [1, "double_sliding"], "motion_direction": [2, -1]}, (15, -9.1), (15, -8.8)),
    ],
)
def test_a_doorway_is_what_the_leaves_sweep(tmp_path, traits, inside, outside):
    building = yaml.safe_load((SAMPLES / "small.building.yaml").read_text())
    building["levels"]["L1"]["doors"] = [[2, 3, {"name": [1, "d"], **traits}]]
    (tmp_path / "x.building.yaml").write_text(yaml.safe_dump(building))
    found = import_file(tmp_path / "x.building.yaml", tmp_path / "out")
    area = Polygon(read_problem_file(found.problem).automatic_doors["d"].polygon)
    assert area.contains(Point(inside))
    assert not area.contains(Point(outside))


@pytest.mark.parametrize(
    ("sample", "durations"),
    [
        ("small.jsp", [[{1}, {3}, {6}], [{8}, {5}, {10}]]),
        ("small.fjs", [[{5, 3}, {4}], [{7}]]),
    ],
)
def test_shops_keep_routes_and_durations(tmp_path, sample, durations):
    records, _ = imported(sample, tmp_path)
    by_job = {}
    for task in records.tasks:
        lengths = {m.duration for m in task.modes.values()} or {task.duration}
        by_job.setdefault(task.id.split("_")[0], []).append(lengths)
    assert list(by_job.values()) == durations
    assert len(records.orders) == sum(len(d) + 1 for d in durations)
    assert main(["check", str(tmp_path / "problem.yaml")]) == 0


@pytest.mark.long
def test_a_flexible_shop_is_solved(tmp_path):
    imported("small.fjs", tmp_path, robots=1)
    fleet = Fleet.from_file(tmp_path / "problem.yaml")
    result = fleet.solve(timeout=60, first_plan=True)
    assert result.plan is not None, result.explain()
    times = {a["name"]: (a["start"], a["end"]) for a in result.data["activities"]}
    (mode,) = [m for m in ("m0", "m1") if f"j0_op0_{m}" in times]
    start, end = times[f"j0_op0_{mode}"]
    assert end - start == {"m0": 5, "m1": 3}[mode]
    assert times[f"deliver_j0_carry0_r0_at_{mode}"][1] <= start
    assert end <= times[f"pick_j0_carry1_r0_at_{mode}"][0]


@pytest.mark.parametrize("seed", range(6))
def test_no_rounding_makes_anything_drivable(tmp_path, seed):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * math.pi, 12))
    radii = rng.uniform(1, 3, 12)
    ring = Polygon([(r * math.cos(a), r * math.sin(a)) for a, r in zip(angles, radii, strict=True)])
    free = shapely.make_valid(ring.difference(Point(0.3, 0.2).buffer(0.4)))
    site = load_map(map_from_polygons(free, tmp_path, cell=0.1))
    rows, cols = site.shape
    drivable = 0
    for row in range(rows):
        for col in range(cols):
            x, y = site.origin[0] + 0.1 * col, site.origin[1] + 0.1 * row
            cell = shapely.box(x, y, x + 0.1, y + 0.1)
            if not site.blocked[row, col]:
                drivable += 1
                assert free.buffer(1e-6).covers(cell)
            else:
                assert not free.covers(cell.buffer(1e-6))
    assert drivable > 0.5 * free.area / 0.01


def test_an_svg_outline(tmp_path):
    pytest.importorskip("svgelements")
    imported("small.svg", tmp_path, cell=1.0)
    _is_the_drawn_hall(grid(tmp_path))


def test_layers_of_an_svg_drawing(tmp_path):
    """Its paper is 20 cm wide: what counts is its ``viewBox``, of which a unit is half a metre."""
    pytest.importorskip("svgelements")
    source, out = str(SAMPLES / "layers.svg"), tmp_path / "out"
    assert main(["import", source, "--out", str(out), "--metres-per-unit", "0.5"]) == 0
    records = read_problem_file(out / "problem.yaml")
    poses = {name: place.pose for name, place in records.places.items()}
    assert poses == {
        "dock_1": pytest.approx((1.0, -11.0, math.pi / 2)),
        "bay": pytest.approx((18.0, -10.0, 0.0)),
    }
    assert list(records.zones) == ["wet", "slow"]
    assert records.zones["slow"].polygon[0] == pytest.approx((5.0, -8.0))
    site = grid(out)
    assert site.size == pytest.approx((20.1, 12.1))
    full = [(2.5, -4.0), (15.0, -3.0), (15.0, -3.9), (10.0, -3.0)]  # shelf, round one, wall
    free = [(4.5, -3.5), (15.0, -4.5), (10.0, -9.0), (13.5, -9.5), (18.0, -10.0)]
    assert [state_at(site, *at) for at in full] == ["occupied"] * 4
    assert [state_at(site, *at) for at in free] == ["free"] * 5


def test_a_problem_file_that_is_there_is_not_written_over(tmp_path, capsys):
    command = ["import", str(SAMPLES / "small.lif.json"), "--out", str(tmp_path)]
    assert main(command) == 0
    mine = tmp_path / "problem.yaml"
    mine.write_text("mine")
    assert main(command) == 2
    assert f"'{mine}' is there already; name another folder" in capsys.readouterr().err
    assert mine.read_text() == "mine"


def test_a_zone_that_is_not_closed_is_refused(tmp_path):
    pytest.importorskip("svgelements")
    text = (SAMPLES / "layers.svg").read_text().replace("<polygon", "<polyline")
    (tmp_path / "x.svg").write_text(text)
    with pytest.raises(ProblemError, match=r"x\.svg: layer 'zone wet': zones are closed outlines"):
        import_file(tmp_path / "x.svg", tmp_path / "out")


def test_a_dxf_outline(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    drawing = ezdxf.new(units=4)  # mm
    space = drawing.modelspace()
    space.add_lwpolyline([(0, 0), (20000, 0), (20000, -10000), (0, -10000)], close=True)
    space.add_circle((5000, -5000), 1000)
    space.add_line((10000, 0), (10000, -6000))
    space.add_solid([(1000, -1000), (2000, -1000), (1000, -2000)])
    space.add_text("hall")
    drawing.saveas(tmp_path / "hall.dxf")
    notes = import_file(tmp_path / "hall.dxf", tmp_path / "out").notes
    assert "what was left out, by kind: SOLID, TEXT" in notes
    _is_the_drawn_hall(grid(tmp_path / "out"))


def _is_the_drawn_hall(site):
    assert site.size == pytest.approx((20.1, 10.1))
    assert state_at(site, 5.0, -5.0) == "occupied"
    assert state_at(site, 6.2, -5.0) == "free"
    assert state_at(site, 10.0, -3.0) == "occupied"
    assert state_at(site, 10.0, -7.0) == "free"


@pytest.mark.parametrize("seed", range(3))
def test_a_hall_of_lines_with_zones_places_and_blocks(tmp_path, seed):
    ezdxf = pytest.importorskip("ezdxf")
    drawing = ezdxf.new(units=4)  # mm
    space, rng = drawing.modelspace(), random.Random(seed)
    rack = drawing.blocks.new("rack")
    rack.add_lwpolyline([(0, 0), (2000, 0), (2000, 1000), (0, 1000)], close=True)
    drawing.blocks.new("row").add_blockref("rack", (3000, 0))
    drawing.blocks.new("DOCK 1").add_line((0, 0), (500, 0))
    corners = [(0, 0), (20000, 0), (20000, 12000), (0, 12000)]
    walls = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    square = [(8000, 7000), (12000, 7000), (12000, 11000), (8000, 11000)]
    shown = [
        *(lambda wall=wall: space.add_line(*rng.sample(wall, 2)) for wall in walls),
        lambda: space.add_lwpolyline(square, close=True, dxfattribs={"layer": "ZONE_wet floor"}),
        lambda: space.add_blockref("row", (2000, 2000)),
        lambda: space.add_blockref(
            "DOCK 1", (10000, 3000), dxfattribs={"layer": "Places", "rotation": 90}
        ),
    ]
    for draw in rng.sample(shown, len(shown)):
        draw()
    drawing.saveas(tmp_path / "hall.dxf")
    records = read_problem_file(import_file(tmp_path / "hall.dxf", tmp_path / "out").problem)
    assert list(records.zones) == ["wet_floor"]
    assert records.places["DOCK_1"].pose == pytest.approx((10.0, 3.0, math.pi / 2))
    site = grid(tmp_path / "out")
    assert site.size == pytest.approx((20.05, 12.05), abs=0.1)
    assert state_at(site, 10.0, 9.0) == "free"
    assert state_at(site, 6.0, 2.5) == "occupied"  # the rack in the row
    assert state_at(site, 10.0, 3.0) == "free"


def _are_as_thick(site, walls):
    """Walls (m): from where on, to where, and how thick they are at either end."""
    for (x, y), (to_x, to_y), *widths in walls:
        long = math.dist((x, y), (to_x, to_y))
        across = np.array([y - to_y, to_x - x]) / long
        for share in (0.1, 0.5, 0.9):
            middle = np.array([x, y]) + share * np.array([to_x - x, to_y - y])
            half = (widths[0] + share * (widths[-1] - widths[0])) / 2
            for side in (-1, 1):
                inside, outside = (
                    state_at(site, *(middle + side * (half + by) * across)) for by in (-0.02, 0.12)
                )
                assert (inside, outside) == ("occupied", "free"), (x, y, share, side)


@pytest.mark.parametrize("seed", range(3))
def test_walls_of_a_dxf_drawing_are_as_thick_as_its_polylines(tmp_path, seed):
    ezdxf = pytest.importorskip("ezdxf")
    rng = random.Random(seed)
    units, metre = rng.choice([(4, 1000.0), (5, 100.0), (6, 1.0)])
    drawing = ezdxf.new(units=units)
    space = drawing.modelspace()

    def wall(space, *corners, **options):  # x, y, width from there on, width at the next one
        rows = [[metre * value for value in corner] for corner in corners]
        return space.add_lwpolyline(rows, format="xyse", **options)

    def old(closed=False):
        made = space.add_polyline2d([(metre * 12, metre * 2), (metre * 12, metre * 8)])
        made.dxf.default_start_width = made.dxf.default_end_width = 0.6 * metre
        return made

    even, round_ = drawing.blocks.new("even"), drawing.blocks.new("round")
    wall(even, (0, 0, 0.2, 0.2), (0, 3, 0.2, 0.2))
    arc = round_.add_lwpolyline([(0, 0, 1), (metre, 0, 0)], format="xyb")
    arc.dxf.const_width = 0.2 * metre
    shown = [
        lambda: wall(space, (0, 0), (24, 0), (24, 10), (0, 10), close=True),
        lambda: setattr(wall(space, (2, 2), (2, 8)).dxf, "const_width", 0.5 * metre),
        lambda: wall(space, (6, 2, 0.4, 1.2), (6, 8, 0.3, 0.3), (10, 8, 0.0, 0.0)),
        old,
        lambda: space.add_blockref(
            "even", (16 * metre, 2 * metre), {"xscale": 2, "yscale": 2, "zscale": 2}
        ),
        lambda: space.add_blockref("round", (20 * metre, 5 * metre), {"xscale": 2, "yscale": 1}),
    ]
    for draw in rng.sample(shown, len(shown)):
        draw()
    drawing.saveas(tmp_path / "hall.dxf")
    notes = import_file(tmp_path / "hall.dxf", tmp_path / "out").notes
    assert "widths not read, taken as 0.05 m: in block 'round'" in notes
    walls = [
        ((2, 2), (2, 8), 0.5), ((6, 2), (6, 8), 0.4, 1.2), ((7, 8), (10, 8), 0.3),
        ((12, 2), (12, 8), 0.6), ((16, 2), (16, 8), 0.4),
    ]  # fmt: skip
    _are_as_thick(grid(tmp_path / "out"), walls)


@pytest.mark.parametrize("seed", range(3))
def test_walls_of_an_svg_drawing_are_as_thick_as_its_strokes(tmp_path, seed):
    pytest.importorskip("svgelements")
    rng = random.Random(seed)
    cell, drawn = rng.choice([0.5, 0.02, 0.1]), []

    def n(metres):
        return f"{metres / cell:.9g}"

    def line(x, y, to_x, to_y, rest):
        return f'<line x1="{n(x)}" y1="{n(y)}" x2="{n(to_x)}" y2="{n(to_y)}" {rest}/>'

    mm = cell * 96 / 25.4
    drawn = [
        f'<rect width="{n(24)}" height="{n(10)}" fill="none" stroke="none" stroke-width="99"/>',
        line(2, 2, 2, 8, f'stroke="red" stroke-width="{n(0.5)}"'),
        f'<g style="stroke:#000;stroke-width:{n(0.3)}">{line(4, 2, 9, 2, "")}</g>',
        line(6, 2, 6, 4, f'stroke="#000" stroke-width="{n(0.2)}" transform="scale(2)"'),
        line(15, 5, 18, 5, f'stroke="#000" style="stroke-width:{0.4 / mm:.9g}mm"'),
        line(20, 2, 20, 8, 'id="hair" stroke="red" vector-effect="non-scaling-stroke"'),
        line(22, 2, 22, 8, 'id="odd" stroke="red" stroke-width="-3"'),
    ]
    rng.shuffle(drawn)
    box = f'viewBox="0 0 {n(24)} {n(10)}" width="100mm" height="50mm"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {box}>'
    (tmp_path / "x.svg").write_text(head + "".join(drawn) + "</svg>")
    notes = import_file(tmp_path / "x.svg", tmp_path / "out", options=Options(cell=cell)).notes
    (note,) = [n for n in notes if n.startswith("widths not read, taken as 0.05 m")]
    assert ("'hair'" in note, "'odd'" in note) == (True, True)
    walls = [
        ((2, -2), (2, -8), 0.5), ((4, -2), (9, -2), 0.3), ((12, -4), (12, -8), 0.4),
        ((15, -5), (18, -5), 0.4),
    ]  # fmt: skip
    _are_as_thick(grid(tmp_path / "out"), walls)


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("x.map", "no map", "no Moving AI map"),
        ("x.map", "type octile\nheight 1\nwidth 2\nmap\n.?\n", "unknown cell '\\?'"),
        ("x.scen", "a\nb", "no Moving AI scenario"),
        (
            "x.scen",
            "version 1\n\n0 a.map 9 9 1 1 2 2 1\n0 b.map 9 9 1 1 2 2 1\n",
            "x.scen:4: it is on b.map, others on a.map",
        ),
        ("x.scen", "version 1\n0 a.map 9 9 1 1 2 2\n", "x.scen:2: a line has a bucket"),
        ("x.fjs", "2 2\n1 1 2 7\n1 1 2 7 1\n", "x.fjs:3: numbers are left over: 1 is the first"),
        ("x.fjs", "1 2 1.5\n1 1 2 7.5\n", "x.fjs:2: numbers are needed: '7.5' is no whole number"),
        ("x.fjs", "1 2\n1 1 2 7\n1 1 2 7\n", "x.fjs: 1 jobs are announced, there are 2"),
        ("x.jsp", "1 1\n0 1.5\n", "x.jsp:2: numbers are needed: '1.5' is no whole number"),
        ("x.jsp", "1.5 1\n0 1\n", "x.jsp:1: numbers are needed: '1.5' is no whole number"),
        ("x.lif", "{}", "not readable as a LIF layout: .layouts. is not there"),
        ("x.building.yaml", "a: 1", "not readable as an RMF building map"),
        ("x.jsp", "2 2\n0 1 1", "4 numbers are needed"),
        ("x.fjs", "1 1\n2 1 1", "ends too early"),
        ("x.svg", "<svg/>", "no closed outline"),
        ("x.dxf", "nothing", "not readable as DXF"),
    ],
)
def test_what_is_no_such_file_is_refused_by_name(tmp_path, name, text, what):
    (tmp_path / name).write_text(text)
    with pytest.raises(ProblemError, match=what):
        import_file(tmp_path / name, tmp_path / "out")


def test_the_command(tmp_path, capsys):
    source = str(SAMPLES / "small.jsp")
    assert main(["import", source, "--out", str(tmp_path), "--jobs", "1"]) == 0
    assert "1 of 2 jobs of small.jsp" in capsys.readouterr().out
    with pytest.raises(UnsupportedError, match="--kind"):
        import_file(SAMPLES / "small.agents", tmp_path)


def test_a_layout_without_robots_is_drawn_but_is_no_problem_yet(tmp_path, capsys):
    import_file(SAMPLES / "small.lif.json", tmp_path)
    file = tmp_path / "problem.yaml"
    assert main(["check", str(file)]) == 1
    assert "there is no robot; add one" in capsys.readouterr().out
    assert (tmp_path / "problem.check.png").stat().st_size > 3000
    assert main(["solve", str(file)]) == 2
    assert "there is no robot; add one" in capsys.readouterr().err
