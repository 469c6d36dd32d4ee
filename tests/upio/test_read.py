import math

import pytest
from unified_planning.model import Object
from unified_planning.model.motion import (
    SE3,
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    MotionModels,
    MovableObject,
)
from unified_planning.shortcuts import OneshotPlanner

from tests.upio.hall import ROBOT, Hall, write_hall
from up_samp.model import MotionModel, ProblemError, UnsupportedError
from up_samp.model.snapshot import Term, TermKind
from up_samp.upio import read_problem
from up_samp.validation import validate_plan


def test_a_move_is_read_with_its_poses_and_limits(tmp_path):
    hall = Hall(tmp_path, robots=2, door=True)
    hall.move("go", 0, "left0", "right0", static_obstacles=[hall.door])
    hall.open_door()
    snapshot = read_problem(hall.problem)
    (task,) = snapshot.tasks
    assert task.object == "r0"
    assert [t.name for t in task.terms] == ["left0", "right0"]
    assert task.avoid == {"door"}
    body = snapshot.objects["r0"].body
    assert body.kinematics.turning_radius == 0.8
    assert body.kinematics.model is MotionModel.REEDSSHEPP
    assert body == snapshot.objects["r1"].body
    (change,) = snapshot.changes
    assert change.object == "door"
    assert change.term == Term(TermKind.CONSTANT, "away")
    assert snapshot.initial == {"r0": "left0", "r1": "left1", "door": "shut"}
    assert snapshot.map_file.endswith("hall.yaml")


def test_no_obstacle_lists_mean_all_objects(tmp_path):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0")
    assert read_problem(hall.problem).tasks[0].avoid is None


def test_a_bicycle_is_read_as_a_car(tmp_path):
    def bicycle(q, u, qdot):
        qdot[0] = u[0] * math.cos(q[2])
        qdot[1] = u[0] * math.sin(q[2])
        qdot[2] = u[0] * math.tan(u[1]) / 0.5

    limit = math.atan(0.5 / 2.0)
    hall = Hall(
        tmp_path,
        control_model=bicycle,
        control_parameters={"v_min": -1.0, "v_max": 1.5, "phi_min": -limit, "phi_max": limit},
    )
    hall.move("go", 0, "left0", "right0")
    limits = read_problem(hall.problem).objects["r0"].body.kinematics
    assert limits.model is MotionModel.REEDSSHEPP
    assert limits.turning_radius == pytest.approx(2.0)
    assert limits.v_max == 1.0  # the smaller of motion parameter and control bound


@pytest.mark.parametrize(
    ("low", "own", "limits"),
    [
        (-0.5, {}, (2.0, 0.5)),
        (-0.5, {"v_max": 1.5}, (1.5, 0.5)),
        (-3.0, {}, (2.0, math.inf)),
        (-1.0, {"reverse_v_max": 0.3}, (2.0, 0.3)),
        (-0.2, {"reverse_v_max": 0.3}, (2.0, 0.2)),
        (0.5, {}, (2.0, math.inf)),
    ],
)
def test_a_bicycle_is_slow_backwards_alone(low, own, limits, tmp_path):
    """Ahead it drives as fast as it may: by both speeds at once it was called slower than it is."""

    def bicycle(q, u, qdot):
        qdot[0] = u[0] * math.cos(q[2])
        qdot[1] = u[0] * math.sin(q[2])
        qdot[2] = u[0] * math.tan(u[1]) / 0.5

    hall = Hall(
        tmp_path,
        map_file=write_hall(tmp_path, wall_gap=(20, 50)),
        motion_parameters={"a_max": 0.5, **own},
        control_model=bicycle,
        control_parameters={"v_min": low, "v_max": 2.0, "phi_max": math.atan(0.5)},
    )
    hall.move("go", 0, "left0", "right0")
    read = read_problem(hall.problem).objects["r0"].body.kinematics
    assert (read.v_max, read.v_back) == limits
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(hall.problem, timeout=60)
    # 14 m from rest to rest, ahead
    assert int(result.metrics["makespan"]) == math.ceil(14.0 / read.v_max + read.v_max / 0.5)
    assert validate_plan(hall.problem, result.plan).valid


