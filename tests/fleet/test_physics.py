"""What a fleet problem allows is what happens on the floor, and what can be done is not ruled out.

Random small fleets around a plan that is made first (``witness``), and their plans before a judge
who knows nothing of Unified Planning (``physics``).
"""

import copy
import functools
from types import SimpleNamespace

import pytest
from shapely.geometry import Polygon

from tests.fleet.physics import Physics
from tests.fleet.witness import NoWitnessError, fleet_of
from tests.shuffled import shuffled_fleet
from up_samp.fleet.batteries import tell_levels
from up_samp.fleet.build import write_problem
from up_samp.fleet.files import read_record
from up_samp.fleet.fleet import solve_problem
from up_samp.fleet.records import FleetRecords
from up_samp.validation import validate_plan


def told(seed, folder, timeout=20.0):
    """Return what is wrong with the answer to a random fleet; None where there is no such fleet."""
    try:
        made = fleet_of(seed, folder)
    except NoWitnessError:
        return None
    records = read_record(FleetRecords, {k: v for k, v in made.spec.items() if k != "walls"})
    records = shuffled_fleet(records, seed, rename=False).records
    written, unit = write_problem(records, folder), records.seconds_per_unit
    params = {"seconds_per_unit": unit, ("optimal" if seed % 3 == 0 else "first_plan"): True}
    fleet = SimpleNamespace(check=list, tell=lambda plan: tell_levels(records, written, plan))
    result = solve_problem(written, timeout, params, fleet)
    bound = float((result.outcome.metrics or {}).get("lower_bound") or 0) * unit
    found = [f"a bound of {bound} s, beaten by {made.makespan} s"] * (bound > made.makespan + 1e-6)
    if result.plan is None:
        return found + [result.status] * ("UNSOLVABLE" in result.status)
    verdict = validate_plan(result.problem, result.plan, seconds_per_unit=unit)
    physics = Physics(made.spec, result.data)
    return [*found, *map(str, verdict.violations), *physics.faults, *untold(physics, result)]


def untold(physics, result):
    """Return which batteries fall lower, by what is really driven, than ``explain`` tells."""
    text = result.explain()
    for robot in physics.spec["robots"]:
        battery = physics.kind(robot).get("battery")
        if battery is None:
            continue
        line = next(x for x in text.splitlines() if f"the battery of {robot} falls to" in x)
        least, reserve = min(physics.levels(robot)), battery.get("reserve", 0)
        near = 0.01 * battery["capacity"]
        if abs(float(line.split("falls to ")[1].split()[0]) - least) > near:
            yield f"{robot} has {least:.3f} at its lowest, and is told to have: {line}"
        if least < reserve - near and "by detours among the others" not in line:
            yield f"{robot} falls below its reserve of {reserve}, which is not told: {line}"


@pytest.mark.parametrize(
    "seed", [8, *(pytest.param(s, marks=pytest.mark.long) for s in (3, 4, 22))]
)
def test_plans_hold_on_the_floor_and_proofs_against_a_witness(seed, tmp_path):
    assert told(seed, tmp_path) == []


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 500, 50))
def test_many_plans_hold_on_the_floor(first, tmp_path):
    findings = {seed: told(seed, tmp_path) for seed in range(first, first + 50)}
    assert sum(found is not None for found in findings.values()) >= 30
    assert {seed: found for seed, found in findings.items() if found} == {}


def crossed(plan, spec):
    plan["motions"][0]["samples"][3][1] += 3.0


def unloaded(plan, spec):
    plan["activities"] = [a for a in plan["activities"] if not a["name"].startswith("deliver_")]


def early(plan, spec):
    spec["orders"][0]["pickup"]["window"] = [1e6, 2e6]


def small(plan, spec):
    spec["robot_types"]["agv"]["battery"]["level"] = 0.5


def crowded(plan, spec):
    spec["zones"]["busy"] = {"polygon": [[0, 0], [16, 0], [16, 9], [0, 9]], "max_robots": 0}


def walled(plan, spec):
    spec["walls"] = [Polygon([(0, 0), (16, 0), (16, 9), (0, 9)])]


def busy(plan, spec):
    spec["resources"]["table"] = {"capacity": 0}
    spec["orders"][0]["delivery"]["resources"] = ["table"]


def unskilled(plan, spec):
    spec["orders"][0]["skills"] = ["fly"]


def full(plan, spec):
    spec["orders"][0]["load"] = {"item": 9}


@pytest.mark.parametrize(
    "harm", [crossed, unloaded, early, small, crowded, walled, busy, unskilled, full]
)
def test_the_judge_sees_what_is_wrong(harm, tmp_path_factory):
    spec, plan = copy.deepcopy(good(tmp_path_factory.getbasetemp()))
    assert Physics(spec, plan).faults == []
    harm(plan, spec)
    assert Physics(spec, plan).faults


@functools.cache
def good(folder):
    made = fleet_of(4, folder)
    records = read_record(FleetRecords, {k: v for k, v in made.spec.items() if k != "walls"})
    unit = records.seconds_per_unit
    written = write_problem(records, folder)
    return made.spec, solve_problem(written, 20.0, {"seconds_per_unit": unit}).data
