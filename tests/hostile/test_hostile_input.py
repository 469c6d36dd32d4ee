"""Maps, problems and parameters that no one should write: refused in words, in bounded time."""

import json
import math
import struct
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    ConfigurationType,
    Fluent,
    MovableType,
    OneshotPlanner,
    TimePointInterval,
    Timing,
)

from up_samp.fleet import FleetError, read_problem_file
from up_samp.geometry import load_map
from up_samp.model import Deadline, ProblemError, SampError
from up_samp.model.errors import short
from up_samp.search import Parameters
from up_samp.upio import read_problem

BOMB = "\n".join(
    ["a: &a [x,x,x,x,x,x,x,x,x]"]
    + [
        f"{c}: &{c} [{','.join(['*' + p] * 9)}]"
        for p, c in zip("abcdefgh", "bcdefghi", strict=False)
    ]
)

MAPS = Path(__file__).parents[2] / "examples" / "maps"


def write(folder, text="", image=True, **keys):
    if image is True:
        Image.fromarray(np.full((20, 20), 254, dtype=np.uint8)).save(folder / "m.png")
    lines = {"image": "m.png", "resolution": 0.1, "origin": "[0, 0, 0]", "negate": 0,
             "occupied_thresh": 0.65, "free_thresh": 0.196, **keys}  # fmt: skip
    path = folder / "m.yaml"
    path.write_text(text + "\n" + "".join(f"{k}: {v}\n" for k, v in lines.items()))
    return path


YAML = {
    "bomb": dict(text=BOMB, origin="*i"),
    "bomb as number": dict(text=BOMB, resolution="*i"),
    "itself": dict(origin="&me [*me, *me]"),
    "deep": dict(origin="[" * 2000),
    "long number": dict(resolution="9" * 4000),
    "too long number": dict(resolution="9" * 6000),
    "huge": dict(resolution="1e308"),
    "nan": dict(resolution=".nan"),
    "text": dict(resolution="wide"),
    "date": dict(origin="[2020-01-01, 0, 0]"),
    "long text": dict(mode="m" * 100_000),
    "long key": dict(**{"k" * 1000: 1}),
    "map": dict(origin="{x: 1}"),
    "tab": dict(text="\t- x"),
    "tag": dict(origin="!!python/object/apply:os.system [touch run]"),
    "large": dict(text="#" * 2_000_000),
}


@pytest.mark.parametrize("kind", YAML)
def test_hostile_map_files_are_refused_shortly(kind, tmp_path):
    began = time.process_time()
    with pytest.raises(ProblemError) as error:
        load_map(write(tmp_path, **YAML[kind]))
    assert len(str(error.value)) < 600
    assert str(tmp_path) in str(error.value)
    assert time.process_time() - began < 5.0


def png_header(width, height):
    """A PNG of any size that holds no pixels."""

    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b""))
        + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize(
    "data",
    [
        png_header(200_000, 200_000),
        png_header(12_000, 12_000),
        png_header(50, 50),
        b"P5\n99999 99999\n255\n",
        b"P5\n-3 5\n255\n",
        b"P5",
        b"",
        b"GIF89a" + b"\x00" * 100,
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n",
        b"BM" + b"\x00" * 60,
        b"II*\x00" + b"\x00" * 60,
    ],
)
def test_hostile_images_are_refused(data, tmp_path):
    path = write(tmp_path, image=False)
    (tmp_path / "m.png").write_bytes(data)
    with pytest.raises(ProblemError, match=r"m\.png"):
        load_map(path)


def test_images_of_other_formats_are_refused_whatever_their_name(tmp_path):
    path = write(tmp_path)
    Image.fromarray(np.full((20, 20), 254, dtype=np.uint8)).save(tmp_path / "m.bmp")
    (tmp_path / "m.bmp").rename(tmp_path / "m.png")
    with pytest.raises(ProblemError, match="cannot be read as PNG or PGM"):
        load_map(path)


