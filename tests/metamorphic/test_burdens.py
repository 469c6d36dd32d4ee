"""A plan under more burdens refutes what is claimed under fewer."""

import math
import random

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status

from tests.metamorphic.burdens import Burdened
from up_samp.search.params import IDEAS
from up_samp.validation import validate_plan


def other_way(rng):
    """Return parameters of another search: the same problem must come out of it."""
    if rng.random() < 0.2:
        return {"engine": "aries"}
    some = rng.sample(sorted(IDEAS.keys() - {"refine"}), rng.choice([0, 1, 1, 3]))
    return {"without": tuple(some), "seed": rng.randrange(1000)}


def claims_and_plans(fleet, timeout, params):
    """Solve a fleet in two ways; yield what is claimed (unsolvable, or an absolute bound), and the
    makespan of a plan.
    """
    for asked in ({"optimal": True}, params):
        result = fleet.solve(timeout, query_seconds=1.0, **asked)
        assert result.outcome.status is not Status.INTERNAL_ERROR, result.explain()
        told = result.outcome.metrics
        bound = told["lower_bound"] if told["bound_kind"] == "absolute" else "0"
        bound = float(told.get("absolute_bound", bound))
        unit, makespan = float(told["seconds_per_unit"]), None
        if result.plan is not None:
            assert validate_plan(result.problem, result.plan, seconds_per_unit=unit).valid
            makespan = int(told["makespan"])
        unsolvable = result.outcome.status is Status.UNSOLVABLE_PROVEN
        yield math.inf if unsolvable else bound, makespan


def refuted(seed, folder, timeout):
    """Return the claims under few burdens that plans under more refute, and how many plans."""
    rng, case = random.Random(f"refuted {seed}"), Burdened(seed, folder)
    some = [burden for burden in case.burdens if rng.random() < 0.5]
    found, claims, makespans = [], [], []
    for burdens in ([], some, case.burdens)[rng.choice([0, 1]) :]:
        solved = [*claims_and_plans(case.fleet(burdens), timeout, other_way(rng))]
        claims += [claim for claim, _ in solved]
        makespans += [makespan for _, makespan in solved if makespan is not None]
        least = min((m for _, m in solved if m is not None), default=None)
        found += [(claim, least) for claim in claims if least is not None and claim > least]
    return found, len(makespans)


def test_plans_under_burdens_refute_nothing(tmp_path):
    assert refuted(3, tmp_path, 1.5)[0] == []


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 200, 10))
def test_plans_under_many_burdens_refute_nothing(first, tmp_path):
    rows = {seed: refuted(seed, tmp_path, 6.0) for seed in range(first, first + 10)}
    assert {seed: found for seed, (found, _) in rows.items() if found} == {}
    assert sum(plans for _, plans in rows.values()) > 20
