"""No proof rules out who waits or stays where a leaf lies, or who shuts a door behind itself."""

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status

from tests.soundness.leaves import behind, halts
from tests.soundness.test_gates import BLIND, admits, ends_of, proven_bound, solve
from tests.usual import usually
from up_samp.model.refinement import Strength

SORTS = {"halts": halts, "behind": behind}


def wrong(problem):
    """Return what is claimed of a problem that a plan of it refutes, and whether there is one."""
    told = solve(problem, 10.0, optimal=True)
    plan = solve(problem, 10.0, without=BLIND, first_plan=True).plan
    found = []
    if plan is not None:
        makespan = max(end for _, end in ends_of(plan)[0].values())
        if told.status is Status.UNSOLVABLE_PROVEN or proven_bound(told) > makespan:
            found.append(f"{told.status.name} {proven_bound(told)}, and {makespan}")
        proven = [r for r in told.history.refinements if r.strength is Strength.PROVEN]
        if not admits(problem, plan, proven):
            broken = [str(r) for r in proven if not admits(problem, plan, [r])]
            found.append(f"{ends_of(plan)[0]} breaks {broken}")
    return found, plan is not None


CASES = [("halts", 1), ("halts", 3), ("halts", 9), ("behind", 3), ("behind", 8), ("behind", 17)]


@pytest.mark.parametrize(("sort", "seed"), usually(("halts", 3), ("behind", 17), of=CASES))
def test_a_plan_refutes_nothing_of_robots_and_a_leaf(sort, seed, tmp_path):
    assert wrong(SORTS[sort](seed, tmp_path)) == ([], True)


@pytest.mark.long
@pytest.mark.parametrize("sort", SORTS)
@pytest.mark.parametrize("first", range(100, 300, 20))
def test_plans_refute_nothing_of_many_robots_and_leaves(sort, first, tmp_path):
    found = {s: wrong(SORTS[sort](s, tmp_path)) for s in range(first, first + 20)}
    assert {seed: row for seed, (row, _) in found.items() if row} == {}
    assert sum(known for _, known in found.values()) > 5
