"""Problems that are dear to work on end in time, whatever stage they are dear in."""

from contextlib import nullcontext
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from tests.oracles.clocks import Watch
from tests.search.expensive import KINDS, Floor
from tests.shuffled import shuffled
from tests.usual import usually
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.model import Deadline, MotionModel, OutOfTimeError, in_force
from up_samp.search import check as checks
from up_samp.search.loop import state_what_is_known
from up_samp.search.params import Parameters
from up_samp.search.search import Wrapped
from up_samp.search.session import open_search
from up_samp.search.statements import lower_bounds, unary_places, unreachable
from up_samp.upio.plan import up_path
from up_samp.validation import validate_plan

pytestmark = pytest.mark.usefixtures("on_the_clock")

LATE = 2.0
"""Seconds that a solve may end after its limit."""

ENDINGS = (Status.TIMEOUT, Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY)


def solve(problem, engine, limit):
    with OneshotPlanner(name=f"samp-refine[{engine}]") as planner:
        watch = Watch()
        result = planner.solve(problem, timeout=limit)
        late = watch.late(limit)
    assert result.status in ENDINGS, result.log_messages
    return late


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_solve_ends_in_time(tmp_path, kind):
    assert solve(KINDS[kind](tmp_path, 0.15), "cpsat", 0.5) < LATE


@pytest.mark.long
@pytest.mark.parametrize("limit", [2.0, 6.0, 20.0])
@pytest.mark.parametrize("engine", ["cpsat", "aries", "aries-opt"])
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_large_ones_end_in_time(tmp_path, kind, engine, limit):
    assert solve(KINDS[kind](tmp_path, 1.0), engine, limit) < LATE


def test_plans_are_written_and_judged_in_time_only(tmp_path):
    problem = KINDS["long_chain"](tmp_path, 0.002)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        plan = planner.solve(problem, timeout=60).plan
    model = MotionModel.REEDSSHEPP
    for seconds, late in ((0.0, True), (60.0, False)):
        # long after their limits: what was found may be written down a moment later
        deadline = Deadline.after(seconds)
        with in_force(replace(deadline, at=deadline.at - 5)):
            for write in (
                lambda: up_path(next(iter(plan.trajectories.values())), model),
                lambda: validate_plan(problem, plan),
            ):
                with pytest.raises(OutOfTimeError) if late else nullcontext():
                    write()
    with in_force(Deadline.after(0.0)):
        assert validate_plan(problem, plan).valid


@pytest.mark.parametrize(
    ("engine", "seconds"), [("aries-opt", 3e6), ("aries-opt", 1e300), ("cpsat", 1e300)]
)
def test_limits_of_months_are_limits(tmp_path, engine, seconds):
    floor = Floor(tmp_path, (10, 6))
    floor.pose("a", 2, 2)
    floor.pose("b", 8, 4)
    floor.robot("r0", "a")
    floor.move("go", "r0", "a", "b")
    with OneshotPlanner(name=f"samp-refine[{engine}]") as planner:
        result = planner.solve(floor.problem, timeout=seconds)
    assert result.status is Status.SOLVED_OPTIMALLY


@pytest.mark.parametrize("asked", range(6))
def test_motions_that_nobody_looked_at_any_more_do_not_pass(monkeypatch, asked):
    """Time may be up whenever one asks."""
    monkeypatch.setattr(checks, "groups_of", lambda motions: [[m] for m in motions])
    monkeypatch.setattr(checks, "motion_key", str)
    seen, number = [], count()
    deadline = SimpleNamespace(expired=lambda: next(number) >= asked)
    budget = SimpleNamespace(deadline=deadline, motion_time=nullcontext)
    cuts = SimpleNamespace(first_only=False)
    checker = checks.Checker(SimpleNamespace(budget=budget), None, cuts, (), None)
    monkeypatch.setattr(checks.Checker, "_check_group", lambda _s, _i, g, _c, **_: seen.extend(g))
    check = checker.check(SimpleNamespace(motions=["a", "b", "c", "d"]))
    assert check.passed == (asked >= 4)
    assert len(seen) == min(4, asked + 1)


def opened(seed, size=(2, 4)):
    """Return a search on a warehouse that knows nothing yet, listed anyhow."""
    problem = shuffled(warehouse(*size, encoding="compact", seed=seed), seed).problem
    wrapped = Wrapped("cpsat", {"workers": 1}, lambda *_: [], lambda *_: [], native=True)
    search = open_search(problem, wrapped, Parameters(), Deadline.after(600.0))
    search.scheduler.close()
    return search


@pytest.mark.parametrize(
    ("looks", "size"),
    usually((0, (2, 4)), (50, (2, 4)), of=[*((k, (2, 4)) for k in (0, 1, 50)), (200, (3, 6))]),
)
def test_what_is_known_is_stated_as_long_as_there_is_time(looks, size):
    """One thing at a time: of a large fleet it takes as long as all that was to be done."""
    search, number = opened(looks, size), count()
    deadline = SimpleNamespace(over=lambda _: next(number) >= looks)
    with in_force(deadline), pytest.raises(OutOfTimeError):
        state_what_is_known(search)
    assert next(number) == looks + 1
    assert len(search.knowledge.active) <= looks
    with in_force(Deadline.never()):
        state_what_is_known(search)
    assert len(search.knowledge.active) > looks


def test_what_is_stated_is_looked_for_as_long_as_there_is_time():
    search = opened(3)
    finders = (
        lambda: lower_bounds(search.motions, search.knowledge),
        lambda: unreachable(search.motions),
        lambda: unary_places(search.motions),
    )
    for find in finders:
        with in_force(Deadline.after(0.0)), pytest.raises(OutOfTimeError):
            find()
