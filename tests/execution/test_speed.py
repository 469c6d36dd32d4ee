"""Updates are quick enough for large fleets (CPU time, so that other work on the machine does not
count)."""

import importlib.util
import statistics
from pathlib import Path

import pytest

from up_samp.execution import Executor

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "execution" / "made_up.py"


@pytest.fixture(scope="module")
def made_up():
    spec = importlib.util.spec_from_file_location("made_up_plans", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("robots", "tasks", "limit"), [(10, 200, 0.005), (50, 1000, 0.05)])
def test_updates_and_commands_are_quick(made_up, robots, tasks, limit):
    executor = Executor({}, dependencies=made_up.fleet(robots, tasks))
    spent = made_up.drive_all(executor, 25.0, forecasts=False)
    assert statistics.median(spent["update"]) < limit
    assert statistics.median(spent["commands"]) < limit
    assert len(spent["update"]) > 10 * robots
