"""Each way to break a motion is planted once, and found by its kind."""

import math

import numpy as np
import pytest
from unified_planning.engines import ValidationResultStatus
from unified_planning.model import Timing
from unified_planning.model.motion import (
    SE3,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SE2Path,
)
from unified_planning.shortcuts import ConfigurationType
from validation_kit import DOOR, World, controls, drive, hall, kinds

from up_samp.engines.validator import SampValidator
from up_samp.model import ProblemError, Trajectory
from up_samp.validation import validate_plan

HOME = (4.0, 10.0, 0.0)
WAY = [(10.0, 0.0), (3.0, 0.5), (-4.0, 0.0), (6.0, -1.0)]


@pytest.fixture
def world(tmp_path):
    """One car that drives a winding way with a cusp, one that is parked."""
    w = World(tmp_path)
    w.object("r1", HOME)
    w.object("r2", (30.0, 4.0, 0.0))
    return w


def judge(w, **options):
    return validate_plan(
        w.problem, w.plan(), options.pop("trajectories", w.trajectories), **options
    )


def changed(trajectory, change):
    """A copy with ``change(times, poses)`` applied to copies in place."""
    times, poses = trajectory.times.copy(), trajectory.poses.copy()
    result = change(times, poses)
    return Trajectory(*(result or (times, poses)))


# ------------------------------------------------------------------ what is right stays right


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


# ------------------------------------------------------------------ places and times


def test_missing_and_stray_trajectories(world):
    world.move("m", "r1", drive(HOME, WAY), 0, 26)
    assert kinds(judge(world, trajectories={})) == ["trajectory"]
    with_path = world.plan(paths=True)
    assert kinds(validate_plan(world.problem, with_path, {})) == ["trajectory"]
    stray = {**world.trajectories, "n": drive(HOME, WAY)}
    assert kinds(judge(world, trajectories=stray)) == ["trajectory"]


def test_window(world):
    for start, end in ((1, 30), (0, 23)):
        world.times.clear()
        world.move(f"m{start}", "r1", drive(HOME, WAY, 0.5), start, end)
        for a in [a for a in world.problem.activities if a.name not in world.times]:
            a._optional = True
        world.trajectories = {k: v for k, v in world.trajectories.items() if k in world.times}
        assert kinds(judge(world)) == ["window"]


def test_start_goal_waypoint_and_their_order(tmp_path):
    trajectory = drive(HOME, [(6.0, 0.0), (4.0, 0.25), (4.0, 0.0)])

    def verdict(*stops):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        w = World(folder)
        w.object("r1", HOME)
        w.move("m", "r1", trajectory, 0, 30, fake=[HOME, *stops])
        return kinds(judge(w))

    first, second, goal = (10.0, 10.0, 0.0), trajectory.at(6.03), tuple(trajectory.poses[-1])
    assert verdict(first, second, goal) == []
    turned = (first[0], first[1], math.tau)
    assert verdict(turned, goal) == []
    assert verdict(second, first, goal) == ["waypoint"]
    assert verdict((10.0, 10.01, 0.0), goal) == ["waypoint"]
    assert verdict((10.0, 10.0, 0.01), goal) == ["waypoint"]
    assert verdict((goal[0] + 0.01, goal[1], goal[2])) == ["goal"]


def test_wrong_start_and_teleport(tmp_path):
    w = World(tmp_path)
    w.object("r1", HOME)
    w.move("m", "r1", drive((4.0, 10.5, 0.0), [(5.0, 0.0)]), 0, 20)
    assert kinds(judge(w)) == ["continuity"]
    w.trajectories["m"] = drive(HOME, [(5.0, 0.0)])
    assert kinds(judge(w)) == ["goal", "start"]


def test_second_motion_starts_where_the_first_ended(tmp_path):
    for gap, found in ((0.0, []), (0.5, ["continuity"])):
        folder = tmp_path / str(gap)
        folder.mkdir()
        w = World(folder)
        w.object("r1", HOME)
        w.move("m", "r1", drive(HOME, [(5.0, 0.0)]), 0, 8)
        w.move("n", "r1", drive((9.0 + gap, 10.0, 0.0), [(5.0, 0.0)], 9.0), 9, 20)
        assert kinds(judge(w)) == found


