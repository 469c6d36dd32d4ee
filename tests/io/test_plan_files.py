import json
import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft7Validator
from unified_planning.engines import PlanGenerationResult, PlanGenerationResultStatus
from unified_planning.model.motion import SE2, SE2Path, SE2WithControlsPath
from unified_planning.plans import MotionSchedule

from tests import handmade
from up_samp.io import (
    check_plan,
    dump_plan,
    plan_from_dict,
    plan_to_dict,
    read_plan,
    result_to_dict,
    write_plan,
)
from up_samp.io.precision import PRECISION
from up_samp.io.sampling import rows_trajectory, trajectory_rows
from up_samp.model import ProblemError, Trajectory, interpolate
from up_samp.model.refinement import ABSOLUTE, RELATIVE
from up_samp.plotting.gantt import title_of
from up_samp.upio.plan import path_trajectory

ROOT = Path(__file__).parents[2]
KEYS = [
    "format",
    "version",
    "problem",
    "engine",
    "status",
    "makespan",
    "lower_bound",
    "seconds_per_unit",
    "map",
    "objects",
    "activities",
    "motions",
    "changes",
]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return handmade.make(tmp_path_factory.mktemp("hall"))


@pytest.fixture
def data(made):
    return plan_to_dict(
        made.problem, made.plan, engine="e", status="SOLVED_SATISFICING", lower_bound=20
    )


def test_has_exactly_the_documented_fields(data):
    assert list(data) == KEYS
    assert data["format"] == "up-samp-plan"
    assert data["version"] == 1
    assert (data["engine"], data["status"]) == ("e", "SOLVED_SATISFICING")
    assert (data["makespan"], data["lower_bound"], data["seconds_per_unit"]) == (26, 20, 1)
    robot = data["objects"][0]
    assert list(robot) == [
        "name", "type", "footprint", "model", "turning_radius", "v_max", "a_max", "initial",
    ]  # fmt: skip
    assert robot["name"] == "r0"
    assert robot["footprint"] == [[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]]
    assert robot["initial"] == [4.0, 4.0, 0.0]
    assert Path(data["map"]["yaml"]).is_absolute()
    assert Path(data["map"]["yaml"]).is_file()


def test_only_present_activities_by_start(data, made):
    names = [a["name"] for a in data["activities"]]
    assert made.unused.name not in names
    assert [a["start"] for a in data["activities"]] == [0, 1, 2, 9, 10, 24]
    assert all(list(a) == ["name", "start", "end"] for a in data["activities"])


def test_motions_are_dense_and_true(data, made):
    assert [m["activity"] for m in data["motions"]] == [
        "move_r0_depot0_to_button", "move_r1_depot1_to_corner", "move_r0_button_to_item",
    ]  # fmt: skip
    for motion in data["motions"]:
        rows = np.array(motion["samples"])
        moving = np.any(np.diff(rows[:, 1:], axis=0) != 0, axis=1)
        assert np.all(np.diff(rows[:, 0])[moving] <= PRECISION.step + 1e-9)
        original = made.trajectories[motion["activity"]]
        for row in motion["samples"]:
            assert original.at(row[0]) == pytest.approx(row[1:], abs=2e-6)


def test_changes_happen_at_the_end_of_their_activity(data):
    assert data["changes"] == [
        {
            "activity": "open_door_r0",
            "object": "door",
            "time": 10,
            "configuration": [15.0, 9.0, 0.0],
        }
    ]


def test_seconds_per_unit_scales_changes_not_activities(made):
    data = plan_to_dict(made.problem, made.plan, seconds_per_unit=0.5)
    assert data["changes"][0]["time"] == 5
    assert data["makespan"] == 26
    assert data["seconds_per_unit"] == 0.5


@pytest.mark.parametrize("unit", [0.5, 1 / 3, 2.5e-3, 60.0])
def test_results_are_written_in_the_unit_that_they_were_planned_with(made, unit):
    """``metrics`` of a result of any engine, or the plan itself, know the unit."""
    status = PlanGenerationResultStatus.SOLVED_SATISFICING
    result = PlanGenerationResult(
        status, made.plan, "e", {"seconds_per_unit": repr(unit), "makespan": "26"}
    )
    data = result_to_dict(made.problem, result)
    assert data["seconds_per_unit"] == unit
    assert data["changes"][0]["time"] == pytest.approx(10 * unit, abs=1e-6)
    with pytest.raises(ProblemError, match="was made with seconds_per_unit"):
        result_to_dict(made.problem, result, seconds_per_unit=7.0)
    own = plan_from_dict(made.problem, data)
    assert own.seconds_per_unit == unit
    assert dump_plan(plan_to_dict(made.problem, own)) == dump_plan(
        {**data, "engine": "", "status": ""}
    )


