"""What a claim of optimality may rest on: exact motions, and searches that were finished."""

import math
import random
from dataclasses import replace
from types import SimpleNamespace

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import OneshotPlanner

from tests.benchmarks.scene import SceneBuilder
from tests.fuzz.cases import Case, Robot, Style
from tests.fuzz.floors import rooms
from tests.fuzz.problems import build
from tests.shuffled import shuffled
from up_samp.benchmarks.places import box
from up_samp.extensions import extended
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    TimedMotion,
)
from up_samp.model.refinement import Layer, Strength
from up_samp.motion import MotionService
from up_samp.motion.planners.car import CarPlanner
from up_samp.search.events import Observer
from up_samp.search.facts import LATE, Facts
from up_samp.validation import validate_plan
from up_samp.validation.tolerances import TOLERANCES


def straight_problem(model, stops, heading=0.0):
    """16 m straight ahead at v = a = 1 through ``stops`` waypoints: 17 s, stopping or not."""
    scene = SceneBuilder("straight")
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


class Hurried:
    """The car planner on a machine so slow that its deadline always ends it."""

    name = "hurried"
    reversible = True
    complete = False

    def __init__(self, scene, seed):
        self.planner = CarPlanner(scene, seed)

    def leg(self, query, deadline):
        return replace(self.planner.leg(query, deadline), complete=self.complete)


class Patient(Hurried):
    """The same, with all the time that it needs."""

    name = "patient"
    complete = True


def around_a_robot():
    """A drive past robots that stand in the way: slower than any admissible bound says."""
    scene = SceneBuilder("around")
    start, goal = scene.place("start", (5.0, 10.0, 0.0)), scene.place("goal", (20.0, 10.0, 0.0))
    robot = scene.robot("r0", start)
    for i, y in enumerate((6.0, 8.0, 10.0, 12.0, 14.0)):
        scene.robot(f"parked{i}", scene.place(f"between{i}", (12.0, y, math.pi / 2)))
    scene.drive("go", robot, [start, goal], (1, 100))
    return scene.problem


@pytest.mark.parametrize("planner", [Hurried, Patient])
def test_only_a_finished_search_proves_anything(planner):
    """What is found is the same on a slow machine and on a fast one; what is proven is less."""
    problem = around_a_robot()
    with (
        extended("planners", planner.name, planner),
        OneshotPlanner(
            name="samp-refine[cpsat]",
            params={"path_planner": planner.name},
            optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY,
        ) as solver,
    ):
        result = solver.solve(problem, timeout=6)
    assert validate_plan(problem, result.plan).valid
    if planner.complete:
        assert result.status is Status.SOLVED_OPTIMALLY
        assert result.metrics["bound_kind"].startswith("relative")
    else:
        assert result.status is Status.SOLVED_SATISFICING
        assert int(result.metrics["lower_bound"]) < int(result.metrics["makespan"])


def test_a_sharp_waypoint_is_passed_and_never_called_optimal_where_it_is_not():
    """A slider round a corner: with a stop there it would take a unit longer or more."""
    scene = SceneBuilder("corner")
    poses = [(5.0, 5.0, 0.0), (15.0, 5.0, 0.0), (15.0, 15.0, 0.0)]
    places = [scene.place(f"p{i}", pose) for i, pose in enumerate(poses)]
    robot = scene.robot("r0", places[0], MotionModels.SE2)
    scene.drive("go", robot, places, (1, 100))
    with OneshotPlanner(
        name="samp-refine[cpsat]", optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY
    ) as solver:
        result = solver.solve(scene.problem, timeout=20)
    assert validate_plan(scene.problem, result.plan).valid
    # 10 m twice, each from rest to rest at v = 2 and a = 1: 7 s; the bound is 20 / 2 + 2 s
    assert 12 <= int(result.metrics["makespan"]) < 14


@pytest.mark.parametrize("unit", [0.1, 1, 60, 3600])
def test_units_forgive_rounding_and_no_more_than_the_validator(unit):
    facts = Facts(SimpleNamespace(seconds_per_unit=unit), {})
    for count in (1, 17, 1000):
        assert facts.units(count * unit) == count
        assert facts.units(count * unit * (1 + 1e-14)) == count
        assert facts.units(count * unit + 2e-6) == count + 1
    assert TOLERANCES.late > LATE


@pytest.mark.parametrize("planner", [Hurried, Patient])
def test_a_group_is_complete_only_if_all_its_paths_are(planner):
    body = Body(box(2, 1), Kinematics(MotionModel.REEDSSHEPP, 1.0, 2.0, 1.0))
    ways = {
        "east": ((0.0, 0.0, 0.0), (20.0, 0.0, 0.0)),
        "north": ((9.0, -9.0, 1.6), (9.0, 9.0, 1.6)),
    }
    motions = tuple(TimedMotion(n, n, body, poses, 0.0, 100.0) for n, poses in ways.items())
    with extended("planners", planner.name, planner):
        service = MotionService(None, planner=planner.name)
        for _ in range(2):  # what was cut short is not remembered as anything better
            report = service.coordinate(GroupQuery(motions), Deadline.after(60))
            assert report.outcome is Outcome.FOUND
            assert report.complete is planner.complete
            alone = service.plan(PathQuery(body, ways["east"]), Deadline.after(60))
            assert alone.complete is planner.complete