def problem(folder, **given):
    """A car that drives 8 m, with something odd about it."""
    footprint = given.get("footprint", [(-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)])
    poses = ConfigurationType(
        "pose", OccupancyMap(str(write(folder, resolution=1.0)), (0, 0)), ConfigurationKind.SE2
    )
    found = SchedulingMotionProblem("odd")
    car = MovableObject(
        "car",
        MovableType("car_type"),
        footprint=footprint,
        motion_model=MotionModels.REEDSSHEPP,
        motion_parameters=given.get("limits", {"turning_radius": 1.0}),
    )
    start = ConfigurationObject("start", poses, SE2(4.0, 10.0, 0.0))
    goal = ConfigurationObject("goal", poses, given.get("goal", SE2(12.0, 10.0, 0.0)))
    found.add_objects([car, start, goal])
    found.set_initial_configuration(car, start)
    drive = found.add_motion_activity(given.get("name", "drive"))
    drive.set_duration_bounds(*given.get("duration", (1, 100)))
    drive.add_motion_constraint(ActivityWaypoints(car, start, [goal]))
    drive.add_motion_effect(car, goal)
    return found


ODD = {
    "points in space": dict(footprint=[(0, 0, 0), (1, 0, 0), (1, 1, 0)]),
    "texts": dict(footprint=[("a", "b"), ("c", "d"), ("e", "f")]),
    "numbers": dict(footprint=[1.0, 2.0, 3.0]),
    "nothing": dict(footprint=[(None, None)] * 3),
    "two corners": dict(footprint=[(0, 0), (1, 1)]),
    "not finite": dict(footprint=[(0, 0), (math.inf, 0), (0, 1)]),
    "enormous": dict(footprint=[(0, 0), (1e300, 0), (0, 1e300)]),
    "speed as text": dict(limits={"v_max": "fast"}),
    "no speed": dict(limits={"v_max": math.nan}),
    "goal as text": dict(goal=SE2("a", "b", "c")),
    "goal not finite": dict(goal=SE2(math.nan, 0, 0)),
    "goal far away": dict(goal=SE2(1e300, 0, 0)),
    "turned round and round": dict(goal=SE2(12.0, 10.0, 1e15)),
    "negative duration": dict(duration=(-5, -3)),
}


@pytest.mark.parametrize("kind", ODD)
def test_odd_problems_are_refused_by_name(kind, tmp_path):
    # UP itself refuses some
    with pytest.raises((SampError, AssertionError)) as error:
        read_problem(problem(tmp_path, **ODD[kind]))
    if isinstance(error.value, SampError):
        assert any(name in str(error.value) for name in ("'car'", "'goal'", "'drive'"))
        assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    "given",
    [dict(seed="a"), dict(seed=1.5), dict(seed=True), dict(seconds_per_unit=math.inf),
     dict(seconds_per_unit=math.nan), dict(seconds_per_unit="1"), dict(margin=math.inf),
     dict(query_seconds=math.nan), dict(max_restarts=2.5), dict(optimal="yes"), dict(cache=3),
     dict(trace=b"x"), dict(progress=4), dict(path_planner=None), dict(preset=7),
     dict(without=("order",)), dict(without="tidy"), dict(without=[["tidy"]])],
    ids=str,
)  # fmt: skip
def test_wrong_parameters_are_refused_by_name(given):
    (name,) = given
    with pytest.raises(ProblemError, match=f"'{name}'"):
        Parameters(**given)


@pytest.mark.parametrize(
    "given", [dict(workers=2.5), dict(seed="a"), dict(workers="2"), dict(seed=None)], ids=str
)
def test_wrong_options_of_cpsat_are_refused(given):
    (name,) = given
    with pytest.raises(ProblemError, match=f"cpsat's {name} must be a whole number"):
        OneshotPlanner(name="cpsat", params=given)


@pytest.mark.parametrize("seconds", [math.nan, -1, "3", True, [], -math.inf])
def test_wrong_time_limits_are_refused(seconds):
    with pytest.raises(ProblemError, match="time limit"):
        Deadline.after(seconds)
    assert Deadline.after(math.inf).remaining() == math.inf


def test_values_in_messages_are_short():
    for value in (10**5000, "x" * 9999, [[[1] * 99] * 99] * 99, {1: {2: {3: 4}}}):
        assert len(short(value)) <= 80


def test_an_activity_may_be_called_like_a_further_motion(tmp_path):
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(problem(tmp_path, name="go#1"), timeout=60)
    assert result.status.name.startswith("SOLVED"), result.log_messages


def stray(found, drive):
    drive.add_condition(TimePointInterval(Timing(0, drive.start)), Fluent("free")())


