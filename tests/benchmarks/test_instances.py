"""The 132 instances of the paper: names, sizes, figures, frozen files, free and reachable poses."""

import itertools
import math
import random
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.ndimage
import yaml
from PIL import Image

from tests.benchmarks import freeze
from up_samp.benchmarks import families, instance, instances, job_shop, logistics, places
from up_samp.benchmarks.builders.building import BUILDING_KINDS, SIZE, building, building_floor
from up_samp.benchmarks.builders.door_sequence import sequence_floor
from up_samp.benchmarks.builders.jobshop import draw_shop, frozen_shops, shop_poses
from up_samp.benchmarks.builders.kitting import kitting_floor
from up_samp.benchmarks.builders.logistics import layout
from up_samp.benchmarks.builders.navigation import navigation_floor
from up_samp.benchmarks.places import FamilyFloor, box, least_duration, outline
from up_samp.benchmarks.report import table_drawn
from up_samp.benchmarks.runner import select
from up_samp.model import ProblemError


def test_the_paper_has_132():
    paper = instances("paper")
    assert len(paper) == len({i.name for i in paper}) == 132
    groups = [i.group for i in paper]
    assert [groups.count(g) for g in ("OC-DO", "OC-DC", "ALL-DO", "ALL-DC", "JSP")] == [24] * 4 + [
        36
    ]
    assert len(instances("logistics")) == 96
    assert len(instances("jobshop")) == 36
    assert instance("logistics-dc-all-r2-i4").family == "logistics"
    assert instance("jobshop-r2-j2-m4").group == "JSP"
    names = [i.name for family in families() for i in instances(family)]
    assert len(names) == len(set(names))


def test_any_size_and_seed_by_name():
    for name in ("logistics-do-oc-r4-i3-s7", "jobshop-r1-j1-m1-s3"):
        assert instance(name).build(metric=False).name == name
    with pytest.raises(ProblemError, match="robots"):
        instance("logistics-dc-all-r11-i1").build()


@pytest.mark.parametrize("bad", ["logistics-r1", "nothing", "doors-dc-r1"])
def test_unknown_names_are_refused(bad):
    with pytest.raises(ProblemError, match=bad):
        instance(bad)
    with pytest.raises(ProblemError, match=bad):
        instances(bad)


def test_sizes():
    # per robot: 8 + 1 places out and back, 8 from the button, 4 picks, 1 door
    problem = logistics(2, 4, door="closed", sides="all")
    assert len(problem.activities) == 2 * (9 + 9 + 8 + 4 + 1)
    assert len(logistics(3, 8, door="open", sides="corridor").activities) == 72
    # per robot: 10 places (2 starts, 4 machines, 4 buttons), 8 operations, 4 doors
    assert len(job_shop(2, 2, 4).activities) == 2 * (10 * 9 + 8 + 4) == 204


@pytest.mark.parametrize("arguments", [(0, 1), (11, 1), (1, 0), (1, 17)])
def test_impossible_sizes_are_refused(arguments):
    with pytest.raises(ProblemError, match="logistics takes"):
        logistics(*arguments)


def test_unknown_settings_are_refused():
    with pytest.raises(ProblemError, match="ajar"):
        logistics(1, 1, door="ajar")
    with pytest.raises(ProblemError, match="encoding"):
        logistics(1, 1, encoding="latin")
    with pytest.raises(ProblemError, match="machines"):
        job_shop(1, 1, 7)


def test_least_duration():
    # 8 m at 0.5 m/s^2: 2 sqrt(8 / 0.5) = 8 s exactly
    assert least_duration((0, 0, 0), (8, 0, 0), 0.5) == 8
    assert least_duration((0, 0, 0), (0, 0, 1), 0.5) == 1
    assert least_duration((0, 0, 0), (3, 4, 0), 1.0) == math.floor(2 * math.sqrt(5))
    # beyond 800 m the guess of 20 m/s is reached: 1000 / 20 + 20 / 0.5
    assert least_duration((0, 0, 0), (1000, 0, 0), 0.5) == 90


def test_a_move_as_up_sees_it():
    problem = logistics(2, 1, door="closed", sides="corridor")
    move = problem.get_activity("move_robot0_robot0_depot_to_item0_in")
    (constraint,) = move.motion_constraints
    assert move.optional
    assert str(constraint.movable) == "robot0"
    assert [o.name for o in constraint.static_obstacles] == ["door0"]
    assert [o.name for o in constraint.dynamic_obstacles_at_start] == ["robot1"]
    opening = problem.get_activity("open_door0_robot1")
    assert not opening.motion_constraints
    assert {str(k): str(v) for k, v in opening.motion_effects.items()} == {"door0": "door0_open"}
    assert problem.clone() == problem


