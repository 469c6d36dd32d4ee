"""Problems with bodies of every motion model, through the whole meta-engine."""

import math

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.motion import MotionModels
from unified_planning.shortcuts import LT, OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from tests.motion.fleet.flying import QUARTER, UPRIGHT, World
from up_samp.model import ProblemError
from up_samp.validation import validate_plan

FOUND = (Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY)


@pytest.fixture
def world(tmp_path):
    get_environment().credits_stream = None
    return World(tmp_path)


def solved(world, seconds=60, **params):
    """Solve, and let the independent validator judge the plan."""
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(world.problem, timeout=seconds)
    assert result.status in FOUND, result.log_messages
    verdict = validate_plan(world.problem, result.plan)
    assert verdict.violations == ()
    return result


def test_one_flyer_goes_through_the_gap_and_back(world):
    pytest.importorskip("coal")
    drone = world.flyer("drone", (3, 2, 1, *UPRIGHT))
    goal = world.place(17, 10, 4, *QUARTER)
    there = world.move("there", drone, drone.home, goal)
    back = world.move("back", drone, goal, drone.home)
    world.problem.add_constraint(LT(there.end, back.start))
    plan = solved(world).plan
    assert set(plan.trajectories) == {"there", "back"}
    heights = plan.trajectories["there"].poses[:, 2]
    assert heights[0] == 1.0
    assert heights[-1] == 4.0


def test_two_flyers_exchange_places_in_the_air(world):
    """No order of taking turns works: one has to fly round the other."""
    pytest.importorskip("coal")
    a = world.flyer("a", (3, 6, 2, *UPRIGHT))
    b = world.flyer("b", (17, 6, 2, *UPRIGHT))
    world.move("go_a", a, a.home, world.place(17, 6, 2, *UPRIGHT))
    world.move("go_b", b, b.home, world.place(3, 6, 2, *UPRIGHT))
    plan = solved(world, first_plan=True, query_seconds=0.15).plan
    spans = [(t.start, t.end) for t in plan.trajectories.values()]
    assert max(s for s, _ in spans) < min(e for _, e in spans)  # they are in the air together


def test_a_flyer_waits_for_one_that_hovers_in_the_gap(tmp_path):
    """The gap is for one: the first has to come out of it before the second may pass."""
    pytest.importorskip("coal")
    get_environment().credits_stream = None
    world = World(tmp_path, gap=(5.0, 7.0))
    sitter = world.flyer("sitter", (10, 6, 2, *UPRIGHT), size=(1.6, 1.6, 12.0))
    drone = world.flyer("drone", (3, 6, 2, *UPRIGHT))
    world.move("leave", sitter, sitter.home, world.place(14, 10, 2, *UPRIGHT))
    world.move("pass", drone, drone.home, world.place(17, 3, 2, *UPRIGHT))
    plan = solved(world).plan
    leaving, through = plan.trajectories["leave"], plan.trajectories["pass"]
    below = through.poses[:, 2] < 7.0
    inside = through.times[(through.poses[:, 0] > 9.0) & below]
    assert inside[0] > leaving.start + 1.0


def test_a_flyer_waits_until_a_door_opens(world):
    """A door has no height of its own: it is closed from the floor to the sky."""
    pytest.importorskip("coal")
    drone = world.flyer("drone", (3, 6, 1, *UPRIGHT))
    door = world.flat(
        "door", (10, 6, 0), corners=[(-0.05, -1.9), (0.05, -1.9), (0.05, 1.9), (-0.05, 1.9)]
    )
    opened = world.place(10, 9.9, 0)
    opens = world.problem.add_motion_activity("open", duration=4)
    opens.add_motion_effect(door, opened)
    world.move("go", drone, drone.home, world.place(17, 6, 5, *UPRIGHT))
    plan = solved(world).plan
    flight = plan.trajectories["go"]
    assert flight.times[flight.poses[:, 0] > 9.5][0] >= 4.0


