"""Whole solves on a clock that jumps: less is proven then, and nothing that is not so; what such a
solve leaves in the cache misleads no other.
"""

import random
import time
from types import SimpleNamespace

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.shortcuts import OneshotPlanner

from tests.fuzz.problems import SECONDS, build
from tests.fuzz.small import small_case
from tests.oracles.clocks import JumpingClock
from up_samp.model import deadline
from up_samp.motion import MotionCache

pytestmark = pytest.mark.usefixtures("on_the_clock")

JUMPS = (0.1, 0.5, 1.0, 2.0)


def solved(case, folder, timeout, **params):
    with OneshotPlanner(
        name="samp-refine[cpsat]",
        params={"seconds_per_unit": SECONDS, "query_seconds": 1.0, **params},
        optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY,
    ) as planner:
        return planner.solve(build(case, folder), timeout=timeout)


def false_claims(seed, folder, monkeypatch, every):
    """Return what is claimed on a jumping clock, or with what it has left in the cache, that a
    solve without cache on a good clock refutes; None where that one proves nothing.
    """
    case, cache = small_case(seed), MotionCache()
    honest = solved(case, folder, 20.0)
    if honest.status not in (Status.SOLVED_OPTIMALLY, Status.UNSOLVABLE_PROVEN):
        return None
    clock = JumpingClock(random.Random(seed), every, JUMPS, time.monotonic)
    with monkeypatch.context() as patch:
        patch.setattr(deadline, "time", SimpleNamespace(monotonic=clock.monotonic))
        hurried = solved(case, folder, 20.0, cache=cache)
    after = solved(case, folder, 20.0, cache=cache)
    best = int(honest.metrics["makespan"]) if honest.plan else None
    wrong = []
    for name, result in (("hurried", hurried), ("after", after)):
        bound = int((result.metrics or {}).get("lower_bound") or 0)
        if best is not None and (result.status is Status.UNSOLVABLE_PROVEN or bound > best):
            wrong.append(f"{name}: {result.status.name} {bound}, and {best} is possible")
        if best is None and result.plan is not None:
            wrong.append(f"{name}: a plan of what is unsolvable")
        if result.status is Status.INTERNAL_ERROR:
            wrong.append(f"{name}: {[m.message for m in result.log_messages]}")
    return wrong


@pytest.mark.parametrize("seed", [2, 5])
def test_a_jumping_clock_proves_nothing_false(seed, tmp_path, monkeypatch):
    assert false_claims(seed, tmp_path, monkeypatch, 100) == []


@pytest.mark.long
@pytest.mark.parametrize("every", [30, 300, 3000])
def test_many_solves_on_jumping_clocks(every, tmp_path, monkeypatch):
    claims = {}
    for seed in range(300, 340):
        (tmp_path / str(seed)).mkdir()
        claims[seed] = false_claims(seed, tmp_path / str(seed), monkeypatch, every)
    assert sum(claim is not None for claim in claims.values()) >= 20
    assert {seed: claim for seed, claim in claims.items() if claim} == {}