def test_one_activity_at_a_time_moves_an_object(tmp_path):
    for start, found in ((7, ["overlap"]), (8, []), (9, [])):
        folder = tmp_path / str(start)
        folder.mkdir()
        w = World(folder)
        w.object("r1", HOME)
        w.move("m", "r1", drive(HOME, [(5.0, 0.0)]), 0, 8)
        w.move("n", "r1", drive((9.0, 10.0, 0.0), [(5.0, 0.0)], 9.0), start, 20)
        assert kinds(judge(w)) == found


def test_setting_an_object_that_is_driven(tmp_path):
    w = World(tmp_path)
    w.object("r1", HOME)
    w.move("m", "r1", drive(HOME, [(5.0, 0.0)]), 0, 8)
    w.set_place("s", "r1", (9.0, 10.0, 0.0), 4, 5)
    assert "overlap" in kinds(judge(w))
    w.times["s"] = (8, 9)
    assert judge(w).valid
    # the driving activity's own effect has to agree with where it drives
    own = w.problem.activities[0]
    own.add_motion_effect(w.movables["r1"], w.place((9.0, 10.0, 0.0)))
    assert judge(w).valid
    own.clear_motion_effects()
    own.add_motion_effect(w.movables["r1"], w.place((9.0, 11.0, 0.0)))
    assert kinds(judge(w)) == ["teleport"]


# ------------------------------------------------------------------ collisions


def test_thin_wall_between_samples(tmp_path):
    """The cells at x = 20 are hit although each end of each sample step is free of them."""
    cells = np.zeros((100, 400), dtype=int)
    cells[50, 200] = 1
    w = World(tmp_path, cells)
    dot = [(-0.01, -0.01), (0.01, -0.01), (0.01, 0.01), (-0.01, 0.01)]
    fast = {"v_max": 20.0, "a_max": 50.0}
    w.object("r1", (11.55, 5.05, 0.0), dot, motion_parameters=fast)
    w.move("m", "r1", drive((11.55, 5.05, 0.0), [(16.0, 0.0)], v=20.0, a=50.0), 0, 20)
    xs = w.trajectories["m"].poses[:, 0]
    assert not ((xs > 19.98) & (xs < 20.12)).any()
    verdict = judge(w)
    assert kinds(verdict) == ["map-collision"]
    assert "m [0, 20] moving r1" in verdict.violations[0].what


def test_corner_cut_and_outside(tmp_path):
    cells = np.zeros((200, 400), dtype=int)
    cells[100:110, 200:210] = 1
    w = World(tmp_path, cells)
    w.object("r1", (17.0, 9.4, 0.0))
    w.move("m", "r1", drive((17.0, 9.4, 0.0), [(8.0, 0.0)]), 0, 20)
    assert judge(w).valid
    w2 = World(tmp_path, cells, name="other")
    w2.object("r1", (17.0, 9.55, 0.0))
    w2.move("m", "r1", drive((17.0, 9.55, 0.0), [(8.0, 0.0)]), 0, 20)
    assert kinds(judge(w2)) == ["map-collision"]
    w3 = World(tmp_path, cells, name="edge")
    w3.object("r1", (35.0, 5.0, 0.0))
    w3.move("m", "r1", drive((35.0, 5.0, 0.0), [(4.2, 0.0)]), 0, 20)
    assert kinds(judge(w3)) == ["map-collision"]


@pytest.mark.parametrize(("overlap", "found"), [(0.0, []), (9e-7, []), (1e-3, ["collision"])])
def test_touching_is_no_collision(tmp_path, overlap, found):
    w = World(tmp_path)
    w.object("r1", HOME)
    w.object("r2", (7.0, 11.0 - overlap, 0.0))
    w.move("m", "r1", drive(HOME, [(2.0, 0.0)]), 0, 20)
    assert kinds(judge(w)) == found