@pytest.mark.parametrize(
    ("pose", "why"),
    [((10, 2, 1, *UPRIGHT), "wall"), ((17.2, 6, 1.1, *UPRIGHT), "overlaps 'crate'")],
)
def test_flyers_that_start_in_something_are_told(world, pose, why):
    pytest.importorskip("coal")
    drone = world.flyer("drone", pose)
    world.flyer("crate", (17, 6, 1, *UPRIGHT), size=(1.0, 1.0, 1.0))
    world.move("fly", drone, drone.home, world.place(3, 6, 5, *UPRIGHT))
    with (
        OneshotPlanner(name="samp-refine[cpsat]") as planner,
        pytest.raises(ProblemError, match=why),
    ):
        planner.solve(world.problem, timeout=10)


def test_a_flyer_that_starts_at_a_planar_pose_is_told(world):
    pytest.importorskip("coal")
    drone = world.flyer("drone", (3, 6, 1))
    world.move("fly", drone, world.place(3, 6, 1, *UPRIGHT), world.place(3, 8, 1, *UPRIGHT))
    with (
        OneshotPlanner(name="samp-refine[cpsat]") as planner,
        pytest.raises(ProblemError, match="wrong type"),
    ):
        planner.solve(world.problem, timeout=10)


def test_two_omnidirectional_bodies_pass_the_gap(world):
    a, b = world.flat("a", (3, 6, 0)), world.flat("b", (17, 6, math.pi))
    world.move("go_a", a, a.home, world.place(17, 4, 0))
    world.move("go_b", b, b.home, world.place(3, 8, 0))
    plan = solved(world).plan
    assert set(plan.trajectories) == {"go_a", "go_b"}


def bicycle(state, control, result):
    result[0] = control[0] * math.cos(state[2])
    result[1] = control[0] * math.sin(state[2])
    result[2] = control[0] * math.tan(control[1]) / 0.8


def test_two_bicycles_take_turns_in_the_gap(world):
    """A bicycle is a car with the speed and the curvature of its control parameters."""
    limits = {"v_min": -1.0, "v_max": 1.0, "phi_min": -0.6, "phi_max": 0.6}
    more = {"control_model": bicycle, "control_parameters": limits, "motion_parameters": {}}
    a = world.flat("a", (3, 6, 0), MotionModels.REEDSSHEPP, **more)
    b = world.flat("b", (17, 6, math.pi), MotionModels.REEDSSHEPP, **more)
    world.move("go_a", a, a.home, world.place(17, 4, 0))
    world.move("go_b", b, b.home, world.place(3, 8, math.pi))
    plan = solved(world).plan
    assert max(t.duration for t in plan.trajectories.values()) > 14.0


def drift(state, control, result):
    """Drives straight ahead or turns, at its own rates."""
    result[0] = control[0] * math.cos(state[2])
    result[1] = control[0] * math.sin(state[2])
    result[2] = control[1]


@pytest.mark.long
def test_two_bodies_with_their_own_laws_take_turns_in_the_gap(world):
    limits = {"speed_min": -1.0, "speed_max": 1.0, "turn_min": -0.8, "turn_max": 0.8}
    more = {"control_model": drift, "control_parameters": limits, "motion_parameters": {}}
    a = world.flat("a", (4, 6, 0), MotionModels.SE2, **more)
    b = world.flat("b", (16, 6, math.pi), MotionModels.SE2, **more)
    world.move("go_a", a, a.home, world.place(16, 3, 0))
    world.move("go_b", b, b.home, world.place(4, 9, math.pi))
    plan = solved(world, seconds=200).plan
    assert set(plan.trajectories) == {"go_a", "go_b"}


def test_two_that_turn_on_the_spot_pass_the_gap(world):
    more = {"motion_parameters": {"turning_radius": 0, "v_max": 1.5, "omega_max": 1.2}}
    a = world.flat("a", (4, 6, 0), MotionModels.REEDSSHEPP, **more)
    b = world.flat("b", (16, 6, math.pi), MotionModels.REEDSSHEPP, **more)
    world.move("go_a", a, a.home, world.place(16, 3, math.pi / 2))
    world.move("go_b", b, b.home, world.place(4, 3, -math.pi / 2))
    plan = solved(world).plan
    for activity in ("go_a", "go_b"):
        steps = plan.trajectories[activity].poses
        assert abs(steps[-1, 2] - steps[0, 2]) > 1.0
