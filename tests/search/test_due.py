"""What is due too soon is told at once; what a plan keeps is never told to be too soon."""

import itertools
import random
import re
import time

import pytest
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
    LT,
    And,
    ClosedTimeInterval,
    ConfigurationType,
    Equals,
    Implies,
    MinimizeMakespan,
    MovableType,
    Not,
    OneshotPlanner,
    Or,
    TimePointInterval,
)

from tests.benchmarks.scene import hall_map
from tests.metamorphic.motions import ALIKE, OTHERS, write
from tests.metamorphic.sites import FAMILIES
from tests.search.limits import WRITINGS, by_scope, limits, releases
from tests.search.test_assumptions import Site
from tests.shuffled import shuffled
from tests.usual import usually
from up_samp.benchmarks.instances import instance
from up_samp.model import Deadline, TrafficZone
from up_samp.model.frames import Frame
from up_samp.scheduling.cpsat.encode.terms import least
from up_samp.search import loop
from up_samp.search.due import SoonestEnds, due_too_soon
from up_samp.search.fleet_bound.work import units_apart
from up_samp.search.params import Parameters
from up_samp.search.search import Wrapped
from up_samp.search.session import open_search

STYLES = [*ALIKE, *OTHERS]
INSTANCES = (
    "logistics-do-oc-r1-i1", "logistics-do-all-r2-i2", "jobshop-r2-j1-m1",
    "kitting-r2-k1-p3-d2", "doors-r2-d1", "warehouse-r2-o3", "warehouse-compact-r2-o3",
)  # fmt: skip


def plan_of(problem, **params):
    params = {"first_plan": True, "seed": 0, **params}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        return planner.solve(problem, timeout=20.0)


def motions_of(problem):
    wrapped = Wrapped("cpsat", {"workers": 1}, lambda *_: [], lambda *_: [], native=True)
    search = open_search(problem, wrapped, Parameters(), Deadline.after(600.0))
    search.scheduler.close()
    return search.motions


def tell_when(problem, seed):
    """Return how much later than its least duration says each activity of a plan is known to end,
    where everything has to begin and end by when it does in that plan: nothing of it is refuted.
    """
    rng, plan = random.Random(seed), plan_of(problem).plan
    assert plan is not None
    there = {a.name for a in plan.activities}
    activities = [a for a in problem.activities if a.name in there]

    def units(point) -> int:
        return int(plan.get(point).constant_value())

    times = {a.name: (units(a.start), units(a.end)) for a in activities}
    for activity in activities:
        for point, then in zip((activity.start, activity.end), times[activity.name], strict=True):
            rng.choice(WRITINGS)(problem, activity, rng.choice(limits(point, then)))
            if rng.random() < 0.3:
                rng.choice(WRITINGS)(problem, activity, rng.choice(releases(point, then)))
    motions = motions_of(problem)
    told = due_too_soon(problem, motions)
    assert told == [], seed
    soonest, later = SoonestEnds(problem, motions.facts, motions.service), []
    for name, (start, end) in times.items():
        known = soonest.of(name)
        assert known[0] <= start, (seed, name)
        assert known[1] <= end, (seed, name)
        later.append(known[1] - least(problem.get_activity(name).duration))
    return later


@pytest.mark.parametrize("name", usually(*INSTANCES[:5:2], of=INSTANCES))
def test_what_an_instance_has_a_plan_for_is_not_due_too_soon(name):
    assert max(tell_when(shuffled(instance(name).build(), name).problem, name)) > 0


@pytest.mark.parametrize("family", usually("shop", "doors", of=FAMILIES))
def test_what_a_site_has_a_plan_for_is_not_due_too_soon(family, tmp_path):
    style = random.Random(family).choice(STYLES)
    tell_when(write(FAMILIES[family](0), style, tmp_path), 0)


@pytest.mark.long
@pytest.mark.parametrize("family", FAMILIES)
def test_what_many_sites_have_plans_for_is_not_due_too_soon(family, tmp_path):
    for seed, style in enumerate(STYLES):
        tell_when(write(FAMILIES[family](seed), style, tmp_path), seed)


