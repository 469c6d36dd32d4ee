"""Where and when a motion starts and ends, and what else moves its object: rules 15 to 17."""

import math

import numpy as np
import pytest

from tests.validation.validation_kit import HOME, WAY, World, drive, judge, kinds
from up_samp.model import Trajectory
from up_samp.validation import validate_plan


@pytest.mark.parametrize(
    ("stay", "found"), [((26, 26), ["overlap"]), ((26, 27), []), ((27, 27), []), ((0, 0), [])]
)
def test_who_takes_no_time_does_not_drive_just_when_another_drive_ends(world, stay, found):
    """Whether or not that one says by a motion effect where it ends."""
    way = drive(HOME, WAY)
    world.move("m", "r1", way, 0, 26)
    place = way.poses[:1] if stay == (0, 0) else way.poses[-1:]
    world.move("stay", "r1", Trajectory(np.array([float(stay[0])]), place.copy()), *stay)
    assert kinds(judge(world)) == found


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
