"""How searches end: what leaves no schedule is named, and proven where it can be."""

import math
import runpy
from dataclasses import replace
from pathlib import Path

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines import ValidationResultStatus
from unified_planning.model import Fluent
from unified_planning.model.motion import ActivityWaypoints
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LT,
    BoolType,
    ClosedTimeInterval,
    LeftOpenTimeInterval,
    MinimizeMakespan,
    OneshotPlanner,
    PlanValidator,
    get_environment,
)

from tests.search.test_end_to_end import solve
from tests.search.test_parameters import EACH_INSTALLED, EACH_PROVING, INSTALLED, PROVING, choice_of
from tests.search.test_tidy import idle_fleet
from tests.upio.hall import Hall, write_hall
from up_samp.search import budget
from up_samp.validation import validate_plan


def refused(hall, engine="cpsat", **params):
    """Return why the problem is proven unsolvable."""
    result = solve(hall.problem, engine, **params)
    assert result.status is Status.UNSOLVABLE_PROVEN, result.log_messages
    assert result.metrics["bound_kind"] == "absolute" or engine != "cpsat"
    return result.log_messages[0].message


@EACH_PROVING
def test_a_deadline_that_no_motion_meets(tmp_path, engine):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0").add_deadline(10)
    why = refused(hall, engine)
    assert "go absent (due at 10, 17 at the soonest: r0 begins at left0)" in why


def test_a_duration_that_was_forgotten(tmp_path):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0", bounds=(1, 1))
    why = refused(hall)
    assert "go lasts at least 17" in why
    assert "go may last 1 at most" in why


def test_a_goal_in_a_wall(tmp_path):
    hall = Hall(tmp_path)
    hall.pose("wall", 10.0, 8.0, 0.0)
    hall.move("go", 0, "left0", "wall")
    hall.move("else", 0, "left0", "right0", optional=True)
    why = refused(hall)
    assert "go absent" in why
    assert "collides with the map" in why
    assert "else" not in why


def test_two_robots_at_one_place(tmp_path):
    hall = Hall(tmp_path, robots=2)
    hall.pose("there", 6.0, 5.0, 0.0)
    hall.move("a", 0, "left0", "there")
    hall.move("b", 1, "left1", "there")
    assert "place there holds one object" in refused(hall)


def test_all_values_of_a_parameter_are_out_of_reach(tmp_path):
    hall = Hall(tmp_path, map_file=write_hall(tmp_path, wall_gap=None))
    hall.pose("beyond", 15.0, 3.0, 0.0)
    choice_of(hall, "go", "right0", "beyond")
    why = refused(hall)
    assert "go.to is not right0" in why
    assert "go.to is not beyond" in why


def test_what_motions_have_no_part_in(tmp_path):
    hall = Hall(tmp_path)
    go = hall.move("go", 0, "left0", "right0")
    wait = hall.problem.add_activity("wait", 3)
    hall.problem.add_constraint(LT(wait.end, go.start))
    hall.problem.add_constraint(LT(go.end, wait.start))
    for engine in PROVING:
        why = refused(hall, engine)
        assert "whatever the motions" in why
        assert "(end(wait) < start(go)) is asked for" in why
        assert "(end(go) < start(wait)) is asked for" in why
        assert "may last" not in why


def test_a_motion_that_starts_where_nothing_brings_its_robot(tmp_path):
    hall = Hall(tmp_path, robots=2)
    hall.move("there", 1, "left1", "right1")
    hall.move("go", 0, "right0", "left0")
    why = refused(hall)
    assert "go needs r0 at right0 (r0 begins at left0)" in why
    assert "there" not in why


def test_few_of_many_facts_are_named(tmp_path):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0").add_deadline(10)
    for k in range(6):
        hall.pose(f"p{k}", 4.0 + 0.4 * k, 7.0, 0.0)
        hall.move(f"aside{k}", 0, "left0", f"p{k}", optional=True)
    assert "aside" not in refused(hall)