@pytest.mark.parametrize("encoding", ["fluents", "no-fluents"])
def test_encodings_use_what_they_say(encoding):
    for problem in (logistics(2, 2, encoding=encoding), job_shop(1, 1, 1, encoding=encoding)):
        assert bool(problem.fluents) == (encoding == "fluents")
        assert problem.quality_metrics
    assert not logistics(1, 1, metric=False).quality_metrics


def test_frozen_files_are_what_the_code_draws(tmp_path):
    freeze.write(tmp_path)
    drawn = {p.name for p in tmp_path.iterdir()}
    assert drawn <= {p.name for p in places.DATA.iterdir()}
    for name in drawn:
        if name.endswith(".png"):
            pictures = (Image.open(d / name).convert("L") for d in (tmp_path, places.DATA))
            assert np.array_equal(*map(np.asarray, pictures))
        else:
            assert (tmp_path / name).read_text() == (places.DATA / name).read_text()
    assert frozen_shops()["jobshop-r2-j2-m4"] == draw_shop(2, 2, 4, 0)


def test_other_sizes_are_drawn_into_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("UP_SAMP_CACHE_DIR", str(tmp_path))
    problem = job_shop(1, 1, 3, seed=5)
    yaml_file = Path(problem.user_type("pose").occupancy_map.filename)
    assert yaml_file.parent == tmp_path / "maps"
    assert yaml.safe_load(yaml_file.read_text())["image"] == yaml_file.with_suffix(".png").name
    assert draw_shop(1, 1, 3, 5).floor.yaml == str(yaml_file)
    assert problem.name == "jobshop-r1-j1-m3-s5"


def test_seeds_draw_other_instances():
    assert layout(3, 8, 0) != layout(3, 8, 1) == layout(3, 8, 1)
    assert len({p for n, p in layout(10, 16)[1].items() if n.endswith("_in")}) == 16
    assert draw_shop(2, 2, 2, 1) == draw_shop(2, 2, 2, 1)
    for seeds in ((1, 2), (0, 1)):
        one, other = (draw_shop(2, 2, 2, seed) for seed in seeds)
        assert one.jobs != other.jobs
        assert one.machines != other.machines
        assert one.floor.walls != other.floor.walls
        assert one.floor.doors != other.floor.doors
    assert len({draw_shop(1, 1, 1, seed).floor.footprint for seed in range(8)}) > 2


@pytest.mark.parametrize(
    "name",
    [
        *("navigation-r3", "kitting-r2-k1-p2-d2", "doors-r2-d2"),
        *("building-rooms-r2-o3", "building-aisles-r1-o5-c2"),
    ],
)
def test_published_families_draw_from_seeds(name):
    frozen, *drawn = select([name], seeds=(0, 1, 1, 2))
    assert [i.name for i in drawn] == [f"{name}-s1", f"{name}-s2"]
    one, same, other = drawn[0].build(), drawn[0].build(), drawn[1].build()
    assert one == same
    assert one.name == f"{name}-s1"
    floors = [_map_of(problem) for problem in (frozen.build(), one, other)]
    assert len(set(floors)) == 3


def _map_of(problem):
    (floor,) = {t.occupancy_map.filename for t in problem.user_types if hasattr(t, "occupancy_map")}
    return floor


@pytest.mark.parametrize("kind", BUILDING_KINDS)
def test_buildings_have_room_for_all(kind):
    """No two places are so close that robots at both would touch, and each can be driven to."""
    for needed, seed in itertools.product((6, 12, 20, 40), range(5)):
        size, walls, spots = building_floor(kind, needed, random.Random(seed))
        assert len(spots) >= needed
        floor = SimpleNamespace(size=size, walls=walls, doors=(), footprint=box(*SIZE))
        assert are_joined(floor, spots)
        for one, other in itertools.combinations(spots, 2):
            assert math.dist(one, other) > math.hypot(*SIZE)


@pytest.mark.parametrize(
    ("sizes", "more"), [((0, 1), {}), ((1, 0), {}), ((1, 1, 0), {}), ((1, 1), {"kind": "halls"})]
)
def test_buildings_that_are_none_are_refused(sizes, more):
    with pytest.raises(ProblemError, match="building"):
        building(*sizes, **more)


