"""Plans come back without motions that nothing needs, and end no later for it."""

import itertools

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model import Fluent
from unified_planning.model.timing import TimePointInterval, Timing
from unified_planning.shortcuts import Equals, GlobalEndTiming, Not, OneshotPlanner

from tests.search.test_end_to_end import solve
from tests.search.test_parameters import EACH_INSTALLED
from tests.upio.hall import Hall
from up_samp.benchmarks import instance
from up_samp.motion.protocol import MotionCache
from up_samp.validation import validate_plan


def idle_fleet(folder, *, robots=2):
    """Robot 0 has a long way to go; the others may drive about meanwhile, and a door may open."""
    hall = Hall(folder, robots=robots, door=True)
    hall.move("go", 0, "left0", "right0")
    hall.open_door(optional=True)
    hall.open_door("open_again", optional=True)
    for k in range(1, robots):
        hall.pose(f"aside{k}", 6.0, 3.0 + 4.0 * k, 0.0)
        for a, b in itertools.permutations((f"left{k}", f"aside{k}"), 2):
            for n in range(2):
                hall.move(f"r{k}_{a}_{b}_{n}", k, a, b, optional=True)
    return hall


def present(result):
    return {a.name for a in result.plan.activities}


@EACH_INSTALLED
def test_idle_robots_stay(tmp_path, engine):
    hall = idle_fleet(tmp_path)
    result = solve(hall.problem, engine, optimal=engine != "aries")
    assert result.plan is not None, result.log_messages
    names = present(result)
    assert "go" in names
    assert len(names) == 2
    assert names - {"go"} < {"open", "open_again"}
    assert validate_plan(hall.problem, result.plan).valid


def test_a_needed_move_stays(tmp_path):
    """It ends where it has to, by one drive and not by three."""
    hall = idle_fleet(tmp_path)
    at = Fluent("at", hall.place)
    hall.problem.add_fluent(at, default_initial_value=hall.poses["left1"])
    for activity in hall.problem.activities:
        if activity.name.startswith("r1_"):
            goal = "aside1" if activity.name.startswith("r1_left1") else "left1"
            activity.add_effect(activity.end, at, hall.poses[goal])
    end = TimePointInterval(Timing(0, GlobalEndTiming().timepoint))
    hall.problem.add_condition(end, Equals(at(), hall.poses["aside1"]))
    result = solve(hall.problem)
    assert result.status is Status.SOLVED_OPTIMALLY
    moves = [n for n in present(result) if n.startswith("r1_")]
    assert len(moves) == 1
    assert validate_plan(hall.problem, result.plan).valid


def test_the_makespan_is_the_same_without_tidying(tmp_path):
    hall = idle_fleet(tmp_path)
    tidy, loose = solve(hall.problem), solve(hall.problem, without=("tidy",))
    assert tidy.metrics["makespan"] == loose.metrics["makespan"]
    assert tidy.status is loose.status is Status.SOLVED_OPTIMALLY
    assert present(tidy) <= present(loose) | {"open", "open_again"}


@pytest.mark.parametrize("direct_last", [True, False])
def test_one_move_takes_the_place_of_two_in_a_row(tmp_path, direct_last):
    """A plan to begin from drives round by a place at which nothing is done."""

    def stated(round_about):
        hall = Hall(tmp_path, robots=2)
        hall.move("go", 0, "left0", "right0")
        hall.pose("mid", 6.0, 8.0, 0.0)
        hall.pose("aside", 8.5, 7.0, 0.0)
        ways = [("left1", "mid"), ("mid", "aside")]
        ways.insert(2 if direct_last else 0, ("left1", "aside"))
        at = Fluent("at", hall.place)
        hall.problem.add_fluent(at, default_initial_value=hall.poses["left1"])
        for a, b in ways:
            activity = hall.move(f"{a}_{b}", 1, a, b, optional=True)
            activity.add_condition(activity.start, Equals(at(), hall.poses[a]))
            activity.add_effect(activity.end, at, hall.poses[b])
            if round_about and (a, b) == ("left1", "aside"):
                hall.problem.add_constraint(Not(activity.present))
        end = TimePointInterval(Timing(0, GlobalEndTiming().timepoint))
        hall.problem.add_condition(end, Equals(at(), hall.poses["aside"]))
        return hall.problem

    found = solve(stated(True))
    assert present(found) == {"go", "left1_mid", "mid_aside"}
    problem = stated(False)
    names = {a.name: a for a in problem.activities}
    old = {a.name: found.plan.get(a.start).constant_value() for a in found.plan.activities}
    assert old["left1_mid"] == 0
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, warm_start_plan=found.plan)
    assert present(result) == {"go", "left1_aside"}
    assert result.plan.get(names["left1_aside"].start).constant_value() == 0
    assert validate_plan(problem, result.plan).valid


def test_what_may_begin_sooner_does():
    """Waits that end before the makespan does are no part of a plan."""
    sums, motions = {}, MotionCache()
    for without in ((), ("tidy",)):
        problem = instance("building-rooms-r2-o3-s1").build()
        result = solve(problem, optimal=False, without=without, cache=motions)
        assert validate_plan(problem, result.plan).valid
        starts = [result.plan.get(a.start).constant_value() for a in result.plan.activities]
        sums[without] = result.metrics["makespan"], sum(starts)
    assert sums[()][0] == sums["tidy",][0]
    assert sums[()][1] < sums["tidy",][1]
