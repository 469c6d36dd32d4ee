"""Obstacles that rest, and places that fluents and parameters tell: rules 14 and 19."""

import itertools

import pytest
from unified_planning.model import Timing
from unified_planning.model.motion import (
    ActivityWaypoints,
)
from unified_planning.shortcuts import Equals, IntType, Minus

from tests.usual import usually
from tests.validation.validation_kit import DOOR, HOME, World, drive, judge, kinds
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio import read_problem, relax
from up_samp.validation import validate_plan


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


def with_door(folder):
    """A robot, a door, where it goes, and the fluent that tells where it is."""
    w = World(folder)
    w.object("r1", HOME)
    door = w.object("door", (20.05, 10.0, 0.0), DOOR)
    shut, away = w.place((20.05, 10.0, 0.0)), w.place((20.05, 15.0, 0.0))
    return w, door, away, w.problem.add_fluent("door_at", w.place_type, default_initial_value=shut)


@pytest.mark.parametrize(
    ("delay", "asks", "found"),
    [(0, 4, ["obstacle-place"]), (0, 5, []), (-1, 4, []), (-1, 3, ["static"]), (2, 5, ["place"])],
)
def test_a_static_obstacle_is_where_its_fluent_says(tmp_path, delay, asks, found):
    """A door opens at 4, its fluent is set ``delay`` later: who asks waits until both agree."""
    w, door, away, at = with_door(tmp_path)
    opening = w.set_place("open", "door", (20.05, 15.0, 0.0), 3, 4)
    opening.add_effect(Timing(delay, opening.end), at, away)
    trajectory = drive(HOME, [(6.0, 0.0)], asks)
    w.move("m", "r1", trajectory, asks, asks + 10, static_obstacles={door: at})
    assert len(found) == 0 or any(found[0] in k for k in kinds(judge(w)))
    assert judge(w).valid == (not found)


def test_obstacles_with_fluents(tmp_path):
    w, door, away, at = with_door(tmp_path)
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


@pytest.mark.parametrize(
    ("how", "least"),
    usually(
        *(("start", 0), ("end - 1", 1), ("end", 1), ("end + 2", 0), ("end + 2", 1)),
        *(("says_the_same", 0), ("own", 1)),
        of=itertools.product(
            ("start", "end - 1", "end", "end + 2", "says_the_same", "own"), (0, 1)
        ),
    ),
)
def test_the_scheduler_takes_what_is_valid_with_obstacles_told_by_fluents(tmp_path, how, least):
    """Whenever the motion begins, while an obstacle is moved, and its fluent set."""
    w = World(tmp_path)
    w.object("r1", HOME)
    box = w.object("box", (30.0, 4.0, 0.0), DOOR)
    here, there = w.place((30.0, 4.0, 0.0)), w.place((30.0, 15.0, 0.0))
    at = w.problem.add_fluent("box_at", w.place_type, default_initial_value=here)
    mover = w.set_place("put", "box", (30.0, 15.0, 0.0), 14, 16)
    mover.set_duration_bounds(least, 20)
    if how == "own":
        mover.add_effect(mover.end - 1, at, there)
        mover.add_condition(mover.start, Equals(at, here))
    elif how == "says_the_same":
        teller = w.problem.add_activity("tell", duration=2)
        w.times["tell"] = (14, 16)
        teller.add_effect(teller.end, at, here)
        w.times["put"] = (38, 40)
    else:
        delay = {"end - 1": -1, "end + 2": 2}.get(how, 0)
        mover.add_effect(Timing(delay, mover.start if how == "start" else mover.end), at, there)
    motion = w.move("m", "r1", drive(HOME, [(6.0, 0.0)]), 0, 9, static_obstacles={box: at})
    valid, taken = set(), set()
    for start in range(2, 22):
        w.times["m"] = (start, start + 9)
        w.trajectories["m"] = drive(HOME, [(6.0, 0.0)], start)
        if judge(w).valid:
            valid.add(start)
    relaxation = relax(w.problem, read_problem(w.problem))
    for activity in relaxation.problem.activities:
        if activity.name != motion.name:
            start, end = w.times[activity.name]
            relaxation.problem.add_constraint(Equals(activity.start, start))
            relaxation.problem.add_constraint(Equals(activity.end, end))
    move = relaxation.activities[motion.name]
    relaxation.problem.add_constraint(Equals(Minus(move.end, move.start), 9))
    low = relaxation.problem.add_variable("low", IntType(2, 21))
    relaxation.problem.add_constraint(Equals(move.start, low))
    for start in range(2, 22):
        problem = relaxation.problem.clone()
        problem.add_constraint(Equals(low, start))
        if CpsatSession(problem, workers=1).solve(Deadline.after(20.0)).schedule is not None:
            taken.add(start)
    assert valid
    assert valid == taken