def test_what_a_bound_rests_on_is_told_where_it_is_not_the_problem_alone(made):
    def told(kind):
        metrics = {"lower_bound": "26", "bound_kind": kind}
        status = PlanGenerationResultStatus.SOLVED_OPTIMALLY
        result = PlanGenerationResult(status, made.plan, "e", metrics)
        return result_to_dict(made.problem, result)

    plain, resting = told(ABSOLUTE), told(RELATIVE)
    assert "bound_kind" not in plain
    assert "minor" not in plain
    assert resting["bound_kind"] == RELATIVE
    assert resting["minor"] == 6
    schema = json.loads(files("up_samp.io").joinpath("plan.schema.json").read_text())
    assert not list(Draft7Validator(schema).iter_errors(resting))
    assert "relative" in title_of(resting)
    assert "relative" not in title_of(plain)


def test_a_result_without_a_unit_has_seconds(made):
    result = PlanGenerationResult(PlanGenerationResultStatus.SOLVED_SATISFICING, made.plan, "e")
    assert result_to_dict(made.problem, result)["seconds_per_unit"] == 1


def test_round_trip_through_a_file(data, made, tmp_path):
    path = write_plan(tmp_path / "plan.json", data)
    assert read_plan(path) == data
    assert json.loads(path.read_text()) == data
    again = plan_from_dict(made.problem, read_plan(path))
    options = {"engine": "e", "status": "SOLVED_SATISFICING", "lower_bound": 20}
    assert dump_plan(plan_to_dict(made.problem, again, **options)) == path.read_text()
    assert isinstance(again, MotionSchedule)
    assert set(again.trajectories) == set(made.trajectories)


def test_equal_plans_give_equal_files(made, tmp_path):
    one, two = (dump_plan(plan_to_dict(made.problem, made.plan)) for _ in range(2))
    assert one == two


def test_a_relative_map_is_relative_to_the_plan(data, tmp_path):
    data["map"]["yaml"] = "maps/hall.yaml"
    path = write_plan(tmp_path / "plan.json", data)
    assert read_plan(path)["map"]["yaml"] == str(tmp_path / "maps" / "hall.yaml")


def test_up_paths_serve_where_there_are_no_trajectories(made, data):
    bare = MotionSchedule(made.plan.activities, dict(made.plan.assignment), made.plan.motion_paths)
    untimed = plan_to_dict(made.problem, bare)
    for one, two in zip(untimed["motions"], data["motions"], strict=True):
        poses = [np.array(m["samples"])[:, 1:] for m in (one, two)]
        assert np.allclose(poses[0][[0, -1]], poses[1][[0, -1]], atol=1e-5)
        assert one["samples"][0][0] == next(
            a["start"] for a in data["activities"] if a["name"] == one["activity"]
        )


def test_a_motion_without_path_or_time_is_refused(made):
    bare = MotionSchedule(made.plan.activities, dict(made.plan.assignment), {})
    with pytest.raises(ProblemError, match="neither a trajectory nor a path for 'r0'"):
        plan_to_dict(made.problem, bare)
    with pytest.raises(ProblemError, match="says nothing about time"):
        path_trajectory(SE2Path([SE2(0, 0, 0)]), 0.0, "move")


def test_an_activity_of_another_problem_is_refused(made, tmp_path):
    other = handmade.make(tmp_path)
    other.problem.add_activity("extra", duration=1)
    extra = other.problem.get_activity("extra")
    other.plan.activities.append(extra)
    other.plan.set(extra.start, 0)
    other.plan.set(extra.end, 1)
    with pytest.raises(ProblemError, match="'extra' is not in the problem"):
        plan_to_dict(made.problem, other.plan)


