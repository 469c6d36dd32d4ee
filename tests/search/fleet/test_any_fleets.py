"""Fleets of whatever may be asked of them have a first plan, soon."""

import random

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.search.fleet.drawn import drawn_fleet
from tests.search.fleet.guesses import along_the_axes
from tests.shuffled import shuffled
from tests.usual import usually
from up_samp.model import Deadline
from up_samp.search.fleet.assignment import assign, decided_by, drives_chosen
from up_samp.search.fleet.duties import duties_of
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.jobs import find_jobs
from up_samp.search.fleet.travel_times import TravelTimeModel
from up_samp.tuning import Tuning
from up_samp.upio import read_problem
from up_samp.validation import validate_plan


def drawn(seed, features=None):
    """Return the problem of a drawn fleet, listed anyhow."""
    return shuffled(drawn_fleet(seed, features).problem, seed, rename=False).problem


def assert_planned(problem):
    get_environment().credits_stream = None
    params = {"first_plan": True}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=60.0)
    assert result.plan is not None
    assert validate_plan(problem, result.plan).valid


@pytest.mark.parametrize("seed", usually(4, of=sorted({*range(24)} - {17})))
def test_any_fleet_has_a_plan(seed):
    """But one in which robots wait at a place for others that have to pass there and are carried
    together (17).
    """
    assert_planned(drawn(seed))


@pytest.mark.parametrize(
    "features",
    usually(
        {"capacity"},
        of=[
            {"slots"}, {"capacity"}, {"crew", "capacity"}, {"priority", "capacity"},
            {"slots", "capacity"}, {"alternatives"}, {"alternatives", "due"}, {"optional"},
            {"optional", "capacity", "crew"}, {"slots", "battery"}, {"together", "after"},
        ],
    ),
    ids=lambda some: "-".join(sorted(some)),
)  # fmt: skip
@pytest.mark.parametrize("seed", usually(101, of=(100, 101)))
def test_each_feature_has_plans(features, seed):
    assert_planned(drawn(seed, features))


@pytest.mark.parametrize("seed", range(12))
def test_tours_lead_from_stop_to_stop_and_drives_are_chosen_for_them(seed):
    problem = drawn(seed)
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    guess = TravelTimeModel(snapshot, along_the_axes, duties=duties_of(problem, snapshot, jobs))
    evaluator, rng = AssignmentEvaluator(guess, jobs), random.Random(seed)
    assignment = assign(evaluator, Deadline.never(), rng, Tuning(exchanges=9), rounds=0)
    chosen = drives_chosen(assignment, problem.activities)
    kept = decided_by(assignment, problem.activities, chosen=chosen)
    pose = snapshot.configurations
    for robot, drives in assignment.drives().items():
        here = pose[snapshot.initial[robot]]
        for _, (who, a, b) in drives:
            assert (who, a) == (robot, here)
            here = b
        tour = [jobs.options[j][k] for j, k in assignment.tours[robot]]
        for number, option in enumerate(tour):  # all its stops, in their order
            seen = iter([b for n, (_, _, b) in drives if n == number])
            assert all(stop in seen for stop in option.stops)
        names = [name for _, name in chosen[robot]]
        ways = [
            (pose[t.terms[0].name], pose[t.terms[-1].name])
            for name in names
            for t in snapshot.by_activity[name]
        ]
        assert ways == [(a, b) for _, (_, a, b) in drives if a != b]
        assert {*names} <= kept
        left = [t for t in snapshot.by_object[robot] if t.activity in kept - {*names}]
        ends = {here, *(option.exit for option in tour[-1:])}
        assert {pose[t.terms[0].name] for t in left} <= ends
