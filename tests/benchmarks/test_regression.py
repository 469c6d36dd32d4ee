"""A short subset of the benchmark: solved, valid, proven optimal.

``OPTIMA`` are the makespans that full sweeps proved (docs/benchmarks.md); a run that is proven
optimal at another makespan means that plans, bounds or instances changed.
"""

import pytest

from up_samp.benchmarks import report, runner
from up_samp.benchmarks.one_run import RunSpec, perform

ENGINE = "samp-refine[cpsat]"

OPTIMA = {
    "logistics-do-oc-r3-i3": 75,
    "logistics-dc-oc-r2-i2": 83,
    "jobshop-r1-j1-m1": 24,
    "jobshop-r2-j2-m1": 27,
}
"""Makespan by instance; both lean encodings mean the same problem."""

MORE = {
    "logistics-do-all-r2-i2": 57,
    "logistics-dc-all-r1-i2": 115,
    "logistics-do-oc-r1-i8": 615,
    "logistics-do-all-r3-i4": 97,
    "logistics-dc-oc-r2-i3": 133,
    "logistics-do-all-r2-i3": 105,
}
"""The same for the long tests."""


def run(instance, encoding="lean", **options):
    return perform(RunSpec(instance, ENGINE, encoding, timeout=240, **options))


@pytest.mark.parametrize("instance", OPTIMA)
def test_the_short_subset_is_solved_to_the_known_optimum(instance):
    record = run(instance)
    assert report.proven(record), record
    assert record["makespan"] == record["metrics"]["lower_bound"] == OPTIMA[instance]


def test_a_published_instance_is_solved_to_the_known_optimum():
    """In a process of its own, as the runner does it."""
    spec = RunSpec("logistics-do-oc-r3-i3", ENGINE, "fluents", timeout=240)
    record = runner.execute(spec.to_dict())
    assert report.proven(record), record
    assert record["makespan"] == 41
    assert record["seconds_cpu"] > 0


def test_a_single_robot_gains_nothing_by_parallel_work():
    record = run("jobshop-r1-j1-m1", optimal=False)
    assert report.solved(record), record
    # open the door, go in, work, one after another: nothing can be parallel
    assert record["sequential"] <= record["makespan"]


@pytest.mark.long
@pytest.mark.parametrize("instance", [*OPTIMA, *MORE])
def test_lean_instances_are_solved_to_the_known_optimum(instance):
    record = run(instance, encoding="lean")
    assert report.proven(record), record
    assert record["makespan"] == {**OPTIMA, **MORE}[instance]
    assert run(instance, encoding="lean", optimal=False)["valid"]
