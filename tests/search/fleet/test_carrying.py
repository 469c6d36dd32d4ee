"""Robots that carry several loads at once are told from those that bring each before the next."""

import itertools
import random
from pathlib import Path

import pytest

from tests.search.fleet.guesses import along_the_axes
from up_samp.fleet import Fleet
from up_samp.search.fleet.duties import duties_of, loads_of
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.jobs import find_jobs
from up_samp.search.fleet.travel_times import TravelTimeModel
from up_samp.upio import read_problem

MAP = Path(__file__).parents[3] / "examples" / "maps" / "two_rooms.yaml"


def shuffled(rng, *items):
    return rng.sample(items, len(items))


def fleet(load=None, **options):
    found = Fleet(MAP)
    found.add_robot_type("agv", (0.8, 0.5), v_max=1.5, a_max=0.5, **options)
    rng = random.Random(f"{load} {options}")
    for place, x, y in shuffled(
        rng, ("a", 3, 3), ("b", 8, 3), ("c", 3, 6), ("h0", 5, 2), ("h1", 5, 5)
    ):
        found.add_place(place, x, y)
    for robot in shuffled(rng, "r0", "r1"):
        found.add_robot(robot, "agv", f"h{robot[1]}", end=f"h{robot[1]}")
    for order, (pickup, delivery) in shuffled(
        rng, *enumerate(("ab", "bc", "ca", "ac", "ba", "cb"))
    ):
        more = {} if load is None else {"load": load[order % len(load)]}
        found.add_order(f"o{order}", pickup=pickup, delivery=delivery, **more)
    return found


@pytest.mark.parametrize(
    ("load", "options", "many"),
    [
        (None, {}, 1),
        (None, {"capacity": {"item": 1}}, 1),
        (None, {"capacity": {"item": 2}}, 2),
        ([{"item": 2}], {"capacity": {"item": 3}}, 1),
        ([{"item": 2}], {"capacity": {"item": 4}}, 2),
        ([{"item": 1}], {"capacity": {"item": 3}}, 3),
        ([{"item": 1}], {"capacity": {"item": 5}}, 3),
        ([{"box": 1}, {"bin": 1}], {"capacity": {"box": 1, "bin": 1}}, 2),
    ],
    ids=[
        "one",
        "room for one",
        "two",
        "two of three",
        "two of four",
        "three",
        "many",
        "one of each",
    ],
)
def test_who_carries_several_loads_at_once(load, options, many):
    problem = fleet(load, **options).problem
    jobs = find_jobs(problem, read_problem(problem, 1.0))
    assert loads_of(problem, jobs) == (dict.fromkeys(("r0", "r1"), many) if many > 1 else {})


def evaluator_of(many, seed):
    """Return a drawn fleet's assignment evaluator, which guesses drives along the axes."""
    rng = random.Random(seed)
    drawn = Fleet(MAP)
    drawn.add_robot_type("agv", (0.8, 0.5), model="omni", capacity={"item": many})
    for k in rng.sample(range(6), 6):
        drawn.add_place(f"p{k}", 2 + 1.5 * k, rng.uniform(2, 6))
    for robot in shuffled(rng, "r0", "r1"):
        drawn.add_robot(robot, "agv", f"p{robot[1]}")
    for k in rng.sample(range(4), 4):
        pickup, delivery = rng.sample(range(1, 6), 2)
        drawn.add_order(f"o{k}", pickup=f"p{pickup}", delivery=f"p{delivery}")
    problem = drawn.problem
    snapshot = read_problem(problem)
    jobs = find_jobs(problem, snapshot)
    duties = duties_of(problem, snapshot, jobs)
    return AssignmentEvaluator(TravelTimeModel(snapshot, along_the_axes, duties=duties), jobs)


def orders_of_stops(tour, many):
    """Yield all orders in which one may come by the stops of some jobs, ``many`` under way."""
    todo = [((), frozenset(tour), ())]
    while todo:
        before, left, aboard = todo.pop()
        if not left and not aboard:
            yield before
        for job in left if len(aboard) < many else ():
            todo.append(((*before, (job, 0)), left - {job}, (*aboard, job)))
        for job in aboard:
            rest = tuple(other for other in aboard if other != job)
            todo.append(((*before, (job, 1)), left, rest))


def end_of(evaluator, jobs):
    """Return when r0 has done some jobs, as the evaluator tells it (s)."""
    mine = [[o.robot for o in some].index("r0") for some in evaluator.jobs.options]
    return evaluator.ends({"r0": [(j, mine[j]) for j in jobs]})["r0"][0]


def lasts(evaluator, order):
    """Return when a robot has come by all stops and done what is done there (s)."""
    guess = evaluator.guess
    options = [[o for o in some if o.robot == "r0"] for some in evaluator.jobs.options]
    here = guess.snapshot.configurations[guess.snapshot.initial["r0"]]
    seconds = sum(options[j][0].work for j, stop in order if stop == 0)
    for j, stop in order:
        there = (options[j][0].entry, options[j][0].exit)[stop]
        seconds += guess.ride("r0", here, there)
        here = there
    return seconds


@pytest.mark.parametrize("seed", range(4))
def test_two_jobs_that_are_done_together_take_what_their_stops_take(seed):
    apart, together = evaluator_of(1, seed), evaluator_of(2, seed)
    sooner = 0
    for one, other in itertools.permutations(range(4), 2):
        in_turn = lasts(apart, [(one, 0), (one, 1), (other, 0), (other, 1)])
        mixed = lasts(apart, [(one, 0), (other, 0), (one, 1), (other, 1)])
        assert end_of(apart, [one, other]) == pytest.approx(in_turn)
        assert end_of(together, [one, other]) == pytest.approx(min(in_turn, mixed))
        sooner += mixed < in_turn
    assert sooner


@pytest.mark.parametrize("seed", range(4))
def test_tours_that_are_guessed_can_be_done(seed):
    evaluator = evaluator_of(2, seed)
    jobs = random.Random(seed).sample(range(4), 4)
    told = end_of(evaluator, jobs)
    possible = [lasts(evaluator, order) for order in orders_of_stops(jobs, 2)]
    assert min(possible) <= told + 1e-6
    assert any(value == pytest.approx(told) for value in possible)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_dealt_out_loads_are_carried_together(seed):
    """Orders from one end of the floor to the other one: a robot brings two at a time."""
    ends = []
    for many in (1, 2):
        found = Fleet(MAP)
        found.add_robot_type("agv", (0.8, 0.5), v_max=1.5, a_max=0.5, capacity={"item": many})
        rng = random.Random(seed)
        for k, name in shuffled(rng, *enumerate(("from0", "from1", "to0", "to1", "h0", "h1"))):
            found.add_place(name, (3, 3, 10, 10, 6, 6)[k], (3, 5)[k % 2])
        for robot in shuffled(rng, "r0", "r1"):
            found.add_robot(robot, "agv", f"h{robot[1]}", end=f"h{robot[1]}")
        for order in shuffled(rng, *range(4)):
            found.add_order(f"o{order}", pickup=f"from{order % 2}", delivery=f"to{order % 2}")
        result = found.solve(timeout=60, first_plan=True, tuning={"large": 1})
        ends.append(result.makespan)
    assert ends[1] <= 0.75 * ends[0]
