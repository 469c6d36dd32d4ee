"""Beginning from a plan: what still fits is kept; for what does not, as if there were no plan."""

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.plans import Schedule, SequentialPlan
from unified_planning.shortcuts import LE, OneshotPlanner

from tests.shuffled import shuffled
from tests.upio.hall import Hall
from tests.usual import usually
from up_samp.model import ProblemError
from up_samp.validation import validate_plan

SOLVED = (Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY)


def crossing(folder, *, door=True, robots=2):
    """Robots cross a hall through the one gap, whose door is open from 3 on."""
    hall = Hall(folder, robots=robots, door=door)
    if door:
        hall.open_door().add_release_date(2)
    for k in range(robots):
        hall.move(f"go{k}", k, f"left{k}", f"right{k}", optional=True)
        hall.move(f"back{k}", k, f"right{k}", f"left{k}", optional=True)
        hall.problem.add_constraint(hall.problem.get_activity(f"go{k}").present)
    return hall


def solve(problem, start=None, **params):
    phases = []
    params = {"progress": lambda event: phases.append(event.phase), **params}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=60, warm_start_plan=start)
    if result.plan is not None:
        assert validate_plan(problem, result.plan).valid
    return result, phases


def test_a_plan_that_still_fits_is_kept(tmp_path):
    hall = crossing(tmp_path)
    first, _ = solve(hall.problem, first_plan=True)
    again, phases = solve(hall.problem, first.plan, first_plan=True)
    assert again.status in SOLVED
    assert {a.name for a in again.plan.activities} == {a.name for a in first.plan.activities}
    assert int(again.metrics["makespan"]) <= int(first.metrics["makespan"])
    assert phases.count("prepare") == 1  # nothing is stated but what the plan drives
    assert int(again.metrics["refinements_bound"]) <= 2


@pytest.mark.parametrize("seed", usually(1, of=range(3)))
def test_a_plan_is_not_lost_if_there_is_no_time_to_make_it_again(tmp_path, seed):
    hall = crossing(tmp_path)
    problem = shuffled(hall.problem, seed, rename=False).problem
    first, _ = solve(problem, first_plan=True)
    hall.problem.get_activity("go0").add_release_date(
        first.plan.get(problem.get_activity("go0").end).constant_value() + 1
    )
    later = shuffled(hall.problem, seed, rename=False).problem
    for runtime in (0.0, 0.02):
        counted = {"reproducible": True, "runtime": runtime, "optimal": True}
        again, _ = solve(problem, first.plan, **counted)
        assert again.status in SOLVED
        assert int(again.metrics["makespan"]) <= int(first.metrics["makespan"])
        # nothing comes of what drives nothing, nor of a plan of another problem
        times = {t: first.plan.get(t) for a in first.plan.activities for t in (a.start, a.end)}
        lost, _ = solve(problem, Schedule(first.plan.activities, times), **counted)
        assert lost.plan is None
        lost, _ = solve(later, first.plan, **counted)
        assert lost.plan is None


def test_the_proof_goes_on_from_the_plan(tmp_path):
    hall = crossing(tmp_path, robots=1)
    best, _ = solve(hall.problem, optimal=True)
    assert best.status is Status.SOLVED_OPTIMALLY
    times = {}
    for activity in best.plan.activities:
        start, end = (int(str(best.plan.get(t))) for t in (activity.start, activity.end))
        times |= {activity.start: start + 20, activity.end: end + 20}
    late = Schedule(best.plan.activities, times)
    again, phases = solve(hall.problem, late, optimal=True)
    assert again.status is Status.SOLVED_OPTIMALLY
    assert again.metrics["makespan"] == best.metrics["makespan"]
    assert phases.index("plan") < phases.index("prepare", 1)


def test_motions_get_the_time_that_they_need_now(tmp_path):
    hall = crossing(tmp_path)
    first, _ = solve(hall.problem, first_plan=True)
    short = {}
    for activity in first.plan.activities:
        start = int(str(first.plan.get(activity.start)))
        short |= {activity.start: start, activity.end: start + 1}
    again, _ = solve(hall.problem, Schedule(first.plan.activities, short), first_plan=True)
    assert again.status in SOLVED


def test_a_plan_of_another_problem(tmp_path):
    """It has activities that are gone, and lacks one that has to be present now."""
    hall = crossing(tmp_path)
    extra = hall.problem.add_activity("errand", 4)
    first, _ = solve(hall.problem, first_plan=True)
    assert extra.name in {a.name for a in first.plan.activities}
    other = crossing(tmp_path)
    check = other.problem.add_activity("check", 3)
    other.problem.add_constraint(LE(other.problem.get_activity("go0").end, check.start))
    again, _ = solve(other.problem, first.plan, first_plan=True)
    assert again.status in SOLVED
    assert {a.name for a in again.plan.activities} >= {"check", "go0", "go1", "open"}


def test_a_plan_that_cannot_be_kept(tmp_path):
    """A robot must come back now: the plan has no way home."""
    hall = crossing(tmp_path)
    first, _ = solve(hall.problem, first_plan=True)
    other = crossing(tmp_path)
    go, back = (other.problem.get_activity(n) for n in ("go0", "back0"))
    other.problem.add_constraint(back.present)
    other.problem.add_constraint(LE(go.end, back.start))
    again, _ = solve(other.problem, first.plan, first_plan=True)
    assert again.status in SOLVED
    assert "back0" in {a.name for a in again.plan.activities}


def test_only_schedules_are_plans_to_begin_from(tmp_path):
    hall = crossing(tmp_path, door=False)
    with pytest.raises(ProblemError, match="SequentialPlan"):
        solve(hall.problem, SequentialPlan([]))
