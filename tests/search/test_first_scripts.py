"""Problems in nobody's style are solved to the optimum that one finds by hand."""

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner, PlanValidator

import up_samp  # noqa: F401 - registers the engines
from tests.search.first_scripts import SCRIPTS, Hall
from tests.shuffled import shuffled
from up_samp.model import MotionModel
from up_samp.motion.compile import precompile


@pytest.fixture(scope="module", autouse=True)
def compiled():
    precompile([MotionModel.SE2])


def check(script, engine, folder, *, proven):
    hall = Hall(folder)
    optimum = script(hall)
    with OneshotPlanner(name=f"samp-refine[{engine}]") as planner:
        told = shuffled(hall.problem, script.__name__)
        result = planner.solve(told.problem, timeout=60.0)
    assert result.plan is not None
    with PlanValidator(name="samp-validator") as validator:
        assert validator.validate(hall.problem, told.back(result.plan))
    assert int(result.metrics["lower_bound"]) <= optimum <= int(result.metrics["makespan"])
    if proven:
        assert result.status is Status.SOLVED_OPTIMALLY


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.__name__)
def test_first_scripts(script, tmp_path):
    check(script, "cpsat", tmp_path, proven=True)


@pytest.mark.long
@pytest.mark.parametrize("engine", ["aries", "aries-opt"])
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.__name__)
def test_first_scripts_by_other_engines(script, engine, tmp_path):
    check(script, engine, tmp_path, proven=False)