def docked(rng, places):
    """A robot that drives from place to place in a hall, in order; it comes slowly to the
    last one, a dock, if it does so from outside of the zone before it.
    """
    problem = SchedulingMotionProblem("docked")
    hall = OccupancyMap(str(hall_map(divided=False)), SE2(0.0, 0.0, 0.0))
    pose = ConfigurationType("pose", hall, ConfigurationKind.SE2)
    x, y, turn = places[-1]
    frame = Frame(x, y, turn)
    corners = frame.points([(-2.0, -0.01), (0.01, -0.01), (0.01, 0.01), (-2.0, 0.01)])
    zone = TrafficZone(tuple(map(tuple, corners.tolist())), 0.1, dock=(x, y, turn))
    turns = rng.choice((None, 0.0, 1.0))  # None: it moves in any direction
    more = {} if turns is None else {"turning_radius": turns}
    robot = MovableObject(
        "robot",
        MovableType("robot"),
        footprint=[(-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (-0.4, 0.3)],
        motion_model=MotionModels.SE2 if turns is None else MotionModels.REEDSSHEPP,
        motion_parameters={"v_max": 1.0, "a_max": 1.0, "zones": (zone,), **more},
    )
    problem.add_object(robot)
    at = [ConfigurationObject(f"at{k}", pose, SE2(*place)) for k, place in enumerate(places)]
    problem.add_objects(at)
    problem.set_initial_configuration(robot, at[0])
    drives = []
    for k, (start, goal) in enumerate(itertools.pairwise(at)):
        drives.append(problem.add_motion_activity(f"drive{k}", 1))
        drives[-1].set_duration_bounds(1, 100)
        drives[-1].add_motion_constraint(ActivityWaypoints(robot, start, [goal]))
    for one, other in itertools.pairwise(drives):
        problem.add_constraint(LE(one.end, other.start))
    problem.add_quality_metric(MinimizeMakespan())
    return problem, drives[-1]


@pytest.mark.parametrize("seed", range(6))
def test_what_is_done_with_a_stop_before_a_dock_is_not_due_too_soon(seed):
    """What a dock asks for binds the last drive: from within its zone that is a short one."""
    rng = random.Random(seed)
    goal = rng.uniform(12, 20), 10.0, rng.uniform(-0.5, 0.5)
    before = [Frame(*goal).of((-ahead, 0.0, 0.0)) for ahead in (rng.uniform(4, 8), 0.2)]
    problem, last = docked(rng, [*before, goal])
    problem = shuffled(problem, seed, rename=False).problem
    problem.add_constraint(LE(problem.get_activity(last.name).end, 15))
    result = plan_of(problem)
    assert result.plan is not None, result.log_messages


SEEDS = [1, *(pytest.param(k, marks=pytest.mark.long) for k in range(2, 9))]


@pytest.mark.parametrize("seed", SEEDS)
def test_no_place_is_nearer_with_a_stop_on_the_way(seed):
    """By what is known of tours: what is known of drives tells more of those that end at a dock."""
    rng = random.Random(seed)

    def drawn():
        return rng.uniform(5, 35), rng.uniform(5, 15), rng.choice((0.0, rng.uniform(-3, 3)))

    goal = drawn()
    inside = [Frame(*goal).of((-rng.uniform(0.1, 1.9), 0.0, 0.0)) for _ in range(3)]
    problem, _ = docked(rng, [*(drawn() for _ in range(4)), *inside, goal])
    motions, more = motions_of(problem), 0
    body = motions.facts.snapshot.objects["robot"].body
    pose = motions.facts.snapshot.configurations

    def driven(start, goal):
        return motions.facts.units(motions.service.lower_bound(body, (pose[start], pose[goal])))

    for start, stop, goal in itertools.permutations(pose, 3):
        least = units_apart(motions.facts, motions.service, "robot", start, goal)
        assert least <= driven(start, stop) + driven(stop, goal)
        assert least <= driven(start, goal)
        more += least < driven(start, goal)
    assert more > 0


def read_on_the_way(rng):
    """A robot that drives off, and something late that asks for it to be told to be where it began:
    it is, until the drive is over.
    """
    problem = SchedulingMotionProblem("read on the way")
    hall = OccupancyMap(str(hall_map(divided=False)), SE2(0.0, 0.0, 0.0))
    pose = ConfigurationType("pose", hall, ConfigurationKind.SE2)
    here, there = (
        ConfigurationObject(name, pose, SE2(x, 10.0, 0.0))
        for name, x in (("here", 5.0), ("there", rng.uniform(20.0, 30.0)))
    )
    robot = MovableObject(
        "robot",
        MovableType("robot"),
        footprint=[(-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (-0.4, 0.3)],
        motion_model=MotionModels.SE2,
        motion_parameters={"v_max": 1.0, "a_max": 1.0},
    )
    problem.add_objects([robot, here, there])
    problem.set_initial_configuration(robot, here)
    at = problem.add_fluent("at", pose, default_initial_value=here)
    drive = problem.add_motion_activity("drive", 1)
    drive.set_duration_bounds(1, 100)
    drive.add_motion_constraint(ActivityWaypoints(robot, rng.choice((at, here)), [there]))
    drive.add_effect(drive.end - rng.choice((0, 1)), at, there)
    before = problem.add_activity("before", duration=rng.randint(8, 12))
    late, last = (problem.add_activity(name, duration=1) for name in ("late", "last"))
    for activity, place in ((late, here), (last, there)):
        spans = TimePointInterval(activity.start), ClosedTimeInterval(activity.start, activity.end)
        activity.add_condition(rng.choice(spans), Equals(at, place))
    for one, other in ((before, late), (late, last)):
        problem.add_constraint(LE(one.end, other.start))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


@pytest.mark.parametrize("seed", range(6))
def test_who_is_told_to_be_somewhere_may_be_under_way(seed):
    problem = shuffled(read_on_the_way(random.Random(seed)), seed, rename=False).problem
    tell_when(problem, seed)


@pytest.mark.parametrize(
    ("units", "hand", "soonest"), [(1, False, False), (0, True, False), (1, True, True)]
)
def test_who_drives_off_is_told_to_be_where_it_was_until_it_has_come_elsewhere(
    units, hand, soonest
):
    """What is looked at at home may be so while the robot drives, unless that keeps it there."""
    site = Site(1)
    go, wait = site.drive("go", 0, "B", "home0"), site.work("wait", 0, 9, hand=False)
    look, work = site.work("look", 0, units, "home0", hand=hand), site.work("work", 0, 1, "B")
    site.problem.add_constraint(work.present)
    for other in (go, wait, look):
        site.state(other.present, work)
    site.state(LE(wait.end, look.start))
    site.state(LE(look.end, work.start))
    problem = shuffled(site.problem, units, rename=False).problem
    problem.add_constraint(LE(problem.get_activity("work").end, 16))
    assert bool(due_too_soon(problem, motions_of(problem))) == soonest
    result = plan_of(problem)
    assert (result.status is Status.UNSOLVABLE_PROVEN) == soonest, result.log_messages
    assert soonest == (result.plan is None)


@pytest.mark.parametrize(
    ("writing", "sort"),
    usually(*zip(WRITINGS, (1, 2, 0), strict=True), of=itertools.product(WRITINGS, range(3))),
)
def test_it_is_told_who_would_come_from_where(writing, sort):
    problem = shuffled(instance("warehouse-compact-r3-o5").build(), sort, rename=False).problem
    motions = motions_of(problem)
    some = [a for a in problem.activities if re.fullmatch(r"unload_robot\d_order2", a.name)]
    ends = SoonestEnds(problem, motions.facts, motions.service)
    soonest = min(ends.of(a.name)[1] for a in some)
    for activity in some:
        writing(problem, activity, limits(activity.end, soonest - 1)[sort])
    assert len(due_too_soon(problem, motions)) == len(some) == 3
    result = plan_of(problem)
    assert result.status is Status.UNSOLVABLE_PROVEN
    (message,) = [m.message for m in result.log_messages]
    assert f"due at {soonest - 1}, {soonest} at the soonest: robot" in message
    assert "begins at dock" in message


def test_what_others_have_to_be_present_for_is_not_due_without_them():
    problem = instance("warehouse-compact-r2-o3").build()
    unload, other = map(problem.get_activity, ("unload_robot0_order0", "leave_robot0_order1"))
    problem.add_constraint(LE(unload.end, 1), scope=[unload.present, other.present])
    problem.add_constraint(Implies(And(unload.present, Not(other.present)), LE(unload.end, 1)))
    problem.add_constraint(Or(LE(unload.end, 1), LE(other.end, 1)), scope=[unload.present])
    assert due_too_soon(problem, motions_of(problem)) == []
    problem.add_constraint(Implies(And(unload.present, unload.present), LE(unload.end, 1)))
    assert len(due_too_soon(problem, motions_of(problem))) == 1


def test_a_large_fleet_is_told_in_seconds():
    """Not by way of assignments that cannot be scheduled, and a model of everything."""
    problem = instance("warehouse-compact-r10-o30").build()
    for activity in problem.activities:
        if re.fullmatch(r"unload_robot\d_order6", activity.name):
            by_scope(problem, activity, LE(activity.end, 3))
    began = time.process_time()
    result = plan_of(problem)
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert result.metrics["rounds"] == "0"
    assert time.process_time() - began < 60


def test_what_nobody_can_reach_is_told_without_a_scheduler(monkeypatch):
    """What proofs leave nobody to do, whatever they are about, ends the search."""
    problem = instance("warehouse-compact-r2-o3").build()
    for activity in problem.activities:
        if activity.name.startswith("carry_") and activity.name.endswith("order1"):
            by_scope(problem, activity, LT(activity.start, 1))
    monkeypatch.setattr(loop, "get_schedule", None)
    result = plan_of(problem)
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert "has to be there" in result.log_messages[0].message
