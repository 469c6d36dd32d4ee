"""Whole solves of small problems whose answers are known."""

import math
import re

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.shortcuts import (
    LT,
    AnytimePlanner,
    Equals,
    Iff,
    OneshotPlanner,
    Or,
    get_environment,
)

import up_samp
from tests.upio.hall import Hall, write_hall
from tests.usual import usually
from up_samp.model import ProblemError
from up_samp.validation import validate_plan

get_environment().credits_stream = None


def solve(problem, engine="cpsat", *, timeout=60.0, optimal=True, **params):
    guarantee = OptimalityGuarantee.SOLVED_OPTIMALLY if optimal else None
    params = params if optimal else {"first_plan": True, **params}
    with OneshotPlanner(
        name=f"samp-refine[{engine}]", params=params, optimality_guarantee=guarantee
    ) as planner:
        return planner.solve(problem, timeout=timeout)


def straight_time(distance, v=1.0, a=0.5):
    """Rest-to-rest time over a straight line."""
    return distance / v + v / a if distance >= v * v / a else 2 * math.sqrt(distance / a)


def test_one_straight_drive_takes_its_trapezoid(tmp_path):
    hall = Hall(tmp_path)
    hall.pose("ahead", 8.5, 3.0, 0.0)
    hall.move("go", 0, "left0", "ahead")
    result = solve(hall.problem)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert result.metrics["makespan"] == str(math.ceil(straight_time(5.5)))
    trajectory = up_samp.trajectories(result.plan)["go"]
    assert trajectory.duration == pytest.approx(straight_time(5.5), rel=0.001)
    assert trajectory.at(trajectory.start) == pytest.approx((3.0, 3.0, 0.0))
    assert validate_plan(hall.problem, result.plan).valid


def test_the_door_is_opened_in_time(tmp_path):
    hall = Hall(tmp_path, door=True)
    hall.move("go", 0, "left0", "right0")
    opening = hall.open_door(optional=True)
    opening.add_release_date(12)
    result = solve(hall.problem)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert result.metrics["bound_kind"] == "absolute"
    names = {a.name for a in result.plan.activities}
    assert names == {"go", "open"}
    end = result.plan.get(opening.end).constant_value()
    assert end == 13
    # it waits on its way, not at its start: the rest of the way is shorter than the whole
    assert int(result.metrics["makespan"]) - end < straight_time(14.0)
    assert validate_plan(hall.problem, result.plan).valid


def test_nobody_may_open_the_door(tmp_path):
    hall = Hall(tmp_path, door=True)
    hall.move("go", 0, "left0", "right0")
    result = solve(hall.problem)
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert result.plan is None
    (message,) = result.log_messages
    assert "door" in message.message
    assert "go" in message.message


def test_a_wall_without_a_gap_is_proven_unsolvable(tmp_path):
    hall = Hall(tmp_path, map_file=write_hall(tmp_path, wall_gap=None))
    hall.move("go", 0, "left0", "right0")
    result = solve(hall.problem)
    assert result.status is Status.UNSOLVABLE_PROVEN


def test_two_robots_exchange_sides_through_one_gap(tmp_path):
    hall = Hall(tmp_path, robots=2)
    hall.pose("far", 17.0, 3.0, math.pi)
    hall.pose("near", 3.0, 3.0, math.pi)
    other = hall.robots[1]
    hall.problem._initial_configuration = [
        p for p in hall.problem.initial_configuration if p[0].object() != other
    ]
    hall.problem.set_initial_configuration(other, hall.poses["far"])
    hall.move("east", 0, "left0", "right1")
    hall.move("west", 1, "far", "near")
    hall.pose("spare", 4.0, 8.0, 0.0)
    result = solve(hall.problem, optimal=False)
    assert result.plan is not None
    assert validate_plan(hall.problem, result.plan).valid


@pytest.mark.parametrize(
    "engine", usually("aries-opt", "cpsat", of=("aries", "aries-opt", "cpsat"))
)
def test_optional_alternatives_with_every_engine(tmp_path, engine):
    hall = Hall(tmp_path)
    near = hall.pose("near", 6.5, 3.0, 0.0)
    short = hall.move("short", 0, "left0", "near", optional=True)
    long = hall.move("long", 0, "left0", "right0", optional=True)
    hall.problem.add_constraint(Or(short.present, long.present))
    result = solve(hall.problem, engine, optimal=engine != "aries")
    assert result.plan is not None
    if engine != "aries":
        assert [a.name for a in result.plan.activities] == ["short"]
        assert result.metrics["makespan"] == str(math.ceil(straight_time(3.5)))
    assert near is not None


def test_fluents_and_motions_agree(tmp_path):
    hall = Hall(tmp_path)
    problem = hall.problem
    at = problem.add_fluent("robot_at", hall.place, default_initial_value=hall.poses["left0"])
    hall.pose("pickup", 6.5, 3.0, 0.0)
    go = hall.move("go", 0, "left0", "pickup")
    back = hall.move("back", 0, "pickup", "left0")
    for move, start, goal in ((go, "left0", "pickup"), (back, "pickup", "left0")):
        move.add_condition(move.start, Equals(at, hall.poses[start]))
        move.add_effect(move.end, at, hall.poses[goal])
    pick = problem.add_activity("pick", 3)
    pick.add_condition(pick.start, Equals(at, hall.poses["pickup"]))
    pick.add_condition(pick.end, Equals(at, hall.poses["pickup"]))
    problem.add_constraint(LT(pick.end, back.start))
    result = solve(problem)
    drive = math.ceil(straight_time(3.5))
    assert result.status is Status.SOLVED_OPTIMALLY
    # a change at t is seen from t + 1 on
    assert result.metrics["makespan"] == str(drive + 1 + 3 + 1 + drive)


