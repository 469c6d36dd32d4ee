"""What a claim of optimality may rest on: exact motions, and searches that were finished."""

import math

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import OneshotPlanner

from up_samp.benchmarks.places import box
from up_samp.test_cases.scene import Scene
from up_samp.validation import validate_plan


def straight_problem(model, stops, heading=0.0):
    """16 m straight ahead at v = a = 1 through ``stops`` waypoints: 17 s, stopping or not."""
    scene = Scene("straight")
    places = []
    for i in range(stops + 2):
        way = 16.0 * i / (stops + 1)
        pose = (5.0 + way * math.cos(heading), 10.0 + way * math.sin(heading), heading)
        places.append(scene.place(f"p{i}", pose))
    robot = MovableObject(
        "r0",
        scene.robot_type,
        footprint=list(box(1, 0.6)),
        motion_model=model,
        motion_parameters={"v_max": 1.0, "a_max": 1.0},
    )
    scene.problem.add_object(robot)
    scene.problem.set_initial_configuration(robot, places[0])
    scene.drive("go", robot, places, (1, 100))
    return scene.problem


@pytest.mark.parametrize("stops", [0, 5])
@pytest.mark.parametrize("heading", [0.0, 0.3])
@pytest.mark.parametrize("model", [MotionModels.REEDSSHEPP, MotionModels.SE2])
def test_sixteen_metres_take_seventeen_seconds(model, heading, stops):
    problem = straight_problem(model, stops, heading)
    with OneshotPlanner(
        name="samp-refine[cpsat]", optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY
    ) as planner:
        result = planner.solve(problem, timeout=60)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert result.metrics["makespan"] == "17"
    assert result.metrics["bound_kind"] == "absolute"
    assert validate_plan(problem, result.plan).valid
