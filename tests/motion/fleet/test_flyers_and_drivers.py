"""Flyers and bodies that drive below them, in one problem."""

import math
import random

import numpy as np
import pytest
import shapely
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import LT, OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from tests.handmade import drive
from tests.motion.fleet.flying import UPRIGHT, World
from tests.usual import usually
from up_samp.geometry.meshes import covered
from up_samp.io import result_to_dict
from up_samp.io.restore import contradictions
from up_samp.model import CandidateSchedule, ProblemError
from up_samp.upio import build_plan, read_problem
from up_samp.validation import validate_plan

pytest.importorskip("coal")
FOUND = (Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY)
LOW = {"v_max": 1.5, "a_max": 1.0, "height": 1.2}


@pytest.fixture
def world(tmp_path):
    get_environment().credits_stream = None
    return World(tmp_path)


def solved(world, seconds=240, **params):
    """Solve, and let the independent validator judge the plan."""
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(world.problem, timeout=seconds)
    if result.status in FOUND:
        assert validate_plan(world.problem, result.plan).violations == ()
    return result


def crossing(world, flies_at, **driver):
    """A cart goes through the gap one way while a drone goes the other way at a height (m)."""
    drone = world.flyer("drone", (17, 6, flies_at, *UPRIGHT))
    cart = world.flat("cart", (3, 6, 0), **driver)
    world.move("fly", drone, drone.home, world.place(4, 3, flies_at, *UPRIGHT))
    world.move("drive", cart, cart.home, world.place(16, 9, 0))
    return world


def together(plan):
    spans = [(t.start, t.end) for t in plan.trajectories.values()]
    return max(s for s, _ in spans) < min(e for _, e in spans)


def test_a_flyer_above_a_driver_is_not_in_its_way(tmp_path):
    narrow = World(tmp_path, gap=(5.0, 7.0))
    result = solved(crossing(narrow, 2.0, motion_parameters=LOW))
    alone = max(t.end - t.start for t in result.plan.trajectories.values())
    assert result.plan.trajectories["drive"].start == pytest.approx(0.0, abs=0.01)
    assert result.plan.trajectories["fly"].end <= alone + 1.01


@pytest.mark.parametrize("driver", [{}, {"motion_parameters": LOW}], ids=["no height", "low"])
def test_a_flyer_that_is_not_above_keeps_clear(tmp_path, driver):
    narrow = World(tmp_path, gap=(5.0, 7.0))
    flies_at = 2.0 if not driver else 1.0
    plan = solved(crossing(narrow, flies_at, **driver)).plan
    assert set(plan.trajectories) == {"fly", "drive"}


def standing(world, height):
    """A drone stands in the only gap, and the cart has to get through."""
    world.flyer("drone", (10, 6, height, *UPRIGHT), size=(0.8, 3.6, 0.3))
    cart = world.flat("cart", (3, 6, 0), motion_parameters=LOW)
    world.move("drive", cart, cart.home, world.place(17, 6, 0))
    return world


@pytest.mark.parametrize("margin", usually(0.2, of=(0.01, 0.2)))
def test_what_hovers_above_is_driven_under(world, margin):
    """It is 5 cm above: the margin is kept from what is beside."""
    assert solved(standing(world, 1.4), margin=margin).status in FOUND


def test_what_hovers_too_low_is_proven_to_be_in_the_way(world):
    result = solved(standing(world, 1.3))
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert any("drone" in message.message for message in result.log_messages)


def test_many_drive_under_one_that_hovers(world, monkeypatch):
    """Two are many here: the motions of many are decided one after the other, in the plane."""
    world.flyer("drone", (9, 6, 3, *UPRIGHT))
    for k, y in enumerate((3, 6)):
        cart = world.flat(f"cart{k}", (3, y, 0), motion_parameters=LOW)
        world.move(f"drive{k}", cart, cart.home, world.place(7, y, 0))
    monkeypatch.setattr("up_samp.search.fleet.improve.MANY", 2)
    result = solved(world)
    assert result.status in FOUND


def test_a_driver_waits_until_a_drone_has_taken_off(world):
    drone = world.flyer("drone", (10, 6, 0.4, *UPRIGHT), size=(0.8, 3.6, 0.3))
    cart = world.flat("cart", (7, 6, 0), motion_parameters=LOW)
    up = world.move("rise", drone, drone.home, world.place(10, 6, 3, *UPRIGHT))
    world.move("drive", cart, cart.home, world.place(13, 6, 0))
    wait = world.problem.add_activity("wait", 3)
    world.problem.add_constraint(LT(wait.end, up.start))
    plan = solved(world, first_plan=True, query_seconds=0.15).plan
    drive = plan.trajectories["drive"]
    assert drive.times[drive.poses[:, 0] > 10][0] > 3.0


