"""Loads that travel: the search takes robot and load for one body, and the validator agrees."""

import math

import numpy as np
import pytest
import shapely
from PIL import Image
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines import ValidationResultStatus
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import MovableType, OneshotPlanner

from tests.upio.hall import Hall, write_hall
from up_samp.engines.validator import SampValidator
from up_samp.io import plan_from_dict, plan_to_dict
from up_samp.model import UnsupportedError
from up_samp.plotting.tracks import tracks_of
from up_samp.upio import read_problem

SOLVED = (Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY)


def rectangle(length, width):
    x, y = length / 2, width / 2
    return [(-x, -y), (x, -y), (x, y), (-x, y)]


def with_load(hall, name, place, footprint):
    load = MovableObject(
        name, MovableType("load"), footprint=footprint, motion_model=MotionModels.SE2
    )
    hall.problem.add_object(load)
    hall.problem.set_initial_configuration(load, hall.poses[place])
    return load


def carrying(folder, width, *, gap=(40, 60), ahead=0.9, robots=1, **robot):
    """A robot in a hall with a wall that has a 2 m gap; its load of 0.8 m x ``width`` is on its
    other side in the end.
    """
    hall = Hall(folder, robots=robots, map_file=write_hall(folder, wall_gap=gap), **robot)
    hall.pose("before", 3.0 + ahead, 3.0, 0.0)
    hall.pose("behind", 17.0 + ahead, 3.0, 0.0)
    load = with_load(hall, "pallet", "before", rectangle(0.8, width))
    ride = hall.move("carry", 0, "left0", "right0")
    ride.add_motion_effect(hall.robots[0], hall.poses["right0"])
    ride.add_motion_effect(load, hall.poses["behind"])
    return hall, load


def solve(problem, timeout=60.0, **params):
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=timeout)
    if result.plan is not None:
        with SampValidator() as judge:
            verdict = judge.validate(problem, result.plan)
        assert verdict.status is ValidationResultStatus.VALID
    return result


def outlines(problem, plan, times):
    """Where everybody is, sampled, by the poses of the plan alone."""
    data = plan_to_dict(problem, plan)
    return [
        {t.name: shapely.Polygon(t.outline(t.at(float(at)))) for t in tracks_of(data)}
        for at in times
    ]


def test_a_load_that_fits_goes_through_and_a_wider_one_does_not(tmp_path):
    for width, status in ((1.4, SOLVED), (2.2, (Status.UNSOLVABLE_PROVEN,))):
        folder = tmp_path / str(width)
        folder.mkdir()
        hall, load = carrying(folder, width, ahead=0.2)
        load.footprint[:] = rectangle(2.2, width)
        assert solve(hall.problem).status in status, width
    folder = tmp_path / "bare"
    folder.mkdir()
    hall = Hall(folder, map_file=write_hall(folder, wall_gap=(40, 60)))
    hall.move("go", 0, "left0", "right0")
    assert solve(hall.problem).status in SOLVED


def test_robot_and_load_take_the_way_that_is_wide_enough(tmp_path):
    """Bare, a robot takes the near gap of 1.2 m; with its load it drives through the far one."""
    hall, load = carrying(tmp_path, 2.0, ahead=0.0, gap=(24, 36))
    pixels = np.array(Image.open(tmp_path / "hall.png"))
    pixels[10:42, 99:101] = 255  # 5.8 m to 9 m from below
    Image.fromarray(pixels).save(tmp_path / "hall.png")
    back = hall.move("back", 0, "right0", "left0", dynamic_obstacles_at_start=[])
    manager = hall.problem.environment.expression_manager
    hall.problem.add_constraint(manager.LE(hall.problem.activities[0].end, back.start))
    result = solve(hall.problem)
    assert result.status in SOLVED
    through = {
        name: float(t.poses[np.abs(t.poses[:, 0] - 10.0).argmin(), 1])
        for name, t in result.plan.trajectories.items()
    }
    assert through["carry"] > 5.8
    assert through["back"] < 3.6
    assert load.name == "pallet"


@pytest.mark.long
def test_loads_keep_clear_of_each_other_and_stand_where_they_are_put(tmp_path):
    """Two robots with wide loads pass in a hall and put them down; judged by samples as well."""
    hall, load = carrying(tmp_path, 1.6, gap=(20, 80), robots=2)
    hall.pose("before1", 16.1, 7.0, math.pi)
    hall.pose("behind1", 2.1, 7.0, math.pi)
    hall.pose("right1b", 17.0, 7.0, math.pi)
    hall.pose("left1b", 3.0, 7.0, math.pi)
    problem = hall.problem
    problem.initial_configuration[:] = [
        (o, p) for o, p in problem.initial_configuration if str(o) != "r1"
    ]
    problem.set_initial_configuration(hall.robots[1], hall.poses["right1b"])
    other = with_load(hall, "crate", "before1", rectangle(0.8, 1.6))
    ride = hall.move("bring", 1, "right1b", "left1b")
    ride.add_motion_effect(other, hall.poses["behind1"])
    result = solve(problem)
    assert result.status in SOLVED
    end = max(t.end for t in result.plan.trajectories.values())
    for world in outlines(problem, result.plan, np.arange(0.0, end, 0.1)):
        mine, theirs = (
            shapely.union(world["r0"], world["pallet"]),
            shapely.union(world["r1"], world["crate"]),
        )
        assert mine.intersection(theirs).area < 1e-6
    assert load is not None