def test_another_ode_stays_a_control_model(tmp_path):
    def unicycle(q, u, qdot):
        qdot[0] = u[0] * math.cos(q[2])
        qdot[1] = u[0] * math.sin(q[2])
        qdot[2] = u[1]

    hall = Hall(
        tmp_path,
        control_model=unicycle,
        control_parameters={"v_max": 1.0, "w_min": -1.0, "w_max": 1.0},
    )
    hall.move("go", 0, "left0", "right0")
    limits = read_problem(hall.problem).objects["r0"].body.kinematics
    assert limits.model is MotionModel.CONTROL
    assert limits.control.bounds == (("v", -1.0, 1.0), ("w", -1.0, 1.0))


def _spoil_unknown_parameter(folder):
    return Hall(folder, motion_parameters={"turning_radios": 1.0})


def _spoil_bad_parameter(folder):
    return Hall(folder, motion_parameters={"v_max": -1.0})


def _spoil_model(folder):
    return Hall(folder, motion_model="hovercraft")


def _spoil_footprint(folder):
    return Hall(folder, footprint=[(0, 0), (1, 0)])


def _spoil_no_initial(folder):
    hall = Hall(folder)
    other = MovableObject("lost", hall.robot, footprint=ROBOT, motion_model=MotionModels.REEDSSHEPP)
    hall.problem.add_object(other)
    hall.robots.append(other)
    hall.move("go", 1, "left0", "right0")
    return hall


def _spoil_two_initials(folder):
    hall = Hall(folder)
    hall.problem.set_initial_configuration(hall.robots[0], hall.poses["right0"])
    return hall


def _spoil_duplicate_name(folder):
    hall = Hall(folder)
    hall.move("go", 0, "left0", "right0")
    hall.move("go", 0, "right0", "left0")
    return hall


def _spoil_waypoint_kind(folder):
    hall = Hall(folder)
    pose = ConfigurationObject("high", hall.place, SE3(0, 0, 0, 0, 0, 0, 1))
    hall.problem.add_object(pose)
    hall.poses["high"] = pose
    hall.move("go", 0, "left0", "high")
    return hall


def _spoil_waypoint_object(folder):
    hall = Hall(folder)
    pose = Object("nowhere", hall.place)
    hall.problem.add_object(pose)
    hall.poses["nowhere"] = pose
    hall.move("go", 0, "left0", "nowhere")
    return hall


def _spoil_effect(folder):
    hall = Hall(folder)
    hall.move("go", 0, "left0", "right0").add_motion_effect(hall.robots[0], hall.poses["left0"])
    return hall


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_spoil_unknown_parameter, ["r0", "turning_radios"]),
        (_spoil_bad_parameter, ["r0", "v_max"]),
        (_spoil_model, ["r0", "motion model"]),
        (_spoil_footprint, ["r0", "footprint"]),
        (_spoil_no_initial, ["lost", "go", "initial configuration"]),
        (_spoil_two_initials, ["r0", "left0", "right0"]),
        (_spoil_duplicate_name, ["go"]),
        (_spoil_waypoint_kind, ["go", "high", "r0"]),
        (_spoil_waypoint_object, ["nowhere"]),
        (_spoil_effect, ["go", "left0", "right0"]),
    ],
)
def test_bad_input_is_named(tmp_path, spoil, words):
    hall = spoil(tmp_path)
    with pytest.raises(ProblemError) as caught:
        read_problem(hall.problem)
    for word in words:
        assert word in str(caught.value)


def test_two_constraints_on_one_object_are_refused_by_name(tmp_path):
    hall = Hall(tmp_path)
    hall.pose("middle", 5.0, 5.0, 0.0)
    activity = hall.move("go", 0, "left0", "middle")
    activity.add_motion_constraint(
        ActivityWaypoints(hall.robots[0], hall.poses["middle"], [hall.poses["right0"]])
    )
    with pytest.raises(UnsupportedError, match="go"):
        read_problem(hall.problem)


def test_reading_does_not_change_the_problem(tmp_path):
    hall = Hall(tmp_path, door=True)
    hall.move("go", 0, "left0", "right0")
    before = repr(hall.problem)
    read_problem(hall.problem)
    assert repr(hall.problem) == before
    assert isinstance(hall.problem.activities[0], MotionActivity)