@pytest.mark.parametrize(("height", "meets"), [(1.2, False), (2.8, False), (2.9, True)])
def test_the_validator_sees_a_drone_that_is_too_low(tmp_path, height, meets):
    folders = tmp_path / "over", tmp_path / "into"
    for folder in folders:
        folder.mkdir()
    over, into = map(World, folders)
    for world, tall in ((over, 1.2), (into, height)):
        drone = world.flyer("drone", (7, 6, 3, *UPRIGHT))  # its lower side is at 2.85
        world.flat("cart", (10, 6, 0.3), motion_parameters={**LOW, "height": tall})
        world.move("fly", drone, drone.home, world.place(13, 6, 3, *UPRIGHT))
    plan = solved(over).plan
    fly = plan.trajectories["fly"]
    assert np.abs(fly.poses[:, 1:3] - (6, 3)).max() < 1e-6  # straight over the cart
    found = validate_plan(into.problem, plan).violations
    assert {v.kind for v in found} == ({"collision"} if meets else set())


def test_a_plan_file_tells_heights_and_contradictions(tmp_path):
    world = crossing(World(tmp_path), 2.0, motion_parameters=LOW)
    plan = result_to_dict(world.problem, solved(world))
    cart = next(o for o in plan["objects"] if o["name"] == "cart")
    assert cart["height"] == 1.2
    assert contradictions(world.problem, plan) == []
    for stated in ({"height": 0.1}, {}):
        other = {**{k: v for k, v in cart.items() if k != "height"}, **stated}
        changed = {**plan, "objects": [other if o is cart else o for o in plan["objects"]]}
        assert any("height" in text for text in contradictions(world.problem, changed))


@pytest.mark.parametrize("height", [0, -1, math.nan, "tall"])
def test_a_wrong_height_is_told(world, height):
    cart = world.flat("cart", (3, 6, 0), motion_parameters={"height": height})
    world.move("drive", cart, cart.home, world.place(5, 6, 0))
    with (
        OneshotPlanner(name="samp-refine[cpsat]") as planner,
        pytest.raises(ProblemError, match="'cart': its height"),
    ):
        planner.solve(world.problem, timeout=10)


def test_shadows_are_where_triangles_are_low():
    """Against points on the triangles."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        triangles = rng.uniform(-1, 1, size=(6, 3, 3))
        height = random.Random(1).uniform(-0.8, 0.8)
        shadow = shapely.union_all(covered(triangles, height))
        weights = rng.dirichlet((1, 1, 1), size=400)
        points = np.einsum("wk,tkc->twc", weights, triangles).reshape(-1, 3)
        low = points[points[:, 2] < height - 1e-9]
        assert shapely.distance(shadow, shapely.points(low[:, :2])).max(initial=0) < 1e-6
        # and nothing more: what the shadow covers is below some triangle's low part
        inside = shapely.points(rng.uniform(-1, 1, size=(200, 2)))
        inside = inside[shapely.contains(shadow, inside)]
        near = shapely.MultiPoint(low[:, :2])
        assert len(low) == 0 or shapely.distance(near, inside).max(initial=0) < 0.4


@pytest.mark.parametrize("place", [(7, 6, 3), (12, 6, 3)])
def test_what_hangs_above_a_cart_and_not_above_its_tall_load_is_no_proof(world, place):
    """One body, of which the judge takes each part to be as high as it is."""
    world.flyer("bar", (*place, *UPRIGHT), size=(1.0, 0.5, 0.3))
    cart = world.flat("cart", (7, 6, 0), motion_parameters={**LOW, "height": 0.5})
    world.flat("load", (7, 6.6, 0), motion_parameters={**LOW, "height": 3.5})
    go = world.move("drive", cart, cart.home, world.place(12, 6, 0))
    go.add_motion_effect(world.problem.object("load"), world.place(12, 6.6, 0))
    drives = {"drive": drive((7, 6, 0), [(5.0, 0.0)], 0.0, 1.5, 1.0)}
    times = CandidateSchedule({"drive": (0, 6)}, {})
    known = build_plan(world.problem, read_problem(world.problem), times, drives)
    assert validate_plan(world.problem, known).valid
    few = {"max_restarts": 0, "query_seconds": 0.2}
    with OneshotPlanner(name="samp-refine[cpsat]", params=few) as planner:
        status = planner.solve(world.problem, timeout=20).status
    assert status is not Status.UNSOLVABLE_PROVEN
