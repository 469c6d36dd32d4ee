"""First plans of large problems do not hang on how quick a machine is: they go by counted work."""

import random
import time
from types import SimpleNamespace

import pytest
from unified_planning.shortcuts import AnytimePlanner, OneshotPlanner, get_environment

from tests.oracles.clocks import JumpingClock
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.io import dump_plan, result_to_dict
from up_samp.model import deadline

pytestmark = pytest.mark.usefixtures("on_the_clock")

JUMPS = (0.05, 0.6, 3.0)
LARGE = {"tuning": {"large": 1}}


def first_plan(problem, *, timeout, anytime=False):
    """Return the first plan of a problem, as text."""
    name = "samp-refine[cpsat]"
    if anytime:
        with AnytimePlanner(name=name, params=LARGE) as planner:
            result = next(iter(planner.get_solutions(problem, timeout=timeout)))
    else:
        with OneshotPlanner(name=name, params={**LARGE, "first_plan": True}) as planner:
            result = planner.solve(problem, timeout=timeout)
    assert result.plan is not None
    told = result_to_dict(problem, result)
    # bounds and statuses may differ: one is asked for better plans, too
    return dump_plan({key: told[key] for key in ("activities", "motions")})


def check(size, seed, monkeypatch, every):
    """Compare the first plan on a jumping clock with others on a good one."""
    get_environment().credits_stream = None
    problem = warehouse(*size, encoding="compact", seed=seed)
    quiet = first_plan(problem, timeout=None)
    clock = JumpingClock(random.Random(seed), every, JUMPS, time.monotonic)
    with monkeypatch.context() as patch:
        patch.setattr(deadline, "time", SimpleNamespace(monotonic=clock.monotonic))
        assert first_plan(problem, timeout=1e6) == quiet
    assert clock.ahead > 10.0
    return problem, quiet


def test_a_first_plan_does_not_hang_on_the_clock(monkeypatch):
    check((3, 5), 0, monkeypatch, 40)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_first_plans_of_larger_fleets_do_not_hang_on_the_clock(seed, monkeypatch):
    problem, quiet = check((6, 14), seed, monkeypatch, 100)
    assert first_plan(problem, timeout=600, anytime=True) == quiet