def test_samples_in_the_middle_of_a_rest_are_left_out():
    times = np.arange(0, 10, 0.05)
    poses = np.zeros((len(times), 3))
    poses[100:, 0] = 1.0
    rows = trajectory_rows(Trajectory(times, poses))
    assert len(rows) <= 6
    assert rows[0] == [0.0, 0.0, 0.0, 0.0]
    assert rows[-1][0] == pytest.approx(times[-1])


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(0.01, 0.6),
            st.floats(-2, 2),
            st.floats(-2, 2),
            st.floats(-1.5, 1.5),
        ),
        min_size=1,
        max_size=12,
    )
)
def test_rows_follow_any_trajectory(steps):
    times = np.cumsum([0.0, *(s[0] for s in steps)])
    poses = np.cumsum([[0.0, 0.0, 0.0], *(s[1:] for s in steps)], axis=0)
    trajectory = Trajectory(times, poses)
    rows = trajectory_rows(trajectory)
    gaps = np.diff([r[0] for r in rows])
    moving = np.any(np.diff([r[1:] for r in rows], axis=0) != 0, axis=1)
    assert np.all(gaps > 0)
    assert np.all(gaps[moving] <= PRECISION.step + 1e-9)
    for row in rows:
        # rounding of the time moves the pose by at most speed times half a digit
        assert trajectory.at(row[0]) == pytest.approx(row[1:], abs=1e-3)
    again = rows_trajectory(rows)
    for t in times:
        assert again.at(float(t)) == pytest.approx(trajectory.at(float(t)), abs=1e-3)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-3, 3),
    st.lists(
        st.tuples(st.floats(-2, 2), st.floats(-1.5, 1.5), st.floats(0.05, 2.0)),
        min_size=1,
        max_size=6,
    ),
)
def test_paths_with_controls_are_arcs(heading, pieces):
    pose = np.array([1.0, 2.0, heading])
    path = []
    for speed, turn, seconds in pieces:
        path.append((SE2(*pose), speed, turn, seconds))
        # fine Euler steps as the oracle
        for _ in range(2000):
            step = seconds / 2000
            middle = pose[2] + 0.5 * turn * step
            pose = pose + step * np.array([speed * np.cos(middle), speed * np.sin(middle), turn])
    path.append((SE2(*pose), 0.0, 0.0, 0.0))
    trajectory = path_trajectory(SE2WithControlsPath(path), 3.0, "move")
    assert trajectory.start == 3.0
    assert trajectory.duration == pytest.approx(sum(p[2] for p in pieces))
    assert trajectory.poses[-1] == pytest.approx(pose, abs=1e-4)
    middle = interpolate(trajectory.poses[0], trajectory.poses[1], 0.5)
    speed, turn, seconds = pieces[0]
    assert middle[2] == pytest.approx(heading + turn * seconds / 2, abs=1e-6)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: p.update(format="other"), "is no plan"),
        (lambda p: p.update(version=2), "version 2"),
        (lambda p: p.pop("motions"), "lacks 'motions'"),
        (lambda p: p.update(makespan="long"), "'makespan' cannot be 'long'"),
        (lambda p: p["objects"][0].pop("footprint"), "entry 0 of 'objects' lacks 'footprint'"),
        (lambda p: p["motions"][0].update(object="r9"), "moves 'r9', which is no object"),
        (lambda p: p["motions"][0].update(activity="fly"), "which is no activity"),
        (lambda p: p["motions"][0].update(samples=[]), r"must be rows \[t, x, y, theta\]"),
        (lambda p: p["motions"][0].update(samples=[[0, 1]]), r"must be rows \[t, x, y, theta\]"),
        (lambda p: p["motions"][0].update(samples=[[0, 1, 2, None]]), "finite numbers"),
        (lambda p: p["motions"][0]["samples"][0].append(1.0), "must be rows"),
        (lambda p: p.update(makespan=float("nan")), "'makespan' cannot be nan: .* finite number"),
        (lambda p: p.update(makespan=1e8), "a number between"),
        (lambda p: p["objects"][0].update(name="r" * 1001), "a text of at most 1000"),
        (lambda p: p["motions"][0]["samples"].reverse(), "increasing times"),
    ],
)
def test_wrong_plans_are_refused_by_name(data, spoil, message):
    spoil(data)
    with pytest.raises(ProblemError, match=message):
        check_plan(data, "the plan")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: p["activities"][0].update(name="fly"), "which is no activity"),
        (lambda p: p["activities"].append({"name": "x", "start": 0, "end": 1}), "'x' is not in"),
        (lambda p: p["activities"][0].update(end=8.5), "no whole number"),
        (lambda p: p["motions"].pop(0), "has no motion of 'r0'"),
    ],
)
def test_plans_of_another_problem_are_refused(made, data, spoil, message):
    spoil(data)
    with pytest.raises(ProblemError, match=message):
        plan_from_dict(made.problem, data)


def test_unreadable_files_are_named(tmp_path):
    with pytest.raises(ProblemError, match=r"none\.json' cannot be read"):
        read_plan(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(ProblemError, match=r"bad\.json' is not JSON"):
        read_plan(tmp_path / "bad.json")


def test_the_documented_example_is_a_plan():
    text = (ROOT / "docs" / "plan-format.md").read_text()
    example = re.search(r"```json\n(.*?)```", text, re.DOTALL).group(1)
    plan = json.loads(example.replace(" ...,", ""))
    check_plan(plan, "the example")
    assert list(plan) == KEYS
