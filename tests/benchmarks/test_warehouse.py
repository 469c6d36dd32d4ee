"""The warehouse family: frozen by its seed, compact, and solved."""

import math

import numpy as np
import pytest
from shapely import box as rectangle
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from up_samp.benchmarks.builders.warehouse import FOOTPRINT, draw_orders, store, warehouse
from up_samp.benchmarks.instances import instance
from up_samp.model import ProblemError
from up_samp.validation import validate_plan


@pytest.mark.parametrize("robots", [1, 5, 12, 50])
def test_everywhere_that_a_robot_stands_is_free_and_its_own(robots):
    plan = store(robots)
    radius = max(math.hypot(x, y) for x, y in FOOTPRINT)
    poses = np.array([*plan.docks, *plan.stations, *plan.slots])
    for x, y, _ in poses:
        here = rectangle(x - 0.45, y - 0.65, x + 0.45, y + 0.65)  # all look along y
        assert not any(rectangle(*wall).intersects(here) for wall in plan.walls)
    gaps = np.hypot(*(poses[:, None, :2] - poses[None, :, :2]).transpose(2, 0, 1))
    assert gaps[~np.eye(len(poses), dtype=bool)].min() > 2 * radius


def test_drawn_once_and_for_all():
    orders = draw_orders(store(5), 10, 0)
    assert orders == draw_orders(store(5), 10, 0)
    assert orders != draw_orders(store(5), 10, 1)
    assert [o.slot for o in orders] == [o.slot for o in draw_orders(store(5), 10, 0)]
    assert sum(o.due is not None for o in orders) == 2
    assert sum(o.optional for o in orders) == 2


def test_sizes_grow_with_robots_times_orders():
    for robots, orders in ((2, 4), (4, 4), (4, 8)):
        problem = warehouse(robots, orders, encoding="compact")
        assert len(problem.activities) == 5 * robots * orders
        assert len(problem.base_constraints) <= 12 * robots * orders + orders
    assert instance("warehouse-compact-r2-o3").build().name == "warehouse-compact-r2-o3"
    with pytest.raises(ProblemError, match="encoding"):
        warehouse(2, 2, encoding="other")
    with pytest.raises(ProblemError, match="robots"):
        warehouse(0, 2)


@pytest.mark.parametrize(
    "name", ["warehouse-r2-o2", pytest.param("warehouse-compact-r2-o2", marks=pytest.mark.long)]
)
def test_small_ones_are_solved(name):
    get_environment().credits_stream = None
    problem = instance(name).build()
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(problem, timeout=120)
    assert result.status in (Status.SOLVED_OPTIMALLY, Status.SOLVED_SATISFICING)
    assert validate_plan(problem, result.plan).violations == ()
