"""Handing over a place: gaps between a departure and an arrival, and plans that need them."""

import itertools
import math
import random

import pytest
import shapely
import shapely.affinity
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import (
    LE,
    ConfigurationType,
    Equals,
    MinimizeMakespan,
    MovableType,
    OneshotPlanner,
)

from tests.benchmarks.scene import hall_map
from tests.handmade import drive as as_driven
from tests.shuffled import shuffled
from up_samp.benchmarks.instances import instance
from up_samp.model import Body, CandidateSchedule, Deadline, Kinematics, MotionModel
from up_samp.model.refinement import Strength
from up_samp.search.cuts import rejecting
from up_samp.search.loop import state_what_is_known
from up_samp.search.params import Parameters
from up_samp.search.search import Wrapped
from up_samp.search.session import open_search
from up_samp.search.statements import proven_gap
from up_samp.upio import build_plan, read_itinerary, read_problem
from up_samp.validation import validate_plan

CAR = ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5))


def flow_shop(robots, stations):
    """Every robot visits all stations of a hall in the same order, 5 units each, and goes on."""
    problem = SchedulingMotionProblem("flow shop")
    hall = OccupancyMap(str(hall_map(divided=False)), SE2(0.0, 0.0, 0.0))
    pose = ConfigurationType("pose", hall, ConfigurationKind.SE2)

    def place(name, x, y):
        item = ConfigurationObject(name, pose, SE2(x, y, 0.0))
        problem.add_object(item)
        return item

    shared = [place(f"s{k}", 10.0 + 8.0 * k, 10.0) for k in range(stations)]
    for r in range(robots):
        stops = [place(f"h{r}", 4.0, 4.0 + 4.0 * r), *shared, place(f"o{r}", 36.0, 4.0 + 4.0 * r)]
        robot = MovableObject(
            f"r{r}",
            MovableType("robot"),
            footprint=list(CAR),
            motion_model=MotionModels.REEDSSHEPP,
            motion_parameters={"turning_radius": 1.0, "v_max": 2.0, "a_max": 1.0},
        )
        problem.add_object(robot)
        problem.set_initial_configuration(robot, stops[0])
        before = None
        for k in range(stations + 1):
            go = problem.add_motion_activity(f"go{r}_{k}", 1)
            go.set_duration_bounds(1, 400)
            go.add_motion_constraint(ActivityWaypoints(robot, stops[k], [stops[k + 1]]))
            if before is not None:
                problem.add_constraint(LE(before.end, go.start))
            if k < stations:
                before = problem.add_activity(f"work{r}_{k}", duration=5)
                problem.add_constraint(LE(go.end, before.start))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def solve(problem, timeout=60.0, **params):
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=timeout)
    assert result.plan is None or validate_plan(problem, result.plan).valid
    return result


def test_a_shared_station_is_handed_over(tmp_path):
    result = solve(flow_shop(2, 1), first_plan=True, query_seconds=0.15)
    assert result.status is Status.SOLVED_SATISFICING
    gaps = [r for r in result.history.refinements if "arrives where" in r.why]
    proven = [r for r in gaps if r.strength is Strength.PROVEN]
    guessed = [r for r in gaps if r.strength is Strength.HEURISTIC]
    assert proven
    assert len(proven) + len(guessed) == len(gaps)
    # to arrive 2 m behind who drives off takes twice 2 m at 1 m/s^2
    assert all(f">= {math.ceil(2 * math.sqrt(2))} " in str(r.statement) for r in guessed)


@pytest.mark.long
@pytest.mark.parametrize(("robots", "stations", "most"), [(3, 3, 70), (4, 3, 80)])
def test_flow_shops_are_scheduled_well(robots, stations, most):
    result = solve(flow_shop(robots, stations), first_plan=True)
    assert result.status is Status.SOLVED_SATISFICING
    assert int(result.metrics["makespan"]) <= most


def body(a_max=1.0, model=MotionModel.REEDSSHEPP, footprint=CAR):
    return Body(footprint, Kinematics(model, 1.0, 2.0, a_max, 1.0))


