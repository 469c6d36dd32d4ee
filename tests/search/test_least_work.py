"""Optional work is left out first where no plan with it is found."""

from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from tests.upio.hall import Hall
from up_samp.validation import validate_plan


def with_a_visitor(folder):
    """r0 drives to the other room and back; r1 may park in the gap between, and 60 units are to
    be waited for if it does not. Once r1 is there (before r0 comes back), nobody gets through.
    """
    hall = Hall(folder, robots=2)
    hall.pose("gap", 10.0, 5.0, 0.0)
    out = hall.move("out", 0, "left0", "right0", bounds=(1, 100))
    back = hall.move("back", 0, "right0", "left0", bounds=(1, 100))
    visit = hall.move("visit", 1, "left1", "gap", bounds=(1, 100), optional=True)
    problem = hall.problem
    problem.add_constraint(problem.environment.expression_manager.LE(out.end, back.start))
    manager = problem.environment.expression_manager
    problem.add_constraint(manager.LE(visit.end, back.start), [visit.present])
    without = problem.add_activity("without", 200, optional=True)
    problem.add_constraint(manager.Or(visit.present, without.present))
    return problem


def test_what_may_be_left_out_is_left_out_first(tmp_path):
    problem = with_a_visitor(tmp_path)
    params = {"first_plan": True, "without": ("certificates",), "query_seconds": 0.1}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=60)
    assert result.status is Status.SOLVED_SATISFICING
    assert validate_plan(problem, result.plan).valid
    names = {a.name for a in result.plan.activities}
    assert "visit" not in names
    assert "without" in names
    assert result.metrics["rounds"] == "1"