def through_a_doorway(folder):
    """Three cars, two one way and one the other, and a doorway for one."""
    floor = rooms(random.Random(4))
    ways = (("r0", "box", "p1", "p4"), ("r1", "long", "p2", "p5"), ("r2", "square", "p5", "p1"))
    robots = tuple(Robot(n, True, shape, start, ((goal,),), 0) for n, shape, start, goal in ways)
    style = Style("all", "order", 0, "optional", "pairs")
    return build(Case(4, floor, robots, style), folder)


class Seen(Observer):
    """Remembers what was learned of groups."""

    def __init__(self):
        self.groups = []

    def on_refinement(self, state, refinements):
        self.groups += [r for r in refinements if r.layer is Layer.GROUP]


def optimum(problem, **params):
    """Return what comes of a problem, and the strengths of what is learned of groups."""
    seen = Seen()
    with OneshotPlanner(
        name="samp-refine[cpsat]",
        params={"observers": [seen], "max_restarts": 0, **params},
        optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY,
    ) as solver:
        result = solver.solve(problem, timeout=120)
    seconds = params.get("seconds_per_unit", 1.0)
    assert validate_plan(problem, result.plan, seconds_per_unit=seconds).valid
    return result, {r.strength for r in seen.groups}


def crossing():
    """Two sliding robots whose fastest ways take 4.5 s and cross where both are at half time."""
    scene = SceneBuilder("crossing")
    ways = (((7.5, 10, 0), (12.5, 10, 0)), ((10, 7.5, math.pi / 2), (10, 12.5, math.pi / 2)))
    for k, way in enumerate(ways):
        places = [scene.place(f"p{k}{i}", pose) for i, pose in enumerate(way)]
        robot = scene.robot(f"r{k}", places[0], MotionModels.SE2)
        scene.drive(f"go{k}", robot, places, (1, 100))
    return scene.problem


@pytest.mark.parametrize("relative", [True, pytest.param(False, marks=pytest.mark.long)])
def test_no_order_of_two_robots_is_a_proof(relative):
    """One of them is late on its fastest way, and off it: that it would be on any is not known."""
    result, strengths = optimum(crossing(), relative=relative)
    assert strengths == {Strength.HEURISTIC}
    assert result.status is Status.SOLVED_SATISFICING
    assert int(result.metrics["lower_bound"]) < int(result.metrics["makespan"])


def test_no_order_of_three_robots_is_a_proof(tmp_path):
    """Their orders, and who gives way where, are tried and not searched to an end: what is learned
    of the three stays a guess. The facts on which a bound may rest leave 22 units, as a plan does.
    """
    result, strengths = optimum(through_a_doorway(tmp_path), seconds_per_unit=0.5)
    assert strengths == {Strength.HEURISTIC}
    assert result.status is Status.SOLVED_OPTIMALLY
    assert int(result.metrics["lower_bound"]) == 22 == int(result.metrics["makespan"])


def strewn(seed):
    """A drive of one robot past others that stand about, listed anyhow."""
    rng = random.Random(f"strewn {seed}")
    scene = SceneBuilder(f"strewn{seed}")
    model = rng.choice([MotionModels.REEDSSHEPP, MotionModels.SE2])

    def place(name, low, high, y):
        return scene.place(name, (rng.uniform(low, high), y, rng.uniform(-3.0, 3.0)))

    ends = [place(f"p{k}", x, x + 4.0, rng.uniform(5.0, 15.0)) for k, x in enumerate((3.0, 17.0))]
    robot = scene.robot("r0", ends[0], model)
    for i in range(rng.choice([0, 3, 5])):
        scene.robot(f"parked{i}", place(f"between{i}", 9.5, 13.5, 4.0 + 2.6 * i))
    scene.drive("go", robot, ends, (1, 2000))
    return shuffled(scene.problem, seed).problem


def bounds_beaten(seed):
    """Return what random trees say that no plan beats, where another plan does; and whether two of
    them differ.
    """
    told, makespans = [], []
    for params in ({"preset": "paper", "seed": 1}, {"preset": "paper", "seed": 2}, {}):
        params = {"seconds_per_unit": 0.1, "query_seconds": 2.0, "optimal": True, **params}
        with OneshotPlanner(name="samp-refine[cpsat]", params=params) as solver:
            metrics = solver.solve(strewn(seed), timeout=20).metrics
        told += [float(metrics["lower_bound"])] if "preset" in params else []
        makespans.append(int(metrics["makespan"]))
    return [bound for bound in told if bound > min(makespans)], len({*makespans[:2]}) > 1


@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(6, 60), marks=pytest.mark.long)])
def test_a_way_drawn_at_random_bounds_nothing(seeds):
    """What a random tree finds is the planner's fastest only where nothing is in its way."""
    found = [bounds_beaten(seed) for seed in seeds]
    assert [beaten for beaten, _ in found] == [[] for _ in seeds]
    assert any(differ for _, differ in found)
