"""A short subset of the benchmark: solved, valid, proven optimal.

``OPTIMA`` are the makespans that full sweeps proved (docs/benchmarks.md); a run that is proven
optimal at another makespan means that plans, bounds or instances changed.
"""

import pytest

from up_samp.benchmarks import report, runner
from up_samp.benchmarks.runner import RunSpec, perform

ENGINE = "samp-refine[cpsat]"

OPTIMA = {
    "logistics-do-all-r2-i2": 37,
    "logistics-dc-oc-r2-i2": 54,
    "jobshop-r1-j1-m1": 19,
    "jobshop-r2-j2-m1": 23,
}
"""Makespan by instance, in the form with fluents."""

MORE = {
    "logistics-do-oc-r3-i3": 41,
    "logistics-dc-all-r1-i2": 74,
    "logistics-do-oc-r1-i8": 350,
    "logistics-do-all-r3-i4": 66,
    "logistics-dc-oc-r2-i3": 84,
    "logistics-do-all-r2-i3": 70,
}
"""The same for the long tests."""


def run(instance, **options):
    return perform(RunSpec(instance, ENGINE, timeout=240, **options))


@pytest.mark.parametrize("instance", OPTIMA)
def test_the_short_subset_is_solved_to_the_known_optimum(instance):
    """The first in a process of its own, as the runner does it."""
    spec = RunSpec(instance, ENGINE, timeout=240)
    own = instance == next(iter(OPTIMA))
    record = runner.execute(spec) if own else perform(spec)
    assert report.proven(record), record
    assert record["makespan"] == record["metrics"]["lower_bound"] == OPTIMA[instance]
    assert record["seconds_cpu"] > 0


def test_a_single_robot_gains_nothing_by_parallel_work():
    record = run("jobshop-r1-j1-m1", optimal=False)
    assert report.solved(record), record
    # open the door, go in, work, one after another: nothing can be parallel
    assert record["sequential"] <= record["makespan"]


@pytest.mark.long
@pytest.mark.parametrize("instance", MORE)
def test_more_instances_are_solved_to_the_known_optimum(instance):
    record = run(instance)
    assert report.proven(record), record
    assert record["makespan"] == MORE[instance]
