"""UP's operation modes with UP's factory: who is picked, what is refused, replanning, repair."""

from __future__ import annotations

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.exceptions import (
    UPNoRequestedEngineAvailableException,
    UPUsageError,
)
from unified_planning.model import InstantaneousAction
from unified_planning.model.motion import ActivityWaypoints, MotionActivity
from unified_planning.shortcuts import (
    LE,
    BoolType,
    IntType,
    MinimizeExpressionOnFinalState,
    ObjectExp,
    OneshotPlanner,
    PlanRepairer,
    Replanner,
    get_environment,
)
from unified_planning.test.examples.scheduling import get_example_problems

from tests.benchmarks.cases import choice, drive
from tests.scheduling.compilers.test_own_effects import FOUND, drawn
from tests.scheduling.cpsat.random_problems import random_problem
from up_samp.engines.factory import engine_named
from up_samp.model import ProblemError, UnsupportedError
from up_samp.scheduling import known_engines, open_scheduler
from up_samp.scheduling.compilers.translate import read_plain
from up_samp.scheduling.engine_scheduler import chain, compilers_for
from up_samp.scheduling.quirks import quirks_of
from up_samp.validation import validate_plan

SOLVED = (Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY)
WRAPPED = ("cpsat", *(name for name, _, _ in known_engines()))
OPTIMALLY = "SOLVED_OPTIMALLY"


@pytest.fixture(autouse=True)
def _silent(monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)


def factory():
    return get_environment().factory


def other_metric():
    """Either drive, by the least final value of a number: the longer one."""
    problem = choice().problem
    number = problem.add_fluent("number", IntType(0, 9), default_initial_value=0)
    for name, value in (("near", 3), ("long", 2)):
        activity = problem.get_activity(name)
        activity.add_effect(activity.end, number, value)
    problem.clear_quality_metrics()
    problem.add_quality_metric(MinimizeExpressionOnFinalState(number()))
    return problem


def valid(problem, result):
    assert result.status in SOLVED, result.log_messages
    assert validate_plan(problem, result.plan).violations == ()
    return sorted(a.name for a in result.plan.activities)


# -- names ---------------------------------------------------------------------------------------
def test_unknown_engines_are_refused_with_the_names_there_are():
    there = r"samp-refine\[aries\], .*samp-refine\[cpsat\]"
    for make in (OneshotPlanner, PlanRepairer):
        with pytest.raises(UPNoRequestedEngineAvailableException, match=there):
            make(name="samp-refine[gurobi]")
    with pytest.raises(UPNoRequestedEngineAvailableException, match=there):
        Replanner(drive().problem, name="samp-refine[gurobi]")
    with pytest.raises(UPNoRequestedEngineAvailableException, match=r"'gurobi'.*aries.*cpsat"):
        OneshotPlanner(name="gurobi")
    with pytest.raises(ProblemError, match=there):
        engine_named("samp-refine[gurobi]")
    with pytest.raises(ProblemError, match=r"'gurobi'.*aries.*cpsat"):
        open_scheduler("gurobi", drive().problem)
    assert engine_named("cpsat") is factory().engine("cpsat")


# -- guarantees ----------------------------------------------------------------------------------
def test_optimal_plans_with_motions_are_promised_for_every_metric_by_cpsat():
    for problem in (other_metric(), choice().problem):
        engines = factory().get_all_applicable_engines(problem.kind, optimality_guarantee=OPTIMALLY)
        assert engines[0] == "samp-refine[cpsat]"
        assert "samp-refine[aries]" not in engines
    only = factory().get_all_applicable_engines(other_metric().kind, optimality_guarantee=OPTIMALLY)
    assert only == ["samp-refine[cpsat]"]


def test_an_engine_that_has_to_be_optimal_proves_other_metrics():
    problem = other_metric()
    with OneshotPlanner(problem_kind=problem.kind, optimality_guarantee=OPTIMALLY) as planner:
        result = planner.solve(problem, timeout=60)
    assert result.status.name == OPTIMALLY
    assert valid(problem, result) == ["long"]
    assert (result.metrics["value"], result.metrics["value_bound"]) == ("2", "2")


