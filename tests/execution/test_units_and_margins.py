"""Execution goes on in the units, and with the clearance, that the plan was made with."""

import copy
import json
from importlib.resources import files

import pytest
from jsonschema import Draft7Validator
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401
from tests.execution.legs import carried_out
from up_samp.benchmarks import instance
from up_samp.execution import (
    Delays,
    Executor,
    dependencies_of,
    with_dependencies,
)
from up_samp.execution.simulate import solve_remaining
from up_samp.io import plan_from_dict, plan_to_dict, read_plan, result_to_dict, write_plan
from up_samp.io.files import check_plan
from up_samp.io.precision import PRECISION
from up_samp.model import ProblemError
from up_samp.search.params import Parameters
from up_samp.validation import validate_plan

PARAMS = {"seconds_per_unit": 0.5, "margin": 0.2}


@pytest.fixture(scope="module")
def solved():
    get_environment().credits_stream = None
    problem = instance("logistics-do-oc-r2-i2").build()
    with OneshotPlanner(name="samp-refine[cpsat]", params=PARAMS) as planner:
        return problem, planner.solve(problem, timeout=120)


def test_files_tell_a_margin_that_is_not_the_usual_one(solved, tmp_path):
    problem, result = solved
    data = result_to_dict(problem, result)
    assert (data["margin"], data["minor"]) == (0.2, 6)  # and what its bound rests on
    write_plan(tmp_path / "plan.json", data)
    again = read_plan(tmp_path / "plan.json")
    assert again["margin"] == 0.2
    assert plan_from_dict(problem, again).margin == 0.2
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        usual = planner.solve(problem, timeout=120)
    assert usual.plan.margin == PRECISION.margin == Parameters().margin
    assert "margin" not in result_to_dict(problem, usual)


@pytest.mark.parametrize("wrong", [-0.1, "0.2", None, True, 1e300, [0.2]])
def test_a_margin_of_a_wrong_type_is_refused_by_name(solved, wrong):
    problem, result = solved
    data = {**copy.deepcopy(result_to_dict(problem, result)), "margin": wrong}
    with pytest.raises(ProblemError, match="'margin' cannot be"):
        check_plan(data, "the plan")


def test_dependencies_keep_the_margin_of_their_plan(solved):
    problem, result = solved
    data = result_to_dict(problem, result)
    assert dependencies_of(problem, data).graph.margin == 0.2
    assert dependencies_of(problem, data, margin=0.05).graph.margin == 0.05
    full = with_dependencies(problem, data)
    assert full["minor"] == 6
    assert full["dependencies"]["margin"] == 0.2
    schema = json.loads((files("up_samp.io") / "plan.schema.json").read_text())
    assert list(Draft7Validator(schema).iter_errors(full)) == []
    del data["margin"]
    assert dependencies_of(problem, data).graph.margin == 0.01


def test_an_executor_knows_the_units_of_a_up_plan(solved):
    problem, result = solved
    executor = Executor(result.plan, problem)
    assert executor.plan["seconds_per_unit"] == 0.5
    assert executor.dependencies.graph.margin == 0.2
    with pytest.raises(ProblemError, match=r"made with seconds_per_unit=0\.5, not 1"):
        Executor(result.plan, problem, seconds_per_unit=1.0)


def test_the_rest_is_planned_in_the_units_and_with_the_margin_of_the_plan(solved):
    problem, result = solved
    plans = []

    def solve(left):
        assert left.params == PARAMS
        plans.append((left.problem, solve_remaining(left, seconds=120)))
        return plans[-1][1]

    plan = plan_to_dict(problem, result.plan)
    journey = carried_out(problem, plan, Delays(long_stop=30.0), 3, late=2.0, solve=solve)
    assert len(journey) == 2
    assert journey[1][1].finished
    assert not any(leg.contacts for _, leg in journey)
    for left, data in plans:
        assert (data["seconds_per_unit"], data["margin"]) == (0.5, 0.2)
        assert validate_plan(left, plan_from_dict(left, data), seconds_per_unit=0.5).valid
