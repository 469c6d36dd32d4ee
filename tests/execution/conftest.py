"""The hall, the crossing of two robots in it, and who executes that."""

import pytest

from tests.execution import floors
from up_samp.execution import Executor, dependencies_of


@pytest.fixture(scope="module")
def yaml(tmp_path_factory):
    return floors.hall(tmp_path_factory.mktemp("hall"))


@pytest.fixture(scope="module")
def crossed(yaml):
    problem, plan = floors.crossing(yaml)
    return problem, plan, dependencies_of(problem, plan)


@pytest.fixture
def executor(crossed):
    problem, plan, found = crossed
    return Executor(plan, problem, dependencies=found)