def test_what_was_drawn_is_reported_by_seed():
    record = {
        "engine": "e", "status": "SOLVED_OPTIMALLY", "valid": True, "makespan": 100,
        "metrics": {"lower_bound": 90}, "optimal": True,
    }  # fmt: skip
    names = ("jobshop-r1-j1-m1", "jobshop-r1-j1-m1-s2", "jobshop-r1-j1-m2-s2")
    plain = {"encoding": "fluents", "preset": "default", "number": 0, "timeout": 60.0}
    plain |= {"memory": 1, "tuning": ""}
    records = [record | plain | {"instance": name} for name in names]
    records[2] = records[2] | {"status": "TIMEOUT", "valid": None}
    table = table_drawn(records).splitlines()
    assert table[0].endswith("| seed 0 | seed 2 |")
    assert table[2].endswith("| 1 / 1 of 1, gap 10.0% | 1 / 1 of 2, gap 10.0% |")


def test_poses_in_walls_or_too_close_are_refused():
    floor = FamilyFloor("bare", (10, 10), [(0, 0, 1, 10)])
    with pytest.raises(ProblemError, match="wall"):
        floor.check({"a": (1.5, 5, 0)})
    with pytest.raises(ProblemError, match="wall"):
        floor.check({"a": (9.5, 5, 0)})
    with pytest.raises(ProblemError, match="a and b"):
        floor.check({"a": (5, 5, 0), "b": (5, 6, 0)})
    floor.check({"a": (5, 5, 0), "b": (5, 7, 0)})


def parts_of(floor):
    """Label the cells where a robot could even turn on the spot with all doors open; return what
    tells the part of a pose.
    """
    free = ~places.draw(floor.size, floor.walls)
    for door in floor.doors:
        (x0, y0, x1, y1) = outline(door.footprint, door.open).bounds
        free[round(y0 * 10) : round(y1 * 10), round(x0 * 10) : round(x1 * 10)] = False
    reach = scipy.ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    radius = max(math.hypot(*corner) for corner in floor.footprint)
    labels, _ = scipy.ndimage.label(reach > radius * 10 + 1.5)
    return lambda p: int(labels[int(p[1] * 10), int(p[0] * 10)])


def are_joined(floor, poses):
    """A disc of the footprint's circumradius can be at all poses, and discs connect them: a
    Reeds-Shepp car, which is small-time locally controllable, can follow such a way.
    """
    part = parts_of(floor)
    parts = {part(p) for p in (*poses, *(door.button for door in floor.doors))}
    return len(parts) == 1 and 0 not in parts


def test_all_places_are_reachable():
    floor, spots = layout(10, 16)
    assert are_joined(floor, spots.values())
    for name, shop in [*frozen_shops().items()][::4]:
        assert are_joined(shop.floor, shop_poses(shop).values()), name


@pytest.mark.parametrize(
    "seed", [1, 2, *(pytest.param(s, marks=pytest.mark.long) for s in range(3, 6))]
)
def test_all_places_that_are_drawn_are_reachable(seed):
    for size in ((1, 1), (2, 8), (3, 8), (10, 16)):
        floor, spots = layout(*size, seed)
        assert are_joined(floor, spots.values()), size
    for size in ((1, 3, 1), (3, 3, 2), (2, 2, 4), (3, 3, 6)):
        shop = draw_shop(*size, seed)
        shop.floor.check(shop_poses(shop))
        assert are_joined(shop.floor, shop_poses(shop).values()), size
    for floor in (sequence_floor, kitting_floor):
        assert are_joined(floor(2, random.Random(seed), "drawn"), [(4.0, 6.0, 0.0)])
    part = parts_of(navigation_floor(3, random.Random(seed), "drawn"))
    assert part((4.0, 6.0)) == part((36.0, 36.0)) != 0


def test_box():
    assert box(2, 1) == ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5))


@pytest.mark.long
@pytest.mark.parametrize("encoding", ["fluents", "no-fluents"])
def test_all_instances_build(encoding):
    large = [instances(family)[0] for family in families()]
    for i in [*instances("paper"), *large, instance("logistics-dc-all-r10-i16")]:
        if i.family in ("warehouse", "building") and encoding != "fluents":
            with pytest.raises(ProblemError, match="encoding"):
                i.build(encoding, False)
            continue
        problem = i.build(encoding, False)
        assert problem.name == i.name
        assert len({a.name for a in problem.activities}) == len(problem.activities)
