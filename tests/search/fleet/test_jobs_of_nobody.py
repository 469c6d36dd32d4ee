"""Large problems with a job that nobody can do: that is proven, and said by the place's name."""

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from tests.search.fleet.test_drives_home import site


def solved(problem):
    assert sum(a.optional for a in problem.activities) >= 100, "it is large"
    with OneshotPlanner(name="samp-refine[cpsat]", params={"seed": 0}) as planner:
        return planner.solve(problem, timeout=120)


@pytest.mark.usefixtures("unexplained")
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_a_place_in_a_wall_is_named(seed):
    result = solved(site(seed, odd=(0.1, 8.0)))
    assert result.status is Status.UNSOLVABLE_PROVEN
    told = " ".join(message.message for message in result.log_messages)
    assert "'odd'" in told
    assert "'p0'" not in told


def test_the_same_elsewhere_is_dealt_out():
    result = solved(site(0, odd=(8.0, 8.0)))
    assert result.status is Status.SOLVED_SATISFICING
    assert result.metrics["rounds"] == "0"
