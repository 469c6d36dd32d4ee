"""Several robots driven by one activity: no loads of each other, and obstacles to each other."""

from __future__ import annotations

import itertools

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.motion import ActivityWaypoints
from unified_planning.shortcuts import OneshotPlanner

from tests.upio.hall import Hall, write_hall
from up_samp.validation import validate_plan

SIDE_BY_SIDE = ("right0", "right1")
CROSSED = ("right1", "right0")


def formation(folder, goals, *, lists="none", gap=(5, 95)):
    """Two robots that drive in one activity through a hall with a wide or a narrow gap."""
    hall = Hall(folder, robots=2, map_file=write_hall(folder, wall_gap=gap))
    both = hall.problem.add_motion_activity("both")
    both.set_duration_bounds(1, 200)
    for k, goal in enumerate(goals):
        robot, other = hall.robots[k], hall.robots[1 - k]
        named = {
            "none": {},
            "listed": {"dynamic_obstacles_at_start": [other]},
            "heedless": {"dynamic_obstacles_at_start": []},
        }[lists]
        start, end = hall.poses[f"left{k}"], hall.poses[goal]
        both.add_motion_constraint(ActivityWaypoints(robot, start, [end], **named))
        both.add_motion_effect(robot, end)
    return hall.problem


def solve(problem, engine="samp-refine[cpsat]"):
    with OneshotPlanner(name=engine) as planner:
        return planner.solve(problem, timeout=60)


@pytest.mark.parametrize("lists", ["none", "listed"])
def test_robots_that_keep_their_distance_are_no_loads(tmp_path, lists):
    result = solve(formation(tmp_path, SIDE_BY_SIDE, lists=lists))
    assert result.status is Status.SOLVED_OPTIMALLY
    assert len(result.plan.trajectories) == 2


@pytest.mark.parametrize(
    "engine", ["samp-refine[cpsat]", pytest.param("samp-refine[aries]", marks=pytest.mark.long)]
)
def test_robots_of_one_activity_give_way_to_each_other(tmp_path, engine):
    problem = formation(tmp_path, CROSSED, gap=(40, 55))
    result = solve(problem, engine)
    assert result.plan is not None
    assert validate_plan(problem, result.plan).valid


def test_the_validator_sees_robots_of_one_activity_collide(tmp_path):
    heedless = formation(tmp_path, CROSSED, lists="heedless", gap=(40, 55))
    plan = solve(heedless).plan
    assert validate_plan(heedless, plan).valid
    for lists in ("none", "listed"):
        verdict = validate_plan(formation(tmp_path, CROSSED, lists=lists, gap=(40, 55)), plan)
        kinds = [v.kind for v in verdict.violations]
        assert set(kinds) == {"collision"}, list(itertools.islice(verdict.violations, 3))
