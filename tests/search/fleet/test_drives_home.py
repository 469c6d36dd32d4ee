"""Fleets whose robots may end anywhere, with fewer stations than robots: whoever has done its last
job gets out of the way of who comes there later.
"""

import logging
import random

import pytest
from unified_planning.shortcuts import Equals, GlobalEndTiming, OneshotPlanner, get_environment

from tests.search.fleet.guesses import along_the_axes
from tests.shuffled import shuffled
from tests.usual import usually
from up_samp import Fleet
from up_samp.benchmarks.builders.warehouse import WAREHOUSE_ENCODINGS, warehouse
from up_samp.io.plan_dict import plan_to_dict
from up_samp.model import Deadline
from up_samp.search.fleet.assignment import Assignment, assign
from up_samp.search.fleet.duties import duties_of
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.jobs import find_jobs
from up_samp.search.fleet.solve import homes_of
from up_samp.search.fleet.travel_times import TravelTimeModel
from up_samp.tuning import Tuning
from up_samp.upio import read_problem
from up_samp.validation import validate_plan

STARTS = {"r0": (3.0, 3.0), "r1": (3.0, 8.0), "r2": (11.0, 3.0)}
NOBODY = {robot: {} for robot in STARTS}
ONLY = (11.0, 8.0, 0.0)
"""The one station."""


def site(seed, jobs=6, *, ends=False, odd=None):
    """Return the problem of a fleet that brings everything to one station, listed in any order.

    :param ends: everybody has to be back where it starts; ``odd``: where a load waits, too.
    """
    rng = random.Random(seed)
    fleet = Fleet("examples/maps/two_rooms.yaml")
    fleet.add_robot_type("amr", (0.8, 0.6), model="omni")
    spots = [(x, y) for x in (2.0, 6.0, 8.0, 12.0) for y in (11.0, 13.0)]
    places = {f"p{i}": spot for i, spot in enumerate(rng.sample(spots, jobs))}
    loads = [*places, *(["odd"] if odd else [])]
    places |= {"odd": odd} if odd else {}
    places |= {"station": ONLY[:2], **{f"at_{r}": pose for r, pose in STARTS.items()}}
    for name in rng.sample(sorted(places), len(places)):
        fleet.add_place(name, *places[name])
    for name in rng.sample(sorted(STARTS), len(STARTS)):
        end = {"end": f"at_{name}"} if ends else {}
        fleet.add_robot(name, "amr", start=f"at_{name}", **end)
    for name in rng.sample(loads, len(loads)):
        fleet.add_order(f"from_{name}", name, "station")
    problem = fleet.problem
    rng.shuffle(problem.activities)
    return problem


def assigned_to(problem, owners):
    """Return an assignment in which job by job somebody (by number) does it."""
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    duties = duties_of(problem, snapshot, jobs)
    guess = TravelTimeModel(snapshot, along_the_axes, duties=duties)
    tours = {robot: [] for robot in STARTS}
    for j, (options, number) in enumerate(zip(jobs.options, owners, strict=True)):
        robot = sorted(STARTS)[number]
        k = next(k for k, option in enumerate(options) if option.robot == robot)
        tours[robot].append((j, k))
    return Assignment(AssignmentEvaluator(guess, jobs), tours)


@pytest.mark.parametrize("seed", range(3))
def test_whoever_ends_where_others_come_has_a_drive_back(seed):
    assignment = assigned_to(site(seed), (0, 0, 0, 0, 2, 2))
    assert assignment.drives_home() == {
        "r0": {3: ["move_r0_station_to_at_r0"]},
        "r1": {},
        "r2": {1: ["move_r2_station_to_at_r2"]},
    }
    homes = {
        o.robot: assignment.guess.home(o) for options in assignment.jobs.options for o in options
    }
    assert homes == {robot: (*pose, 0.0) for robot, pose in STARTS.items()}


def test_nobody_drives_back_who_is_alone_at_a_station_or_has_an_end():
    assert assigned_to(site(0), (1,) * 6).drives_home() == NOBODY
    assert assigned_to(site(0, ends=True), (0, 0, 1, 1, 2, 2)).drives_home() == NOBODY


@pytest.mark.parametrize("seed", usually(1, of=range(2)))
def test_such_a_fleet_is_dealt_out(seed):
    problem = site(seed)
    params = {"seed": 0, "first_plan": True}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=60)
    assert validate_plan(problem, result.plan).valid
    # no round of the usual search, which may be as quick here
    assert result.metrics["rounds"] == "0"
    told = plan_to_dict(problem, result.plan)
    start = {activity["name"]: activity["start"] for activity in told["activities"]}
    drives = sorted(told["motions"], key=lambda motion: start[motion["activity"]])
    ends = {drive["object"]: tuple(drive["samples"][-1][1:3]) for drive in drives}
    assert len(set(ends.values())) == len(STARTS)
    assert sum(end == pytest.approx(ONLY[:2]) for end in ends.values()) == 1


def homely(seed):
    """Return a warehouse of which some robots have to be at their docks in the end, which these
    are, and how it is assigned; listed anyhow.
    """
    rng = random.Random(f"homely {seed}")
    robots, encoding = rng.choice([2, 3]), rng.choice(WAREHOUSE_ENCODINGS)
    problem = warehouse(robots, rng.choice([3, 4, 5]), seed=seed, encoding=encoding)
    ends = [f"robot{k}" for k in range(robots) if rng.random() < 0.6]
    for name in ends:
        there = problem.fluent("robot_at")(problem.object(name))
        dock = problem.object(name.replace("robot", "dock"))
        problem.add_condition(GlobalEndTiming(), Equals(there, dock))
    return shuffled(problem, seed, rename=False).problem, ends


@pytest.mark.parametrize("seed", range(6))
def test_who_has_to_be_home_in_the_end_drives_there(seed):
    problem, ends = homely(seed)
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    guess = TravelTimeModel(snapshot, along_the_axes, duties=duties_of(problem, snapshot, jobs))
    evaluator = AssignmentEvaluator(guess, jobs)
    assignment = assign(
        evaluator, Deadline.never(), random.Random(seed), Tuning(exchanges=9), rounds=0
    )
    homes = homes_of(problem, assignment)
    assert {task.object for n in homes for task in snapshot.by_activity[n]}.isdisjoint(ends)
    assert bool(homes) == (len(ends) < len(evaluator.robots))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(12))
def test_plans_of_who_has_to_be_home_get_better(seed, caplog):
    get_environment().credits_stream = None
    problem, _ = homely(seed)
    params = {"tuning": {"large": 1, "stale": 15}, "seconds_per_unit": 0.5}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=60)
    assert validate_plan(problem, result.plan, seconds_per_unit=0.5).valid
    assert not [r for r in caplog.records if r.levelno >= logging.ERROR]
