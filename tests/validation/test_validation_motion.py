"""Motions that are right, what cannot be judged, and the UP engine."""

import math

import numpy as np
import pytest
from unified_planning.engines import ValidationResultStatus
from unified_planning.model.motion import (
    SE3,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
)
from unified_planning.shortcuts import ConfigurationType

from tests.validation.validation_kit import HOME, WAY, World, controls, drive, hall, judge, kinds
from up_samp.engines.validator import SampValidator
from up_samp.model import ProblemError, Trajectory
from up_samp.validation import validate_plan


def test_valid_drive(world):
    world.move("m", "r1", drive(HOME, WAY, 1.3), 1, 26)
    assert judge(world).valid
    assert judge(world).definition3


@pytest.mark.parametrize("step", [0.02, 0.05, 0.1])
def test_sampling_rate_does_not_matter(world, step):
    world.move("m", "r1", drive(HOME, WAY, 1.3, step=step), 1, 26)
    assert judge(world).valid


def test_paths_alone_and_both(world):
    trajectory = drive(HOME, WAY, 1.0)
    world.move("m", "r1", trajectory, 1, 26)
    plan = world.plan(paths=True)
    assert validate_plan(world.problem, plan).valid
    assert validate_plan(world.problem, plan, world.trajectories).valid
    # waiting before the start is no disagreement
    late = {"m": trajectory.shifted(0.7)}
    assert validate_plan(world.problem, plan, late).valid
    other = {"m": drive(HOME, [(10.0, 0.0), (3.0, 0.5), (-4.0, 0.0), (6.0, -0.97)], 1.0)}
    assert "path" in kinds(validate_plan(world.problem, plan, other))
    # trajectories of the plan itself are used first
    plan.trajectories = {"m": drive(HOME, WAY, 0.0)}
    assert kinds(validate_plan(world.problem, plan)) == ["window"]


def test_controls_that_lead_elsewhere(world):
    trajectory = drive(HOME, WAY, 1.0)
    world.move("m", "r1", trajectory, 1, 26)
    path = controls(trajectory)
    pose, v, omega, dt = path.path[50]
    path.path[50] = (pose, v * 1.1, omega, dt)
    plan = world.plan()
    activity = world.problem.activities[0]
    plan.motion_paths = {(activity, activity.motion_constraints[0]): path}
    assert kinds(validate_plan(world.problem, plan)) == ["path", "trajectory"]


def test_constant_speed_over_long_pieces_is_no_rest_to_rest_motion(world):
    trajectory = drive(HOME, [(8.0, 0.0)], 1.0)
    world.move("m", "r1", trajectory, 1, 26)
    path = controls(trajectory)
    path.path[:] = [(path.path[0][0], 1.0, 0.0, 8.0), (path.path[-1][0], 0.0, 0.0, 0.0)]
    plan = world.plan()
    activity = world.problem.activities[0]
    plan.motion_paths = {(activity, activity.motion_constraints[0]): path}
    assert kinds(validate_plan(world.problem, plan)) == ["rest-at-end", "rest-at-start"]


def test_seconds_per_unit(world):
    world.move("m", "r1", drive(HOME, WAY, 2.0), 4, 52)
    assert judge(world, seconds_per_unit=0.5).valid
    assert kinds(judge(world)) == ["window"]
    with pytest.raises(ProblemError):
        judge(world, seconds_per_unit=0.0)


def test_map_with_turned_origin_and_unknown_cells(tmp_path):
    yaw = 0.3
    c, s = math.cos(yaw), math.sin(yaw)

    def world_pose(x, y, theta):
        return 5 + c * x - s * y, -3 + s * x + c * y, theta + yaw

    for unknown in (False, True):
        cells = hall()
        if unknown:
            cells[98:102, 100] = 2
        folder = tmp_path / str(unknown)
        folder.mkdir()
        w = World(folder, cells, origin=(5.0, -3.0, yaw))
        w.object("r1", world_pose(*HOME))
        w.move("m", "r1", drive(world_pose(*HOME), [(12.0, 0.0)]), 0, 20)
        assert kinds(judge(w)) == (["map-collision"] if unknown else [])


def test_wrong_problems_are_named(tmp_path):
    w = World(tmp_path)
    w.object("r1", HOME, motion_parameters={"vmax": 2.0})
    w.move("m", "r1", drive(HOME, [(4.0, 0.0)]), 0, 26)
    with pytest.raises(ProblemError, match="r1: unknown motion parameter 'vmax'"):
        judge(w)
    w = World(tmp_path, name="two")
    w.object("r1", None)
    w.move("m", "r1", drive(HOME, [(4.0, 0.0)]), 0, 26)
    assert kinds(judge(w)) == ["continuity"]
    w = World(tmp_path, name="three")
    w.object("r1", HOME, footprint=[(0, 0), (1, 1), (1, 0), (0, 1)])
    w.move("m", "r1", drive(HOME, [(4.0, 0.0)]), 0, 26)
    with pytest.raises(ProblemError, match="footprint of r1"):
        judge(w)
    w = World(tmp_path, name="four")
    w.object("r1", HOME)
    w.move("m", "r1", drive(HOME, [(4.0, 0.0)]), 0, 26)
    (tmp_path / "four.yaml").unlink()
    with pytest.raises(ProblemError, match=r"four\.yaml"):
        judge(w)


def test_a_flyer_needs_its_model(tmp_path):
    w = World(tmp_path)
    mesh = w.place_type.occupancy_map.filename
    space = ConfigurationType("space", OccupancyMap(mesh, (0, 0)), ConfigurationKind.SE3)
    a, b = (SE3(x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0) for x in (0.0, 3.0))
    flyer = MovableObject("f", w.robot, geometric_model="f.stl", motion_model=MotionModels.SE3)
    here, there = ConfigurationObject("here", space, a), ConfigurationObject("there", space, b)
    w.problem.add_objects([flyer, here, there])
    w.problem.set_initial_configuration(flyer, here)
    activity = w.problem.add_motion_activity("m", 10)
    activity.add_motion_constraint(ActivityWaypoints(flyer, here, [there]))
    w.times["m"] = (0, 10)
    planar = drive((0, 0, 0), [(3.0, 0.0)], v=1.0, a=1.0)
    poses = np.zeros((len(planar.times), 7))
    poses[:, 0], poses[:, 6] = planar.poses[:, 0], 1.0
    with pytest.raises(ProblemError, match="object f"):
        judge(w, trajectories={"m": Trajectory(planar.times, poses)})


def test_up_face(world):
    world.move("m", "r1", drive(HOME, WAY), 0, 26)
    plan = world.plan(paths=True)
    with SampValidator() as validator:
        assert validator.supports(world.problem.kind)
        assert validator.supports_plan(plan.kind)
        result = validator.validate(world.problem, plan)
        assert result.status is ValidationResultStatus.VALID
        assert list(result.metric_evaluations.values()) == [26]
        assert result.metrics == {"reading": "PDDL 2.1"}
        world.times["m"] = (0, 20)
        result = validator.validate(world.problem, world.plan(paths=True))
        assert result.status is ValidationResultStatus.INVALID
        assert any("window" in message.message for message in result.log_messages)
    with pytest.raises(ProblemError, match="colour"):
        SampValidator(colour=1)
