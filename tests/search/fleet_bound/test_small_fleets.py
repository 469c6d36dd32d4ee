"""Fleets that are solved as a whole are bounded by all of their jobs, too."""

from unified_planning.shortcuts import OneshotPlanner

from up_samp.benchmarks.builders.warehouse import warehouse


def test_a_small_fleet_is_bounded_by_what_its_jobs_take():
    params = {"first_plan": True, "stop": lambda state: True}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(warehouse(3, 6, encoding="compact"), timeout=300)
    assert int(result.metrics["lower_bound"]) >= 46
