"""Fleets whose jobs are assigned open doors, and charge for that, beside what they do."""

import itertools
import random

import numpy as np
import pytest

from tests.usual import usually
from up_samp.fleet import Fleet
from up_samp.geometry.maps import write_map
from up_samp.validation import validate_plan

NARROW = [(12, 5), (14, 5), (14, 9), (12, 9)]
PLACES = {"s0": (6, 2), "s1": (6, 12), "t0": (20, 2), "t1": (20, 12)}
BUTTONS = {"button": (10, 10), "inner": (16, 10)}
JOBS = [("s0", "t0"), ("s1", "t1"), ("t1", "s1"), ("s0", "t1")]


def halls(folder, seed, *, battery, opened_from):
    """Two halls with a gate and a zone for two between, all robots in one, listed in any order."""
    rng, cells = random.Random(seed), np.zeros((140, 260), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    cells[:50, 128:132], cells[90:, 128:132] = True, True
    fleet = Fleet(write_map(folder, "halls", cells, 0.1))
    levels = {"battery": {"capacity": 60, "per_metre": 1.0, "reserve": 3}} if battery else {}
    fleet.add_robot_type("agv", (1.0, 0.7), model="diff", capacity={"item": 2}, **levels)
    charger = {"charger": {"per_second": 2.0, "step": 10}} if battery else {}
    homes = {f"home{i}": (1.5, 1.5 + 2 * i) for i in range(2)}
    plugs = {"plug0": (1.5, 12), "plug1": (24.5, 12)}
    every = [*PLACES.items(), *homes.items(), *plugs.items(), *BUTTONS.items()]
    for name, at in rng.sample(every, len(every)):
        fleet.add_place(name, *at, **(charger if name in plugs else {}))
    for home in rng.sample(sorted(homes), 2):
        fleet.add_robot(f"r_{home}", "agv", home, end=home)
    fleet.add_zone("narrow", NARROW, max_robots=2)
    fleet.add_door("gate", (0.4, 4.0), (13, 7, 0), (13, 11.2, 0), opened_from=opened_from)
    for number, (a, b) in rng.sample(list(enumerate(JOBS)), len(JOBS)):
        fleet.add_order(f"o{number}", a, b)
    return fleet


EACH = list(itertools.product(("button", ["inner", "button"]), (False, True)))


@pytest.mark.parametrize(("opened_from", "battery"), usually(("button", False), of=EACH))
def test_the_first_plan_is_dealt_out(tmp_path, opened_from, battery):
    """The usual search, which finds a plan as well, takes ten times as long: it never begins."""
    fleet = halls(tmp_path, len(opened_from), battery=battery, opened_from=opened_from)
    result = fleet.solve(timeout=300, first_plan=True, tuning={"large": 1})
    assert result.plan is not None, result.explain()
    assert result.outcome.history.rounds == []  # found as it was assigned
    assert validate_plan(fleet.problem, result.plan).valid
    assert any(a["name"].startswith("open_gate") for a in result.data["activities"])