def test_without_a_metric_the_plan_is_satisficing(tmp_path):
    hall = Hall(tmp_path)
    hall.problem.clear_quality_metrics()
    hall.move("go", 0, "left0", "right0")
    result = solve(hall.problem, optimal=False)
    assert result.status is Status.SOLVED_SATISFICING


def test_anytime_plans_get_better_and_the_last_is_optimal(tmp_path):
    hall = Hall(tmp_path, robots=2)
    hall.move("go0", 0, "left0", "right1")
    hall.move("go1", 1, "left1", "right0")
    with AnytimePlanner(name="samp-refine[cpsat]") as planner:
        results = list(planner.get_solutions(hall.problem, timeout=60.0))
    assert results
    makespans = [int(r.metrics["makespan"]) for r in results]
    assert makespans == sorted(makespans, reverse=True)
    assert results[-1].status in (Status.SOLVED_OPTIMALLY, Status.SOLVED_SATISFICING)
    assert all(validate_plan(hall.problem, r.plan).valid for r in results)


def test_the_same_seed_gives_the_same_plan(tmp_path):
    plans = []
    for _ in range(2):
        hall = Hall(tmp_path, robots=2)
        hall.move("go0", 0, "left0", "right1")
        hall.move("go1", 1, "left1", "right0")
        result = solve(hall.problem, seed=3)
        plans.append((str(result.plan), result.plan.trajectories["go0"].poses.tolist()))
    assert plans[0] == plans[1]


def test_the_history_tells_rounds_and_refinements(tmp_path):
    hall = Hall(tmp_path, door=True)
    hall.move("go", 0, "left0", "right0")
    hall.open_door()
    trace = tmp_path / "trace"
    result = solve(hall.problem, trace=str(trace))
    data = result.history.to_dict()
    assert data["rounds"]
    assert data["refinements"]
    assert {r["strength"] for r in data["refinements"]} <= {"proven", "relative"}
    assert "candidate schedule" in (trace / "round-001.txt").read_text()


def _in_wall(folder):
    hall = Hall(folder)
    hall.pose("inside", 10.0, 2.0, 0.0)
    hall.problem._initial_configuration.clear()
    hall.problem.set_initial_configuration(hall.robots[0], hall.poses["inside"])
    hall.move("go", 0, "inside", "right0")
    return hall, ["r0", "inside", "hall.yaml"]


def _outside(folder):
    hall = Hall(folder)
    hall.pose("beyond", -4.0, 2.0, 0.0)
    hall.problem._initial_configuration.clear()
    hall.problem.set_initial_configuration(hall.robots[0], hall.poses["beyond"])
    hall.move("go", 0, "beyond", "right0")
    return hall, ["r0", "beyond"]


def _overlapping(folder):
    hall = Hall(folder, robots=2)
    hall.pose("close", 3.2, 3.1, 0.0)
    hall.problem._initial_configuration.pop()
    hall.problem.set_initial_configuration(hall.robots[1], hall.poses["close"])
    hall.move("go", 0, "left0", "right0")
    return hall, ["r0", "r1"]


def _no_map(folder):
    hall = Hall(folder, map_file=folder / "missing.yaml")
    hall.move("go", 0, "left0", "right0")
    return hall, ["missing.yaml"]


def _broken_image(folder):
    path = write_hall(folder)
    (folder / "hall.png").write_bytes(b"this is not a picture")
    hall = Hall(folder, map_file=path)
    hall.move("go", 0, "left0", "right0")
    return hall, ["hall.png"]


@pytest.mark.parametrize(
    "spoil", [_in_wall, _outside, _overlapping, _no_map, _broken_image], ids=lambda f: f.__name__
)
def test_bad_input_is_named(tmp_path, spoil):
    hall, words = spoil(tmp_path)
    with pytest.raises(ProblemError) as caught:
        solve(hall.problem)
    for word in words:
        assert re.search(re.escape(word), str(caught.value))


def test_unknown_presets_and_parameters_are_named(tmp_path):
    with pytest.raises(ProblemError, match="hasty"):
        OneshotPlanner(name="samp-refine[cpsat]", params={"preset": "hasty"})


def test_a_problem_without_motions_is_simply_scheduled():
    from unified_planning.model.metrics import MinimizeMakespan
    from unified_planning.model.scheduling import SchedulingProblem

    problem = SchedulingProblem("plain")
    a = problem.add_activity("a", 3)
    b = problem.add_activity("b", 4)
    problem.add_constraint(LT(a.end, b.start))
    problem.add_quality_metric(MinimizeMakespan())
    result = solve(problem)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert result.metrics["makespan"] == "8"


def test_the_paper_preset_solves_the_door_too(tmp_path):
    hall = Hall(tmp_path, door=True)
    go = hall.move("go", 0, "left0", "right0", optional=True)
    opening = hall.open_door(optional=True)
    hall.problem.add_constraint(go.present)
    hall.problem.add_constraint(Iff(opening.present, opening.present))
    result = solve(hall.problem, preset="paper", optimal=False, query_seconds=1.0)
    assert result.plan is not None
    assert validate_plan(hall.problem, result.plan).valid
    assert int(result.metrics["refinements_geometric"]) >= 1


def test_the_sequential_pipeline_does_not_refine(tmp_path):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0")
    result = solve(hall.problem, preset="sequential", optimal=False)
    assert result.plan is None
    assert result.status is Status.UNSOLVABLE_INCOMPLETELY
