"""What robots do beside their jobs, counted in assignments: drives home, breaks, charging."""

import math
import random

import pytest
from unified_planning.shortcuts import IntType

from tests.search.fleet.guesses import along_the_axes
from tests.usual import usually
from up_samp import Fleet
from up_samp.model import Deadline
from up_samp.search.fleet.assignment import assign
from up_samp.search.fleet.duties import duties_of
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.jobs import find_jobs
from up_samp.search.fleet.travel_times import TravelTimeModel
from up_samp.tuning import Tuning
from up_samp.upio import read_problem

HOME, PLUG = (3.0, 3.0, 0.0), (4.0, 13.0, 0.0)
BREAK, FULL, LOW, STEP = 40, 100, 30, 10


def site(seed, jobs=6):
    """Return the problem of a fleet without doors, listed in a random order: r0 has a break, r1 a
    battery that is nearly empty; both have to be home in the end.
    """
    rng = random.Random(seed)
    fleet = Fleet("examples/maps/two_rooms.yaml")
    cells = {"capacity": FULL, "per_metre": 1.0}
    fleet.add_robot_type("amr", (0.8, 0.6), model="omni", battery=cells)
    places = {f"p{i}": (rng.uniform(2, 12), rng.uniform(2, 14)) for i in range(jobs)}
    places |= {"home": HOME[:2], "away": (3, 8), "dock": (11, 8)}
    for name in rng.sample(sorted(places), len(places)):
        fleet.add_place(name, *places[name])
    fleet.add_place("plug", *PLUG[:2], charger={"per_second": 2.0, "step": STEP})
    rest = [{"duration": BREAK, "window": (0, 500)}]
    robots = {"r0": {"breaks": rest, "start": "home"}, "r1": {"level": LOW, "start": "away"}}
    for name in rng.sample(sorted(robots), 2):
        fleet.add_robot(name, "amr", end="home" if name == "r0" else "away", **robots[name])
    for i in rng.sample(range(jobs), jobs):
        fleet.add_order(f"o{i}", f"p{i}", "dock")
    problem = fleet.problem
    rng.shuffle(problem.activities)
    return problem


def evaluator_of(seed):
    """Return a problem's assignment evaluator, which guesses drives along the axes."""
    problem = site(seed)
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    duties = duties_of(problem, snapshot, jobs)
    return AssignmentEvaluator(TravelTimeModel(snapshot, along_the_axes, duties=duties), jobs)


@pytest.mark.parametrize("seed", usually(0, of=range(3)))
def test_duties_are_read_however_they_are_listed(seed):
    duties = evaluator_of(seed).guess.duties
    assert duties.ends == {"r0": HOME, "r1": (3.0, 8.0, 0.0)}
    assert duties.rests == {"r0": BREAK, "r1": 0.0}
    grains = duties.batteries["r0"].full / FULL
    assert duties.batteries["r1"].first == pytest.approx(LOW * grains)
    assert duties.batteries["r0"].first == duties.batteries["r0"].full
    for battery in duties.batteries.values():
        assert battery.given == {PLUG: 2.0 * grains}
    assert duties.taken
    for (_, full, a, b), taken in duties.taken.items():
        assert full == duties.batteries["r0"].full
        assert taken >= math.floor(grains * math.dist(a[:2], b[:2]))


def by_hand(evaluator, robot, tour):
    """Return when a robot alone has done a tour and all else that it has to do (s), and how often
    it charges.
    """
    guess, duties = evaluator.guess, evaluator.guess.duties
    battery, here = (
        duties.batteries[robot],
        guess.snapshot.configurations[guess.snapshot.initial[robot]],
    )
    kind = guess.snapshot.objects[robot].body, battery.full
    seconds, taken, nearest = duties.rests.get(robot, 0.0), 0.0, math.inf
    trips = 0
    stops = [(o.entry, o) for o in (evaluator.jobs.options[j][k] for j, k in tour)]
    for there, option in [*stops, (duties.ends[robot], None)]:
        direct = guess.ride(robot, here, there)
        seconds += direct
        taken += duties.taken.get((*kind, here, there), 0.0)
        by_way = guess.ride(robot, here, PLUG) + guess.ride(robot, PLUG, there) - direct
        nearest, here = min(nearest, by_way), there
        if option is not None:
            seconds += option.work + sum(guess.ride(robot, *leg) for leg in option.legs)
            taken += sum(duties.taken[(*kind, *leg)] for leg in option.legs)
            here = option.exit
        if taken > battery.first + trips * battery.full:
            seconds, nearest, trips = seconds + nearest, math.inf, trips + 1
    return seconds + max(0.0, taken - battery.first) / battery.given[PLUG], trips


@pytest.mark.parametrize("seed", usually(2, of=range(3)))
def test_what_a_tour_takes_counts_the_way_home_breaks_and_charging(seed):
    evaluator, rng = evaluator_of(seed), random.Random(seed)
    for _ in range(10):
        robot = rng.choice(evaluator.robots)
        some = rng.sample(range(len(evaluator.jobs.options)), rng.randint(0, 4))
        mine = [[o.robot for o in evaluator.jobs.options[j]].index(robot) for j in some]
        tour = list(zip(some, mine, strict=True))
        told, _ = evaluator.ends({robot: tour})[robot]
        seconds, trips = by_hand(evaluator, robot, tour)
        assert told == pytest.approx(seconds)
        assert evaluator.charging({robot: tour}) == ({(robot, PLUG)} if trips else set())


def test_who_rests_gets_less_to_do():
    evaluator = evaluator_of(1)
    assignment = assign(evaluator, Deadline.never(), random.Random(0), Tuning(), rounds=0)
    ends = evaluator.ends(assignment.tours)
    free = AssignmentEvaluator(
        TravelTimeModel(evaluator.guess.snapshot, along_the_axes), evaluator.jobs
    )
    unaware = assign(free, Deadline.never(), random.Random(0), Tuning(), rounds=0)
    honest = evaluator.ends(unaware.tours)
    assert max(end for end, _ in ends.values()) < max(end for end, _ in honest.values())


def test_what_drives_count_without_a_limit_is_no_battery():
    problem = site(0)
    metres = problem.add_fluent("r0_metres_left", default_initial_value=0, typename=IntType())
    for activity in problem.activities:
        if activity.name.startswith("move_r0"):
            activity.add_decrease_effect(activity.end, metres(), 7)
    snapshot = read_problem(problem)
    duties = duties_of(problem, snapshot, find_jobs(problem, snapshot))
    assert {robot: battery.given for robot, battery in duties.batteries.items()} == {
        robot: battery.given for robot, battery in evaluator_of(0).guess.duties.batteries.items()
    }