def test_a_plan_file_tells_of_rides(tmp_path):
    hall, _ = carrying(tmp_path, 1.0)
    result = solve(hall.problem)
    data = plan_to_dict(hall.problem, result.plan)
    assert data["rides"] == [
        {"activity": "carry", "object": "pallet", "carrier": "r0", "offset": [0.9, 0.0, 0.0]}
    ]
    restored = plan_from_dict(hall.problem, data)
    with SampValidator() as judge:
        assert judge.validate(hall.problem, restored).status is ValidationResultStatus.VALID
    tracks = {t.name: t for t in tracks_of(data)}
    middle = result.plan.trajectories["carry"].end / 2
    x, y, theta = tracks["r0"].at(middle)
    at = tracks["pallet"].at(middle)
    assert at == pytest.approx((x + 0.9 * math.cos(theta), y + 0.9 * math.sin(theta), theta))
    assert tracks["pallet"].at(1e6) == pytest.approx((17.9, 3.0, 0.0))


def test_decisions_that_a_ride_would_hang_on_are_refused(tmp_path):
    hall, load = carrying(tmp_path, 1.0)
    carry = hall.problem.activities[0]
    goal = carry.add_parameter("goal", hall.place)
    carry.motion_effects.clear()
    carry.add_motion_effect(load, goal)
    with pytest.raises(UnsupportedError, match=r"carry.*whether 'pallet' travels with 'r0'"):
        read_problem(hall.problem)


def test_who_lists_a_load_has_to_list_its_robot(tmp_path):
    hall, load = carrying(tmp_path, 1.0, robots=2)
    hall.move("go", 1, "left1", "right1", dynamic_obstacles_at_start=[load])
    with pytest.raises(UnsupportedError, match=r"go.*'pallet' but not 'r0'"):
        read_problem(hall.problem)


def robot(hall, name, place):
    """Another robot like the first."""
    like = hall.robots[0]
    found = MovableObject(
        name,
        hall.robot,
        footprint=like.footprint,
        motion_model=like.motion_model,
        motion_parameters=like.motion_parameters,
    )
    hall.robots.append(found)
    hall.problem.add_object(found)
    hall.problem.set_initial_configuration(found, hall.poses[place])
    return found


def test_what_one_robot_brings_another_takes_on_at_that_instant(tmp_path):
    """Their bodies have the load in common: no gap between them is proven."""
    hall = Hall(tmp_path, map_file=write_hall(tmp_path, wall_gap=(10, 90)))
    hall.pose("from", 8.0, 3.0, math.pi)
    hall.pose("to", 5.5, 3.0, math.pi)  # its motion takes half a second less than its activity
    hall.pose("store", 7.0, 3.0, 0.0)
    hall.pose("dock", 4.5, 3.0, 0.0)
    hall.pose("start", 3.5, 3.0, 0.0)
    hall.pose("up", 3.5, 8.0, 0.0)
    hall.pose("shelf", 4.5, 8.0, 0.0)
    hall.problem.initial_configuration.clear()
    hall.problem.set_initial_configuration(hall.robots[0], hall.poses["start"])
    robot(hall, "r1", "from")
    crate = with_load(hall, "crate", "store", rectangle(0.9, 0.9))
    bring = hall.move("bring", 1, "from", "to")
    bring.add_motion_effect(crate, hall.poses["dock"])
    hall.move("away", 1, "to", "from", dynamic_obstacles_at_start=[hall.robots[0]])
    take = hall.move("take", 0, "start", "up")
    take.add_motion_effect(crate, hall.poses["shelf"])
    result = solve(hall.problem, optimal=True)
    assert result.status is Status.SOLVED_OPTIMALLY
    bring, take = (
        next(a for a in result.plan.activities if a.name == n) for n in ("bring", "take")
    )
    assert str(result.plan.get(take.start)) == str(result.plan.get(bring.end))


def test_a_robot_that_is_carried_away_leaves_its_place(tmp_path):
    hall = Hall(tmp_path, map_file=write_hall(tmp_path, wall_gap=(10, 90)))
    hall.pose("place", 8.0, 3.0, 0.0)
    hall.pose("behind", 6.8, 3.0, 0.0)
    hall.pose("far", 16.0, 8.0, 0.0)
    hall.pose("behind_far", 14.8, 8.0, 0.0)
    hall.pose("farther", 18.0, 8.0, 0.0)
    robot(hall, "r1", "behind")
    ridden = robot(hall, "r2", "place")
    carry = hall.move("carry", 1, "behind", "behind_far")
    carry.add_motion_effect(ridden, hall.poses["far"])
    hall.move("own", 2, "far", "farther", optional=True)
    hall.move("come", 0, "left0", "place")
    assert solve(hall.problem).status in SOLVED
