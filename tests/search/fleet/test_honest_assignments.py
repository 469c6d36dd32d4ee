"""Assignments that learn what drives really take, and foresee who is where when."""

import math
import random
from dataclasses import replace

import pytest

from tests.search.fleet.guesses import along_the_axes
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.model import Deadline
from up_samp.search.fleet.assignment import Assignment, assign, exchanged, inserted
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.evaluator_kernel import CostWeights
from up_samp.search.fleet.jobs import Jobs, find_jobs
from up_samp.search.fleet.travel_times import ENOUGH, TravelTimeModel, pauses_of
from up_samp.tuning import Tuning
from up_samp.upio import read_problem


@pytest.fixture(scope="module")
def problem():
    return warehouse(3, 8, encoding="compact")


@pytest.fixture(scope="module")
def snapshot(problem):
    return read_problem(problem)


def all_due(jobs, due):
    options = tuple(tuple(replace(o, due=due) for o in some) for some in jobs.options)
    return Jobs(options, jobs.needs)


def slow_to_turn(snapshot):
    """Return what drives take where bounds of the robot that turns on the spot are far too low."""
    slow = snapshot.objects["robot1"].body

    def drives(body, a, b, deadline=None):
        return (4.0 if body == slow else 1.0) * along_the_axes(body, a, b)

    return drives


def judged(assignment, jobs, snapshot, drives, rules):
    """Return by how much an assignment is late (s) if one knows what drives take."""
    evaluator = AssignmentEvaluator(TravelTimeModel(snapshot, drives), jobs, rules)
    return math.fsum(late for _, late in evaluator.ends(assignment.tours).values())


@pytest.mark.parametrize("seed", range(3))
def test_jobs_that_are_due_are_dealt_to_those_that_really_make_them(problem, snapshot, seed):
    drives, rules = slow_to_turn(snapshot), CostWeights(traffic=1.0)
    free = find_jobs(problem, snapshot)
    real = AssignmentEvaluator(TravelTimeModel(snapshot, drives), free, rules)
    made = assign(real, Deadline.never(), random.Random(9), Tuning())
    latest = max(end for end, _ in real.ends(made.tours).values())
    jobs = all_due(free, math.ceil(1.05 * latest))

    def assigned(rounds):
        guess = TravelTimeModel(snapshot, along_the_axes, drives)
        some = AssignmentEvaluator(guess, jobs, rules)
        rng = random.Random(seed)
        return assign(some, Deadline.never(), rng, Tuning(), rounds=rounds)

    misled, honest = assigned(0), assigned(6)
    late = misled.evaluator.ends(misled.tours).values()
    assert all(seconds == 0.0 for _, seconds in late), "it looks good"
    assert judged(misled, jobs, snapshot, drives, rules) > 0.0, "and is not"
    assert judged(honest, jobs, snapshot, drives, rules) == 0.0
    assert len(honest.tours["robot1"]) < len(misled.tours["robot1"])


def test_what_lasts_for_months_and_is_late_by_them_is_shared_out_too(problem, snapshot):
    """Such ends to a high power are beyond all numbers."""
    jobs = all_due(find_jobs(problem, snapshot), 1)
    guess = TravelTimeModel(snapshot, lambda *drive: 1e6 * along_the_axes(*drive))
    evaluator = AssignmentEvaluator(guess, jobs, CostWeights(steep=60.0))
    [one, *_] = evaluator.robots
    ways = ([o.robot for o in some] for some in jobs.options)
    steps = [(j, robots.index(one)) for j, robots in enumerate(ways)]
    alone = Assignment(evaluator, {**dict.fromkeys(evaluator.robots, ()), one: steps})
    shared = exchanged(alone, random.Random(0), Deadline.never())
    assert 1e7 < evaluator.length(shared.tours) < 0.8 * evaluator.length(alone.tours) < math.inf


def test_bounds_that_tell_drives_well_are_believed(snapshot):
    asked = []

    def drives(body, a, b, deadline):
        asked.append((a, b))
        return 1.5 * along_the_axes(body, a, b)

    guess = TravelTimeModel(snapshot, along_the_axes, drives)
    places = sorted(snapshot.configurations.values())
    ways = [("robot0", places[0], b) for b in places[1:15]]
    ways += [("robot0", b, places[0]) for b in places[1:15]]
    guess.ask(ways, Deadline.never())
    assert len(asked) == ENOUGH
    body = snapshot.objects["robot0"].body
    told = guess.ride("robot0", places[3], places[7])
    assert told == math.ceil(1.5 * along_the_axes(body, places[3], places[7]) - 1e-6)
    assert guess.ask([], Deadline.never()) == 0


def test_places_are_taken_in_turns_and_left_for_others(problem, snapshot):
    jobs = find_jobs(problem, snapshot)
    guess = TravelTimeModel(snapshot, along_the_axes, pauses=pauses_of(problem, jobs))
    evaluator = AssignmentEvaluator(guess, jobs)
    # load, carry and unload come after one another, with a unit in between
    assert set(pauses_of(problem, jobs).values()) == {3}
    goals = [options[0].exit for options in jobs.options]
    one, two = next((i, j) for i in range(len(goals)) for j in range(i) if goals[i] == goals[j])
    tours = {"robot0": [(one, 0)], "robot1": [(two, 1)]}
    assert jobs.options[two][1].robot == "robot1"
    ends = {robot: end for robot, (end, _) in evaluator.ends(tours).items()}
    alone = {robot: evaluator.ends({robot: tours[robot]})[robot][0] for robot in tours}
    # who is there first goes home, or who is there last waits for it, or both
    assert sum(ends.values()) > sum(alone.values())
    assert all(ends[r] >= alone[r] for r in tours)
    first = min(alone, key=alone.get)
    step = tours[first][0]
    option = jobs.options[step[0]][step[1]]
    home = guess.ride(first, option.exit, guess.home(option))
    assert ends[first] == alone[first] + home
    assert inserted(Assignment(evaluator, {"robot0": [], "robot1": [], "robot2": []}), one)
