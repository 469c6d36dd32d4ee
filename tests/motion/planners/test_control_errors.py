"""What a user's control model raises comes out with the object's name."""

import math

import pytest
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import OneshotPlanner

from tests.benchmarks.scene import SceneBuilder
from up_samp.benchmarks.places import box
from up_samp.model import ProblemError


def at_once(q, u, qdot):
    raise KeyError("no such wheel")


def beyond_a_line(q, u, qdot):
    if q[0] > 4.2:
        raise RuntimeError("the model ends here")
    qdot[0], qdot[1], qdot[2] = u[0] * math.cos(q[2]), u[0] * math.sin(q[2]), u[1]


def by_nothing(q, u, qdot):
    qdot[0] = float(u[0]) / (float(q[0]) - float(q[0]))
    qdot[1] = qdot[2] = 0.0


def nowhere(q, u, qdot):
    qdot[0], qdot[1], qdot[2] = math.nan, 0.0, 0.0


@pytest.mark.parametrize(
    ("law", "kind", "names"),
    [
        (at_once, "KeyError", ("v", "phi")),
        (beyond_a_line, "RuntimeError", ("v", "w")),
        (by_nothing, "ZeroDivisionError", ("v", "phi")),
        (nowhere, "not finite", ("v", "w")),
    ],
)
def test_an_error_in_a_control_model_names_the_object(law, kind, names):
    scene = SceneBuilder("raising")
    start, goal = scene.place("start", (4.0, 10.0, 0.0)), scene.place("goal", (9.0, 10.0, 0.0))
    robot = MovableObject(
        "r7",
        scene.robot_type,
        footprint=list(box(1, 0.6)),
        motion_model=MotionModels.SE2,
        control_model=law,
        control_parameters={f"{name}_max": 0.5 for name in names},
    )
    scene.problem.add_object(robot)
    scene.problem.set_initial_configuration(robot, start)
    scene.drive("go", robot, [start, goal], (1, 100))
    with (
        OneshotPlanner(name="samp-refine[cpsat]") as planner,
        pytest.raises(ProblemError, match=f"(?s)r7.*{kind}"),
    ):
        planner.solve(scene.problem, timeout=20)
