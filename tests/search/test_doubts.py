"""A bound or a proof that rests on what was recognised, and is wrong: it is refuted by the plain
model, told as an error, and what is returned rests on nothing that was recognised.
"""

import logging
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from unified_planning.engines import LogLevel
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from tests.scheduling.cpsat import fleets
from tests.scheduling.cpsat.fleets import optimum, write_fleet
from up_samp.fleet import Fleet
from up_samp.model import CandidateSchedule
from up_samp.model.refinement import Strength
from up_samp.refinement import rules
from up_samp.scheduling.cpsat.solve import strategy
from up_samp.search import loop
from up_samp.search.check import Checker
from up_samp.search.conclusion import Conclusion, conclude
from up_samp.search.knowledge import Bounds, History, Incumbent
from up_samp.validation import validate_plan

MAPS = Path(__file__).parents[2] / "examples" / "maps"
PAIR = fleets.Fleet((0, 30), (6, 21), (2, 2), ((0, 1), (0, 1)), home=True)


def there_and_back(*near):
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type(
        "agv", (1.2, 0.8), turning_radius=0.8, v_max=2.0, a_max=0.5, reverse_cost=1
    )
    fleet.add_place("home", 3, 3)
    fleet.add_place("near", *near or (8, 3))
    fleet.add_robot("r1", "agv", "home", end="home")
    fleet.add_task("look", "near", duration=3)
    return fleet


@pytest.fixture(params=[7, 100_000], ids=["too great", "beyond all"])
def wrong(request, monkeypatch, caplog):
    """Let the bound by work be too great by some units; a very great one leaves no schedule."""
    honest = strategy.bound_by_work

    def bound(*args, **more):
        found = honest(*args, **{**more, "value": 0})
        return replace(found, value=found.value + request.param)

    monkeypatch.setattr(strategy, "bound_by_work", bound)
    caplog.set_level(logging.CRITICAL, "up_samp")  # it is told; here it need not be heard
    return request.param


def refuted(result):
    """Return whether a result says that a claim was refuted, by its metric and as an error."""
    told = [m.message for m in result.log_messages or [] if m.level is LogLevel.ERROR]
    assert ("refuted" in result.metrics) == any(m.startswith("refuted:") for m in told)
    return "refuted" in result.metrics


@pytest.mark.parametrize("name", ["cpsat", "samp-refine[cpsat]"])
def test_a_schedule_rests_on_nothing_that_was_refuted(name, wrong):
    with OneshotPlanner(name=name) as planner:
        result = planner.solve(write_fleet(PAIR, 3))
    assert refuted(result)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert int(result.metrics["makespan"]) == int(result.metrics["lower_bound"]) == optimum(PAIR)


@pytest.mark.parametrize("optimal", [True, False])
def test_a_plan_rests_on_nothing_that_was_refuted(optimal, wrong):
    fleet = there_and_back()
    result = fleet.solve(optimal=optimal)
    assert result.outcome.metrics["refuted"]
    assert validate_plan(fleet.problem, result.plan).valid
    bound = int(result.outcome.metrics["lower_bound"])
    assert bound <= result.makespan
    assert not optimal or (result.status, bound) == ("SOLVED_OPTIMALLY", result.makespan)


@pytest.mark.parametrize("name", ["cpsat", "samp-refine[cpsat]"])
def test_what_holds_is_not_refuted(name):
    with OneshotPlanner(name=name) as planner:
        assert not refuted(planner.solve(write_fleet(PAIR, 3)))


@pytest.mark.parametrize("strength", [Strength.RELATIVE, Strength.PROVEN])
@pytest.mark.parametrize("optimal", [True, False])
def test_what_a_valid_plan_breaks_is_taken_back(strength, optimal, monkeypatch, caplog):
    """The first check says too much; the plan that is made of the same schedule shows it."""
    caplog.set_level(logging.CRITICAL, "up_samp")
    honest, said = Checker.check, []

    def check(self, itinerary):
        found = honest(self, itinerary)
        if found.passed and not said:
            drive = itinerary.motions[0]
            units = drive.end - drive.start + 5
            wrong = rules.lasts(drive.activity, units, "it is said", strength=strength)
            said.append(wrong)
            found.refinements.append(wrong)
        return found

    def adopt(search, itinerary, check):
        learned = [r for r in check.refinements if r not in said]
        return adopted(search, itinerary, replace(check, refinements=learned))

    adopted = loop.adopt_or_repair
    far = 17, 2, 1.57  # drives there and back take longer than is proven that they need
    honestly = there_and_back(*far).solve(optimal=True, relative=True)
    monkeypatch.setattr(loop, "adopt_or_repair", adopt)
    monkeypatch.setattr(Checker, "check", check)
    result = there_and_back(*far).solve(optimal=optimal, relative=True)
    assert said
    assert ("refuted" in result.outcome.metrics) == (strength is Strength.PROVEN)
    bound = int(result.outcome.metrics["lower_bound"])
    assert bound <= honestly.makespan <= result.makespan
    assert not optimal or (result.status, bound) == ("SOLVED_OPTIMALLY", honestly.makespan)


@pytest.mark.parametrize("native", [True, False])
@pytest.mark.parametrize("plain", [True, False])
def test_no_plan_is_optimal_that_ends_before_a_bound_that_was_doubted_in_vain(
    native, plain, caplog
):
    caplog.set_level(logging.CRITICAL, "up_samp")
    schedule = CandidateSchedule({"a": (0, 8)}, {})
    history, forgotten = History(), []
    search = SimpleNamespace(
        bounds=Bounds(lower=10, stood=10, incumbent=Incumbent(schedule, {}, None)),
        problem=SimpleNamespace(native=native),
        plain=plain,
        prover=SimpleNamespace(sooner_than=lambda *_: False),
        knowledge=SimpleNamespace(active=[]),
        history=history,
        recognise_nothing=lambda: forgotten.append(True),
        refute=history.refuted.append,
    )
    ended = conclude(search)
    assert ended.conclusion is Conclusion.SOLVED
    assert search.bounds.lower == 0
    told = native and not plain
    assert (len(history.refuted), len(forgotten)) == (told, told)
