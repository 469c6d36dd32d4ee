"""Robots of a type with ``reverse: never``: solved, judged, written, executed, exported."""

import json

import numpy as np
import pytest

from up_samp.execution import with_dependencies
from up_samp.execution.floor import Drive
from up_samp.execution.lives import lives_of
from up_samp.export import export_plan
from up_samp.fleet import Fleet, FleetError
from up_samp.geometry.maps import write_map
from up_samp.io.files import read_plan
from up_samp.operate.judge import judge_day
from up_samp.validation import validate_plan
from up_samp.validation.collisions import pieces_of

RING = [(-0.6, -0.35), (0.6, -0.35), (0.6, 0.35), (-0.6, 0.35)]
LIMITS = {"v_max": 1.5, "a_max": 0.7}


def drawn(folder, width):
    """A hall with a dead end to its right, ``width`` m wide."""
    cells = np.zeros((90, 160), dtype=bool)
    cells[:, 100:] = True
    half = round(5 * width)
    cells[45 - half : 45 + half, 100:140] = False
    cells[[0, -1]] = cells[:, [0, -1]] = True
    return write_map(folder, "pocket", cells, 0.1)


def hall(folder, width=1.0, **options):
    fleet = Fleet(drawn(folder, width))
    fleet.add_robot_type("truck", RING, turning_radius=0.8, **LIMITS, **options)
    fleet.add_robot_type("cart", RING, model="diff", omega_max=0.8, **LIMITS, **options)
    fleet.add_place("west", 2, 2.5)
    fleet.add_place("north", 3, 6.5)
    fleet.add_place("east", 8, 4.5)
    fleet.add_place("deep", 12.8, 4.5)
    return fleet


def two_at_work(folder, **options):
    fleet = hall(folder, **options)
    fleet.add_robot("t", "truck", "west", end="west")
    fleet.add_robot("c", "cart", "north", end="north")
    fleet.add_order("o1", "north", "east")
    fleet.add_order("o2", "east", "west")
    return fleet


def one_at_work(folder, **options):
    fleet = hall(folder, **options)
    fleet.add_robot("t", "truck", "west", end="west")
    fleet.add_order("o", "east", "west")
    return fleet


def gone_back(data):
    """The metres that each robot drives against its heading."""
    found = {}
    for motion in data["motions"]:
        rows = np.array(motion["samples"])
        along = pieces_of(rows[:, 0], rows[:, 1:]).along
        found.setdefault(motion["object"], 0.0)
        found[motion["object"]] -= float(np.minimum(along, 0.0).sum())
    return found


def test_two_robots_work_ahead_only_and_every_file_says_so(tmp_path):
    fleet = two_at_work(tmp_path, reverse="never")
    result = fleet.solve(timeout=60, first_plan=True, query_seconds=0.15)
    assert result.status.startswith("SOLVED"), result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    assert all(way < 1e-6 for way in gone_back(result.data).values())
    plan, *_ = result.save(tmp_path / "out")
    read = read_plan(tmp_path / "out" / "plan.json")
    assert [o["reverse"] for o in read["objects"]] == [False, False], plan
    assert not any(life.body.kinematics.reverse for life in lives_of(read).values())
    whole = with_dependencies(fleet.problem, read)
    for file in export_plan(whole, "vda5050", tmp_path / "vda"):
        text = file.read_text()
        assert '"orientation"' not in text or '"orientation": 3.14' not in text


def test_who_may_back_off_has_no_larger_bound_and_does_so(tmp_path):
    (never, result), (_, other) = (
        (fleet, fleet.solve(timeout=60, first_plan=True, query_seconds=0.15))
        for fleet in (one_at_work(tmp_path, reverse="never"), one_at_work(tmp_path))
    )
    assert other.data["lower_bound"] <= result.data["lower_bound"]
    assert any(way > 1.0 for way in gone_back(other.data).values())
    assert validate_plan(never.problem, result.plan).valid
    assert not validate_plan(never.problem, other.plan).valid
    assert all("reverse" not in o for o in other.data["objects"])


@pytest.mark.parametrize("kind", ["truck", "cart"])
def test_who_starts_in_a_dead_end_too_narrow_to_turn_in_never_gets_out(tmp_path, kind):
    for options, status in (({"reverse": "never"}, "UNSOLVABLE_PROVEN"), ({}, "SOLVED")):
        fleet = hall(tmp_path, **options)
        fleet.add_robot("r", kind, "deep")
        fleet.add_task("t", "east", duration=5)
        result = fleet.solve(timeout=60)
        assert result.status.startswith(status), result.explain()


def test_a_cart_turns_round_on_the_spot_where_there_is_room(tmp_path):
    fleet = hall(tmp_path, 2.0, reverse="never")
    fleet.add_robot("r", "cart", "deep")
    fleet.add_task("t", "east", duration=5)
    result = fleet.solve(timeout=60)
    assert result.status.startswith("SOLVED"), result.explain()
    (motion,) = result.data["motions"]
    turned = np.abs(np.diff(np.array(motion["samples"])[:, 3])).sum()
    assert turned > 3.1
    assert gone_back(result.data)["r"] < 1e-6


def one_type(floor, **options):
    fleet = Fleet(floor)
    fleet.add_robot_type("agv", RING, **options)
    return fleet.problem


def test_it_is_a_key_of_problem_files(tmp_path):
    fleet = two_at_work(tmp_path, reverse="never")
    fleet.save(tmp_path / "problem.json")
    written = json.loads((tmp_path / "problem.json").read_text())
    assert written["robot_types"]["cart"]["reverse"] == "never"
    for options, what in (({"model": "omni"}, "omni"), ({"reverse": "slow"}, "reverse")):
        with pytest.raises(FleetError, match=what):
            one_type(drawn(tmp_path, 1.0), **{"reverse": "never"} | options)


def test_a_day_in_which_somebody_drives_backwards_is_judged_so(tmp_path):
    fleet = two_at_work(tmp_path, reverse="never")
    initial = {"t": (2.0, 2.5, 0.0), "c": (3.0, 6.5, 0.0)}
    for robot, step in (("t", -0.5), ("c", 0.5)):
        x, y, theta = initial[robot]
        rows = [[float(k), x + k * step, y, theta] for k in range(3)]
        day = judge_day(fleet.records, {}, initial, [Drive(robot, "away", rows)], [])
        assert len(day.unruly) == (step < 0)
        assert day.good == (step > 0)
