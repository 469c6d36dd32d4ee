"""Loads that several robots carry: they keep formation, and nobody else is in their way."""

import csv
import itertools
import json
import math
import random

import numpy as np
import pytest

from up_samp.cli import main
from up_samp.execution import Delays, dependencies_of, simulate, with_dependencies
from up_samp.fleet import Fleet, FleetError
from up_samp.geometry.maps import write_map
from up_samp.model.frames import Frame
from up_samp.plotting.tracks import tracks_of
from up_samp.validation import validate_plan

BEAM = [[-1.5, -0.2], [1.5, -0.2], [1.5, 0.2], [-1.5, 0.2]]
PAIR = ((2.0, 0.0, math.pi),)
THREE = ((2.0, 0.0, math.pi), (1.0, 0.9, 0.0))
OMNI = {"footprint": (0.8, 0.6), "model": "omni", "v_max": 1.0, "a_max": 0.6}


def hall(folder, robots=2, *, carriers=PAIR, shuffled=None, order=None, **types):
    """Two rooms with a gap of 2.2 m; a beam goes from the one to the other, and a box."""
    cells = np.zeros((100, 200), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    cells[:40, 99:101] = cells[62:, 99:101] = True
    fleet = Fleet(write_map(folder, "hall", cells, 0.1), name="hall", margin=0.05)
    for name, told in {"omni": OMNI, **types}.items():
        fleet.add_robot_type(name, **told)
    kinds = [*types, "omni"]
    names = [f"r{k}" for k in range(robots)]
    places = {"bench": (4.0, 7.0, 0.0), "truck": (15.0, 3.0, 1.57)}
    places |= {"shelf": (6.0, 2.0, 0.0), "rack": (17.0, 8.0, 0.0)}
    places |= {f"home{k}": (1.5, 1.5 + 1.2 * k, 0.0) for k in range(robots)}
    load = {"footprint": BEAM, "offset": [1.0, 0.0, 0.0], "carriers": [*map(list, carriers)]}
    orders = {"beam": ("bench", "truck", {"attached": load, **(order or {})})}
    orders |= {"box": ("shelf", "rack", {})}
    listings = [[*places.items()], names, [*orders.items()]]
    for listing in listings if shuffled is not None else ():
        shuffled.shuffle(listing)
    for name, pose in listings[0]:
        fleet.add_place(name, *pose)
    for name in listings[1]:
        home = f"home{name[1:]}"
        other = int(name[1:]) - len(carriers)  # those before them carry
        kind = kinds[other % len(kinds)] if other > 0 else "omni"
        fleet.add_robot(name, kind, start=home, end=home)
    for name, (start, end, told) in listings[2]:
        fleet.add_order(name, {"at": start, "service": 5}, {"at": end, "service": 5}, **told)
    return fleet


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    fleet = hall(tmp_path_factory.mktemp("hall"))
    result = fleet.solve(60)
    assert result.plan is not None
    return fleet, result


def carrying(data):
    """The drive of the beam: who drives, and who keeps formation with it, each with where."""
    (motion,) = (m for m in data["motions"] if m["activity"].startswith("carry_"))
    rides = [r for r in data["rides"] if not r["object"].startswith("load")]
    assert {r["carrier"] for r in rides} == {motion["object"]}
    return motion, {r["object"]: r["offset"] for r in rides}


def judged(fleet, result, carriers=PAIR):
    """The plan is valid, and by its poses alone each carrier is where the load asks for it."""
    assert validate_plan(fleet.problem, result.plan).valid
    motion, others = carrying(result.data)
    given = [pytest.approx(pose, abs=1e-6) for pose in sorted(carriers)]
    assert sorted(map(tuple, others.values())) == given
    tracks = {t.name: t for t in tracks_of(result.data)}
    for at in np.linspace(motion["samples"][0][0], motion["samples"][-1][0], 40):
        first = tracks[motion["object"]].at(float(at))
        for name, offset in others.items():
            there, here = Frame(*first).of(offset), tracks[name].at(float(at))
            assert here == pytest.approx(there, abs=1e-3)  # m; between samples


def test_two_robots_carry_one_beam(carried):
    fleet, result = carried
    judged(fleet, result)
    data = result.data
    ends = {a["name"]: (a["start"], a["end"]) for a in data["activities"]}
    for part in ("pick", "deliver"):
        times = [t for name, t in ends.items() if name.startswith(f"{part}_beam")]
        assert len(times) == 2
        assert times[0] == times[1]
    assert [o["name"] for o in data["objects"] if o.get("drives_along")] == ["r0", "r1"]


def test_executed_with_delays_nobody_meets(carried):
    fleet, result = carried
    told = dependencies_of(fleet.problem, result.data)
    for seed in range(4):
        run = simulate(told, result.data, Delays.of_share(0.3), seed, policy="reorder")
        assert not run.contacts
        assert run.finished
        assert run.makespan >= run.planned


SEEDS = [(2, True), *(pytest.param(k, False, marks=pytest.mark.long) for k in range(12))]


@pytest.mark.parametrize(("seed", "first"), SEEDS)
def test_whatever_is_listed_first(seed, first, tmp_path):
    """Three or four robots of one type or two, two or three of which carry; proofs hold, where
    they are asked for.
    """
    rng = random.Random(seed)
    carriers = rng.choice((PAIR, THREE))
    other = rng.choice(({}, {"small": OMNI | {"v_max": 1.4}}, {"car": CAR}))
    robots = len(carriers) + 1 + (2 if other else 1)
    fleet = hall(tmp_path, robots, carriers=carriers, shuffled=rng, **other)
    presets = ("default",) if first else ("default", "sequential")
    found = [fleet.solve(200, seed=seed, preset=p, first_plan=first) for p in presets]
    for result in found:
        if result.plan is not None:
            judged(fleet, result, carriers)
    assert found[0].plan is not None
    for one, other in itertools.permutations((r for r in found if r.plan is not None), 2):
        if one.status == "SOLVED_OPTIMALLY":
            assert other.makespan >= one.makespan


CAR = {"footprint": (0.8, 0.6), "model": "car", "turning_radius": 0.8}


def test_files_say_so_or_refuse(carried, tmp_path, capsys):
    fleet, result = carried
    motion, others = carrying(result.data)
    (other,) = others
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(with_dependencies(fleet.problem, result.data)))
    plan = str(path)
    assert main(["export", plan, "--to", "csv", "--out", str(tmp_path)]) == 0
    with (tmp_path / "trajectories.csv").open() as file:
        rows = [r for r in csv.DictReader(file) if r["activity"] == motion["activity"]]
    assert {r["object"] for r in rows} == {motion["object"], other}
    fleet.save(tmp_path / "site.yaml")
    again = Fleet.from_file(tmp_path / "site.yaml")
    assert again.records.orders == fleet.records.orders
    for to in ("vda5050", "nav2"):
        told = ["export", plan, "--to", to, "--out", str(tmp_path / to)]
        assert main(told) == 2
        assert f"'{other}' keeps formation with" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"robots": 1}, "asks for 2 robots of one type, which moves in any direction"),
        ({"order": {"optional": True, "penalty": 50}}, "several robots carry is not optional"),
        ({"zone": {"max_robots": 1}}, "robots in formation do not heed 'middle'"),
        ({"zone": {"v_max": 0.5}}, "robots in formation do not heed 'middle'"),
    ],
)
def test_what_is_not_supported_is_said_by_name(told, said, tmp_path):
    with pytest.raises(FleetError, match=said):
        solved(tmp_path, **told)


def solved(folder, zone=None, **told):
    fleet = hall(folder, **told)
    fleet.add_zone("middle", [(9, 4), (11, 4), (11, 6), (9, 6)], **zone)
    return fleet.solve(1)
