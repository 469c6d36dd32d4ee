"""What each stage of a search took is told in the result."""

import sys

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from up_samp.benchmarks.instances import instance
from up_samp.search.knowledge import STAGES, Stages
from up_samp.system.child import peak_memory


def test_seconds_and_memory_by_stage():
    get_environment().credits_stream = None
    problem = instance("jobshop-r1-j1-m1").build()
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(problem, timeout=60)
    metrics = result.metrics
    seconds = {stage: float(metrics[f"seconds_{stage}"]) for stage in STAGES}
    assert seconds["validating"] > 0.0
    assert sum(seconds.values()) <= float(metrics["seconds_total"]) + 0.01
    assert result.history.to_dict()["stages"]["seconds"].keys() == seconds.keys()
    if sys.platform != "win32":
        peaks = [float(metrics[f"mib_{stage}"]) for stage in STAGES]
        assert peaks[0] > 20.0  # Python itself takes that much
        assert max(peaks) <= peak_memory() + 1.0


def test_turns_of_a_stage_add_up_also_where_they_fail():
    stages = Stages()
    for _ in range(2):
        with pytest.raises(ZeroDivisionError), stages.of("checking"):
            sum(range(200_000)) / 0
    once = stages.seconds["checking"]
    with stages.of("checking"):
        sum(range(200_000))
    assert stages.seconds["checking"] > once > 0.0
    assert stages.cpu["checking"] > 0.0
    assert set(stages.metrics()) >= {"seconds_checking", "cpu_checking"}
