"""Motions respect their object's limits: rule 20."""

import math

import numpy as np
import pytest
from unified_planning.model.motion import (
    MotionModels,
    SE2Path,
)

from tests.validation.validation_kit import HOME, World, changed, drive, judge, kinds
from up_samp.model import Trajectory
from up_samp.validation import validate_plan


def test_too_fast(world):
    world.move("m", "r1", drive(HOME, [(14.0, 0.0)], v=2.1), 0, 26)
    assert kinds(judge(world)) == ["speed"]
    world.trajectories["m"] = drive(HOME, [(14.0, 0.0)], v=2.015)
    assert judge(world).valid  # within one per cent


def test_accelerates_too_hard(world):
    world.move("m", "r1", drive(HOME, [(14.0, 0.0)], a=0.55), 0, 26)
    assert kinds(judge(world)) == ["acceleration", "rest-at-end", "rest-at-start"]


def test_speed_jump_in_the_middle(world):
    def skip(times, poses):
        keep = np.ones(len(times), dtype=bool)
        keep[100] = False
        later = times.copy()
        later[100:] -= times[101] - times[100]
        return later[keep], poses[keep]

    smooth = drive(HOME, [(14.0, 0.0)])
    world.move("m", "r1", changed(smooth, skip), 0, 26)
    assert "acceleration" in kinds(judge(world))


def test_moving_off_and_stopping_at_once(world):
    times = np.arange(0, 8.0 + 1e-9, 0.05)
    poses = np.column_stack((4 + times, np.full_like(times, 10.0), np.zeros_like(times)))
    world.move("m", "r1", Trajectory(times, poses), 0, 26)
    assert kinds(judge(world)) == ["rest-at-end", "rest-at-start"]
    # the same with long rests around it
    rest = np.concatenate(([0.0], 5.0 + times, [20.0]))
    around = np.concatenate((poses[:1], poses, poses[-1:]))
    world.trajectories["m"] = Trajectory(rest, around)
    assert kinds(judge(world)) == ["acceleration"]


def test_cusp_without_stop(world):
    """Forth and back along one line with a jump of speed from 1 to -1 m/s."""
    forth = drive(HOME, [(12.0, 0.0)])
    middle = int(np.searchsorted(forth.times, 4.0))
    times = forth.times[: 2 * middle + 1]
    poses = np.concatenate((forth.poses[: middle + 1], forth.poses[:middle][::-1]))
    world.move("m", "r1", Trajectory(times, poses), 0, 26)
    assert "cusp" in kinds(judge(world))


def test_side_slip(world):
    def shear(times, poses):
        poses[:, 1] += 0.03 * (poses[:, 0] - poses[0, 0])

    world.move("m", "r1", changed(drive(HOME, [(14.0, 0.0)]), shear), 0, 26)
    assert "side-slip" in kinds(judge(world))

    def crab(times, poses):
        poses[:, 1] += 0.015 * (poses[:, 0] - poses[0, 0])

    world.trajectories["m"] = changed(drive(HOME, [(14.0, 0.0)]), crab)
    assert "side-slip" in kinds(judge(world))


def test_turns_too_tightly(world):
    world.move("m", "r1", drive(HOME, [(8.0, 0.0), (1.5, 1.05)]), 0, 26)
    assert kinds(judge(world)) == ["curvature"]


def test_turning_on_the_spot(world):
    def spin(times, poses):
        poses[:, 2] = 0.3 * (1 - np.cos(np.minimum(times, math.pi)))

    still = Trajectory(np.arange(0, 4, 0.05), np.tile(HOME, (80, 1)))
    world.move("m", "r1", changed(still, spin), 0, 26)
    assert kinds(judge(world)) == ["curvature"]


def test_gap_between_samples(world):
    def gap(times, poses):
        return np.delete(times, [100, 101]), np.delete(poses, [100, 101], axis=0)

    world.move("m", "r1", changed(drive(HOME, [(14.0, 0.0)]), gap), 0, 26)
    assert kinds(judge(world)) == ["sampling"]


def test_heading_jumps_by_a_full_turn(world):
    def wrap(times, poses):
        poses[100:, 2] += math.tau

    world.move("m", "r1", changed(drive(HOME, [(14.0, 0.0)]), wrap), 0, 26)
    assert "sampling" in kinds(judge(world))