def test_parked_robot_in_the_way(world):
    world.object("r3", (10.0, 10.5, 1.0))
    world.move("m", "r1", drive(HOME, WAY), 0, 26)
    verdict = judge(world)
    assert kinds(verdict) == ["collision"]
    assert "r3" in verdict.violations[0].what


def crossing(folder, delay, **options):
    """Two cars whose ways cross at (12, 10); the second one starts ``delay`` s later."""
    w = World(folder)
    w.object("r1", HOME)
    w.object("r2", (12.0, 3.0, math.pi / 2))
    w.move("m", "r1", drive(HOME, [(14.0, 0.0)]), 0, 30)
    w.move("n", "r2", drive((12.0, 3.0, math.pi / 2), [(13.0, 0.0)], delay), 0, 30, **options)
    return w


@pytest.mark.parametrize(("delay", "meets"), [(0.0, True), (0.5, True), (5.0, False)])
def test_two_moving_robots(tmp_path, delay, meets):
    assert kinds(judge(crossing(tmp_path, delay))) == (["collision"] if meets else [])


def test_overlap_only_between_samples(tmp_path):
    """Fast dots pass through each other between two samples of both."""
    w = World(tmp_path)
    dot = [(-0.01, -0.01), (0.01, -0.01), (0.01, 0.01), (-0.01, 0.01)]
    fast = {"v_max": 20.0, "a_max": 50.0}
    starts = {"r1": (3.5, 10.0, 0.0), "r2": (12.0, 1.5, math.pi / 2)}
    for name, start in starts.items():
        w.object(name, start, dot, motion_parameters=fast)
        trajectory = drive(start, [(16.0, 0.0)], v=20.0, a=50.0)
        w.move(f"drive {name}", name, trajectory, 0, 5)
    one, two = (t.poses[:, :2] for t in w.trajectories.values())
    assert np.abs(one - two).max(axis=1).min() > 0.05
    assert kinds(judge(w)) == ["collision"]


def test_waiting_robot_is_an_obstacle_and_has_them(tmp_path):
    """A robot that has arrived early is hit while its activity still runs, or after it."""
    w = crossing(tmp_path, 0.0)
    w.trajectories["n"] = drive((12.0, 3.0, math.pi / 2), [(7.0, 0.0)])
    activity = w.problem.activities[1]
    activity.clear_motion_constraints()
    goal = w.place((12.0, 10.0, math.pi / 2))
    activity.add_motion_constraint(
        ActivityWaypoints(w.movables["r2"], w.place((12.0, 3.0, math.pi / 2)), [goal])
    )
    w.trajectories["m"] = w.trajectories["m"].shifted(12.0)
    for end in (11, 30):
        w.times["n"] = (0, end)
        assert kinds(judge(w)) == ["collision"]