def test_proven_gaps():
    here, away = (5.0, 5.0, 0.0), (9.0, 5.0, 0.0)
    # two discs of 0.5 m: 1 m to be covered by both; 0.25 T^2 = 1
    gap = proven_gap((body(), (here, away)), (body(), (away, here)))
    assert gap == pytest.approx(0.95 * 2.0, rel=0.01)
    slow = proven_gap((body(0.25), (here, away)), (body(0.25), (away, here)))
    assert slow == pytest.approx(2 * gap, rel=0.01)
    beside = proven_gap((body(), (here, away)), (body(), (away, (5.0, 6.1, 0.0))))
    assert beside == 0.0
    far_off = tuple((x + 3.0, y) for x, y in CAR)
    unknown = body(model=MotionModel.SE2, footprint=far_off)
    assert proven_gap((unknown, (here, away)), (unknown, (away, here))) == 0.0


def test_no_straight_hand_over_is_shorter_than_proven():
    """Both along their own headings, one off, one to the place, against a fine simulation."""

    def at(pose):
        turned = shapely.affinity.rotate(
            shapely.Polygon(CAR), pose[2], origin=(0, 0), use_radians=True
        )
        return shapely.affinity.translate(turned, pose[0], pose[1])

    rng = random.Random(5)
    for _ in range(20):
        p = (0.0, 0.0, rng.uniform(-3, 3))
        q = (rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-3, 3))
        a, b = rng.choice([0.5, 1.0, 2.0]), rng.choice([0.5, 1.0, 2.0])
        gap = proven_gap((body(a), (p, p)), (body(b), (q, q)))

        def along(pose, way):
            x, y, heading = pose
            return x + way * math.cos(heading), y + way * math.sin(heading), heading

        for sign_a in (1, -1):
            for sign_b in (1, -1):
                times = [gap * k / 40 for k in range(41)]
                apart = all(
                    at(along(p, sign_a * a * t * t / 2)).disjoint(
                        at(along(q, sign_b * b * (gap - t) ** 2 / 2))
                    )
                    for t in times
                )
                assert not apart or gap == 0.0


def test_nobody_passes_the_button_while_another_opens_the_door():
    """Who waits for the door does not stop, for no time at all, where the other one rests."""
    problem = instance("logistics-dc-oc-r2-i2").build("fluents", metric=False)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=60.0)
    assert validate_plan(problem, result.plan).valid
    assert int(result.metrics["makespan"]) <= 60  # in turn: 100
    assert int(result.metrics["rounds"]) <= 3


def lifted_away(order):
    """Two cars by which a place is handed over: one moves 2 mm and is lifted away by a crane, the
    other one is put there and moves 2 mm. Neither is under way for as long as a gap takes.
    """
    problem = SchedulingMotionProblem("lifted away")
    hall = OccupancyMap(str(hall_map(divided=False)), SE2(0.0, 0.0, 0.0))
    pose = ConfigurationType("pose", hall, ConfigurationKind.SE2)
    ways = {"leaving": (20.0, 20.002, 30.0), "coming": (10.0, 19.998, 20.0)}
    steps = []
    for name, along in ways.items():
        places = [
            ConfigurationObject(f"{name}{k}", pose, SE2(x, 10.0, 0.0)) for k, x in enumerate(along)
        ]
        problem.add_objects(places)
        limits = {"turning_radius": 1.0, "v_max": 2.0, "a_max": 1.0}
        robot = MovableObject(
            name,
            MovableType("robot"),
            footprint=list(CAR),
            motion_model=MotionModels.REEDSSHEPP,
            motion_parameters=limits,
        )
        problem.add_object(robot)
        problem.set_initial_configuration(robot, places[0])
        first = 0 if name == "leaving" else 1
        go = problem.add_motion_activity(f"go_{name}", 1)
        go.add_motion_constraint(ActivityWaypoints(robot, places[first], [places[first + 1]]))
        lift = problem.add_motion_activity(f"lift_{name}", 1)
        lift.add_motion_effect(robot, places[2 - first])
        steps += [go, lift] if name == "leaving" else [lift, go]
    for one, other in itertools.pairwise(steps):
        problem.add_constraint(LE(one.end, other.start))
    problem.add_quality_metric(MinimizeMakespan())
    return shuffled(problem, order, rename=False).problem


@pytest.mark.parametrize("order", range(3))
def test_a_gap_is_no_longer_than_the_drives_that_it_is_proven_for(order):
    """With both cars under way all the time the gap takes 1.9 s; here they need 0.4 s."""
    result = solve(lifted_away(order), 30.0, seconds_per_unit=0.1)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert result.metrics["makespan"] == "4"


