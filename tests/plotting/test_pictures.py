import copy
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.text import Text
from PIL import Image
from shapely.geometry import Polygon as Shape

from tests import handmade
from up_samp.io import plan_to_dict
from up_samp.io.plan_dict import word
from up_samp.model import ProblemError
from up_samp.plotting import (
    animation_html,
    places_of,
    plot_gantt,
    plot_map,
    write_html,
)
from up_samp.plotting.animation import key_frames, scene_of
from up_samp.plotting.background import ground_of
from up_samp.plotting.gantt import rows_of, short_names
from up_samp.plotting.style import PALETTE, color_of, ink_on, mixed, rgb
from up_samp.plotting.tracks import horizon, tracks_of

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return handmade.make(tmp_path_factory.mktemp("hall"))


@pytest.fixture
def plan(made):
    return plan_to_dict(made.problem, made.plan, engine="e", lower_bound=20)


def extents(figure, texts):
    figure.draw_without_rendering()
    return [t.get_window_extent() for t in texts if t.get_text() and t.get_visible()]


def assert_apart(boxes):
    for i, one in enumerate(boxes):
        for two in boxes[:i]:
            assert not one.padded(-1).overlaps(two.padded(-1))


# ------------------------------------------------------------------ where things are
def test_tracks_tell_where_everything_is(plan, made):
    robot, other, door = tracks_of(plan)
    assert (robot.moves, other.moves, door.moves) == (True, True, False)
    assert robot.at(-1) == (4.0, 4.0, 0.0)
    assert robot.at(9.0) == (12.0, 4.0, 0.0)
    assert robot.at(99.0) == (25.0, 4.0, 0.0)
    assert robot.at(15.0) == pytest.approx(
        made.trajectories["move_r0_button_to_item"].at(15.0), abs=1e-5
    )
    assert door.at(9.99) == (15.0, 4.0, 0.0)
    assert door.at(10.0) == (15.0, 9.0, 0.0)
    assert horizon(plan) == 26.0


def test_outlines_are_placed_footprints(plan):
    robot = tracks_of(plan)[0]
    corners = robot.outline((10.0, 5.0, np.pi / 2))
    assert Shape(corners).equals_exact(Shape([(9.5, 4), (10.5, 4), (10.5, 6), (9.5, 6)]), 1e-9) or (
        Shape(corners).symmetric_difference(Shape([(9.5, 4), (10.5, 4), (10.5, 6), (9.5, 6)])).area
        < 1e-9
    )


def test_key_frames_are_few_and_true(plan):
    for track in tracks_of(plan):
        frames = np.array(key_frames(track))
        samples = sum(len(leg.times) for leg in track.legs)
        if track.moves:
            assert len(frames) < samples / 5
        for t in np.linspace(0, 26, 521):
            if any(abs(t - c) < 1e-6 for c, _ in track.changes):
                continue
            x, y, yaw = (np.interp(t, frames[:, 0], frames[:, k]) for k in (1, 2, 3))
            assert (x, y, yaw) == pytest.approx(track.at(float(t)), abs=0.021)


# ------------------------------------------------------------------ rows and names
def test_rows_hold_each_activity_once(plan):
    rows = rows_of(plan)
    assert [r.name for r in rows] == ["r0", "r1", "door", "scan"]
    placed = [b.activity for r in rows for b in r.bars]
    assert sorted(placed) == sorted(a["name"] for a in plan["activities"])
    assert {b.activity for b in rows[0].bars} == {
        "move_r0_depot0_to_button",
        "open_door_r0",
        "move_r0_button_to_item",
        "pick_r0_item",
    }
    driving = rows[0].bars[2].driving
    assert len(driving) == 1
    assert driving[0] == pytest.approx((10.5, 21.06), abs=0.1)


def test_overlapping_bars_get_lanes_of_their_own(plan):
    for i in range(3):
        plan["activities"].append({"name": f"scan_{i}", "start": i, "end": 20 + i})
    scan = rows_of(plan)[-1]
    assert scan.lanes == 4
    for one in scan.bars:
        for two in scan.bars:
            if one is not two and one.lane == two.lane:
                assert one.end <= two.start or two.end <= one.start


def test_many_groups_become_one(plan):
    names = [
        "alpha",
        "beta",
        "gamma",
        "delta",
        "epsilon",
        "zeta",
        "eta",
        "theta",
        "iota",
        "kappa",
        "lambda",
    ]
    for i, name in enumerate(names):
        plan["activities"].append({"name": name, "start": i, "end": i + 1})
    assert rows_of(plan)[-1].name == "other"