@pytest.mark.parametrize("engine", ["aries", "aries-opt"])
def test_other_engines_schedule_what_is_drawn_by_other_metrics(engine):
    """They are not told of the metric; where all of it is handed over, they refuse it by name."""
    problem = other_metric()
    with OneshotPlanner(name=f"samp-refine[{engine}]", params={"optimal": True}) as planner:
        result = planner.solve(problem, timeout=60)
    assert result.status.name == OPTIMALLY
    assert valid(problem, result) == ["long"]
    assert (result.metrics["value"], result.metrics["value_bound"]) == ("2", "2")
    whole = {"preset": "without-incumbents"}
    with (
        OneshotPlanner(name=f"samp-refine[{engine}]", params=whole) as planner,
        pytest.raises(UnsupportedError, match="only the makespan"),
    ):
        planner.solve(problem, timeout=20)


# -- kinds ---------------------------------------------------------------------------------------
def refusal(engine, problem):
    """Return why a wrapped engine cannot be told the problem (None: it can)."""
    try:
        chain(read_plain(problem), compilers_for(quirks_of(factory().engine(engine))))
    except UnsupportedError as error:
        return str(error)
    return None


def asks_before_its_end(problem):
    """Return whether a condition is asked for before the plan's end: no kind of UP's tells that."""
    spans = [
        *(span for span, _ in problem.base_conditions),
        *(span for activity in problem.activities for span in activity.conditions),
    ]
    times = [time for span in spans for time in (span.lower, span.upper)]
    return any(t.timepoint.kind.name == "GLOBAL_END" and t.delay < 0 for t in times)


def refused(seeds):
    """Return what wrapped engines refuse, by engine and problem, of what they support: but problems
    that ask for something before the plan's end.
    """
    found, supported = {}, 0
    for problem in (make(seed) for seed in seeds for make in (random_problem, drawn)):
        kind = problem.kind
        for engine in (e for e in WRAPPED if e not in ("cpsat", "aries-opt")):
            if factory().engine(f"samp-refine[{engine}]").supports(kind):
                supported += 1
                why = refusal(engine, problem)
                if why is not None and not asks_before_its_end(problem):
                    found[engine, problem.name] = why
    assert supported > len(seeds)
    return found


def test_what_is_supported_is_not_refused():
    assert refused((*range(25), *FOUND)) == {}


@pytest.mark.long
def test_what_is_supported_is_not_refused_in_many():
    assert refused(range(1000, 2500)) == {}


@pytest.mark.parametrize("engine", WRAPPED[1:])
def test_resources_are_counted_where_an_engine_is_asked_for_by_name(engine):
    """A kind does not tell whether numbers are resources: not supported, yet told to the engine."""
    wrapped = factory().engine(f"samp-refine[{engine}]")
    counting = {"INCREASE_EFFECTS", "DECREASE_EFFECTS"}
    for name, case in sorted(get_example_problems().items()):
        kind = case.problem.kind
        assert wrapped.supports(kind) == (not kind.features & counting), name
        assert refusal(engine, case.problem) is None, name


@pytest.mark.parametrize("engine", WRAPPED)
def test_metrics_that_an_engine_does_not_know_are_not_supported(engine):
    kind = other_metric().kind
    assert factory().engine(f"samp-refine[{engine}]").supports(kind) == (engine == "cpsat")
    assert factory().engine(f"samp-refine[{engine}]").supports(choice().problem.kind)


# -- replanning ----------------------------------------------------------------------------------
def test_a_replanner_is_found_by_kind():
    with Replanner(choice().problem) as replanner:
        assert replanner.name == "samp-refine[cpsat]"


