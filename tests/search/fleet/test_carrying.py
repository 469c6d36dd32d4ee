"""Robots that carry several loads at once are told from those that bring each before the next."""

import random
from pathlib import Path

import pytest

from up_samp.fleet import Fleet
from up_samp.search.fleet.duties import carry_several
from up_samp.search.fleet.jobs import find_jobs
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
    for order, (pickup, delivery) in shuffled(rng, *enumerate(("ab", "bc", "ca", "ac"))):
        more = {} if load is None else {"load": load[order % len(load)]}
        found.add_order(f"o{order}", pickup=pickup, delivery=delivery, **more)
    return found


@pytest.mark.parametrize(
    ("load", "options", "several"),
    [
        (None, {}, False),
        (None, {"capacity": {"item": 1}}, False),
        (None, {"capacity": {"item": 2}}, True),
        ([{"item": 2}], {"capacity": {"item": 3}}, False),
        ([{"item": 2}], {"capacity": {"item": 4}}, True),
        ([{"box": 1}, {"bin": 1}], {"capacity": {"box": 1, "bin": 1}}, True),
    ],
    ids=["one", "room for one", "two", "two of three", "two of four", "one of each"],
)
def test_who_carries_several_loads_at_once(load, options, several):
    problem = fleet(load, **options).problem
    jobs = find_jobs(problem, read_problem(problem, 1.0))
    assert carry_several(problem, jobs) == several