def test_robots_are_recognised_by_whole_words():
    assert word("r1").search("pick_r1_item")
    assert not word("r1").search("pick_r10_item")
    assert word("robot_1").search("robot_1-lifts")
    assert short_names("move_r0_depot0_to_item3_in", "r0", motion=True) == (
        "move depot0 to item3 in",
        "depot0 → item3 in",
        "→ item3 in",
        "item3 in",
    )
    assert short_names("r0", "r0", motion=True) == ("r0",)


def test_parameters_name_the_robot_too(plan):
    plan["activities"].append({"name": "wash", "start": 24, "end": 25, "parameters": {"who": "r1"}})
    assert "wash" in {b.activity for b in rows_of(plan)[1].bars}


# ------------------------------------------------------------------ colours
def test_colours_are_apart_and_readable():
    assert len(set(PALETTE)) == len(PALETTE)
    assert color_of(len(PALETTE)) == color_of(0)
    assert mixed("#000000", 0.5) == "#808080"
    assert rgb("#0072B2") == (0, 114, 178)
    assert ink_on("#FFFFFF") != ink_on("#332288") == "#FFFFFF"


# ------------------------------------------------------------------ charts and maps
def test_gantt_returns_axes_and_uses_given_ones(plan):
    figure = Figure(figsize=(9, 4))
    ax = figure.add_subplot()
    assert plot_gantt(plan, ax=ax) is ax
    own = plot_gantt(plan)
    assert [t.get_text() for t in own.get_yticklabels()] == ["r0", "r1", "door", "scan"]
    assert own.get_xlim()[1] > 26


def test_names_in_the_gantt_chart_do_not_overlap(plan):
    for i in range(40):
        plan["activities"].append({"name": f"pick_r0_thing{i}", "start": i, "end": i + 1})
    ax = plot_gantt(plan)
    assert_apart(extents(ax.figure, ax.texts))


@pytest.mark.parametrize("draw", [plot_gantt, plot_map])
def test_texts_are_measured_without_a_picture_for_each(plan, draw, monkeypatch):
    from matplotlib.backends import backend_agg

    made, real = [], backend_agg.RendererAgg
    monkeypatch.setattr(backend_agg, "RendererAgg", lambda *size: made.append(size) or real(*size))
    ax = draw(plan)
    assert len(ax.texts) > 3
    assert 1 <= len(made) <= 3


def test_the_map_shows_footprints_and_places(plan, made):
    ax = plot_map(plan, places=places_of(made.problem))
    assert ax.get_xlim() == (0.0, 30.0)
    assert ax.get_ylim() == (0.0, 16.0)
    words = {t.get_text() for t in ax.texts}
    assert {"r0", "r1", "door", "depot0", "button", "item", "corner"} <= words
    assert "door_open" not in words
    drawn = [Shape(p.get_xy()) for p in ax.patches if isinstance(p, Polygon)]
    start = Shape([(3, 3.5), (5, 3.5), (5, 4.5), (3, 4.5)])
    assert any(s.symmetric_difference(start).area < 1e-6 for s in drawn)
    named = [t for t in ax.texts if t.get_text()]
    assert_apart(extents(ax.figure, named))


def test_map_on_given_axes_and_without_places(plan):
    ax = Figure().add_subplot()
    assert plot_map(plan, ax=ax) is ax


def test_a_plan_without_a_map_is_drawn_on_white(plan):
    plan["map"]["yaml"] = None
    ground = ground_of(plan)
    left, right, bottom, top = ground.extent
    assert left < 3.0
    assert right > 26.0
    assert bottom < 2.0
    assert top > 14.0
    plot_map(plan)


def test_a_missing_map_is_named(plan):
    plan["map"]["yaml"] = "/nowhere/map.yaml"
    with pytest.raises(ProblemError, match=r"/nowhere/map\.yaml"):
        plot_map(plan)


def test_backgrounds_show_walls_where_they_are(plan):
    ground = ground_of(plan)
    assert ground.pixels.shape == (160, 300, 3)
    assert tuple(ground.pixels[80, 150]) != (255, 255, 255)  # the wall at x = 15, y = 8
    assert tuple(ground.pixels[120, 150]) == (255, 255, 255)  # the gap at y = 4