def set_only(found, drive):
    drive.add_effect(Timing(0, drive.end), Fluent("free"), True)


def borrowed(found, drive):
    drive.uses(SchedulingProblem("other").add_resource("free", 1))


def empty(found, drive):
    found.add_fluent(free := Fluent("free"))
    drive.add_condition(TimePointInterval(Timing(0, drive.start)), free())


@pytest.mark.parametrize("engine", ["cpsat", "aries"])
@pytest.mark.parametrize("harm", [stray, set_only, borrowed, empty])
def test_fluents_that_have_no_value_are_refused_by_name(harm, engine, tmp_path):
    """They made a problem "unsolvable", proven, or an engine break down."""
    found = problem(tmp_path)
    harm(found, found.activities[0])
    with (
        OneshotPlanner(name=f"samp-refine[{engine}]") as planner,
        pytest.raises(ProblemError, match="the fluent 'free' "),
    ):
        planner.solve(found, timeout=20)


def test_a_fluent_that_nobody_uses_needs_no_value(tmp_path):
    found = problem(tmp_path)
    found.add_fluent(Fluent("free"))
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        assert planner.solve(found, timeout=60).plan is not None


def test_a_body_without_a_motion_model_is_refused_by_name(tmp_path):
    found = problem(tmp_path)
    found.object("car")._motion_model = None
    with (
        OneshotPlanner(name="samp-refine[cpsat]") as planner,
        pytest.raises(ProblemError, match="'car'"),
    ):
        planner.solve(found, timeout=20)


FIGURES = {
    "seconds_per_unit": (1e-308, 1e308, math.inf),
    "robot_types.agv.v_max": (1e-308, 1e308, "fast", [1.0]),
    "robot_types.agv.a_max": (1e-308, math.nan),
    "robot_types.agv.turning_radius": (1e9, -1),
    "robot_types.agv.footprint": ([1e308, 1e308], [[0, 0, 0]] * 3, ["a", "b"]),
    "robot_types.agv.capacity.item": (10**400, 2.5),
    "robot_types.agv.battery.capacity": (1e308, 0),
    "robot_types.agv.battery.per_metre": (1e308, -1),
    "places.home": ([1e308, 0, 0], [0, -1e308, 0], [0, 0, 1e15], [0, 0], "home"),
    "places.plug.park": (10**9, 0.5),
    "places.plug.charger.times": (10**9, 0),
    "zones.wet.polygon": ([[0, 0], [1e308, 0], [0, 1]], [[0, 0]] * 2, [0] * 5000),
    "orders": ([{"id": "x" * 10**5, "pickup": "home", "delivery": "home"}], {}),
}


@pytest.mark.parametrize(("place", "value"), [(k, v) for k, vs in FIGURES.items() for v in vs],
                         ids=lambda x: short(x)[:30])  # fmt: skip
def test_figures_of_problem_files_that_nothing_real_has_are_refused_by_name(place, value, tmp_path):
    battery = {"capacity": 100.0, "per_metre": 1.0}
    spec = {
        "format": "up-samp-problem",
        "version": 1,
        "map": str(MAPS / "two_rooms.yaml"),
        "seconds_per_unit": 1.0,
        "robot_types": {
            "agv": {"footprint": [1.0, 0.6], "capacity": {"item": 1}, "battery": battery}
        },
        "robots": {"r": {"type": "agv", "start": "home"}},
        "places": {
            "home": [3, 3, 0],
            "plug": {"pose": [9, 3, 0], "charger": {"per_second": 1.0, "times": 1}},
        },
        "zones": {"wet": {"polygon": [[0, 0], [1, 0], [0, 1]], "keep_out": ["agv"]}},
        "orders": [],
    }
    file = tmp_path / "problem.json"
    file.write_text(json.dumps(spec))
    assert read_problem_file(file).robots  # it is the one figure that is wrong
    *before, last = place.split(".")
    part = spec
    for key in before:
        part = part[key]
    part[last] = value
    file.write_text(json.dumps(spec))
    with pytest.raises(FleetError) as error:
        read_problem_file(file)
    text = str(error.value)
    assert place.split(".")[0] in text or str(file) in text
    assert last in text or before[-1] in text
    assert len(text) < 3000
