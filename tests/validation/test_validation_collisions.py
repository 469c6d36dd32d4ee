"""Who moves keeps clear of the map and of others: rule 18."""

import math

import numpy as np
import pytest
from unified_planning.model.motion import (
    ActivityWaypoints,
)

from tests.validation.validation_kit import DOOR, HOME, WAY, World, drive, judge, kinds


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
