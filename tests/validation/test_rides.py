"""Loads that travel with a robot: with it one body, before, during and after the ride (rule 18)."""

import math

import pytest

from tests.validation.validation_kit import HOME, World, drive, kinds
from up_samp.validation import validate_plan

PALLET = [(-0.5, -1.0), (0.5, -1.0), (0.5, 1.0), (-0.5, 1.0)]
BEAM = [(-0.15, -2.5), (0.15, -2.5), (0.15, 2.5), (-0.15, 2.5)]
"""5 m wide: the hall's gap is 4 m, the cars are 1 m."""


def judge(w):
    return validate_plan(w.problem, w.plan(), w.trajectories)


def laden(folder, *, shape=PALLET, ahead=1.5, way=20.0, goal=None, stands=None, **lists):
    """A car that drives ``way`` m straight ahead with a load ``ahead`` m before it."""
    w = World(folder)
    w.object("r1", HOME)
    x, y, theta = HOME
    box = w.object("box", stands or (x + ahead, y, theta), shape)
    ride = w.move("m", "r1", drive(HOME, [(way, 0.0)]), 0, 30, **lists)
    ride.add_motion_effect(box, w.place(goal or (x + ahead + way, y, theta)))
    return w


def test_a_load_has_to_fit_where_its_robot_does(tmp_path):
    narrow, wide = tmp_path / "narrow", tmp_path / "wide"
    narrow.mkdir(), wide.mkdir()
    assert judge(laden(narrow)).valid
    verdict = judge(laden(wide, shape=BEAM, ahead=1.15))
    assert kinds(verdict) == ["map-collision"]
    assert verdict.violations[0].objects == ("box",)
    # set down by other means, it is where it was until the end, and fits
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert judge(laden(elsewhere, shape=BEAM, goal=(30.0, 10.0, 0.0))).valid


@pytest.mark.parametrize("lists", ["all", "listed"])
def test_a_load_meets_what_its_robot_passes_by(tmp_path, lists):
    w = laden(tmp_path)
    other = w.object("r2", (12.0, 11.8, 0.0))  # 0.3 m beside the load's way, 0.8 m beside the car
    assert judge(w).valid
    w.problem.initial_configuration.pop()
    w.problem.set_initial_configuration(other, w.place((12.0, 11.4, 0.0)))
    if lists == "listed":
        w.problem.activities[0].motion_constraints[0]._dynamic_obstacles_at_start = [other]
    verdict = judge(w)
    assert kinds(verdict) == ["collision"]
    assert set(verdict.violations[0].objects) == {"box", "r2"}


def test_where_a_load_was_the_way_is_free_once_it_has_gone(tmp_path):
    w = laden(tmp_path)
    start = (5.5, 7.5, math.pi / 2)
    w.object("r2", start)
    w.move("x", "r2", drive(start, [(6.0, 0.0)], 6.0), 6, 40)
    assert judge(w).valid
    w.times["x"], w.trajectories["x"] = (0, 40), drive(start, [(6.0, 0.0)], 0.0)
    assert kinds(judge(w)) == ["collision"]


def test_a_load_stands_where_it_was_put(tmp_path):
    w = laden(tmp_path, way=9.0)
    back = (13.0, 10.0, 0.0)
    w.move("away", "r1", drive(back, [(-4.0, 0.0)], 31.0), 31, 50)
    assert judge(w).valid
    w.move("again", "r1", drive((9.0, 10.0, 0.0), [(6.0, 0.0)], 51.0), 51, 70)
    assert kinds(judge(w)) == ["collision"]


def test_a_load_has_to_be_there(tmp_path):
    w = laden(tmp_path, stands=(6.0, 14.0, 0.0))
    # nothing ever puts it where the ride would begin: it is no ride
    assert judge(w).valid
    bring = w.problem.add_motion_activity("bring", 1, True)
    box = w.movables["box"]
    bring.add_motion_effect(box, w.place((5.5, 10.0, 0.0)))
    verdict = judge(w)
    assert kinds(verdict) == ["continuity"]
    assert verdict.violations[0].objects == ("r1", "box")


def test_one_load_travels_with_one_robot_at_a_time(tmp_path):
    w = laden(tmp_path, way=9.0)
    start = (7.0, 10.0, math.pi)
    w.object("r2", start)
    w.problem.activities[0].motion_constraints[0]._dynamic_obstacles_at_start = []
    ride = w.move("n", "r2", drive(start, [(-9.0, 0.0)], 0.0), 0, 30, dynamic_obstacles_at_start=[])
    ride.add_motion_effect(w.movables["box"], w.place((14.5, 10.0, 0.0)))
    assert "overlap" in kinds(judge(w))


def test_what_lies_between_robot_and_load_belongs_to_them(tmp_path):
    w = laden(tmp_path, ahead=4.0)
    w.object("post", (6.3, 10.0, 0.0), [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)])
    w.problem.activities.pop()
    ride = w.move("m", "r1", drive(HOME, [(0.4, 0.0)]), 0, 30)
    assert judge(w).valid
    ride.add_motion_effect(w.movables["box"], w.place((8.4, 10.0, 0.0)))
    verdict = judge(w)
    assert kinds(verdict) == ["collision"]
    assert set(verdict.violations[0].objects) == {"r1", "post"}


def test_who_lists_the_robot_keeps_clear_of_its_load(tmp_path):
    w = laden(tmp_path, dynamic_obstacles_at_start=[])
    start = (14.0, 3.0, math.pi / 2)
    other = w.object("r2", start)
    assert other is not None
    arrives = drive(start, [(14.0, 0.0)], 2.0)
    w.move("x", "r2", arrives, 2, 40, dynamic_obstacles_at_start=[w.movables["r1"]])
    hit = kinds(judge(w))
    for begin in range(3, 14):
        w.trajectories["x"] = drive(start, [(14.0, 0.0)], float(begin))
        hit += kinds(judge(w))
    assert "collision" in hit