def test_replanning_again_and_again():
    problem = choice().problem
    flag = problem.add_fluent("seen", BoolType(), default_initial_value=False)
    for activity in problem.activities:
        activity.add_effect(activity.end, flag, activity.name == "long")
    with Replanner(problem, name="samp-refine[cpsat]", params={"optimal": True}) as replanner:
        assert valid(problem, replanner.resolve(timeout=30)) == ["near"]
        replanner.add_goal(flag)
        first = replanner.resolve(timeout=30)
        assert valid(problem, first) == ["long"]
        replanner.remove_goal(flag)
        assert valid(problem, replanner.resolve(timeout=30)) in (["near"], ["long"])
        replanner.remove_action("near")
        assert valid(problem, replanner.resolve(timeout=30)) == ["long"]
        replanner.remove_action("long")
        assert replanner.resolve(timeout=30).plan is None
    assert [a.name for a in problem.activities] == ["near", "long"]  # a copy was changed


def test_what_stands_elsewhere_and_new_activities():
    case = drive()
    problem = case.problem
    go = problem.get_activity("go")
    robot, east = problem.object("r0"), problem.object("east")
    with Replanner(problem, name="samp-refine[cpsat]") as replanner:
        assert valid(problem, replanner.resolve(timeout=30)) == ["go"]
        back = MotionActivity("back", 1, True)
        back.set_duration_bounds(1, 100)
        west = problem.object("west")
        back.add_motion_constraint(ActivityWaypoints(robot, east, [west]))
        replanner.add_action(back)
        replanner.add_goal(back.present)
        result = replanner.resolve(timeout=30)
        assert sorted(a.name for a in result.plan.activities) == ["back", "go"]
        with pytest.raises(UPUsageError, match="already"):
            replanner.add_action(back)
        replanner.remove_goal(back.present)
        replanner.remove_action("back")
        replanner.update_initial_value(ObjectExp(robot), east)
        assert replanner.resolve(timeout=30).plan is None  # go starts in the west
        replanner.update_initial_value(robot, west)
        assert valid(problem, replanner.resolve(timeout=30)) == ["go"]
    assert len(problem.initial_configuration) == 1
    assert go in problem.activities


def test_what_makes_no_sense_for_schedules_is_refused_by_name():
    problem = choice().problem
    near = problem.get_activity("near")
    fixed = problem.add_activity("fixed", 3)
    problem.add_constraint(LE(fixed.end, near.start), scope=[near.present])
    with Replanner(problem, name="samp-refine[cpsat]") as replanner:
        with pytest.raises(UnsupportedError, match="action 'fly'"):
            replanner.add_action(InstantaneousAction("fly"))
        with pytest.raises(UPUsageError, match=r"'fixed' has to be done.*near"):
            replanner.remove_action("fixed")
        replanner._error_on_failed_checks = True
        with pytest.raises(UPUsageError, match="no activity 'nobody'"):
            replanner.remove_action("nobody")
        with pytest.raises(UPUsageError, match="no goal"):
            replanner.remove_goal(near.present)
    with (
        OneshotPlanner(name="samp-refine[cpsat]") as planner,
        pytest.raises(UPUsageError, match="replans nothing"),
    ):
        planner.resolve()


# -- repair --------------------------------------------------------------------------------------
@pytest.mark.parametrize("engine", ["cpsat", pytest.param("aries", marks=pytest.mark.long)])
def test_plans_are_repaired(engine):
    case = choice()
    problem, old = case.problem, case.valid_plans[1]
    with PlanRepairer(name=f"samp-refine[{engine}]") as repairer:
        assert valid(problem, repairer.repair(problem, old)) == ["long"]  # it still fits
        problem.get_activity("long").add_constraint(problem.get_activity("near").present)
        assert valid(problem, repairer.repair(problem, old)) == ["near"]
        with pytest.raises(UPUsageError, match="schedules are repaired"):
            repairer.repair(problem, None)


def test_a_repairer_is_found_by_kind():
    problem = choice().problem
    kinds = {"problem_kind": problem.kind, "plan_kind": choice().valid_plans[0].kind}
    with PlanRepairer(**kinds, optimality_guarantee=OPTIMALLY) as repairer:
        assert repairer.name == "samp-refine[cpsat]"
        result = repairer.repair(problem, choice().valid_plans[1])
    assert (result.status, valid(problem, result)) == (Status.SOLVED_OPTIMALLY, ["near"])