def test_a_turned_map_is_drawn_in_the_world_frame(plan, tmp_path):
    source = plan["map"]["yaml"]
    image = Image.open(source.replace(".yaml", ".png"))
    image.save(tmp_path / "hall.png")
    turned = tmp_path / "turned.yaml"
    text = Path(source).read_text()
    turned.write_text(text.replace("[0.0, 0.0, 0.0]", "[10.0, 0.0, 1.5707963267948966]"))
    plan["map"]["yaml"] = str(turned)
    ground = ground_of(plan)
    # the map's x axis points up: it is now 16 wide and 30 high, to the left of x = 10
    assert ground.extent == pytest.approx((-6.0, 10.0, 0.0, 30.0), abs=0.11)
    rows, cols = ground.pixels.shape[:2]
    assert abs(rows - 300) <= 1
    assert abs(cols - 160) <= 1
    x, y = 10.0 - 8.0, 15.0  # the wall's middle: 15 m along the map's x, 8 m along its y
    row = int((ground.extent[3] - y) / 0.1)
    col = int((x - ground.extent[0]) / 0.1)
    assert tuple(ground.pixels[row, col]) != (255, 255, 255)


# ------------------------------------------------------------------ animations
def embedded(page):
    return json.loads(re.search(r"const scene = (.*);\n", page).group(1))


def test_the_page_holds_everything(plan):
    page = animation_html(plan)
    scene = embedded(page)
    assert scene["map"].startswith("data:image/png;base64,")
    assert [o["name"] for o in scene["objects"]] == ["r0", "r1", "door"]
    assert "{{" not in page
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", page)
    assert "http" not in page.replace("http-equiv", "")
    assert len(page) < 100_000


def test_names_cannot_break_the_page(plan):
    plan = copy.deepcopy(plan)
    plan["problem"] = "</script><b>&"
    page = animation_html(plan)
    assert page.count("</script>") == 1
    assert embedded(page)["problem"] == "</script><b>&"


@pytest.mark.skipif(CHROMIUM is None, reason="needs the browser chromium")
def test_the_page_runs_in_a_browser(plan, tmp_path):
    page = write_html(plan, tmp_path / "animation.html")
    done = subprocess.run(
        [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", f"--user-data-dir={tmp_path / 'profile'}", "--enable-logging=stderr",
            "--virtual-time-budget=2000", "--dump-dom", page.as_uri(),
        ],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert "0.0 / 26 s" in done.stdout
    assert "CONSOLE" not in done.stderr


def test_scenes_are_small(plan):
    assert len(json.dumps(scene_of(plan))) < 12_000


def test_spatial_bodies_are_seen_from_above(plan):
    half = np.sqrt(0.5)
    plan["objects"][0].update(footprint=[], initial=[4.0, 4.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    plan["motions"] = [
        {
            "activity": "move_r0_depot0_to_button",
            "object": "r0",
            "samples": [
                [0.0, 4.0, 4.0, 1.0, 0.0, 0.0, 0.0, 1.0],
                [8.0, 12.0, 4.0, 2.0, 0.0, 0.0, half, half],
            ],
        }
    ]
    assert tracks_of(plan)[0].at(9.0) == pytest.approx((12.0, 4.0, np.pi / 2))
    plot_map(plan)
    animation_html(plan)


def test_a_robot_that_stays_is_no_door(plan):
    plan["motions"] = [m for m in plan["motions"] if m["object"] != "r1"]
    plan["activities"] = [a for a in plan["activities"] if "r1" not in a["name"]]
    assert [t.moves for t in tracks_of(plan)] == [True, True, False]
    assert [r.name for r in rows_of(plan)] == ["r0", "r1", "door", "scan"]
    plot_map(plan)
    plot_gantt(plan)
    animation_html(plan)


@pytest.mark.parametrize("more", [0, 5, 14])
def test_nothing_written_is_cut_however_many_rows_the_legend_has(plan, tmp_path, more):
    robot = next(o for o in plan["objects"] if o["name"] == plan["motions"][0]["object"])
    crowd = [{**robot, "name": f"robot_{n}"} for n in range(more)]
    axes = plot_map({**plan, "objects": [*plan["objects"], *crowd]})
    figure = axes.get_figure()
    figure.savefig(tmp_path / "map.png")
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text():
            box = text.get_window_extent()
            assert figure.bbox.y0 <= box.y0, text
            assert box.y1 <= figure.bbox.y1, text
