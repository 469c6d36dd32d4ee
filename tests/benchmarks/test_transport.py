"""Transport: items are carried from their pallets from machine to machine and back."""

import pytest
from ortools.sat.python import cp_model
from unified_planning.shortcuts import OneshotPlanner

from up_samp.benchmarks import transport
from up_samp.benchmarks.transport import FT06, WITH_FLUENTS
from up_samp.model import ProblemError
from up_samp.validation import validate_plan


def test_one_item_is_treated_and_brought_back():
    problem = transport(1, 1, 1, door="open")
    with OneshotPlanner(name="samp-refine[cpsat]", params={"optimal": True}) as planner:
        plan = planner.solve(problem, timeout=60).plan
    assert validate_plan(problem, plan).valid
    at = {a.name: plan.get(a.start).constant_value() for a in plan.activities}
    legs = ("load_robot0_i0_{}", "carry_robot0_i0_{}_to_{}", "unload_robot0_i0_{}")
    names = [leg.format(0, "machine0") for leg in legs] + ["treat_i0_m0"]
    names += [leg.format(1, "pallet0") for leg in legs]
    assert sorted(names, key=at.__getitem__) == names


def test_what_robots_carry_is_told_by_fluents():
    for encoding in WITH_FLUENTS:
        problem = transport(2, 1, 2, encoding=encoding)
        assert {"robot0_carries", "robot1_carries", "item0_at"} <= {f.name for f in problem.fluents}
    with pytest.raises(ProblemError, match="encoding"):
        transport(2, 1, 2, encoding="no-fluents")


def test_ft06_is_the_classic():
    model = cp_model.CpModel()
    machines, ends = {}, []
    for route in FT06:
        clock = 0
        for m, duration in route:
            start = model.new_int_var(0, 200, "")
            model.add(start >= clock)
            clock = start + duration
            machines.setdefault(m, []).append(
                model.new_fixed_size_interval_var(start, duration, "")
            )
        ends.append(clock)
    for intervals in machines.values():
        model.add_no_overlap(intervals)
    makespan = model.new_int_var(0, 200, "")
    for end in ends:
        model.add(makespan >= end)
    model.minimize(makespan)
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    assert solver.solve(model) == cp_model.OPTIMAL
    assert solver.objective_value == 55