def test_listed_obstacles_only(tmp_path):
    for number, (mine, theirs, meets) in enumerate(
        [
            ([], [], False),
            ([], None, True),
            (["r2"], [], True),
            ([], ["r1"], True),
        ]
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        w = World(folder)
        w.object("r1", HOME)
        w.object("r2", (12.0, 3.0, math.pi / 2))

        def listed(names, w=w):
            return None if names is None else [w.movables[n] for n in names]

        first = {"dynamic_obstacles_at_start": listed(mine), "static_obstacles": []}
        second = {"dynamic_obstacles_at_start": listed(theirs)}
        w.move("m", "r1", drive(HOME, [(14.0, 0.0)]), 0, 30, **first)
        w.move("n", "r2", drive((12.0, 3.0, math.pi / 2), [(13.0, 0.0)]), 0, 30, **second)
        assert kinds(judge(w)) == (["collision"] if meets else [])


def door_world(folder, opens, passes):
    """r1 drives through the gap at x = 20 from ``passes`` on; the door opens at ``opens``."""
    w = World(folder)
    w.object("r1", (10.0, 10.0, 0.0))
    w.object("door", (20.05, 10.0, 0.0), DOOR)
    w.set_place("open", "door", (20.05, 15.0, 0.0), opens - 1, opens)
    w.move("m", "r1", drive((10.0, 10.0, 0.0), [(20.0, 0.0)], passes), passes, passes + 20)
    return w


@pytest.mark.parametrize(("opens", "found"), [(5, []), (9, []), (12, ["collision"])])
def test_door(tmp_path, opens, found):
    """The car reaches the door 5.5 s after its start at 5: the door may open while it drives."""
    assert kinds(judge(door_world(tmp_path, opens, 5))) == found


def test_door_that_closes_on_a_waiting_robot(tmp_path):
    w = World(tmp_path)
    w.object("r1", (10.0, 10.0, 0.0))
    w.object("door", (20.05, 15.0, 0.0), DOOR)
    w.set_place("close", "door", (20.05, 10.0, 0.0), 28, 29)
    w.move("m", "r1", drive((10.0, 10.0, 0.0), [(10.0, 0.0)], 0.0), 0, 30)
    assert kinds(judge(w)) == ["collision"]
    # objects are obstacles wherever they are: also at rest, between activities
    w.times["m"] = (0, 20)
    (hit,) = judge(w).violations
    assert (hit.kind, hit.activities, hit.objects, hit.time) == (
        "collision",
        ("close",),
        ("door", "r1"),
        29.0,
    )
    w.times["close"] = (3, 4)
    assert kinds(judge(w)) == ["collision"]  # into the door then


def test_a_door_may_shut_onto_what_never_heeds_it(tmp_path):
    """A leaf beside another, and a robot whose motions all name other obstacles."""
    w = World(tmp_path)
    w.object("r1", (10.0, 10.0, 0.0))
    w.object("door", (20.05, 15.0, 0.0), DOOR)
    w.object("leaf", (20.05, 10.0, 0.0), DOOR)
    w.set_place("close", "door", (20.05, 10.0, 0.0), 28, 29)
    assert judge(w).valid
    none = {"static_obstacles": [], "dynamic_obstacles_at_start": []}
    w.move("m", "r1", drive((10.0, 10.0, 0.0), [(9.0, 0.0)], 0.0), 0, 20, **none)
    assert judge(w).valid
    w.move("n", "r1", drive((19.0, 10.0, 0.0), [(-9.0, 0.0)], 40.0), 40, 60)
    assert kinds(judge(w)) == ["collision"]


def test_a_door_may_shut_behind_a_robot_that_drives(tmp_path):
    w = World(tmp_path)
    w.object("r1", (19.3, 10.0, 0.0))
    w.object("door", (20.05, 15.0, 0.0), DOOR)
    w.set_place("close", "door", (20.05, 10.0, 0.0), 8, 9)
    w.move("m", "r1", drive((19.3, 10.0, 0.0), [(-9.0, 0.0)], 0.0), 0, 20)
    assert judge(w).valid
    w.times["close"] = (0, 1)
    assert kinds(judge(w)) == ["collision"]


def test_what_an_activity_carries_is_no_obstacle_to_it(tmp_path):
    """What does not travel with it (it stands 0.1 m further ahead in the end) is where it was for
    all others until the end; then it is set down.
    """
    w = World(tmp_path)
    w.object("r1", HOME)
    w.object("box", (5.5, 10.0, 0.0), DOOR)
    carry = w.move("m", "r1", drive(HOME, [(9.0, 0.0)]), 0, 20)
    assert kinds(judge(w)) == ["collision"]
    carry.add_motion_effect(w.movables["box"], w.place((14.6, 10.0, 0.0)))
    assert judge(w).valid
    # afterwards it is an obstacle like any other, to its carrier too
    w.move("n", "r1", drive((13.0, 10.0, 0.0), [(4.0, 0.0)], 21.0), 21, 40)
    assert kinds(judge(w)) == ["collision"]
    # others meet it where it was until the ride ends, and where it is set down from then on
    w.problem.activities.pop()
    w.times.pop("n")
    w.trajectories.pop("n")
    w.object("r2", (5.5, 3.0, math.pi / 2))
    w.move("x", "r2", drive((5.5, 3.0, math.pi / 2), [(10.0, 0.0)], 8.0), 8, 30)
    assert kinds(judge(w)) == ["collision"]
    w.times["x"], w.trajectories["x"] = (21, 50), w.trajectories["x"].shifted(13.0)
    assert judge(w).valid


def test_a_listed_load_is_an_obstacle(tmp_path):
    w = World(tmp_path)
    w.object("r1", HOME)
    box = w.object("box", (5.5, 10.0, 0.0), DOOR)
    carry = w.move("m", "r1", drive(HOME, [(9.0, 0.0)]), 0, 20, static_obstacles=[box])
    carry.add_motion_effect(box, w.place((14.6, 10.0, 0.0)))
    assert kinds(judge(w)) == ["collision"]


def test_waiting_before_and_after_its_motion_a_robot_rests(tmp_path):
    """Lists that are not mutual: who lists the other keeps clear while it moves itself."""
    for lists_of, meets in (("r2", False), ("r1", True)):
        folder = tmp_path / lists_of
        folder.mkdir()
        w = World(folder)
        w.object("r1", HOME)
        w.object("r2", (12.0, 10.0, 0.0))
        lists = {"r1": [], "r2": []}
        lists[lists_of] = [w.movables["r2" if lists_of == "r1" else "r1"]]
        w.move("m", "r1", drive(HOME, [(20.0, 0.0)]), 0, 20, static_obstacles=lists["r1"])
        late = drive((12.0, 10.0, 0.0), [(5.0, 0.0)], 30.0)
        w.move("n", "r2", late, 0, 40, static_obstacles=lists["r2"])
        assert ("collision" in kinds(judge(w))) == meets


def test_static_obstacles_rest(tmp_path):
    def verdict(number, low, high, door_time=None):
        folder = tmp_path / str(number)
        folder.mkdir()
        w = World(folder)
        w.object("r1", HOME)
        w.object("r2", (30.0, 4.0, 0.0))
        w.object("door", (20.05, 10.0, 0.0), DOOR)
        still = [w.movables["r2"], w.movables["door"]]
        w.move("m", "r1", drive(HOME, [(6.0, 0.0)]), 0, 10, static_obstacles=still)
        w.move("n", "r2", drive((30.0, 4.0, 0.0), [(2.0, 0.0)], low), low, high)
        if door_time:
            w.set_place("open", "door", (20.05, 15.0, 0.0), door_time - 1, door_time)
        return kinds(judge(w))

    assert verdict(0, 11, 20) == []
    assert verdict(1, 9, 20) == ["static-obstacle"]
    assert verdict(2, 11, 20, 5) == ["static-obstacle"]
    assert verdict(3, 11, 20, 10) == []


@pytest.mark.parametrize("effect", ["start", "end", "end - 1", "end + 3"])
@pytest.mark.parametrize("asks", [0, 5, 12, 13, 14, 15, 20])
def test_a_moving_obstacles_fluent_tells_where_it_last_stood(tmp_path, effect, asks):
    """r2 drives from 3 to 13: the dict asks no more than the list, whenever its fluent is set."""
    w = World(tmp_path)
    w.object("r1", HOME)
    r2 = w.object("r2", (30.0, 4.0, 0.0))
    here, there = w.place((30.0, 4.0, 0.0)), w.place((33.0, 4.0, 0.0))
    at = w.problem.add_fluent("r2_at", w.place_type, default_initial_value=here)
    n = w.move("n", "r2", drive((30.0, 4.0, 0.0), [(3.0, 0.0)], 3.5), 3, 13)
    delay = {"end - 1": -1, "end + 3": 3}.get(effect, 0)
    n.add_effect(Timing(delay, n.start if effect == "start" else n.end), at, there)
    w.move(
        "m",
        "r1",
        drive(HOME, [(6.0, 0.0)], asks + 0.5),
        asks,
        asks + 10,
        dynamic_obstacles_at_start={r2: at},
    )
    assert judge(w).valid


def test_a_fluent_that_never_held_is_refused(tmp_path):
    w = World(tmp_path)
    w.object("r1", HOME)
    r2 = w.object("r2", (30.0, 4.0, 0.0))
    wrong = w.place((33.0, 6.0, 0.0))
    at = w.problem.add_fluent("r2_at", w.place_type, default_initial_value=wrong)
    w.move("m", "r1", drive(HOME, [(6.0, 0.0)]), 0, 10, dynamic_obstacles_at_start={r2: at})
    (refused,) = judge(w).violations
    assert (refused.kind, refused.activities, refused.objects, refused.time) == (
        "obstacle-place",
        ("m",),
        ("r2",),
        0.0,
    )


@pytest.mark.parametrize(
    ("delay", "asks", "found"),
    [(0, 4, ["obstacle-place"]), (0, 5, []), (-1, 4, []), (-1, 3, ["static"]), (2, 5, ["place"])],
)
def test_a_static_obstacle_is_where_its_fluent_says(tmp_path, delay, asks, found):
    """A door opens at 4, its fluent is set ``delay`` later: who asks waits until both agree."""
    w = World(tmp_path)
    w.object("r1", HOME)
    door = w.object("door", (20.05, 10.0, 0.0), DOOR)
    shut, away = w.place((20.05, 10.0, 0.0)), w.place((20.05, 15.0, 0.0))
    at = w.problem.add_fluent("door_at", w.place_type, default_initial_value=shut)
    opening = w.set_place("open", "door", (20.05, 15.0, 0.0), 3, 4)
    opening.add_effect(Timing(delay, opening.end), at, away)
    trajectory = drive(HOME, [(6.0, 0.0)], asks)
    w.move("m", "r1", trajectory, asks, asks + 10, static_obstacles={door: at})
    assert len(found) == 0 or any(found[0] in k for k in kinds(judge(w)))
    assert judge(w).valid == (not found)


def test_obstacles_with_fluents(tmp_path):
    w = World(tmp_path)
    w.object("r1", HOME)
    door = w.object("door", (20.05, 10.0, 0.0), DOOR)
    shut, away = w.place((20.05, 10.0, 0.0)), w.place((20.05, 15.0, 0.0))
    at = w.problem.add_fluent("door_at", w.place_type, default_initial_value=shut)
    w.move("m", "r1", drive(HOME, [(6.0, 0.0)], 5.0), 5, 15, static_obstacles={door: at})
    assert judge(w).valid
    opening = w.set_place("open", "door", (20.05, 15.0, 0.0), 3, 4)
    assert kinds(judge(w)) == ["obstacle-place"]
    opening.add_effect(opening.end, at, away)
    assert judge(w).valid
    w.times["open"] = (9, 10)
    assert "static-obstacle" in kinds(judge(w))


def test_places_from_fluents_and_parameters(tmp_path):
    w = World(tmp_path)
    w.object("r1", HOME)
    trajectory = drive(HOME, [(6.0, 0.0)])
    home, goal = w.place(HOME), w.place((10.0, 10.0, 0.0))
    at = w.problem.add_fluent("at", w.place_type, default_initial_value=home)
    activity = w.problem.add_motion_activity("m")
    activity.set_duration_bounds(0, 100)
    to = activity.add_parameter("to", w.place_type)
    activity.add_motion_constraint(ActivityWaypoints(w.movables["r1"], at, [to]))
    activity.add_effect(activity.end, at, to)
    w.times["m"], w.trajectories["m"] = (0, 10), trajectory
    for place, found in ((goal, []), (home, ["goal"])):
        plan = w.plan()
        plan.set(to, place)
        assert kinds(validate_plan(w.problem, plan, w.trajectories)) == found


# ------------------------------------------------------------------ kinematics


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


# ------------------------------------------------------------------ what cannot be judged


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


# ------------------------------------------------------------------ the UP engine


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
