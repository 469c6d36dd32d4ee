"""Robots whose lateral acceleration and whose changes of the turn rate are limited: solved, judged,
timed again in traffic, written, and driven late.
"""

import numpy as np
import pytest

from tests.fleet.driving import hurried
from up_samp.execution.lives import lives_of
from up_samp.fleet import Fleet, FleetError, read_problem_file
from up_samp.geometry.maps import write_map
from up_samp.io.files import read_plan
from up_samp.validation import validate_plan

RING = [(-0.6, -0.35), (0.6, -0.35), (0.6, 0.35), (-0.6, 0.35)]
LIMITS = {"lateral_a_max": 0.5, "alpha_max": 1.0}
KINDS = {
    "truck": {"turning_radius": 0.8, "v_max": 1.5, "a_max": 0.7},
    "cart": {"model": "diff", "omega_max": 1.0, "v_max": 1.2, "a_max": 0.8},
}
PLACES = {"west": (2, 2.5), "north": (3, 6.5), "east": (13, 4.5)}


def hall(folder, walls=(), order=1, **options):
    """A hall with a car and a differential drive, of which both bring something to the east."""
    grid = np.zeros((90, 160), dtype=bool)
    for rows, columns in walls:
        grid[rows, columns] = True
    fleet = Fleet(write_map(folder, "hall", grid, 0.1))
    for name, kind in [*KINDS.items()][::order]:
        fleet.add_robot_type(name, RING, **kind, **options)
    for name, (x, y) in [*PLACES.items()][::order]:
        fleet.add_place(name, x, y)
    for name, kind, place in [("t", "truck", "west"), ("c", "cart", "north")][::order]:
        fleet.add_robot(name, kind, place, end=place)
    fleet.add_order("o1", "north", "east")
    fleet.add_order("o2", "east", "west")
    return fleet


def solved(fleet):
    result = fleet.solve(timeout=300, first_plan=True, query_seconds=0.15)
    assert result.status.startswith("SOLVED"), result.explain()
    assert result.data["engine"].startswith("samp-refine")
    verdict = validate_plan(fleet.problem, result.plan)
    assert verdict.valid, verdict.violations
    return result


@pytest.mark.parametrize("order", [1, pytest.param(-1, marks=pytest.mark.long)])
def test_plans_keep_them_and_plans_without_them_are_refused(tmp_path, order):
    fleet = hall(tmp_path, order=order, **LIMITS)
    result = solved(fleet)
    fleet.save(tmp_path / "problem.json")
    assert read_problem_file(tmp_path / "problem.json").robot_types == fleet.records.robot_types
    result.save(tmp_path / "out")
    read = read_plan(tmp_path / "out" / "plan.json")
    assert all(LIMITS.items() <= o.items() for o in read["objects"])
    for life in lives_of(read).values():
        kinematics = life.body.kinematics
        assert (kinematics.lateral_a_max, kinematics.alpha_max) == tuple(LIMITS.values())

    other = solved(hall(tmp_path, order=order))
    assert other.data["makespan"] <= result.data["makespan"]
    kinds = {v.kind for v in validate_plan(fleet.problem, other.plan).violations}
    assert kinds == {"lateral-acceleration", "turn-acceleration"}


@pytest.mark.parametrize("wide", [1.2, pytest.param(2.2, marks=pytest.mark.long)])
def test_two_that_meet_in_an_aisle_are_timed_again_within_them(tmp_path, wide):
    half = round(5 * wide)
    aisle = [(slice(0, 45 - half), slice(60, 100)), (slice(45 + half, 90), slice(60, 100))]
    fleet = hall(tmp_path, walls=aisle, **LIMITS)
    fleet.add_place("far", 14, 7.5)
    fleet.add_robot("c2", "cart", "far", end="far")
    fleet.add_order("o3", "far", "west", robots=["c2"])
    result = solved(fleet)
    # the judge of what was driven sees who takes bends too fast
    assert any("lateral-acceleration" in text for text in hurried(fleet, result.data, 2, 0.4))


@pytest.mark.parametrize("key", LIMITS)
def test_who_drives_in_any_direction_is_refused_by_name(tmp_path, key):
    fleet = Fleet(write_map(tmp_path, "hall", np.zeros((9, 9), dtype=bool), 1.0))
    with pytest.raises(FleetError, match="lateral_a_max and alpha_max are for car and diff"):
        fleet.add_robot_type("slider", RING, model="omni", **{key: 1.0})