def beside_who_rests(way, order):
    """Return a problem in which one car rests where another one comes to rest, or its load does,
    and the plan of it: the first one is lifted away before the other one drives.
    """
    problem = SchedulingMotionProblem("beside who rests")
    hall = OccupancyMap(str(hall_map(divided=False)), SE2(0.0, 0.0, 0.0))
    kind = ConfigurationType("pose", hall, ConfigurationKind.SE2)
    laden = way == "load"
    x = 22.4 if laden else 20.0  # where both are to rest
    poses = {
        "before": (20.0 if laden else 14.0, 10.0, 0.0),
        "here": (20.0, 10.0, 0.0),
        "then": (30.0, 10.0, 0.0),
        "above": (x, 13.0, -math.pi / 2),
        "beside": (x, 10.3, -math.pi / 2),
        "away": (x, 16.0, -math.pi / 2),
        "load": (22.4, 10.0, 0.0),
        "unload": (32.4, 10.0, 0.0),
    }
    at = {name: ConfigurationObject(name, kind, SE2(*pose)) for name, pose in poses.items()}
    problem.add_objects(at.values())
    limits = {"turning_radius": 1.0, "v_max": 1.0, "a_max": 1.0}
    cars = {
        name: MovableObject(
            name,
            MovableType("car"),
            footprint=[(1.2 * x, 2.4 * y) for x, y in CAR] if name == "pallet" else list(CAR),
            motion_model=MotionModels.REEDSSHEPP,
            motion_parameters=limits,
        )
        for name in ("first", "other", *(["pallet"] if laden else []))
    }
    problem.add_objects(cars.values())
    for name, place in zip(cars, ("above", "before", "load"), strict=False):
        problem.set_initial_configuration(cars[name], at[place])

    def drive(name, car, start, goal, heeds):
        go = problem.add_motion_activity(name, 1)
        go.set_duration_bounds(1, 100)
        listed = {"dynamic_obstacles_at_start": [cars[n] for n in heeds]}
        go.add_motion_constraint(ActivityWaypoints(cars[car], at[start], [at[goal]], **listed))
        return go

    come = drive("come", "first", "above", "beside", ["other"])
    leave = drive("leave", "other", "here", "then", ["first"])
    driven = {
        "come": as_driven(poses["above"], [(2.7, 0.0)], 0.0, v_max=1.0, a_max=1.0),
        "leave": as_driven(poses["here"], [(10.0, 0.0)], 10.0, v_max=1.0, a_max=1.0),
    }
    if way == "driven":
        drive("prepare", "other", "before", "here", [])
        begin = poses["before"]
        driven["prepare"] = as_driven(begin, [(6.0, 0.0)], 0.9, v_max=1.0, a_max=1.0)
    if way == "set":
        come.add_motion_effect(cars["other"], at["here"])
    if laden:
        leave.add_motion_effect(cars["other"], at["then"])
        leave.add_motion_effect(cars["pallet"], at["unload"])
    lift = problem.add_motion_activity("lift", 1)
    lift.add_motion_effect(cars["first"], at["away"])
    problem.add_constraint(Equals(come.end, leave.start))
    problem.add_quality_metric(MinimizeMakespan())
    problem = shuffled(problem, order, rename=False).problem
    times = {"come": (0, 8), "lift": (8, 9), "prepare": (0, 8), "leave": (8, 22)}
    there = {activity.name for activity in problem.activities}
    schedule = CandidateSchedule({n: t for n, t in times.items() if n in there}, {})
    return problem, schedule, build_plan(problem, read_problem(problem), schedule, driven)


@pytest.mark.parametrize("order", range(2))
@pytest.mark.parametrize("way", ["driven", "set", "load"])
def test_there_is_no_gap_after_who_rests_where_another_one_comes_to_rest(way, order):
    problem, schedule, plan = beside_who_rests(way, order)
    verdict = validate_plan(problem, plan)
    assert verdict.valid, verdict.violations
    wrapped = Wrapped("cpsat", {"workers": 1}, lambda *_: [], lambda *_: [], native=True)
    search = open_search(problem, wrapped, Parameters(), Deadline.after(600.0))
    state_what_is_known(search)
    itinerary = read_itinerary(search.knowledge.relaxation, schedule)
    proven = search.knowledge.proven
    search.scheduler.close()
    assert proven
    assert rejecting(itinerary, search.facts.snapshot, proven) == []