def sideways(times, poses, spin):
    """An omnidirectional body that moves along y while it turns."""
    poses[:, 1] = 10 + (poses[:, 0] - 4)
    poses[:, 0] = 4
    poses[:, 2] = spin * (poses[:, 1] - 10)


@pytest.mark.parametrize(
    ("omega", "a_max", "found"),
    [(1.0, 0.5, []), (0.5, 0.5, ["turn-rate"]), (1.0, 0.4, None)],
)
def test_omnidirectional(tmp_path, omega, a_max, found):
    w = World(tmp_path)
    parameters = {"v_max": 2.0, "a_max": a_max, "omega_max": omega}
    w.object("r1", HOME, model=MotionModels.SE2, motion_parameters=parameters)
    trajectory = changed(drive(HOME, [(6.0, 0.0)], step=0.02), lambda t, p: sideways(t, p, 0.4))
    w.move("m", "r1", trajectory, 0, 26)
    verdict = judge(w)
    if found is None:
        assert {"acceleration", "rest-at-start"} <= set(kinds(verdict))
    else:
        assert kinds(verdict) == found


def test_path_of_an_omnidirectional_body_agrees(tmp_path):
    from unified_planning.model.motion import SE2

    w = World(tmp_path)
    limits = {"v_max": 2.0, "a_max": 0.5, "omega_max": 1.0}
    w.object("r1", HOME, model=MotionModels.SE2, motion_parameters=limits)
    trajectory = drive(HOME, [(6.0, 0.0)])
    w.move("m", "r1", trajectory, 0, 26)
    plan, activity = w.plan(), w.problem.activities[0]
    key = (activity, activity.motion_constraints[0])
    plan.motion_paths = {key: SE2Path([SE2(*map(float, p)) for p in trajectory.poses[::3]])}
    assert validate_plan(w.problem, plan, w.trajectories).valid
    assert kinds(validate_plan(w.problem, plan)) == ["trajectory"]
    plan.motion_paths = {key: SE2Path([SE2(4.0, 10.0, 0.0), SE2(7.0, 10.2, 0.0)])}
    assert kinds(validate_plan(w.problem, plan, w.trajectories)) == ["path"]


def bicycle(q, u, qdot):
    qdot[0] = u[0] * math.cos(q[2])
    qdot[1] = u[0] * math.sin(q[2])
    qdot[2] = u[0] * math.tan(u[1]) / 0.8


@pytest.mark.parametrize(
    ("way", "limits", "found"),
    [
        ([(6.0, 0.0), (3.0, 0.65)], {}, []),
        ([(6.0, 0.0), (3.0, 0.75)], {}, ["curvature"]),
        ([(9.0, 0.0)], {"v_max": 1.9}, []),
        ([(9.0, 0.0)], {"v_max": 1.6}, ["speed"]),
        ([(3.0, 0.0), (-2.0, 0.0)], {"v_min": -0.5}, ["speed"]),
        ([(3.0, 0.0), (-2.0, 0.0)], {"v_min": -1.0}, []),
    ],
)
def test_bicycle(tmp_path, way, limits, found):
    w = World(tmp_path)
    steering = math.atan(0.8 * 0.7)  # the tightest curvature is 0.7
    control = {"v_min": -2.0, "v_max": 2.0, "phi_min": -steering, "phi_max": steering, **limits}
    w.object(
        "r1",
        HOME,
        motion_parameters={"a_max": 0.5},
        control_model=bicycle,
        control_parameters=control,
    )
    w.move("m", "r1", drive(HOME, way, v=1.8), 0, 26)
    assert kinds(judge(w)) == found


def unicycle(q, u, qdot):
    qdot[0], qdot[1], qdot[2] = u[0] * math.cos(q[2]), u[0] * math.sin(q[2]), u[1]


@pytest.mark.parametrize(("turn", "found"), [(0.9, []), (0.5, ["control"])])
def test_free_control_model(tmp_path, turn, found):
    w = World(tmp_path)
    control = {"speed_min": -2.0, "speed_max": 2.0, "turn_min": -turn, "turn_max": turn}
    w.object("r1", HOME, control_model=unicycle, control_parameters=control)
    w.move("m", "r1", drive(HOME, [(4.0, 0.0), (3.0, 0.5)], v=1.7), 0, 26)
    assert kinds(judge(w)) == found