@EACH_INSTALLED
def test_a_robot_that_is_lifted_and_drives_on(tmp_path, engine):
    """A motion effect without a motion sets a robot elsewhere, and it starts from a fluent."""
    hall = Hall(tmp_path)
    hall.pose("near", 13.5, 3.0, 0.0)
    at = Fluent("at", hall.place)
    hall.problem.add_fluent(at, default_initial_value=hall.poses["left0"])
    lift = hall.problem.add_motion_activity("lift", 2)
    lift.add_motion_effect(hall.robots[0], hall.poses["right0"])
    lift.add_effect(lift.end, at, hall.poses["right0"])
    go = hall.problem.add_motion_activity("go", 1)
    go.set_duration_bounds(1, 200)
    go.add_motion_constraint(ActivityWaypoints(hall.robots[0], at(), [hall.poses["near"]]))
    go.add_effect(go.end, at, hall.poses["near"])
    hall.problem.add_constraint(LT(lift.end, go.start))
    result = solve(hall.problem, engine, optimal=engine != "aries")
    assert result.plan is not None, result.log_messages
    assert int(result.metrics["makespan"]) == 9
    assert validate_plan(hall.problem, result.plan).valid


def test_intervals_with_bare_timepoints(tmp_path):
    """UP scripts write them; the problem itself is left as it is."""
    hall = Hall(tmp_path)
    free = Fluent("free", BoolType())
    hall.problem.add_fluent(free, default_initial_value=True)
    go = hall.move("go", 0, "left0", "right0")
    interval = ClosedTimeInterval(go.start, go.end)
    go.add_condition(interval, free())
    block = hall.problem.add_activity("block", 1)
    block.add_effect(block.end, free, False)
    for engine in PROVING:
        result = solve(hall.problem, engine)
        assert result.status is Status.SOLVED_OPTIMALLY, result.log_messages
        end = result.plan.get(go.end).constant_value()
        assert result.plan.get(block.end).constant_value() == end + 1
        assert validate_plan(hall.problem, result.plan).valid
    assert list(go.conditions) == [interval]
    assert interval.lower is go.start or interval.lower == go.start


@pytest.mark.parametrize("name", ["cpsat", "samp-refine[cpsat]", "samp-refine[aries-opt]"])
def test_bare_timepoints_without_motions(name):
    if "aries" in name and "aries-opt" not in INSTALLED:
        pytest.skip("no aries")
    problem = SchedulingProblem("plain")
    free = Fluent("free", BoolType())
    problem.add_fluent(free, default_initial_value=True)
    work = problem.add_activity("work", 3)
    work.add_condition(LeftOpenTimeInterval(work.start, work.end), free())
    block = problem.add_activity("block", 1)
    block.add_effect(block.end, free, False)
    problem.add_quality_metric(MinimizeMakespan())
    with OneshotPlanner(name=name) as planner:
        result = planner.solve(problem)
    assert result.status is Status.SOLVED_OPTIMALLY
    with PlanValidator(name="samp-validator") as judge:
        assert judge.validate(problem, result.plan).status is ValidationResultStatus.VALID


@pytest.mark.skipif("aries" not in INSTALLED, reason="no aries")
def test_an_engine_is_not_believed_against_a_shorter_schedule(tmp_path):
    """What is optimal for another problem, or for nobody, is not optimal."""
    factory = get_environment().factory
    if "hasty" not in factory.engines:
        factory.add_engine("hasty", "tests.search.hasty", "Hasty")
    hall = idle_fleet(tmp_path)
    assert solve(hall.problem).metrics["makespan"] == "17"
    drawn = solve(hall.problem, "hasty")
    assert drawn.status is Status.SOLVED_OPTIMALLY
    assert drawn.metrics["lower_bound"] == drawn.metrics["makespan"] == "17"
    # the whole is handed over, and its word is all there is
    result = solve(hall.problem, "hasty", preset="without-incumbents")
    assert result.plan is not None
    assert result.status is Status.SOLVED_SATISFICING
    assert int(result.metrics["lower_bound"]) <= 17 <= int(result.metrics["makespan"])
    assert "not believed" in result.log_messages[0].message


def test_a_search_that_has_nothing_left_to_try_says_so_before_its_time_is_over(monkeypatch):
    monkeypatch.setattr(budget, "_STALE_RESTARTS", 2)
    fleet = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "factory.py"))["fleet"]
    fleet._hold(replace(fleet.records, objective="makespan"))
    result = fleet.solve(timeout=900, patience=math.inf)
    assert result.status == "SOLVED_SATISFICING", result.explain()
    assert float(result.outcome.metrics["seconds_total"]) < 800
    assert "nothing was left to try after" in result.explain()
    first = fleet.solve(timeout=900, first_plan=True)
    assert "left to try" not in first.explain()
