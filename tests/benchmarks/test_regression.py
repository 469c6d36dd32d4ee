"""A short subset of the benchmark, through the runner: solved, valid, proven optimal."""

import pytest

from up_samp.benchmarks import report, runner
from up_samp.benchmarks.runs import RunSpec

ENGINE = "samp-refine[cpsat]"


def run(instance, **options):
    return runner.execute(RunSpec(instance, ENGINE, timeout=240, **options).to_dict())


@pytest.mark.long
def test_a_run_is_recorded_whole():
    record = run("jobshop-r1-j1-m1")
    assert report.proven(record), record
    assert record["makespan"] == record["metrics"]["lower_bound"]
    # open the door, go in, work, one after another: nothing can be parallel
    assert record["sequential"] <= record["makespan"]


@pytest.mark.long
@pytest.mark.parametrize(
    "instance",
    [
        "logistics-do-oc-r1-i2",
        "logistics-dc-oc-r2-i2",
        "logistics-do-all-r2-i3",
        "logistics-dc-all-r2-i4",
        "jobshop-r2-j2-m2",
    ],
)
@pytest.mark.parametrize("encoding", ["fluents", "no-fluents"])
def test_small_instances_are_solved_to_optimality(instance, encoding):
    record = run(instance, encoding=encoding)
    assert report.proven(record), record
    assert run(instance, encoding=encoding, optimal=False)["valid"]
