"""What is left of a plan at any moment has a plan: while loads are taken up, carried, put down by
one robot, by two at once, or by two in formation.
"""

import math
import random

import numpy as np
import pytest
from unified_planning.shortcuts import OneshotPlanner

from tests.shuffled import shuffled_fleet
from up_samp.execution import with_dependencies
from up_samp.execution.simulate import ENGINE, remaining_at
from up_samp.fleet import Fleet
from up_samp.fleet.build import write_problem
from up_samp.geometry.maps import write_map
from up_samp.io import result_to_dict
from up_samp.validation import validate_plan

OMNI = {"footprint": (0.8, 0.6), "model": "omni", "v_max": 1.0, "a_max": 0.6}
BEAM = {"footprint": (3.0, 0.4), "offset": [1.0, 0.0, 0.0], "carriers": [[2.0, 0.0, math.pi]]}
LOADS = {
    "none": [{}, {}],
    "together": [{}, {"together": "o0"}],
    "pallets": [{"attached": {"footprint": (1.2, 1.0)}}] * 2,
    "beam": [{"attached": BEAM}, {}],
}


def site(folder, kind):
    """Two robots and two orders in a hall."""
    cells = np.zeros((100, 180), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    fleet = Fleet(write_map(folder, "hall", cells, 0.1), name=kind, margin=0.05)
    fleet.add_robot_type("agv", **OMNI)
    for k in range(2):
        for name, x in (("home", 2), ("rack", 5), ("dock", 13)):
            fleet.add_place(f"{name}{k}", x, 2 + 4 * k)
        fleet.add_robot(f"r{k}", "agv", f"home{k}", end=f"home{k}")
    for k, told in enumerate(LOADS[kind]):
        stops = ({"at": f"{place}{k}", "service": 5} for place in ("rack", "dock"))
        fleet.add_order(f"o{k}", *stops, **told)
    return fleet


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Return the problem of a kind of loads, in some listing, and a plan of it."""
    known = {}

    def of(kind):
        if kind not in known:
            folder = tmp_path_factory.mktemp(kind)
            records = shuffled_fleet(site(folder, kind).records, kind, rename=False).records
            problem = write_problem(records, folder).problem
            with OneshotPlanner(name=ENGINE, params={"first_plan": True}) as planner:
                result = planner.solve(problem, timeout=60)
            known[kind] = problem, with_dependencies(problem, result_to_dict(problem, result))
        return known[kind]

    return of


def moments(plan, kind):
    """Return a moment (s) within each activity of a plan."""
    rng = random.Random(kind)
    spans = [(a["start"], a["end"]) for a in plan["activities"]]
    return sorted({round(start + rng.uniform(0.1, 0.8) * (end - start), 2) for start, end in spans})


CASES = [
    pytest.param(kind, part, marks=[] if part == 1 and kind != "none" else pytest.mark.long)
    for kind in LOADS
    for part in range(3)
]


@pytest.mark.parametrize(("kind", "part"), CASES)
def test_what_is_left_has_a_plan(kind, part, planned):
    problem, plan = planned(kind)
    some = moments(plan, kind)[part::3]
    assert len(some) > 1
    for moment in some:
        left = remaining_at(problem, plan, moment)
        with OneshotPlanner(name=ENGINE, params={"first_plan": True, **left.params}) as planner:
            result = planner.solve(left.problem, timeout=30, warm_start_plan=left.hint)
        assert result.plan is not None, (kind, moment, result.status, result.log_messages)
        assert validate_plan(left.problem, result.plan).valid
