"""Worlds that were built around a plan have one, and nothing slower is called optimal."""

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.soundness.known_plans import SECONDS, KnownPlan, NoPlanError
from tests.usual import usually
from up_samp.model.deadline import computing_time
from up_samp.motion.protocol import MotionCache
from up_samp.validation import validate_plan

SHARE = 1.05
"""What a claim that rests on the planner's own motions may be too long by."""


def solved(world, seconds=30.0, **settings):
    """Return the answer to a world within so much computing time."""
    settings = {"seconds_per_unit": SECONDS, "optimal": True, **settings}
    with (
        computing_time(),
        OneshotPlanner(name="samp-refine[cpsat]", params=settings) as planner,
    ):
        return planner.solve(world.problem, timeout=seconds)


def beaten(seed, folder):
    """Return what is wrong with the answer to the world of a seed (None: nothing)."""
    try:
        world = KnownPlan(seed, folder)
    except NoPlanError:
        return None
    verdict = validate_plan(world.problem, world.plan(), seconds_per_unit=SECONDS)
    assert verdict.valid, verdict.violations
    return wrong(world, solved(world))


def wrong(world, result):
    """Return what is wrong with an answer to a world (None: nothing)."""
    if result.plan is None:
        return f"{result.status.name}: there is a plan"
    if not validate_plan(world.problem, result.plan, seconds_per_unit=SECONDS).valid:
        return "an invalid plan"
    told, makespan = result.metrics, int(result.metrics["makespan"])
    absolute = "lower_bound" if told["bound_kind"] == "absolute" else "absolute_bound"
    if int(told.get(absolute, 0)) > world.makespan:
        return f"no plan is said to take less than {told[absolute]}, one takes {world.makespan}"
    if result.status is Status.SOLVED_OPTIMALLY and makespan > world.makespan * SHARE:
        return f"{makespan} called optimal, {world.makespan} can be driven"
    return None


@pytest.fixture(autouse=True)
def _silent(monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)


SEEDS = (0, 2, 9, 17, 22, 27, 64, 77, 85, 150, 219)


@pytest.mark.parametrize("seed", usually(0, 150, of=SEEDS))
def test_what_is_called_optimal_is_not_beaten_by_the_plan_that_is_known(seed, tmp_path):
    assert beaten(seed, tmp_path) is None


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 220, 20))
def test_what_is_called_optimal_is_not_beaten_in_many(first, tmp_path):
    found = {seed: beaten(seed, tmp_path) for seed in range(first, first + 20)}
    assert not {seed: why for seed, why in found.items() if why is not None}


@pytest.fixture(scope="module")
def motions():
    """Those of the world of a slider's bends: planned once for all that is asked of it."""
    return MotionCache()


@pytest.mark.parametrize("relative", [False, True])
def test_a_motion_far_from_its_bound_makes_no_optimum_but_where_that_is_asked_for(
    relative, motions, tmp_path
):
    """A slider's bends: what is proven of them knows of no bend."""
    world = KnownPlan(157, tmp_path)
    result = solved(world, relative=relative, cache=motions)
    assert relative or wrong(world, result) is None
    told = result.metrics
    assert told["lower_bound"] == told["makespan"]
    assert told["bound_kind"].startswith("relative")
    most, _, which = told["may_be_shorter"].partition(" % ")
    assert float(most) > 5
    assert which.startswith("go")
    assert any(told["may_be_shorter"] in m.message for m in result.log_messages)
    said = any("relative=True" in m.message for m in result.log_messages)
    status = Status.SOLVED_OPTIMALLY if relative else Status.SOLVED_SATISFICING
    assert (result.status, said) == (status, not relative)


def test_a_bound_that_needs_no_motion_is_absolute(motions, tmp_path):
    """What lasts longest is no motion: whatever these may take, the plan is optimal."""
    world = KnownPlan(157, tmp_path)
    world.problem.add_activity("work", 400)
    result = solved(world, cache=motions)
    told = result.metrics
    assert (result.status, told["makespan"]) == (Status.SOLVED_OPTIMALLY, "400")
    assert told["bound_kind"] == "absolute"
    assert "may_be_shorter" not in told
