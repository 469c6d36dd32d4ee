"""Updates are quick enough for large fleets (CPU time, so that other work on the machine does not
count)."""

import importlib.util
import statistics
from pathlib import Path

import pytest

from up_samp.execution import Executor

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "execution" / "measure.py"


@pytest.fixture(scope="module")
def measure():
    spec = importlib.util.spec_from_file_location("execution_measure", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("robots", "tasks", "limit"), [(10, 200, 0.005), (50, 1000, 0.05)])
def test_updates_and_commands_are_quick(measure, robots, tasks, limit):
    executor = Executor({}, dependencies=measure.fleet(robots, tasks))
    spent = measure.drive_all(executor, 25.0, forecasts=False)
    assert statistics.median(spent["update"]) < limit
    assert statistics.median(spent["commands"]) < limit
    assert len(spent["update"]) > 10 * robots
